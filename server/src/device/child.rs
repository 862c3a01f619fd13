//! The side of the child process: it lists devices, builds programs, or checks a device.
//!
//! The child writes a line of JSON to standard output before each step, so that its parent can attribute a crash or a hang to a step.

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

/// A message of a child to its parent: a line of JSON.
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
    /// A step has passed.
    Passed {
        /// Names of all programs that were built so far, as [`Engine::programs`] returns them.
        programs: Vec<String>,
    },
    /// Everything that a first surface needs has passed.
    FirstSurface,
    /// The request is complete.
    Done,
    /// A permanent error: a retry would fail too.
    Wrong {
        /// Message for users.
        text: String,
    },
    /// An error of the device that may be temporary: a retry may succeed.
    Failed {
        /// Message for users.
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

/// Runs a request of the parent, and reports to the parent.
///
/// # Errors
/// Standard output is closed. Errors of a driver are messages to the parent instead.
pub fn run(request: &Request) -> Result<(), BoxError> {
    match request {
        Request::List => match isopeel_kernels::device::list() {
            Ok(devices) => {
                for device in devices {
                    send(&Message::Device(device.into()))?;
                }
                send(&Message::Done)
            }
            Err(error) => send(&Message::Wrong { text: chain(&error) }),
        },
        Request::Build {
            index,
            workaround,
            programs,
        } => {
            // An error is ignored, because the check builds the same program and reports the error.
            let _ = build(*index, *workaround, programs);
            send(&Message::Done)
        }
        Request::Check {
            index,
            workaround,
            first,
            later,
        } => check(*index, *workaround, first, later),
    }
}

fn send(message: &Message) -> Result<(), BoxError> {
    // The first line break ends a line that the driver may have begun.
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

/// Checks the device: first all that a first surface needs, then the rest. Stops at the first error.
fn check(index: usize, workaround: Workaround, first: &[String], later: &[String]) -> Result<(), BoxError> {
    let of = STEPS.len() * (first.len() + later.len());
    let mut done = 0;
    let mut begin = |stage: &str| {
        done += 1;
        send(&Message::Begin {
            stage: stage.to_owned(),
            done: done - 1,
            of,
        })
    };
    send(&Message::Begin {
        stage: "open".to_owned(),
        done: 0,
        of,
    })?;
    let engine = match open(index, workaround) {
        Ok(engine) => engine,
        // The error is temporary if another process occupies the device.
        Err(error) => return send(&failure(chain(&error), may_be_temporary(&error))),
    };
    let checks = |names| {
        sample_types(names)
            .map(|sample_type| Check::new(&engine, sample_type))
            .collect::<Vec<_>>()
    };
    let (mut first, mut later) = (checks(first), checks(later));
    let mut run = |checks: &mut [Check<'_>], scope| {
        for check in checks {
            for step in STEPS.iter().filter(|step| step.scope == scope) {
                begin(step.stage)?;
                if let Err(error) = check.run(step) {
                    let is_temporary = matches!(&error, CheckError::Failed { source, .. } if may_be_temporary(source));
                    send(&failure(text_of(&error), is_temporary))?;
                    return Ok(false);
                }
                send(&Message::Passed {
                    programs: engine.programs(),
                })?;
            }
        }
        Ok::<_, BoxError>(true)
    };
    if !run(&mut first, Scope::FirstSurface)? {
        return Ok(());
    }
    send(&Message::FirstSurface)?;
    let has_passed =
        run(&mut first, Scope::Rest)? && run(&mut later, Scope::FirstSurface)? && run(&mut later, Scope::Rest)?;
    if has_passed { send(&Message::Done) } else { Ok(()) }
}

fn failure(text: String, is_temporary: bool) -> Message {
    if is_temporary {
        Message::Failed { text }
    } else {
        Message::Wrong { text }
    }
}

/// Whether an error may be temporary: the device was lost or out of memory, perhaps because of other processes.
fn may_be_temporary(error: &Error) -> bool {
    matches!(error, Error::Launch { .. } | Error::OutOfDeviceMemory { .. })
}

/// Returns the messages of an error and of its sources. A long text, such as the log of a compiler, is cut to its first lines.
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
