//! What a child process does with a driver: it lists devices, builds programs, or checks a device. A line of JSON on its standard output
//! tells its parent each thing it begins, so that a crash or a hang has a name.

use std::io::Write;

use isopeel_kernels::check::{Check, CheckError, STEPS, Scope};
use isopeel_kernels::{DeviceInfo, DeviceKind, Engine, SampleType};
use serde::{Deserialize, Serialize};

use super::setup::{Workaround, type_of};
use crate::error::{BoxError, chain};

/// What a child is asked to do: the argument of `isopeel devices --child`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// List the devices.
    List,
    /// Build the programs of these stages.
    Build {
        /// Position of the device in the list.
        index: usize,
        /// How it is used.
        workaround: Workaround,
        /// Stages, in this order.
        stages: Vec<String>,
        /// Sample types.
        types: Vec<String>,
    },
    /// Check a device.
    Check {
        /// Position of the device in the list.
        index: usize,
        /// How it is used.
        workaround: Workaround,
        /// Sample types.
        types: Vec<String>,
    },
}

/// A line that a child writes.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Message {
    /// A device.
    Device(Description),
    /// A stage begins.
    Begin {
        /// Its name; `open` before the first one.
        stage: String,
        /// Steps that are done.
        done: usize,
        /// Steps in all.
        of: usize,
    },
    /// All that a first surface needs is right.
    FirstSurface,
    /// All is done.
    Done,
    /// What was found wrong.
    Wrong {
        /// The whole sentence.
        text: String,
    },
}

/// A device as a child lists it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Description {
    index: usize,
    platform: String,
    name: String,
    kind: String,
    memory_bytes: u64,
    max_allocation_bytes: u64,
    compute_units: u32,
    max_work_group: usize,
    version: String,
    driver: String,
}

impl From<DeviceInfo> for Description {
    fn from(info: DeviceInfo) -> Self {
        let kind = match info.kind {
            DeviceKind::Gpu => "gpu",
            DeviceKind::Cpu => "cpu",
            DeviceKind::Other => "other",
        };
        Self {
            index: info.index,
            platform: info.platform,
            name: info.name,
            kind: kind.to_owned(),
            memory_bytes: info.memory_bytes,
            max_allocation_bytes: info.max_allocation_bytes,
            compute_units: info.compute_units,
            max_work_group: info.max_work_group,
            version: info.version,
            driver: info.driver,
        }
    }
}

impl From<Description> for DeviceInfo {
    fn from(description: Description) -> Self {
        Self {
            index: description.index,
            platform: description.platform,
            name: description.name,
            kind: match description.kind.as_str() {
                "gpu" => DeviceKind::Gpu,
                "cpu" => DeviceKind::Cpu,
                _ => DeviceKind::Other,
            },
            memory_bytes: description.memory_bytes,
            max_allocation_bytes: description.max_allocation_bytes,
            compute_units: description.compute_units,
            max_work_group: description.max_work_group,
            version: description.version,
            driver: description.driver,
        }
    }
}

/// Does what the parent asks for.
///
/// # Errors
/// Standard output is closed. What a driver says goes to the parent.
pub fn run(request: &Request) -> Result<(), BoxError> {
    match request {
        Request::List => match isopeel_kernels::device::list() {
            Ok(devices) => {
                for device in devices {
                    say(&Message::Device(device.into()))?;
                }
                say(&Message::Done)
            }
            Err(error) => say(&Message::Wrong { text: chain(&error) }),
        },
        Request::Build {
            index,
            workaround,
            stages,
            types,
        } => {
            // The check says what is wrong with a program, and which workaround helps.
            let _ = build(*index, *workaround, stages, types);
            say(&Message::Done)
        }
        Request::Check {
            index,
            workaround,
            types,
        } => check(*index, *workaround, types),
    }
}

fn say(message: &Message) -> Result<(), BoxError> {
    let mut line = serde_json::to_vec(message)?;
    line.push(b'\n');
    let mut out = std::io::stdout().lock();
    out.write_all(&line)?;
    Ok(out.flush()?)
}

fn open(index: usize, workaround: Workaround) -> isopeel_kernels::Result<Engine> {
    let devices = isopeel_kernels::device::list()?;
    let tuning = devices.get(index).and_then(|device| workaround.tuning(device));
    Engine::open_tuned(Some(&index.to_string()), None, tuning)
}

fn sample_types(names: &[String]) -> impl Iterator<Item = SampleType> {
    names.iter().filter_map(|name| type_of(name))
}

fn build(index: usize, workaround: Workaround, stages: &[String], types: &[String]) -> isopeel_kernels::Result<()> {
    let engine = open(index, workaround)?;
    for stage in stages {
        sample_types(types).try_for_each(|sample_type| engine.build_stage(stage, sample_type))?;
    }
    Ok(())
}

/// First what a first surface needs, of all types; then all else.
fn check(index: usize, workaround: Workaround, types: &[String]) -> Result<(), BoxError> {
    let types: Vec<SampleType> = sample_types(types).collect();
    let of = STEPS.len() * types.len();
    let mut done = 0;
    let mut begin = |stage: &str| {
        done += 1;
        say(&Message::Begin {
            stage: stage.to_owned(),
            done: done - 1,
            of,
        })
    };
    say(&Message::Begin {
        stage: "open".to_owned(),
        done: 0,
        of,
    })?;
    let engine = match open(index, workaround) {
        Ok(engine) => engine,
        Err(error) => return say(&Message::Wrong { text: chain(&error) }),
    };
    let mut checks: Vec<Check<'_>> = types.iter().map(|&one| Check::new(&engine, one)).collect();
    for scope in [Scope::FirstSurface, Scope::Rest] {
        for check in &mut checks {
            for step in STEPS.iter().filter(|step| step.scope == scope) {
                begin(step.stage)?;
                if let Err(error) = check.run(step) {
                    return say(&Message::Wrong { text: text_of(&error) });
                }
            }
        }
        if scope == Scope::FirstSurface {
            say(&Message::FirstSurface)?;
        }
    }
    say(&Message::Done)
}

/// An error's chain, a compiler's log shortened to its first lines.
fn text_of(error: &CheckError) -> String {
    const LINES: usize = 6;
    let text = chain(error);
    let mut lines = text.lines();
    let mut short = lines.by_ref().take(LINES).collect::<Vec<_>>().join("\n");
    if lines.next().is_some() {
        short += "\n…";
    }
    short
}
