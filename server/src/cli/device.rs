//! Which device a command uses.

use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};

use isopeel_kernels::{Engine, SampleType};

use crate::device::{DeviceFailure, DeviceRequirements, PendingCheck, Prepared, Proven, Unprepared, cache, prepare};
use crate::service::{Choice, ChoiceError, DeviceOptions, StateReporter};

/// Arguments of commands that use a device.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct DeviceArgs {
    /// OpenCL device: an index or a part of a name, as `isopeel devices` lists them [default: the first that passes the check]
    #[arg(long, value_name = "SEL")]
    device: Option<String>,

    /// Use the device of --device without a check, at your own risk: wrong surfaces are not noticed
    #[arg(long, requires = "device")]
    trust_device: bool,

    #[arg(skip)]
    next: NextEnvironment,
}

/// Environment variables of the process that takes the place of this one; none if there is no need of one.
#[derive(Clone, Debug, Default)]
pub(super) struct NextEnvironment(Arc<Mutex<Vec<(String, String)>>>);

impl NextEnvironment {
    fn set(&self, variables: Vec<(String, String)>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = variables;
    }

    /// Takes the variables.
    pub(super) fn take(&self) -> Vec<(String, String)> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Why a command has no device.
#[derive(Debug, thiserror::Error)]
pub enum NoDevice {
    /// No device passed.
    #[error(transparent)]
    Failed(#[from] DeviceFailure),
    /// The device that passed does not open.
    #[error(transparent)]
    Open(#[from] isopeel_kernels::Error),
    /// Another process can open it.
    #[error("the device needs another environment than that of this process")]
    NewProcess,
}

impl DeviceArgs {
    fn requirements(&self, types: Vec<SampleType>, early: bool) -> DeviceRequirements {
        DeviceRequirements {
            selector: self.device.clone(),
            types,
            trusts: self.trust_device,
            early,
            folder: cache::folder(),
        }
    }

    /// A worker's options for a command: all of the check comes before its first result.
    pub(super) fn options(&self, types: Vec<SampleType>, say: impl Fn(&str) + Send + 'static) -> DeviceOptions {
        let (requirements, next) = (self.requirements(types.clone(), false), self.next.clone());
        let choose = move |_: &StateReporter| {
            let progress =
                |done: usize, of: usize| say(&format!("preparing the device: {done} of {of} steps are done"));
            match prepare(&requirements, &progress) {
                Ok(prepared) => Ok(choice(&prepared, requirements.trusts)),
                Err(Unprepared::Failed(failure)) => Err(ChoiceError::Refused(failure.to_string())),
                Err(Unprepared::NewProcess(environment)) => {
                    next.set(environment);
                    Err(ChoiceError::NewProcess)
                }
            }
        };
        DeviceOptions {
            choose: Box::new(choose),
            types,
            ..DeviceOptions::unchecked(None)
        }
    }

    /// A worker's options for a server, which is ready for a first surface while the rest of the check runs.
    pub(super) fn server_options(&self, types: Vec<SampleType>) -> DeviceOptions {
        let (requirements, next) = (self.requirements(types.clone(), true), self.next.clone());
        let choose = move |report: &StateReporter| match prepare(&requirements, &|done, of| report.progress(done, of)) {
            Ok(mut prepared) => {
                let rest = prepared.rest.take();
                let proven = rest.map(|rest| checked_meanwhile(rest, report.clone(), next));
                Ok(Choice {
                    proven,
                    ..choice(&prepared, requirements.trusts)
                })
            }
            Err(Unprepared::Failed(failure)) => Err(ChoiceError::Refused(failure.to_string())),
            Err(Unprepared::NewProcess(environment)) => {
                next.set(environment);
                Err(ChoiceError::NewProcess)
            }
        };
        DeviceOptions {
            choose: Box::new(choose),
            types,
            ..DeviceOptions::unchecked(None)
        }
    }

    /// Opens the device in this thread.
    ///
    /// # Errors
    /// [`NoDevice`].
    pub(super) fn open(&self) -> Result<Engine, NoDevice> {
        match prepare(&self.requirements(Vec::new(), false), &|_, _| ()) {
            Ok(prepared) => Ok(Engine::open_tuned(prepared.selector.as_deref(), None, prepared.tuning)?),
            Err(Unprepared::Failed(failure)) => Err(failure.into()),
            Err(Unprepared::NewProcess(environment)) => {
                self.next.set(environment);
                Err(NoDevice::NewProcess)
            }
        }
    }

    /// Environment of the process that takes the place of this one.
    pub(super) fn next(&self) -> &NextEnvironment {
        &self.next
    }

    /// Returns the outcome of a command. But if the command failed because the device needs other environment variables, replaces this
    /// process by one that has them and runs the same command.
    pub(super) fn or_restart<T, E>(&self, outcome: Result<T, E>) -> Result<T, E> {
        let environment = self.next.take();
        if outcome.is_err() && !environment.is_empty() {
            let error = start_again(environment);
            tracing::error!("a process with the environment that the device needs could not be started: {error}");
        }
        outcome
    }
}

/// Goes on with a check, whose proven programs are returned. If the device fails, the server ends, or another process
/// with the `next` environment takes its place.
fn checked_meanwhile(rest: PendingCheck, report: StateReporter, next: NextEnvironment) -> Arc<Proven> {
    let proven = Arc::new(Proven::default());
    let found = Arc::clone(&proven);
    // Children end with the thread that started them: the caller's, which is the device's.
    std::thread::spawn(move || {
        let ended = match rest.wait(&|programs| found.add(programs)) {
            Ok(()) => Ok(()),
            Err(Unprepared::Failed(failure)) => {
                tracing::error!("{failure}");
                report.refuse(failure.to_string());
                Err(failure.to_string())
            }
            Err(Unprepared::NewProcess(environment)) => {
                next.set(environment);
                report.need_new_process();
                Err("the server starts again with a workaround for its driver".to_owned())
            }
        };
        found.end(ended);
    });
    proven
}

fn choice(prepared: &Prepared, is_trusted: bool) -> Choice {
    Choice {
        selector: prepared.selector.clone(),
        tuning: prepared.tuning,
        is_trusted,
        proven: None,
    }
}

/// The same command in place of this process, with more in its environment. Returns if that fails.
fn start_again(environment: Vec<(String, String)>) -> std::io::Error {
    Command::new("/proc/self/exe")
        .args(std::env::args_os().skip(1))
        .envs(environment)
        .exec()
}
