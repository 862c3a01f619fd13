//! The devices of a server. Each has a queue, pins, memory and a process of its own. A dataset is on one device, or on several if its queue is
//! long ([`Assignments`]).
//!
//! A viewer or a request has a [`Seat`]: the device that it was given stays the same for a dataset, so that the cuts that the viewer shows stay
//! valid. If that device cannot be used, [`DevicePool::perform`] does the work on another one, where the volume is loaded again.
//!
//! A server with one device takes no decisions: all work goes to that device.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use isopeel_extraction::{EngineId, OpenStepGuard, WorkError, lock};
use isopeel_kernels::DeviceInfo;
use isopeel_volumes::{Dataset, VolumeStep};

use super::assignment::{Assignments, DeviceLoad, Reason, Usability};
use super::device_thread::DeviceState;
use super::worker::DeviceWorker;
use crate::metrics;

/// Maximum time that work waits for a device that is being opened, if another one is ready. A process that has ended is replaced within a
/// second.
const OPENING_LIMIT: Duration = Duration::from_secs(5);

/// Interval at which work that waits longer looks for another device.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// The devices of a server, at least one. Clones are cheap.
#[derive(Clone)]
pub struct DevicePool {
    members: Vec<DeviceWorker>,
    assignments: Arc<Mutex<Assignments>>,
}

/// The device that a viewer or a request was given for a dataset. Clones share it.
#[derive(Clone, Default)]
pub struct Seat(Arc<Mutex<Option<(String, usize)>>>);

/// An error of work on a device.
pub trait DeviceError {
    /// Returns the error of the device, if it is one.
    fn work_error(&self) -> Option<&WorkError>;
}

impl DeviceError for WorkError {
    fn work_error(&self) -> Option<&WorkError> {
        Some(self)
    }
}

impl From<DeviceWorker> for DevicePool {
    fn from(device: DeviceWorker) -> Self {
        Self {
            members: vec![device],
            assignments: Arc::default(),
        }
    }
}

impl DevicePool {
    /// Creates a pool of devices whose numbers are their positions; `None` if there are none.
    pub fn new(members: Vec<DeviceWorker>) -> Option<Self> {
        (!members.is_empty()).then(|| Self {
            members,
            assignments: Arc::default(),
        })
    }

    /// Returns all devices, at least one, in the order of their numbers.
    pub fn members(&self) -> &[DeviceWorker] {
        &self.members
    }

    /// Returns the number of datasets that are assigned to a device. A server with one device assigns none.
    pub fn assigned(&self, device: &DeviceWorker) -> usize {
        lock(&self.assignments).count(device.number().index())
    }

    /// As [`DeviceWorker::charged_to`], for all devices.
    #[must_use]
    pub fn charged_to(&self, user: Option<&str>) -> Self {
        self.map(|member| member.charged_to(user))
    }

    /// As [`DeviceWorker::with_ceiling`], for all devices.
    #[must_use]
    pub fn with_ceiling(&self, triangles: u64) -> Self {
        self.map(|member| member.with_ceiling(triangles))
    }

    fn map(&self, change: impl Fn(&DeviceWorker) -> DeviceWorker) -> Self {
        Self {
            members: self.members.iter().map(change).collect(),
            assignments: Arc::clone(&self.assignments),
        }
    }

    /// As [`DeviceWorker::end_within`], for all devices at once.
    pub fn end_within(self, limit: Duration) -> bool {
        DeviceWorker::end_all_within(self.members, limit)
    }

    /// Waits until a device is open.
    ///
    /// # Errors
    /// As [`DeviceWorker::ready`], if no device can be used: the error of the last one.
    pub async fn ready(&self) -> Result<DeviceInfo, WorkError> {
        let mut outcomes: FuturesUnordered<_> = self.members.iter().map(DeviceWorker::ready).collect();
        let mut last = Err(WorkError::Stopped);
        while let Some(outcome) = outcomes.next().await {
            match outcome {
                Ok(device) => return Ok(device),
                error => last = error,
            }
        }
        last
    }

    /// Resolves when this process can use no device: with the error of the last one, or with `None` if a new process can use a device that
    /// this one cannot. Logs each device that is left out while others can be used.
    pub async fn unusable(&self) -> Option<WorkError> {
        let members = self.members.iter();
        let mut ended: FuturesUnordered<_> = members
            .map(|member| async move { (member.number().index(), member.unusable().await) })
            .collect();
        let mut last = None;
        while let Some((number, outcome)) = ended.next().await {
            let error = outcome?;
            if !ended.is_empty() {
                tracing::warn!(device = number, "device {number} is left out: {error}");
            }
            last = Some(error);
        }
        last
    }

    /// Whether a device answers within the limit, as [`DeviceWorker::answers_within`] says.
    pub async fn answers_within(&self, limit: Duration) -> bool {
        let open = self.members.iter().filter(|member| is_ready(member));
        let mut answers: FuturesUnordered<_> = open.map(|member| member.answers_within(limit)).collect();
        while let Some(answers) = answers.next().await {
            if answers {
                return true;
            }
        }
        false
    }

    /// Returns the engine of the device that works on a volume for this seat.
    pub fn engine(&self, seat: &Seat, volume: &VolumeStep) -> EngineId {
        self.members[self.device_of(seat, volume)].engine()
    }

    /// Returns the device that works on a volume for this seat, if it is open and there are several devices.
    pub fn device(&self, seat: &Seat, volume: &VolumeStep) -> Option<DeviceInfo> {
        if self.members.len() == 1 {
            return None;
        }
        match self.members[self.device_of(seat, volume)].state() {
            DeviceState::Ready(device) => Some(device),
            _ => None,
        }
    }

    /// Marks a time step as open on the device that works on it for this seat, until the returned guard is dropped.
    pub fn mark_open(&self, seat: &Seat, volume: &VolumeStep) -> OpenStepGuard {
        self.members[self.device_of(seat, volume)].mark_open(volume)
    }

    /// Does work on a volume, on the device of the seat. If that device cannot be used, does the work on another one: at once if the device
    /// was lost or could not be opened, after [`OPENING_LIMIT`] if it is being opened.
    ///
    /// # Errors
    /// Those of the work.
    pub async fn perform<T, E, F>(
        &self,
        seat: &Seat,
        volume: &VolumeStep,
        work: impl Fn(DeviceWorker) -> F + Send,
    ) -> Result<T, E>
    where
        E: DeviceError,
        F: Future<Output = Result<T, E>> + Send,
    {
        for _ in 1..self.members.len() {
            let device = self.device_of(seat, volume);
            let outcome = tokio::select! {
                outcome = work(self.members[device].clone()) => outcome,
                () = self.overdue(device) => {
                    self.leave(seat, volume, device);
                    continue;
                }
            };
            match outcome {
                Err(error) if self.must_move(device, &error) => {
                    tracing::debug!(device, "work is done on another device");
                    self.leave(seat, volume, device);
                }
                outcome => return outcome,
            }
        }
        work(self.members[self.device_of(seat, volume)].clone()).await
    }

    /// Returns the position of the device for a seat, which keeps it as long as the device can be used.
    fn device_of(&self, seat: &Seat, volume: &VolumeStep) -> usize {
        if self.members.len() == 1 {
            return 0;
        }
        let dataset = volume.dataset();
        let mut seat = lock(&seat.0);
        let seated = seat.as_ref().filter(|(id, _)| *id == dataset.id);
        if let Some(&(_, device)) = seated.filter(|(_, device)| self.is_usable(*device)) {
            return device;
        }
        let device = self.choose(dataset);
        *seat = Some((dataset.id.clone(), device));
        device
    }

    /// Chooses a device for a dataset.
    fn choose(&self, dataset: &Dataset) -> usize {
        let loads = self.loads();
        let (device, reason) = lock(&self.assignments).choose(&dataset.id, bytes_of(dataset), &loads);
        let (number, volume) = (self.members[device].number(), &dataset.id);
        match reason {
            Reason::Resident => {}
            Reason::New => tracing::debug!(device, volume, "a volume is assigned"),
            Reason::Moved => {
                tracing::warn!(device, volume, "a volume has moved, because its device cannot be used");
                metrics::volume_moved(number);
            }
            Reason::Replicated => {
                tracing::info!(
                    device,
                    volume,
                    "a volume gets a further device, because its queue is long"
                );
                metrics::volume_replicated(number);
            }
        }
        device
    }

    /// Takes a device from a dataset and from a seat.
    fn leave(&self, seat: &Seat, volume: &VolumeStep, device: usize) {
        *lock(&seat.0) = None;
        let loads = self.loads();
        lock(&self.assignments).leave(&volume.dataset().id, device, &loads);
    }

    /// Whether a device is open or will be soon, or no other one is.
    fn is_usable(&self, device: usize) -> bool {
        usability(&self.members[device]) > Usability::Unusable || !self.is_another_better(device)
    }

    /// Whether another device is in a better state.
    fn is_another_better(&self, device: usize) -> bool {
        let own = usability(&self.members[device]);
        self.members.iter().any(|other| usability(other) > own)
    }

    /// Whether work that has failed must be done on another device. Work during which the device was lost is not if the device is being
    /// opened again: it might be the cause.
    fn must_move(&self, device: usize, error: &impl DeviceError) -> bool {
        let usable = match error.work_error() {
            Some(WorkError::Reopening | WorkError::NoDevice(_) | WorkError::Stopped) => Usability::Ready,
            Some(WorkError::DeviceLost) => Usability::Opening,
            _ => return false,
        };
        usability(&self.members[device]) < usable && self.is_another_better(device)
    }

    /// Resolves when a device was not ready for [`OPENING_LIMIT`] and another one is.
    async fn overdue(&self, device: usize) {
        let mut states = self.members[device].states();
        loop {
            let has_thread = states
                .wait_for(|state| !matches!(state, DeviceState::Ready(_)))
                .await
                .is_ok();
            if !has_thread {
                // The work fails at once.
                return std::future::pending().await;
            }
            let mut limit = OPENING_LIMIT;
            loop {
                let opened = states.wait_for(|state| matches!(state, DeviceState::Ready(_)));
                if tokio::time::timeout(limit, opened).await.is_ok() {
                    break;
                }
                if self.members.iter().any(is_ready) {
                    return;
                }
                limit = LOOK_INTERVAL;
            }
        }
    }

    fn loads(&self) -> Vec<DeviceLoad> {
        self.members.iter().map(load).collect()
    }
}

fn usability(member: &DeviceWorker) -> Usability {
    match *member.shared.state.borrow() {
        DeviceState::Ready(_) => Usability::Ready,
        DeviceState::Opening(_) => Usability::Opening,
        DeviceState::Lost | DeviceState::NeedsNewProcess | DeviceState::Failed(_) => Usability::Unusable,
    }
}

fn is_ready(member: &DeviceWorker) -> bool {
    usability(member) == Usability::Ready
}

fn load(member: &DeviceWorker) -> DeviceLoad {
    let memory_bytes = match &*member.shared.state.borrow() {
        DeviceState::Ready(device) => device.memory_bytes,
        _ => 0,
    };
    DeviceLoad {
        usability: usability(member),
        memory_bytes,
        used_bytes: member.shared.memory.borrow().device.in_use,
        wait: member.wait(),
        load_rate: member.shared.load_rate.get(),
    }
}

/// Estimates the bytes of a dataset on a device: those of a time step of all fields that it stores.
fn bytes_of(dataset: &Dataset) -> u64 {
    let sample_bytes: u64 = dataset
        .fields
        .iter()
        .map(|field| field.sample_type.bytes() as u64)
        .sum();
    dataset.geometry.sample_count().saturating_mul(sample_bytes)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use isopeel_volumes::testing;

    use super::*;
    use crate::metrics::DeviceNumber;
    use crate::service::DeviceOptions;

    /// Devices that do not exist, so that this test does the same on every machine.
    fn pool(devices: usize) -> DevicePool {
        let members = (0..devices).map(|index| {
            let options = DeviceOptions {
                number: DeviceNumber::new(index).expect("a number"),
                ..DeviceOptions::unchecked(Some("a device that is nowhere".into()))
            };
            DeviceWorker::start_with(options).expect("a thread")
        });
        DevicePool::new(members.collect()).expect("devices")
    }

    #[tokio::test]
    async fn without_a_device_work_fails_once_and_the_server_ends() {
        let volume = Arc::new(testing::dataset("head", [5, 6, 7], &["a"]));
        let volume = VolumeStep::new(volume, 0).expect("a step");
        for devices in 1..4 {
            let (pool, calls) = (pool(devices), AtomicUsize::new(0));
            let calls = &calls;
            let work = |device: DeviceWorker| async move {
                calls.fetch_add(1, Ordering::Relaxed);
                device.ready().await
            };
            assert!(matches!(pool.unusable().await, Some(WorkError::NoDevice(_))));
            assert!(matches!(pool.ready().await, Err(WorkError::NoDevice(_))));
            assert!(!pool.answers_within(Duration::from_secs(5)).await);
            let outcome = pool.perform(&Seat::default(), &volume, work).await;
            assert!(matches!(outcome, Err(WorkError::NoDevice(_))), "{outcome:?}");
            assert_eq!(calls.load(Ordering::Relaxed), 1, "no device is better");
            assert!(pool.end_within(Duration::from_secs(5)));
        }
    }
}
