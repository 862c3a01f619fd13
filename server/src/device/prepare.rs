//! Selects a device, and checks the device unless it has passed the check before.

use std::collections::VecDeque;
use std::path::PathBuf;

use isopeel_kernels::{DeviceInfo, SampleType, Tuning};
use serde::{Deserialize, Serialize};

use super::building::{Building, Types};
use super::child::Message;
use super::listing::{Listed, list};
use super::run::{Ended, Environment};
use super::setup::{DeviceId, Workaround};
use super::verdicts::Verdicts;

/// Environment variable with the choice of a process, for the process that replaces it. The new process then skips the check.
const CHOSEN: &str = "ISOPEEL_DEVICE_CHOSEN";

/// Requirements on a device.
#[derive(Clone, Debug, Default)]
pub struct DeviceRequirements {
    /// Index of the device, or part of its name; `None`: the first device that passes.
    pub selector: Option<String>,
    /// Sample types that the device must support.
    pub types: Vec<SampleType>,
    /// Whether to use the device without a check.
    pub trusts: bool,
    /// Whether to return as soon as a first surface can be made, and finish the check in the background. The background check includes all
    /// sample types, because volumes of other types may be opened later.
    pub early: bool,
    /// Folder for verdicts; `None`: verdicts are not stored.
    pub folder: Option<PathBuf>,
}

/// A device that may be opened.
pub struct Prepared {
    /// Selector of the device for [`Engine::open_tuned`].
    pub selector: Option<String>,
    /// Settings with which kernels are built and launched; `None`: the defaults of the device.
    pub tuning: Option<Tuning>,
    /// The rest of the check, if it still runs.
    pub rest: Option<PendingCheck>,
}

/// Why this process cannot open a device.
#[derive(Debug)]
pub enum Unprepared {
    /// No device passed.
    Failed(DeviceFailure),
    /// Another process can open a device, with these variables in its environment.
    NewProcess(Environment),
}

/// Why no device is used.
#[derive(Debug, thiserror::Error)]
pub enum DeviceFailure {
    /// No device is listed. The text is the error of the loader, or of the process that lists devices.
    #[error("{0}")]
    Nothing(String),
    /// Two devices of a server need different environments.
    #[error(
        "{device} needs the environment variable {needed}, but another device needs {current}: use them in two servers"
    )]
    Conflict {
        /// The device.
        device: String,
        /// Name and value of the variable that it needs.
        needed: String,
        /// Value of the variable in this process.
        current: String,
    },
    /// No device passed the check.
    #[error(
        "no OpenCL device passes the check, so that none is used:\n{report}\nUpdate or replace the driver (docs/opencl-drivers.md says which \
         were tested), choose another device with --device, or use one all the same, at your own risk, with --device and --trust-device"
    )]
    Unreliable {
        /// One line for each device and workaround that was tried.
        report: String,
    },
}

/// The outcome of checking a device.
#[derive(Clone, Debug)]
pub struct Checked {
    /// The device.
    pub device: DeviceInfo,
    /// Workarounds in the order in which they were tried, each with the failure of its check. A workaround that passed has `None`, and is
    /// the last one. [`Workaround::None`] is the first attempt.
    pub tried: Vec<(Workaround, Option<Ended>)>,
}

impl Checked {
    /// Returns the workaround with which the device passed; `None` if the device failed with all of them.
    pub fn passed(&self) -> Option<Workaround> {
        let (workaround, ended) = self.tried.last()?;
        ended.is_none().then_some(*workaround)
    }

    /// Returns one line for each workaround that failed.
    pub fn report(&self) -> String {
        let device = DeviceId::new(&self.device);
        let failed = self.tried.iter().filter_map(|(workaround, ended)| {
            let ended = ended.as_ref()?;
            Some(format!("  {device}, with {}: {ended}", workaround.text()))
        });
        failed.collect::<Vec<_>>().join("\n")
    }

    /// Whether the device failed with all workarounds, and no failure may be temporary.
    fn is_refused(&self) -> bool {
        let is_permanent = |ended: &Ended| !ended.is_temporary();
        self.tried
            .iter()
            .all(|(_, ended)| ended.as_ref().is_some_and(is_permanent))
    }

    /// Stores the verdict: passed or refused. Removes the stored verdict if the device failed and a failure may be temporary.
    fn store(&self, verdicts: &Verdicts, types: &Types) {
        let id = DeviceId::new(&self.device);
        let stored = match self.passed() {
            Some(workaround) => verdicts.keep(&id, workaround, &types.all()),
            None if self.is_refused() => verdicts.refuse(&id, self.report(), &types.all()),
            None => {
                verdicts.forget(&id);
                Ok(())
            }
        };
        if let Err(error) = stored {
            tracing::warn!(
                "the outcome of the check of {id} cannot be kept, so that the next start checks it again: {error}"
            );
        }
    }

    /// Logs a warning if the device is used with a workaround.
    fn warn_of(&self, workaround: Workaround) {
        if workaround != Workaround::None {
            let (device, how) = (DeviceId::new(&self.device), workaround.text());
            tracing::warn!("{device} is used with {how}, as it fails otherwise:\n{}", self.report());
        }
    }
}

/// A search for a device.
struct Search {
    /// The selector of the requirements.
    selector: Option<String>,
    /// Devices that are not tried yet, preferred first. Devices with a stored refusal come last.
    candidates: VecDeque<DeviceInfo>,
    /// Workarounds with which the first candidate was already tried.
    tried: Vec<(Workaround, Option<Ended>)>,
    /// Reports on the devices that failed in this search.
    refused: Vec<String>,
    types: Types,
    environment: Environment,
    verdicts: Verdicts,
}

/// The device that was selected, and how to use it.
struct Selection {
    /// The selector of the requirements.
    selector: Option<String>,
    device: DeviceInfo,
    workaround: Workaround,
    /// Environment variables with which a process sees the listed devices.
    environment: Environment,
    rest: Option<PendingCheck>,
}

impl Search {
    /// Returns the first candidate that passes. If `early`, returns as soon as a candidate can make a first surface; its check then
    /// continues as `rest` of the selection.
    fn next(mut self, early: bool, progress: &dyn Fn(usize, usize)) -> Result<Selection, DeviceFailure> {
        while let Some(device) = self.candidates.pop_front() {
            let id = DeviceId::new(&device);
            let tried = std::mem::take(&mut self.tried);
            if tried.is_empty()
                && let Some(workaround) = self.verdicts.find(&id, &self.types.all())
            {
                return Ok(self.selected(device, workaround));
            }
            tracing::info!(
                device = device.name,
                "the device has not passed the check of this isopeel yet, and is checked first"
            );
            let (checked, child) = check(&device, &self.types, &self.environment, early, tried, progress);
            let Some(workaround) = checked.passed() else {
                tracing::warn!("{id} is not used:\n{}", checked.report());
                checked.store(&self.verdicts, &self.types);
                self.refused.push(checked.report());
                continue;
            };
            checked.warn_of(workaround);
            let Some(child) = child else {
                checked.store(&self.verdicts, &self.types);
                return Ok(self.selected(device, workaround));
            };
            let (environment, tried) = (self.environment.clone(), checked.tried);
            self.candidates.push_front(device.clone());
            let search = Self { tried, ..self };
            return Ok(Selection {
                selector: search.selector.clone(),
                device,
                workaround,
                environment,
                rest: Some(PendingCheck { child, search }),
            });
        }
        let report = self.refused.join("\n");
        Err(DeviceFailure::Unreliable { report })
    }

    /// Moves devices with a stored refusal behind the others, and logs a warning for each.
    fn try_refused_last(&mut self) {
        let types = self.types.all();
        let (mut others, mut refused) = (VecDeque::new(), Vec::new());
        for device in std::mem::take(&mut self.candidates) {
            match self.verdicts.refusal(&DeviceId::new(&device), &types) {
                Some(report) => refused.push((device, report)),
                None => others.push_back(device),
            }
        }
        if !others.is_empty() {
            for (device, report) in &refused {
                let id = DeviceId::new(device);
                tracing::warn!(
                    "{id} is tried after other devices, because it failed the check before; `isopeel devices --check` checks it \
                     again:\n{report}"
                );
            }
        }
        others.extend(refused.into_iter().map(|(device, _)| device));
        self.candidates = others;
    }

    fn selected(self, device: DeviceInfo, workaround: Workaround) -> Selection {
        Selection {
            selector: self.selector,
            device,
            workaround,
            environment: self.environment,
            rest: None,
        }
    }
}

/// The rest of a check that runs while a device is in use.
pub struct PendingCheck {
    child: Building,
    /// The search to resume if the check fails. Its first candidate is the device in use, and the last entry of `tried` is the workaround
    /// in use.
    search: Search,
}

impl PendingCheck {
    /// Waits for the end of the check, and stores the verdict. Calls `on_passed` with the programs that have passed so far.
    ///
    /// # Errors
    /// The check failed, so this process must not use the device any more. [`Unprepared::NewProcess`] if another device, or the same device
    /// with another workaround, has passed the whole check.
    pub fn wait(self, on_passed: &dyn Fn(Vec<String>)) -> Result<(), Unprepared> {
        let Self { mut child, mut search } = self;
        let on_message = |message| {
            if let Message::Passed { programs } = message {
                on_passed(programs);
            }
        };
        let mut ended = child.follow(false, &on_message).err();
        drop(child);
        let (Some(device), Some((workaround, outcome))) = (search.candidates.front(), search.tried.last_mut()) else {
            return Ok(());
        };
        if let Some(ended_by) = ended.as_ref().filter(|ended| ended.is_temporary()) {
            tracing::warn!("the check of {} is done once more: {ended_by}", device.name);
            let retried = try_once(
                device,
                &search.types,
                *workaround,
                &search.environment,
                false,
                &on_message,
            );
            ended = retried.err();
        }
        *outcome = ended;
        if outcome.is_none() {
            let checked = Checked {
                device: device.clone(),
                tried: std::mem::take(&mut search.tried),
            };
            checked.store(&search.verdicts, &search.types);
            return Ok(());
        }
        search.verdicts.forget(&DeviceId::new(device));
        let selection = search.next(false, &|_, _| ()).map_err(Unprepared::Failed)?;
        Err(selection.new_process())
    }
}

/// The choice that a process passes to the process that replaces it.
#[derive(Serialize, Deserialize)]
struct Chosen {
    /// The selector of the requirements: a server with several devices chooses each by its own.
    selector: Option<String>,
    index: usize,
    workaround: Workaround,
}

/// Chooses a device: the one that the requirements select, or the first that passes the check. Calls `progress` with the number of steps
/// done and the total number of steps.
///
/// # Errors
/// [`Unprepared`].
pub fn prepare(requirements: &DeviceRequirements, progress: &dyn Fn(usize, usize)) -> Result<Prepared, Unprepared> {
    if let Some(chosen) = chosen_before(requirements.selector.as_deref()) {
        return Ok(prepared_as(chosen));
    }
    let listed = list(requirements.folder.as_deref());
    for broken in &listed.broken {
        tracing::warn!(
            "the OpenCL driver of {} is left out: {}",
            broken.icd.display(),
            broken.why
        );
    }
    if listed.devices.is_empty() {
        return Err(Unprepared::Failed(nothing(listed)));
    }
    let candidates = candidates(requirements, &listed);
    let Some(first) = candidates.front() else {
        // No device matches the selector. The error of opening it lists the devices.
        return Ok(Prepared {
            selector: requirements.selector.clone(),
            tuning: None,
            rest: None,
        });
    };
    if requirements.trusts {
        let trusted = Selection {
            selector: requirements.selector.clone(),
            device: first.clone(),
            workaround: Workaround::None,
            environment: listed.environment,
            rest: None,
        };
        return trusted.prepared();
    }
    let mut search = Search {
        selector: requirements.selector.clone(),
        candidates,
        tried: Vec::new(),
        refused: Vec::new(),
        types: Types::new(&requirements.types, requirements.early),
        environment: listed.environment,
        verdicts: Verdicts::new(requirements.folder.as_deref(), &listed.devices),
    };
    search.try_refused_last();
    search
        .next(requirements.early, progress)
        .map_err(Unprepared::Failed)?
        .prepared()
}

/// Checks all devices with all sample types, ignoring stored verdicts, and stores the new ones.
pub fn check_all(folder: Option<PathBuf>, progress: &dyn Fn(usize, usize)) -> (Listed, Vec<Checked>) {
    let listed = list(folder.as_deref());
    let verdicts = Verdicts::new(folder.as_deref(), &listed.devices);
    let types = Types::new(&[], true);
    let checked = listed.devices.iter().map(|device| {
        let (checked, _) = check(device, &types, &listed.environment, false, Vec::new(), progress);
        checked
    });
    let checked: Vec<Checked> = checked.collect();
    checked.iter().for_each(|device| device.store(&verdicts, &types));
    (listed, checked)
}

/// Returns the error for a list without devices.
fn nothing(listed: Listed) -> DeviceFailure {
    if listed.broken.is_empty() {
        return DeviceFailure::Nothing(
            listed
                .why_none
                .unwrap_or_else(|| "there is no OpenCL device".to_owned()),
        );
    }
    let broken = listed.broken.iter();
    let broken = broken.map(|driver| format!("  the driver of {}: {}", driver.icd.display(), driver.why));
    DeviceFailure::Unreliable {
        report: broken.collect::<Vec<_>>().join("\n"),
    }
}

/// Returns the devices that may be used, the preferred one first.
fn candidates(requirements: &DeviceRequirements, listed: &Listed) -> VecDeque<DeviceInfo> {
    let Some(selector) = &requirements.selector else {
        return listed.devices.iter().cloned().collect();
    };
    let position = isopeel_kernels::device::position(&listed.devices, selector);
    position.map(|i| listed.devices[i].clone()).into_iter().collect()
}

/// Checks a device with one workaround after another, except those in `tried`, until the device passes. If `early`, a pass means that a
/// first surface can be made; then also returns the children, which continue with the rest of the check.
fn check(
    device: &DeviceInfo,
    types: &Types,
    environment: &Environment,
    early: bool,
    tried: Vec<(Workaround, Option<Ended>)>,
    progress: &dyn Fn(usize, usize),
) -> (Checked, Option<Building>) {
    let is_untried = |workaround: &Workaround| tried.iter().all(|(before, _)| before != workaround);
    let workarounds: Vec<_> = Workaround::candidates(device).into_iter().filter(is_untried).collect();
    let mut checked = Checked {
        device: device.clone(),
        tried,
    };
    let on_message = |message| {
        if let Message::Begin { done, of, .. } = message {
            progress(done, of);
        }
    };
    for workaround in workarounds {
        let attempt = || try_once(device, types, workaround, environment, early, &on_message);
        // Retries after a failure that may be temporary. Otherwise a needless workaround could pass and be stored.
        let outcome = attempt().or_else(|ended| match ended.is_temporary() {
            true => attempt(),
            false => Err(ended),
        });
        match outcome {
            Ok(child) => {
                checked.tried.push((workaround, None));
                return (checked, early.then_some(child));
            }
            Err(ended) => {
                tracing::debug!("{} with {}: {ended}", device.name, workaround.text());
                checked.tried.push((workaround, Some(ended)));
            }
        }
    }
    (checked, None)
}

/// Checks a device with one workaround, and returns the children. If `early`, returns as soon as a first surface can be made; the children
/// then continue with the rest of the check.
fn try_once(
    device: &DeviceInfo,
    types: &Types,
    workaround: Workaround,
    environment: &Environment,
    early: bool,
    on_message: &dyn Fn(Message),
) -> Result<Building, Ended> {
    let mut environment = environment.clone();
    environment.extend(to_owned_pair(workaround.environment()));
    let mut child = Building::start(device, types, workaround, &environment)?;
    child.follow(early, on_message)?;
    Ok(child)
}

fn to_owned_pair(variable: Option<(&str, &str)>) -> Option<(String, String)> {
    variable.map(|(name, value)| (name.to_owned(), value.to_owned()))
}

impl Selection {
    /// Returns the device, if this process can open it.
    ///
    /// # Errors
    /// [`Unprepared::NewProcess`] if the device needs environment variables that this process does not have. As [`PendingCheck::wait`] if
    /// the rest of the check fails.
    fn prepared(mut self) -> Result<Prepared, Unprepared> {
        let workaround = to_owned_pair(self.workaround.environment());
        let needed: Vec<_> = self.environment.iter().cloned().chain(workaround).collect();
        if let Some(conflict) = self.conflict(&needed) {
            return Err(Unprepared::Failed(conflict));
        }
        let is_set = |(name, value): &(String, String)| std::env::var(name).is_ok_and(|current| current == *value);
        if needed.iter().all(is_set) {
            return Ok(Prepared {
                selector: Some(self.device.index.to_string()),
                tuning: self.workaround.tuning(&self.device),
                rest: self.rest,
            });
        }
        // The next process skips the check, so the whole check must have passed.
        if let Some(rest) = self.rest.take() {
            rest.wait(&|_| ())?;
        }
        Err(self.new_process())
    }

    /// Returns the error that this process has another environment because another of its devices needs that one.
    fn conflict(&self, needed: &Environment) -> Option<DeviceFailure> {
        // The process that is started for a device finds the device without a selection.
        std::env::var_os(CHOSEN)?;
        let different = |(name, value): &(String, String)| {
            let current = std::env::var(name).ok().filter(|current| current != value)?;
            Some(DeviceFailure::Conflict {
                device: DeviceId::new(&self.device).to_string(),
                needed: format!("{name}={value}"),
                current,
            })
        };
        needed.iter().find_map(different)
    }

    /// Returns the environment with which a new process uses the device without another check.
    fn new_process(self) -> Unprepared {
        let mut environment = self.environment;
        environment.extend(to_owned_pair(self.workaround.environment()));
        let chosen = Chosen {
            selector: self.selector,
            index: self.device.index,
            workaround: self.workaround,
        };
        if let Ok(text) = serde_json::to_string(&chosen) {
            environment.push((CHOSEN.to_owned(), text));
        }
        Unprepared::NewProcess(environment)
    }
}

/// Returns the choice of the process that this one replaces, if there was one for this selector.
fn chosen_before(selector: Option<&str>) -> Option<Chosen> {
    let chosen: Chosen = serde_json::from_str(&std::env::var(CHOSEN).ok()?).ok()?;
    (chosen.selector.as_deref() == selector).then_some(chosen)
}

fn prepared_as(chosen: Chosen) -> Prepared {
    // Listing devices in this process is safe: its environment excludes the broken drivers.
    let device = isopeel_kernels::device::list().ok();
    let device = device.as_ref().and_then(|devices| devices.get(chosen.index));
    Prepared {
        selector: Some(chosen.index.to_string()),
        tuning: device.and_then(|device| chosen.workaround.tuning(device)),
        rest: None,
    }
}
