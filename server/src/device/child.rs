//! What a child process does with a driver: it lists devices, builds programs, or checks a device. It reports each step that it begins to
//! its parent as a line of JSON on standard output, so that a crash or a hang can be attributed to a step.

use std::io::Write;

use isopeel_kernels::check::{Check, CheckError, STEPS, Scope};
use isopeel_kernels::{DeviceInfo, DeviceKind, Engine, Error, SampleType};
use serde::{Deserialize, Serialize};

use super::setup::{Workaround, sample_type_of};
use crate::error::{BoxError, chain};

/// Request to a child: the argument of `isopeel devices --child`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Request {
    /// List the devices.
    List,
    /// Build the programs of these stages.
    Build {
        /// Position of the device in the list.
        index: usize,
        /// How to use the device.
        workaround: Workaround,
        /// Stage and sample type of each program, in the order in which they are built.
        programs: Vec<(String, String)>,
    },
    /// Check a device.
    Check {
        /// Position of the device in the list.
        index: usize,
        /// How to use the device.
        workaround: Workaround,
        /// Sample types of a first surface.
        first: Vec<String>,
        /// Sample types that are needed after a first surface.
        later: Vec<String>,
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
        /// Name of the stage; `open` while the device is being opened.
        stage: String,
        /// Steps that are done.
        done: usize,
        /// Steps in all.
        of: usize,
    },
    /// A step has passed. These programs were built so far.
    Passed {
        /// Names of the programs, as [`Engine::programs`] returns them.
        programs: Vec<String>,
    },
    /// Everything that a first surface needs has passed.
    FirstSurface,
    /// The request is complete.
    Done,
    /// An error that a retry would not cure.
    Wrong {
        /// The whole sentence.
        text: String,
    },
    /// An error of the device whose cause may be gone at the next attempt.
    Failed {
        /// The whole sentence.
        text: String,
    },
}

/// A device as a child lists it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Description {
    index: usize,
    platform: String,
    platform_version: String,
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
            platform_version: info.platform_version,
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
            platform_version: description.platform_version,
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
            programs,
        } => {
            // The error is ignored: the check reports what is wrong with a program, and which workaround helps.
            let _ = build(*index, *workaround, programs);
            say(&Message::Done)
        }
        Request::Check {
            index,
            workaround,
            first,
            later,
        } => check(*index, *workaround, first, later),
    }
}

fn say(message: &Message) -> Result<(), BoxError> {
    // Begins with a line break, because a driver may have written the start of a line.
    let line = format!("\n{}\n", serde_json::to_string(message)?);
    let mut out = std::io::stdout().lock();
    out.write_all(line.as_bytes())?;
    Ok(out.flush()?)
}

fn open(index: usize, workaround: Workaround) -> isopeel_kernels::Result<Engine> {
    let devices = isopeel_kernels::device::list()?;
    let tuning = devices.get(index).and_then(|device| workaround.tuning(device));
    Engine::open_tuned(Some(&index.to_string()), None, tuning)
}

fn sample_types(names: &[String]) -> impl Iterator<Item = SampleType> {
    names.iter().filter_map(|name| sample_type_of(name))
}

fn build(index: usize, workaround: Workaround, programs: &[(String, String)]) -> isopeel_kernels::Result<()> {
    let engine = open(index, workaround)?;
    let mut known = programs
        .iter()
        .filter_map(|(stage, name)| Some((stage, sample_type_of(name)?)));
    known.try_for_each(|(stage, sample_type)| engine.build_stage(stage, sample_type))
}

/// Checks first what a first surface needs, then the rest.
fn check(index: usize, workaround: Workaround, first: &[String], later: &[String]) -> Result<(), BoxError> {
    let of = STEPS.len() * (first.len() + later.len());
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
        // Another process may occupy the device for now.
        Err(error) => return say(&failure(chain(&error), may_pass(&error))),
    };
    let checks = |names| {
        sample_types(names)
            .map(|one| Check::new(&engine, one))
            .collect::<Vec<_>>()
    };
    let (mut first, mut later) = (checks(first), checks(later));
    let mut run = |checks: &mut [Check<'_>], scope| {
        for check in checks {
            for step in STEPS.iter().filter(|step| step.scope == scope) {
                begin(step.stage)?;
                if let Err(error) = check.run(step) {
                    let is_temporary = matches!(&error, CheckError::Failed { source, .. } if may_pass(source));
                    say(&failure(text_of(&error), is_temporary))?;
                    return Ok(false);
                }
                say(&Message::Passed {
                    programs: engine.programs(),
                })?;
            }
        }
        Ok::<_, BoxError>(true)
    };
    if !run(&mut first, Scope::FirstSurface)? {
        return Ok(());
    }
    say(&Message::FirstSurface)?;
    let all_right =
        run(&mut first, Scope::Rest)? && run(&mut later, Scope::FirstSurface)? && run(&mut later, Scope::Rest)?;
    if all_right { say(&Message::Done) } else { Ok(()) }
}

/// Returns the message for an error.
fn failure(text: String, is_temporary: bool) -> Message {
    if is_temporary {
        Message::Failed { text }
    } else {
        Message::Wrong { text }
    }
}

/// Whether an error may have a temporary cause: the device was lost or out of memory, perhaps because of other processes.
fn may_pass(error: &Error) -> bool {
    matches!(error, Error::Launch { .. } | Error::OutOfDeviceMemory { .. })
}

/// Returns an error's chain, with a compiler's log shortened to its first lines.
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
