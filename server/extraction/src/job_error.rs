//! Why a piece of work on a workspace has no result, and what has to be done before it is tried again.

use isopeel_kernels::Error;

use super::WorkError;
use super::keys::{HistogramKey, VolumeKey};

/// Why a piece of work ended without a result.
#[derive(Debug)]
pub enum JobError {
    /// Not all fields that it needs are resident: load them and try again.
    NotResident {
        /// The fields, each with its bytes on the device.
        needed: Vec<(VolumeKey, u64)>,
        /// Maximum bytes of all resident fields together.
        budget: u64,
    },
    /// These histograms are not cached: make them and try again.
    NeedsHistograms(Vec<HistogramKey>),
    /// It is too long for short work: try again as long work.
    TakesLong,
    /// Trying again would not help.
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
    /// For work that uses no volume: only `Failed` is expected of them.
    fn from(halt: JobError) -> Self {
        match halt {
            JobError::Failed(error) => error,
            JobError::NotResident { .. } | JobError::NeedsHistograms(_) | JobError::TakesLong => Self::Stopped,
        }
    }
}
