//! Requests that read a field's samples or compute values from them, and a request for the state of the device.

use std::ops::Range;

use isopeel_kernels::{Histogram, HistogramWork, OverviewPart, OverviewValues, Samples};
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use crate::context::JobContext;
use crate::job_error::JobError;
use crate::keys::{HistogramKey, VolumeKey};
use crate::slices::Slice;
use crate::workspace::Workspace;

type Context<'a, 'b> = &'a mut JobContext<'b, Workspace>;

/// Marks the fields of which a histogram is made as used. See [`Workspace::use_histogram_fields`].
#[derive(Clone, Serialize, Deserialize)]
pub struct UseHistogramFields {
    /// The volume.
    pub volume: VolumeStep,
    /// The histogram.
    pub key: HistogramKey,
}

/// Runs the next slice of the work on a histogram. The reply is the remaining work, and the histogram if it is complete. See
/// [`Workspace::continue_histogram`].
#[derive(Clone, Serialize, Deserialize)]
pub struct ContinueHistogram {
    /// The volume.
    pub volume: VolumeStep,
    /// The histogram.
    pub key: HistogramKey,
    /// The work so far.
    pub work: HistogramWork,
}

/// Computes the values of a part of an overview. See [`Workspace::overview_values`].
#[derive(Clone, Serialize, Deserialize)]
pub struct ContinueOverview {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
    /// The part.
    pub part: OverviewPart,
}

/// Reads planes across z. See [`Workspace::samples`].
#[derive(Clone, Serialize, Deserialize)]
pub struct ReadSamples {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
    /// The planes.
    pub planes: Range<u32>,
}

/// Reads a plane across any axis. See [`Workspace::slice`].
#[derive(Clone, Serialize, Deserialize)]
pub struct ReadSlice {
    /// The volume.
    pub volume: VolumeStep,
    /// The field.
    pub key: VolumeKey,
    /// The axis, 0 to 2.
    pub axis: usize,
    /// The plane.
    pub index: u32,
}

/// Asks whether the device answers.
#[derive(Serialize, Deserialize)]
pub struct CheckAnswers;

impl UseHistogramFields {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<(), JobError> {
        workspace.use_histogram_fields(&self.volume, &self.key)
    }
}

impl ContinueHistogram {
    pub(super) fn perform(
        mut self,
        workspace: &mut Workspace,
        _: Context<'_, '_>,
    ) -> Result<(HistogramWork, Option<Histogram>), JobError> {
        let histogram = workspace.continue_histogram(&self.volume, &self.key, &mut self.work)?;
        Ok((self.work, histogram))
    }
}

impl ContinueOverview {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<OverviewValues, JobError> {
        workspace.overview_values(&self.volume, &self.key, &self.part)
    }
}

impl ReadSamples {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<Samples, JobError> {
        workspace.samples(&self.volume, &self.key, self.planes)
    }
}

impl ReadSlice {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<Slice, JobError> {
        workspace.slice(&self.volume, &self.key, self.axis, self.index)
    }
}

impl CheckAnswers {
    pub(super) fn perform(self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<bool, JobError> {
        Ok(workspace.engine().answers())
    }
}
