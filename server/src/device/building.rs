//! The check of a device in a child process, and child processes that compile programs ahead of it.

use std::thread::available_parallelism;

use isopeel_kernels::{DeviceInfo, Engine, SampleType};

use super::child::{Message, Request};
use super::run::{Ended, Environment, Running};
use super::setup::{TYPES, Workaround, type_name};

/// Stages that a first surface needs. The check compiles them in the order of need, so builders begin with those that it needs last.
const FIRST_STAGES: [&str; 7] = [
    "dual",
    "classify",
    "cut",
    "histogram",
    "construct",
    "activate",
    "minmax",
];

/// Maximum concurrent compiler processes. More would only wait, because drivers of GPUs let processes open a device one after another.
const MAX_BUILDERS: usize = 4;

/// Names of the sample types to check.
#[derive(Clone)]
pub(super) struct Types {
    /// Sample types that a first surface needs.
    first: Vec<String>,
    /// Sample types that are checked after the first ones: that of computed fields, and those of volumes that may be opened later.
    later: Vec<String>,
}

impl Types {
    /// `all`: whether to check the other sample types too, after the wanted ones.
    pub(super) fn new(wanted: &[SampleType], all: bool) -> Self {
        let computed = type_name(SampleType::F32);
        let mut first: Vec<_> = wanted.iter().map(|&one| type_name(one).to_owned()).collect();
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

    /// Stage and type of all programs, in the order of need.
    fn programs(&self) -> Vec<(String, String)> {
        let others: Vec<_> = Engine::stages().filter(|stage| !FIRST_STAGES.contains(stage)).collect();
        let of = |stages: &[&str], types: &[String]| {
            let pairs = stages
                .iter()
                .flat_map(|stage| types.iter().map(|one| ((*stage).to_owned(), one.clone())));
            pairs.collect::<Vec<_>>()
        };
        [
            of(&FIRST_STAGES, &self.first),
            of(&others, &self.first),
            of(&FIRST_STAGES, &self.later),
            of(&others, &self.later),
        ]
        .concat()
    }
}

/// A child that runs the check, and others that compile what it needs next.
pub(super) struct Building {
    check: Running,
    /// Children that compile ahead of the check. They are dropped together with it, which ends them.
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
        let builders = available_parallelism()
            .map_or(1, |count| count.get() - 1)
            .clamp(1, MAX_BUILDERS);
        let mut shares = vec![Vec::new(); builders];
        for (at, program) in types.programs().into_iter().enumerate() {
            shares[at % builders].push(program);
        }
        // A builder that cannot be started is left out: the check then compiles those programs itself.
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

    /// Forwards the messages of the check until it ends; if `early`, until a first surface can be made. The children then continue with low
    /// priority.
    pub(super) fn follow(&mut self, early: bool, hear: &dyn Fn(Message)) -> Result<(), Ended> {
        while let Some(message) = self.check.next()? {
            match message {
                Message::FirstSurface if early => {
                    let children = self.builders.iter().chain([&self.check]);
                    children.for_each(Running::lower_priority);
                    return Ok(());
                }
                message => hear(message),
            }
        }
        Ok(())
    }
}
