//! Arguments that select the device, and how commands open it.

use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};

use isopeel_kernels::{Engine, SampleType};

use crate::device::{DeviceFailure, DeviceRequirements, PendingCheck, Prepared, Proven, Unprepared, cache, prepare};
use crate::service::{Choice, ChoiceError, DeviceOptions, StateReporter};

/// Selects several devices, which `isopeel serve` alone uses.
pub(super) const ALL_DEVICES: &str = "all";

/// Arguments of commands that use one device.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct DeviceArgs {
    /// OpenCL device: an index or a part of a name, as `isopeel devices` lists them [default: the first that passes the check]
    #[arg(long, value_name = "SEL", value_parser = one_device)]
    device: Option<String>,

    /// Use the device of --device without a check, at your own risk: wrong surfaces are not noticed
    #[arg(long, requires = "device")]
    trust_device: bool,

    #[arg(skip)]
    next: NextEnvironment,
}

/// Environment variables that the device needs, but this process does not have. If there are any, another process replaces this one.
#[derive(Clone, Debug, Default)]
pub(super) struct NextEnvironment(Arc<Mutex<Vec<(String, String)>>>);

impl NextEnvironment {
    fn set(&self, variables: Vec<(String, String)>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = variables;
    }

    /// Removes and returns the variables.
    pub(super) fn take(&self) -> Vec<(String, String)> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Why a command has no device.
#[derive(Debug, thiserror::Error)]
pub enum NoDevice {
    /// No device has passed the check.
    #[error(transparent)]
    Failed(#[from] DeviceFailure),
    /// The device that has passed the check cannot be opened.
    #[error(transparent)]
    Open(#[from] isopeel_kernels::Error),
    /// The device needs environment variables that this process does not have.
    #[error("the device needs another environment than that of this process")]
    NewProcess,
}

/// Parses the selector of one device.
fn one_device(selector: &str) -> Result<String, String> {
    if selector == ALL_DEVICES {
        return Err(
            "this command uses one device, expected an index or a part of a name; `isopeel serve` uses several".into(),
        );
    }
    Ok(selector.to_owned())
}

impl DeviceArgs {
    /// Creates the arguments of one of a server's devices.
    pub(super) fn new(device: Option<String>, trust_device: bool, next: NextEnvironment) -> Self {
        Self {
            device,
            trust_device,
            next,
        }
    }

    fn requirements(&self, types: Vec<SampleType>, early: bool) -> DeviceRequirements {
        DeviceRequirements {
            selector: self.device.clone(),
            types,
            trusts: self.trust_device,
            early,
            folder: cache::folder(),
        }
    }

    /// Returns the worker options of a command, which waits for the whole check. Calls `report` with progress for users.
    pub(super) fn options(&self, types: Vec<SampleType>, report: impl Fn(&str) + Send + 'static) -> DeviceOptions {
        let (requirements, next) = (self.requirements(types.clone(), false), self.next.clone());
        let choose = move |_: &StateReporter| {
            let progress =
                |done: usize, of: usize| report(&format!("preparing the device: {done} of {of} steps are done"));
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

    /// Returns the worker options of a server, which can make a first surface while the rest of the check runs.
    pub(super) fn server_options(&self, types: Vec<SampleType>) -> DeviceOptions {
        let (requirements, next) = (self.requirements(types.clone(), true), self.next.clone());
        let choose = move |report: &StateReporter| match prepare(&requirements, &|done, of| report.progress(done, of)) {
            Ok(mut prepared) => {
                let rest = prepared.rest.take();
                let proven = rest.map(|rest| finish_check(rest, report.clone(), next));
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

    /// Returns the outcome of a command, unless the command has failed because the device needs other environment variables. In that case,
    /// replaces this process by one that has these variables and runs the same command.
    pub(super) fn or_restart<T, E>(&self, outcome: Result<T, E>) -> Result<T, E> {
        let environment = self.next.take();
        if outcome.is_err() && !environment.is_empty() {
            let error = restart(environment);
            tracing::error!("a process with the environment that the device needs could not be started: {error}");
        }
        outcome
    }
}

/// Finishes a check in a thread. Returns the programs that have passed so far, which the thread updates. If the check fails, the server
/// ends, or a process with the environment `next` replaces it.
fn finish_check(rest: PendingCheck, report: StateReporter, next: NextEnvironment) -> Arc<Proven> {
    let proven = Arc::new(Proven::default());
    let passed = Arc::clone(&proven);
    // The thread that has started the children must live until they end: it is the caller's, which owns the device.
    std::thread::spawn(move || {
        let outcome = match rest.wait(&|programs| passed.add(programs)) {
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
        passed.end(outcome);
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

/// Replaces this process by one that runs the same command with additional environment variables. Returns only if that fails.
fn restart(environment: Vec<(String, String)>) -> std::io::Error {
    Command::new("/proc/self/exe")
        .args(std::env::args_os().skip(1))
        .envs(environment)
        .exec()
}
