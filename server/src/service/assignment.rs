//! Decides which devices of a server have which datasets.
//!
//! A dataset stays on its device: all of its time steps and fields are there, and viewers of it share the work. A dataset that has no device goes
//! to the device with the most free memory. A dataset leaves a device that cannot be used. If the queue of its devices is longer than it
//! would take to load the dataset on another device, it gets that device too.

use std::cmp::Reverse;
use std::num::NonZeroUsize;
use std::time::Duration;

use lru::LruCache;

/// Maximum number of datasets that are assigned to devices. The one that was asked for least recently is forgotten first, and is assigned
/// again when it is needed.
const MAX_ASSIGNMENTS: NonZeroUsize = NonZeroUsize::new(4096).expect("not zero");

/// Free memory is compared in this many parts of a device's memory, because the caches of a device take or free some memory with each edit.
/// Devices whose free memory is about equal get equally many datasets.
const MEMORY_PARTS: u64 = 16;

/// Minimum time that a copy is assumed to take. A new copy also needs histograms, pyramids and vertex trees.
const MIN_COPY_TIME: Duration = Duration::from_millis(200);

/// Whether a device can be used, from the worst to the best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Usability {
    /// The device was lost, or could not be opened.
    Unusable,
    /// The device is being opened.
    Opening,
    /// The device is open.
    Ready,
}

/// State of a device that decides what is assigned to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeviceLoad {
    pub usability: Usability,
    /// Memory of the device, in bytes.
    pub memory_bytes: u64,
    /// Bytes of it that are in use.
    pub used_bytes: u64,
    /// Expected time until a job that is queued now begins.
    pub wait: Duration,
    /// Bytes of samples that are loaded in a second; `None`: nothing was loaded so far.
    pub load_rate: Option<f64>,
}

/// Why [`Assignments::choose`] has chosen a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reason {
    /// The dataset was there before.
    Resident,
    /// The dataset had no device.
    New,
    /// The devices of the dataset cannot be used.
    Moved,
    /// The queue of the dataset's devices is too long.
    Replicated,
}

/// Where datasets are.
pub(super) struct Assignments(LruCache<Box<str>, Assignment>);

/// The devices of a dataset.
struct Assignment {
    /// Positions of the devices.
    devices: Vec<usize>,
    /// Estimated bytes of the dataset on a device.
    bytes: u64,
}

impl Default for Assignments {
    fn default() -> Self {
        Self(LruCache::new(MAX_ASSIGNMENTS))
    }
}

impl Assignments {
    /// Returns the device for a new caller that needs a dataset, and why. `bytes`: estimated bytes of the dataset on a device. `devices`: all
    /// devices of the server, at least one.
    pub(super) fn choose(&mut self, dataset: &str, bytes: u64, devices: &[DeviceLoad]) -> (usize, Reason) {
        self.leave_unusable(dataset, devices);
        let assignment = self.0.get(dataset);
        let Some(nearest) = assignment.and_then(|assignment| nearest(&assignment.devices, devices)) else {
            let reason = if assignment.is_some() {
                Reason::Moved
            } else {
                Reason::New
            };
            let device = self.emptiest(devices, &[]).unwrap_or(0);
            self.add(dataset, bytes, device);
            return (device, reason);
        };
        match self.replica(dataset, bytes, nearest, devices) {
            Some(device) => {
                self.add(dataset, bytes, device);
                (device, Reason::Replicated)
            }
            None => (nearest, Reason::Resident),
        }
    }

    /// Takes a device from a dataset, because the device cannot be used now. Does nothing if no other device is in a better state.
    pub(super) fn leave(&mut self, dataset: &str, device: usize, devices: &[DeviceLoad]) {
        let usability = devices[device].usability;
        if let Some(assignment) = self.0.get_mut(dataset)
            && devices.iter().any(|other| other.usability > usability)
        {
            assignment.devices.retain(|&other| other != device);
        }
    }

    /// Returns the number of datasets on a device.
    pub(super) fn count(&self, device: usize) -> usize {
        self.0
            .iter()
            .filter(|(_, assignment)| assignment.devices.contains(&device))
            .count()
    }

    /// Takes the devices that cannot be used from a dataset, if another device can.
    fn leave_unusable(&mut self, dataset: &str, devices: &[DeviceLoad]) {
        let is_usable = |load: &DeviceLoad| load.usability > Usability::Unusable;
        if let Some(assignment) = self.0.get_mut(dataset)
            && devices.iter().any(is_usable)
        {
            assignment.devices.retain(|&device| is_usable(&devices[device]));
        }
    }

    fn add(&mut self, dataset: &str, bytes: u64, device: usize) {
        let assignment = self.0.get_or_insert_mut(dataset.into(), || Assignment {
            devices: Vec::new(),
            bytes,
        });
        assignment.bytes = bytes;
        assignment.devices.push(device);
    }

    /// Returns the best device for a dataset that is not on these devices: a ready one before one that is being opened, then the one with the
    /// most free memory, the fewest datasets, and the lowest position. `None` if the dataset is on all devices.
    fn emptiest(&self, devices: &[DeviceLoad], except: &[usize]) -> Option<usize> {
        let others = (0..devices.len()).filter(|device| !except.contains(device));
        others.max_by_key(|&device| {
            let load = &devices[device];
            let part = (load.memory_bytes / MEMORY_PARTS).max(1);
            // Rounded, so that a device that is almost empty counts as empty.
            let free_parts = (self.free_bytes(device, load) + part / 2) / part;
            (load.usability, free_parts, Reverse(self.count(device)), Reverse(device))
        })
    }

    /// Returns the free bytes of a device. Datasets that are assigned to it count even if they are not loaded yet.
    fn free_bytes(&self, device: usize, load: &DeviceLoad) -> u64 {
        let assigned = self
            .0
            .iter()
            .filter(|(_, assignment)| assignment.devices.contains(&device));
        let assigned_bytes = assigned.map(|(_, assignment)| assignment.bytes).sum::<u64>();
        load.memory_bytes.saturating_sub(load.used_bytes.max(assigned_bytes))
    }

    /// Returns a further device for a dataset, if a caller waits there for a shorter time, the loading included, than in the queue of
    /// `nearest`.
    fn replica(&self, dataset: &str, bytes: u64, nearest: usize, devices: &[DeviceLoad]) -> Option<usize> {
        let assignment = self.0.peek(dataset)?;
        let device = self.emptiest(devices, &assignment.devices)?;
        let (there, here) = (&devices[device], &devices[nearest]);
        let rate = there.load_rate.or(here.load_rate).filter(|rate| *rate > 0.0)?;
        let copy = Duration::try_from_secs_f64(bytes as f64 / rate)
            .ok()?
            .max(MIN_COPY_TIME);
        let is_ready = [there, here].iter().all(|load| load.usability == Usability::Ready);
        let has_capacity = self.free_bytes(device, there) >= bytes;
        (is_ready && has_capacity && here.wait > copy + there.wait).then_some(device)
    }
}

/// Returns the device of a dataset with the shortest queue, a ready one before others; `None` if the dataset has no device.
fn nearest(of_dataset: &[usize], devices: &[DeviceLoad]) -> Option<usize> {
    let key = |device: &&usize| {
        let load = &devices[**device];
        (load.usability != Usability::Ready, load.wait)
    };
    of_dataset.iter().min_by_key(key).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    fn ready() -> DeviceLoad {
        DeviceLoad {
            usability: Usability::Ready,
            memory_bytes: 16 * GIB,
            used_bytes: 0,
            wait: Duration::ZERO,
            load_rate: Some(GIB as f64),
        }
    }

    fn with(usability: Usability) -> DeviceLoad {
        DeviceLoad { usability, ..ready() }
    }

    #[test]
    fn datasets_go_to_the_device_with_the_most_free_memory_and_stay_there() {
        let mut assignments = Assignments::default();
        let loads = [
            DeviceLoad {
                used_bytes: 3 * GIB,
                ..ready()
            },
            DeviceLoad {
                used_bytes: GIB,
                ..ready()
            },
        ];
        assert_eq!(assignments.choose("a", 1, &loads), (1, Reason::New));
        let later = [
            ready(),
            DeviceLoad {
                used_bytes: 9 * GIB,
                ..ready()
            },
        ];
        assert_eq!(assignments.choose("a", 1, &later), (1, Reason::Resident));
        assert_eq!(assignments.choose("b", 1, &later), (0, Reason::New));
    }

    #[test]
    fn devices_that_are_about_equally_free_get_equally_many_datasets() {
        let mut assignments = Assignments::default();
        let loads = [
            DeviceLoad {
                used_bytes: GIB / 9,
                ..ready()
            },
            ready(),
        ];
        let chosen = ["a", "b", "c", "d"].map(|dataset| assignments.choose(dataset, 1, &loads).0);
        assert_eq!(chosen, [0, 1, 0, 1]);
        assert_eq!([assignments.count(0), assignments.count(1)], [2, 2]);
    }

    #[test]
    fn datasets_that_are_not_loaded_yet_take_memory() {
        let mut assignments = Assignments::default();
        let loads = [
            ready(),
            DeviceLoad {
                used_bytes: 5 * GIB,
                ..ready()
            },
        ];
        let chosen = ["a", "b", "c", "d", "e"].map(|dataset| assignments.choose(dataset, 3 * GIB, &loads).0);
        assert_eq!(chosen, [0, 0, 1, 1, 0]);
    }

    #[test]
    fn a_dataset_leaves_a_device_that_cannot_be_used_and_stays_where_it_is_replaced_soon() {
        let mut assignments = Assignments::default();
        assignments.choose("a", 1, &[ready(), ready()]);
        let opening = [with(Usability::Opening), ready()];
        assert_eq!(assignments.choose("a", 1, &opening), (0, Reason::Resident));
        assert_eq!(
            assignments.choose("b", 1, &opening),
            (1, Reason::New),
            "ready ones come first"
        );
        let all_lost = [with(Usability::Unusable), with(Usability::Unusable)];
        assert_eq!(assignments.choose("a", 1, &all_lost), (0, Reason::Resident));
        let lost_and_opening = [with(Usability::Unusable), with(Usability::Opening)];
        let mut others = Assignments::default();
        others.choose("a", 1, &[ready(), ready()]);
        assert_eq!(others.choose("a", 1, &lost_and_opening), (1, Reason::Moved));
        let lost = [with(Usability::Unusable), ready()];
        assert_eq!(assignments.choose("a", 1, &lost), (1, Reason::Moved));
        assert_eq!(assignments.choose("a", 1, &[ready(), ready()]), (1, Reason::Resident));
    }

    #[test]
    fn a_dataset_leaves_a_device_only_for_one_that_is_ready() {
        let mut assignments = Assignments::default();
        assignments.choose("a", 1, &[ready(), ready()]);
        let opening = [with(Usability::Opening), with(Usability::Opening)];
        assignments.leave("a", 0, &opening);
        assert_eq!(assignments.choose("a", 1, &opening), (0, Reason::Resident));
        let other_ready = [with(Usability::Opening), ready()];
        assignments.leave("a", 0, &other_ready);
        assert_eq!(assignments.choose("a", 1, &other_ready), (1, Reason::Moved));
    }

    #[test]
    fn a_dataset_is_replicated_if_its_queue_is_longer_than_a_copy_takes() {
        let waiting = |milliseconds| DeviceLoad {
            wait: Duration::from_millis(milliseconds),
            ..ready()
        };
        let chosen = |bytes, loads: &[DeviceLoad]| {
            let mut assignments = Assignments::default();
            assignments.choose("a", bytes, &[ready(), ready()]);
            assignments.choose("a", bytes, loads)
        };
        // A copy takes two seconds.
        assert_eq!(chosen(2 * GIB, &[waiting(1_900), ready()]), (0, Reason::Resident));
        assert_eq!(chosen(2 * GIB, &[waiting(2_100), ready()]), (1, Reason::Replicated));
        assert_eq!(chosen(2 * GIB, &[waiting(2_100), waiting(200)]), (0, Reason::Resident));
        assert_eq!(
            chosen(1, &[waiting(150), ready()]),
            (0, Reason::Resident),
            "the minimum"
        );
        let full = DeviceLoad {
            used_bytes: 15 * GIB,
            ..ready()
        };
        assert_eq!(chosen(2 * GIB, &[waiting(2_100), full]), (0, Reason::Resident));
        let unmeasured = |load| DeviceLoad {
            load_rate: None,
            ..load
        };
        let both = [unmeasured(waiting(2_100)), unmeasured(ready())];
        assert_eq!(chosen(2 * GIB, &both), (0, Reason::Resident));
        assert_eq!(
            chosen(2 * GIB, &[waiting(2_100), with(Usability::Opening)]),
            (0, Reason::Resident)
        );
    }

    #[test]
    fn new_callers_of_a_replicated_dataset_get_the_shorter_queue() {
        let mut assignments = Assignments::default();
        let busy = DeviceLoad {
            wait: Duration::from_secs(9),
            ..ready()
        };
        assignments.choose("a", 1, &[ready(), ready()]);
        assert_eq!(assignments.choose("a", 1, &[busy, ready()]), (1, Reason::Replicated));
        assert_eq!(assignments.choose("a", 1, &[ready(), busy]), (0, Reason::Resident));
        assert_eq!(assignments.choose("a", 1, &[busy, ready()]), (1, Reason::Resident));
        assert_eq!(
            assignments.choose("a", 1, &[ready(), with(Usability::Unusable)]),
            (0, Reason::Resident)
        );
        assert_eq!(assignments.count(1), 0, "it has left the lost device");
    }

    #[test]
    fn only_so_many_datasets_are_remembered() {
        let mut assignments = Assignments::default();
        for n in 0..2 * MAX_ASSIGNMENTS.get() {
            assignments.choose(&n.to_string(), 1, &[ready()]);
        }
        assert_eq!(assignments.count(0), MAX_ASSIGNMENTS.get());
    }
}
