//! Messages between the server and the process of its device.

use std::time::Duration;

use isopeel_extraction::{DeviceReply, DeviceRequest, HistogramKey, JobError, VolumeKey, WorkspaceMemory};
use isopeel_kernels::interned::{self, StaticText};
use isopeel_kernels::{DeviceInfo, Histogram, SampleType, Tuning};
use isopeel_volumes::StepKey;
use serde::{Deserialize, Serialize};

use super::meshes::RegionHead;
use crate::device::CheckState;
use crate::service::scheduler::Length;

/// Number of a job, unique in the server.
pub(super) type JobId = u64;

/// The device to open, and how: the first message to the process.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Start {
    /// As in [`crate::service::Choice`].
    pub selector: Option<String>,
    pub tuning: Option<Tuning>,
    pub is_trusted: bool,
    /// State of the check of the device's programs; `None` if the check is complete.
    pub proven: Option<CheckState>,
    /// As in [`crate::service::DeviceOptions`].
    pub types: Vec<SampleType>,
    pub retries_opening: bool,
    pub surface_bytes: Option<u64>,
    pub request_time: Option<Duration>,
    pub user_time: Option<Duration>,
    /// Maximum bytes of host memory of both processes.
    pub host_bytes: Option<u64>,
    /// Numbers of engines and cuts begin after this one.
    pub last_number: u64,
    /// Process id of the server.
    pub server: u32,
}

/// A message to the process.
#[derive(Serialize, Deserialize)]
pub(super) enum ToDevice {
    /// Opens the device.
    Start(Start),
    /// Queues a job.
    Job {
        id: JobId,
        length: Length,
        /// The edit that the job is for, for the log.
        trace: Option<String>,
        request: DeviceRequest,
    },
    /// Cancels a job.
    Cancel(JobId),
    /// The check of the device's programs has gone on.
    Checked(CheckState),
    /// The volumes that are pinned now.
    Pinned(Vec<VolumeKey>),
    /// The time steps that viewers have open now.
    Open(Vec<StepKey>),
    /// Histograms that the server has cached, and the process has not.
    Histograms(Vec<(HistogramKey, Histogram)>),
}

/// A message from the process.
#[derive(Serialize, Deserialize)]
pub(super) enum FromDevice {
    /// The device is open, with the number of its engine.
    Ready { device: DeviceInfo, engine: u64 },
    /// The device is being opened: steps that are done, of all steps.
    Opening { done: usize, of: usize },
    /// The device was lost, and could not be opened again so far.
    Lost,
    /// Only another process can open the device.
    NeedsNewProcess,
    /// The device cannot be used; the text says why.
    Failed(String),
    /// A job begins to run.
    Begun(JobId),
    /// A job has ended.
    Ended {
        id: JobId,
        /// Without the regions of its surface.
        outcome: Box<Result<DeviceReply, JobError>>,
        /// Regions of the surface, whose arrays are behind the message.
        regions: Vec<RegionHead>,
    },
    /// A job was dropped, because the device is not open.
    Dropped(JobId),
    /// Memory of the workspace, after a job.
    Memory(WorkspaceMemory),
    /// An event for the metrics.
    Observed(Event),
}

/// An event of a workspace.
#[derive(Serialize, Deserialize)]
pub(super) enum Event {
    LookedUp {
        #[serde(deserialize_with = "interned::deserialize")]
        cache: StaticText,
        is_hit: bool,
    },
    Stage {
        #[serde(deserialize_with = "interned::deserialize")]
        stage: StaticText,
        milliseconds: f64,
    },
    DeviceLost,
}
