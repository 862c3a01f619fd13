//! Requests that have ended the process of the device. A request that has done so twice is refused.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::{Duration, Instant};

use isopeel_extraction::{DeviceRequest, VolumeKey, VolumeRequest, WorkError};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;

/// How often a request may end the process before it is refused.
const MAX_ENDS: u32 = 2;

/// Maximum number of requests that are remembered. Beyond it, those that have ended the process once are forgotten.
const MAX_REMEMBERED: usize = 256;

/// What a request is about: equal for requests that would do the same work.
struct Subject {
    key: u64,
    /// Text for users.
    text: String,
}

/// Time after which a request that has ended the process once is forgotten.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(600);

/// Requests that have ended the process, each with how often, and when it did so last.
#[derive(Default)]
pub(super) struct Blame(HashMap<u64, (u32, Instant)>);

impl Blame {
    /// Records that the process has ended while it ran this request.
    pub(super) fn add(&mut self, request: &DeviceRequest) {
        let Some(subject) = subject(request) else { return };
        let is_full = self.0.len() >= MAX_REMEMBERED;
        self.0
            .retain(|_, (ends, last)| *ends >= MAX_ENDS || (!is_full && last.elapsed() < FORGOTTEN_AFTER));
        let (ends, last) = self.0.entry(subject.key).or_insert((0, Instant::now()));
        (*ends, *last) = (*ends + 1, Instant::now());
        tracing::error!(ends = *ends, "{} has ended the process of the device", subject.text);
    }

    /// Checks whether a request may run.
    ///
    /// # Errors
    /// [`WorkError::EndsProcess`] if it has ended the process twice.
    pub(super) fn check(&self, request: &DeviceRequest) -> Result<(), WorkError> {
        if self.0.is_empty() {
            return Ok(());
        }
        match subject(request) {
            Some(subject) if self.0.get(&subject.key).is_some_and(|&(ends, _)| ends >= MAX_ENDS) => {
                Err(WorkError::EndsProcess { what: subject.text })
            }
            _ => Ok(()),
        }
    }
}

/// Returns what a request is about; `None` for requests that do no work on samples.
fn subject(request: &DeviceRequest) -> Option<Subject> {
    use DeviceRequest as R;
    match request {
        R::Resolve(_) | R::Prepare(_) | R::FindResident(_) | R::UseField(_) | R::UseHistogramFields(_) => None,
        R::DropUpload(_) | R::MakeSpaceAhead(_) | R::MakeHostSpace(_) | R::Release(_) | R::CheckAnswers(_) => None,
        R::Count(request) => Some(of_view(1, request.volume(), &request.view)),
        R::Refine(request) => Some(of_view(1, request.volume(), &request.view)),
        R::Improve(request) => Some(of_view(2, request.volume(), &request.view)),
        R::Measure(request) => Some(of_view(3, request.volume(), &request.view)),
        R::Extract(request) => Some(of_view(4, request.volume(), &request.view)),
        R::Ask(request) => request
            .shown
            .as_ref()
            .map(|shown| of_view(5, request.volume(), &shown.view)),
        R::Compute(request) => Some(of_field(6, &request.key)),
        R::BeginUpload(request) => Some(of_field(7, &request.key)),
        R::ContinueUpload(request) => Some(of_field(7, &request.key)),
        R::ContinueTable(request) => Some(of_field(7, &request.key)),
        R::FinishUpload(request) => Some(of_field(7, &request.key)),
        R::ContinueHistogram(request) => Some(of_field(8, &request.key.volume)),
        R::ContinueOverview(request) => Some(of_field(9, &request.key)),
        R::ReadSamples(request) => Some(of_field(10, &request.key)),
        R::ReadSlice(request) => Some(of_field(10, &request.key)),
    }
}

fn of_view(kind: u8, volume: &VolumeStep, view: &View) -> Subject {
    let id = &volume.dataset().id;
    let text = match view.iso {
        Some(iso) => format!("the surface of {:?} at {} in volume {id:?}", view.field, iso.get()),
        None => format!("the surface of {:?} in volume {id:?}", view.field),
    };
    // A view is compared by all of its values, which its debug text has.
    Subject {
        key: hash(&(kind, volume.key(), format!("{view:?}"))),
        text,
    }
}

fn of_field(kind: u8, key: &VolumeKey) -> Subject {
    let masked = if key.mask.is_some() { " with its mask" } else { "" };
    Subject {
        key: hash(&(kind, key)),
        text: format!("{:?}{masked} of volume {:?}", key.field, key.step.dataset.id),
    }
}

fn hash(value: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}
