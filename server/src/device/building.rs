//! The child process that checks a device, and the builders: child processes that compile its programs ahead of the check.

use std::thread::available_parallelism;

use isopeel_extraction::HostMemory;
use isopeel_kernels::{DeviceInfo, Engine, SampleType};

use super::child::{Message, Request};
use super::run::{Ended, Environment, Running};
use super::setup::{TYPES, Workaround, type_name};

/// Stages that a first surface needs, in the order in which builders compile them. The check compiles the same stages in the order of the
/// pipeline, so builders begin at the other end.
const FIRST_STAGES: [&str; 7] = [
    "dual",
    "classify",
    "cut",
    "histogram",
    "construct",
    "activate",
    "minmax",
];

/// Maximum number of builders. More would only wait, because GPU drivers let only one process at a time open a device.
const MAX_BUILDERS: usize = 4;

/// Maximum bytes of a child. Measured: 450 MB with PoCL 3.1, which keeps what it has compiled.
const CHILD_BYTES: u64 = 512 << 20;

/// Returns how many builders there is memory for beside the check.
fn builders() -> usize {
    let processors = available_parallelism().map_or(1, |count| count.get() - 1);
    let memory = HostMemory::now();
    let fit = |&builders: &usize| memory.admit((1 + builders as u64) * CHILD_BYTES).is_ok();
    (1..=processors.clamp(1, MAX_BUILDERS)).rfind(fit).unwrap_or(0)
}

/// Names of the sample types to check.
#[derive(Clone)]
pub(super) struct Types {
    /// Sample types that a first surface needs.
    first: Vec<String>,
    /// Sample types that are checked after `first`: the type of computed fields, and types of volumes that may be opened later.
    later: Vec<String>,
}

impl Types {
    /// Lists the `wanted` types as first. The later types are that of computed fields and, if `all` is set, every other type.
    pub(super) fn new(wanted: &[SampleType], all: bool) -> Self {
        let computed = type_name(SampleType::F32);
        let mut first: Vec<_> = wanted.iter().map(|&wanted| type_name(wanted).to_owned()).collect();
        first.sort();
        first.dedup();
        if first.is_empty() {
            first.push(computed.to_owned());
        }
        let others = TYPES
            .iter()
            .map(|(name, _)| *name)
            .filter(|&name| all && name != computed);
        let later = std::iter::once(computed).chain(others).map(str::to_owned);
        let later = later.filter(|name| !first.contains(name)).collect();
        Self { first, later }
    }

    pub(super) fn all(&self) -> Vec<String> {
        [&self.first[..], &self.later].concat()
    }

    /// Returns stage and sample type of each program, most urgent first.
    fn programs(&self) -> Vec<(String, String)> {
        let others: Vec<_> = Engine::stages().filter(|stage| !FIRST_STAGES.contains(stage)).collect();
        let pairs_of = |stages: &[&str], types: &[String]| {
            let pairs = stages
                .iter()
                .flat_map(|stage| types.iter().map(|name| ((*stage).to_owned(), name.clone())));
            pairs.collect::<Vec<_>>()
        };
        [
            pairs_of(&FIRST_STAGES, &self.first),
            pairs_of(&others, &self.first),
            pairs_of(&FIRST_STAGES, &self.later),
            pairs_of(&others, &self.later),
        ]
        .concat()
    }
}

/// A child that runs the check, and builders that compile the programs that the check needs next.
pub(super) struct Building {
    check: Running,
    /// Builders. Dropping `Building` ends them together with the check.
    builders: Vec<Running>,
}

impl Building {
    pub(super) fn start(
        device: &DeviceInfo,
        types: &Types,
        workaround: Workaround,
        environment: &Environment,
    ) -> Result<Self, Ended> {
        let check = Request::Check {
            index: device.index,
            workaround,
            first: types.first.clone(),
            later: types.later.clone(),
        };
        let check = Running::start(&check, environment)?;
        let mut shares = vec![Vec::new(); builders()];
        for (program, share) in types.programs().into_iter().zip((0..shares.len()).cycle()) {
            shares[share].push(program);
        }
        // A builder that cannot be started is not an error: the check then compiles those programs itself.
        let started = shares.into_iter().filter_map(|programs| {
            let request = Request::Build {
                index: device.index,
                workaround,
                programs,
            };
            Running::start(&request, environment).ok()
        });
        Ok(Self {
            check,
            builders: started.collect(),
        })
    }

    /// Passes the messages of the check to `on_message` until the check ends. If `early`, returns as soon as a first surface can be made;
    /// the children then continue with low priority.
    pub(super) fn follow(&mut self, early: bool, on_message: &dyn Fn(Message)) -> Result<(), Ended> {
        while let Some(message) = self.check.next()? {
            match message {
                Message::FirstSurface if early => {
                    let children = self.builders.iter().chain([&self.check]);
                    children.for_each(Running::lower_priority);
                    return Ok(());
                }
                message => on_message(message),
            }
        }
        Ok(())
    }
}
