//! Requests about fields on the device and the memory that they take.

use std::sync::Arc;

use isopeel_kernels::{RectilinearGrid, SampleType, Samples};
use isopeel_volumes::{StepKey, VolumeStep};
use serde::{Deserialize, Serialize};

use crate::context::JobContext;
use crate::grids::padded_grid;
use crate::job_error::JobError;
use crate::keys::VolumeKey;
use crate::workspace::Workspace;

type Context<'a, 'b> = &'a mut JobContext<'b, Workspace>;

/// Asks which fields are resident.
#[derive(Serialize, Deserialize)]
pub struct FindResident {
    /// The fields.
    pub keys: Vec<VolumeKey>,
}

/// Marks a field as used. See [`Workspace::use_field`].
#[derive(Clone, Serialize, Deserialize)]
pub struct UseField {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
}

/// Computes a field from others. See [`Workspace::compute`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Compute {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
    /// The user who is charged for the device time; `None`: no user.
    pub user: Option<Arc<str>>,
}

/// Begins the upload of a field. The reply says whether there is space for it, which only a field that is read ahead can lack. See
/// [`Workspace::begin_upload`] and [`Workspace::begin_upload_ahead`].
#[derive(Serialize, Deserialize)]
pub struct BeginUpload {
    /// The field.
    pub key: VolumeKey,
    /// Grid of the field.
    pub grid: Arc<RectilinearGrid>,
    /// Type of the field's samples.
    pub sample_type: SampleType,
    /// Value of missing samples.
    pub missing: Option<f32>,
    /// If the field is read ahead: maximum bytes of all fields that were read ahead and are not used yet.
    pub ahead_budget: Option<u64>,
}

/// Sends the next samples of a field. See [`Workspace::continue_upload`].
#[derive(Serialize, Deserialize)]
pub struct ContinueUpload {
    /// The field.
    pub key: VolumeKey,
    /// The samples.
    pub samples: Samples,
}

/// Makes the next part of a field's table of minima and maxima. See [`Workspace::continue_table`].
#[derive(Clone, Serialize, Deserialize)]
pub struct ContinueTable {
    /// The field.
    pub key: VolumeKey,
}

/// Makes an uploaded field resident. See [`Workspace::finish_upload`].
#[derive(Serialize, Deserialize)]
pub struct FinishUpload {
    /// The field.
    pub key: VolumeKey,
    /// Whether the field was read ahead.
    pub is_ahead: bool,
}

/// Frees the partial upload of a field. See [`Workspace::drop_upload`].
#[derive(Serialize, Deserialize)]
pub struct DropUpload {
    /// The field.
    pub key: VolumeKey,
}

/// Makes space for a field that is to be read ahead. The reply is false if the field is resident already, or if there is no space. See
/// [`Workspace::make_space_ahead`].
#[derive(Serialize, Deserialize)]
pub struct MakeSpaceAhead {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
    /// Maximum bytes of all fields that were read ahead and are not used yet.
    pub budget: u64,
}

/// Makes sure that the host has this much free memory. See [`Workspace::make_host_space`].
#[derive(Serialize, Deserialize)]
pub struct MakeHostSpace {
    /// Bytes that are needed.
    pub bytes: u64,
}

/// Frees the data of a time step. See [`Workspace::release`].
#[derive(Serialize, Deserialize)]
pub struct Release {
    /// The step.
    pub step: StepKey,
}

impl FindResident {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<Vec<bool>, JobError> {
        Ok(self.keys.iter().map(|key| workspace.is_resident(key)).collect())
    }
}

impl UseField {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.use_field(&self.volume, &self.key)
    }
}

impl Compute {
    pub(super) fn perform(self, workspace: &mut Workspace, context: Context<'_, '_>) -> Result<bool, JobError> {
        workspace.compute(&self.volume, &self.key, self.user.as_deref(), context)
    }
}

impl BeginUpload {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<bool, JobError> {
        let Self {
            key,
            grid,
            sample_type,
            missing,
            ahead_budget,
        } = self;
        match ahead_budget {
            Some(budget) => workspace.begin_upload_ahead(&key, &grid, sample_type, missing, budget),
            None => workspace.begin_upload(key, &grid, sample_type, missing).map(|()| true),
        }
    }
}

impl ContinueUpload {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.continue_upload(&self.key, &self.samples)
    }
}

impl ContinueTable {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<bool, JobError> {
        workspace.continue_table(&self.key)
    }
}

impl FinishUpload {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.finish_upload(self.key, self.is_ahead)
    }
}

impl DropUpload {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.drop_upload(&self.key);
        Ok(())
    }
}

impl MakeSpaceAhead {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<bool, JobError> {
        let grid = padded_grid(&self.volume, self.key.padded)?;
        let sample_bytes = self.key.sample_bytes(&self.volume)?;
        let bytes = workspace.engine().upload_bytes(grid.grid(), sample_bytes);
        Ok(!workspace.is_resident(&self.key) && workspace.make_space_ahead(bytes, self.budget))
    }
}

impl MakeHostSpace {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        Ok(workspace.make_host_space(self.bytes)?)
    }
}

impl Release {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.release(&self.step);
        Ok(())
    }
}
