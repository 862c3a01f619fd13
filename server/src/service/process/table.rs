//! Jobs that were sent to the process of the device and have no outcome yet.

use std::collections::HashMap;

use isopeel_extraction::{ContinueUpload, DeviceReply, DeviceRequest, JobError, WorkError};
use isopeel_kernels::Samples;
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::DropGuard;

use super::messages::JobId;
use crate::service::job::Requester;

/// A job without an outcome.
pub(super) struct Pending {
    /// The request, without samples; `None` until it was sent.
    pub request: Option<DeviceRequest>,
    pub requester: Box<dyn Requester>,
    /// Released when the job ends.
    pub _permit: Option<OwnedSemaphorePermit>,
    /// Ends the task that forwards the job's cancellation.
    pub _forwarding: DropGuard,
    /// Position in the order in which jobs begin; `None` before the job begins.
    pub begun: Option<u64>,
}

/// Jobs without an outcome.
#[derive(Default)]
pub(super) struct Table {
    jobs: HashMap<JobId, Pending>,
    /// Number of jobs that have begun so far.
    begun: u64,
}

impl Table {
    pub(super) fn insert(&mut self, id: JobId, job: Pending) {
        self.jobs.insert(id, job);
    }

    /// Stores the request of a job, unless the job has ended.
    pub(super) fn set_request(&mut self, id: JobId, request: DeviceRequest) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.request = Some(request);
        }
    }

    /// Whether a job has no outcome yet.
    pub(super) fn contains(&self, id: JobId) -> bool {
        self.jobs.contains_key(&id)
    }

    /// Records that a job begins to run.
    pub(super) fn begin(&mut self, id: JobId) {
        if let Some(job) = self.jobs.get_mut(&id) {
            self.begun += 1;
            job.begun = Some(self.begun);
            job.requester.begun();
        }
    }

    /// Whether a job is running.
    pub(super) fn is_running(&self) -> bool {
        self.jobs.values().any(|job| job.begun.is_some())
    }

    /// Removes a job, and gives its caller the outcome.
    pub(super) fn end(&mut self, id: JobId, outcome: Result<DeviceReply, JobError>) {
        if let Some(job) = self.jobs.remove(&id) {
            job.requester.ended(outcome);
        }
    }

    /// Removes a job without an outcome: its caller reads the reason from the device's state.
    pub(super) fn remove(&mut self, id: JobId) {
        self.jobs.remove(&id);
    }

    /// Returns the request of the job that began last, which is running.
    pub(super) fn running(&self) -> Option<&DeviceRequest> {
        let begun = self.jobs.values().filter(|job| job.begun.is_some());
        begun.max_by_key(|job| job.begun)?.request.as_ref()
    }

    /// Removes all jobs, because the process has ended. Callers of jobs that have begun get the error that the device was lost.
    pub(super) fn end_all(&mut self) {
        for (_, job) in self.jobs.drain() {
            job.requester.ended(Err(match job.begun {
                None => JobError::NotBegun,
                Some(_) => WorkError::DeviceLost.into(),
            }));
        }
    }
}

/// Returns a request without its samples, which would take memory until the job ends.
pub(super) fn without_samples(request: DeviceRequest) -> DeviceRequest {
    match request {
        DeviceRequest::ContinueUpload(upload) => ContinueUpload {
            samples: Samples::U8(Vec::new()),
            ..upload
        }
        .into(),
        request => request,
    }
}
