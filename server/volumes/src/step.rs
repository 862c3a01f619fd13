//! One time step of a dataset, and the keys that identify its samples.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Dataset;

/// One time step of a dataset.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct VolumeStep {
    dataset: Arc<Dataset>,
    step: u32,
}

isopeel_kernels::checked_serde!(VolumeStep, |volume| VolumeStep::new(
    volume.dataset.clone(),
    volume.step
));

impl VolumeStep {
    /// # Errors
    /// The dataset has no such step.
    pub fn new(dataset: Arc<Dataset>, step: u32) -> Result<Self, UnknownStep> {
        if step >= dataset.steps {
            return Err(UnknownStep {
                dataset: dataset.id.clone(),
                step,
                steps: dataset.steps,
            });
        }
        Ok(Self { dataset, step })
    }

    /// The dataset.
    pub fn dataset(&self) -> &Arc<Dataset> {
        &self.dataset
    }

    /// The time step, below the dataset's `steps`.
    pub fn step(&self) -> u32 {
        self.step
    }

    /// Returns the key that identifies the samples.
    pub fn key(&self) -> StepKey {
        StepKey {
            dataset: self.dataset.key(),
            step: self.step,
            rewrites: self.dataset.rewrites(self.step),
        }
    }
}

/// Identity of a dataset: two with one key have the same grid and the same fields.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DatasetKey {
    /// Its id.
    pub id: String,
    /// Incremented when another dataset takes the id.
    pub revision: u32,
}

/// Identity of the samples of one time step: two with one key have the same samples in every field.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StepKey {
    /// Key of the dataset.
    pub dataset: DatasetKey,
    /// The time step.
    pub step: u32,
    /// How often its files were rewritten since the server opened the dataset.
    pub rewrites: u32,
}

/// A time step that a dataset does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {step} of volume {dataset:?}, expected 0 to {}", steps.saturating_sub(1))]
pub struct UnknownStep {
    /// Id of the dataset.
    pub dataset: String,
    /// The requested step.
    pub step: u32,
    /// Number of steps of the dataset.
    pub steps: u32,
}
