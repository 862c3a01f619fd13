//! Why a piece of work on a workspace has no result, and what to do before the work is tried again.

use isopeel_kernels::Error;
use serde::{Deserialize, Serialize};

use super::WorkError;
use super::keys::{HistogramKey, VolumeKey};

/// Why a piece of work ended without a result.
#[derive(Debug, Serialize, Deserialize)]
pub enum JobError {
    /// Not all fields that the work needs are resident: load them and try again.
    NotResident {
        /// The fields, each with its bytes on the device.
        needed: Vec<(VolumeKey, u64)>,
        /// Maximum bytes of all resident fields together.
        budget: u64,
    },
    /// These histograms are not cached: make them and try again.
    NeedsHistograms(Vec<HistogramKey>),
    /// The work takes longer than short work may: try again as long work.
    TakesLong,
    /// The process that has the device ended before the work began: try again.
    NotBegun,
    /// The work failed, and trying again would not help.
    Failed(WorkError),
}

impl From<WorkError> for JobError {
    fn from(error: WorkError) -> Self {
        Self::Failed(error)
    }
}

impl From<Error> for JobError {
    fn from(error: Error) -> Self {
        Self::Failed(error.into())
    }
}

impl From<JobError> for WorkError {
    /// Converts the error of work that uses no volume. Such work fails with `Failed` only.
    fn from(error: JobError) -> Self {
        match error {
            JobError::Failed(error) => error,
            JobError::NotBegun => Self::DeviceLost,
            JobError::NotResident { .. } | JobError::NeedsHistograms(_) | JobError::TakesLong => Self::Stopped,
        }
    }
}
