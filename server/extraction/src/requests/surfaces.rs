//! Requests about a view of a volume.

use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use crate::context::JobContext;
use crate::job_error::JobError;
use crate::questions::{Answer, Question, ShownSurface};
use crate::results::{Extraction, FullCount, Making, Measurement, Refinement, Step};
use crate::workspace::Workspace;

type Context<'a, 'b> = &'a mut JobContext<'b, Workspace>;

/// Fills in the values that depend on the data: the default isovalue and the feature's own range. See [`Workspace::resolve`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Resolve {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
}

/// Resolves a view, and marks as used the fields of which its surface is made. See [`Workspace::prepare`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Prepare {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
}

/// Counts the triangles of the full surface. See [`Workspace::count`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Count {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
}

/// Makes a step from the surface that a client shows to that of a view. See [`Workspace::refine`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Refine {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
    /// The step.
    pub step: Step,
    /// Maximum triangles of the final surface.
    pub ceiling: u64,
}

/// Makes the final surface as a cut of the vertex tree. See [`Workspace::improve`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Improve {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
    /// Maximum triangles.
    pub ceiling: u64,
}

/// Measures how far the final surface of a view is from the undecimated one. See [`Workspace::measure`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Measure {
    /// The volume.
    pub volume: VolumeStep,
    /// The view, whose budget is fitted.
    pub view: View,
}

/// Makes the final surface. See [`Workspace::extract`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Extract {
    /// The volume.
    pub volume: VolumeStep,
    /// The view.
    pub view: View,
    /// How the surface is made.
    pub making: Making,
}

/// Asks about the surface that is shown. See [`Workspace::answer`].
#[derive(Clone, Serialize, Deserialize)]
pub struct Ask {
    /// The volume.
    pub volume: VolumeStep,
    /// The surface; `None` if no surface is shown.
    pub shown: Option<ShownSurface>,
    /// The question.
    pub question: Question,
}

impl Resolve {
    pub(super) fn perform(mut self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<View, JobError> {
        workspace.resolve(&self.volume, &mut self.view)?;
        Ok(self.view)
    }
}

impl Prepare {
    pub(super) fn perform(mut self, workspace: &mut Workspace, _: Context<'_, '_>) -> Result<View, JobError> {
        workspace.prepare(&self.volume, &mut self.view)?;
        Ok(self.view)
    }
}

impl Count {
    pub(super) fn perform(
        mut self,
        workspace: &mut Workspace,
        context: Context<'_, '_>,
    ) -> Result<FullCount, JobError> {
        workspace.count(&self.volume, &mut self.view, context)
    }
}

impl Refine {
    pub(super) fn perform(
        mut self,
        workspace: &mut Workspace,
        context: Context<'_, '_>,
    ) -> Result<Refinement, JobError> {
        workspace.refine(&self.volume, &mut self.view, self.step, self.ceiling, context)
    }
}

impl Improve {
    pub(super) fn perform(
        mut self,
        workspace: &mut Workspace,
        context: Context<'_, '_>,
    ) -> Result<Option<Refinement>, JobError> {
        workspace.improve(&self.volume, &mut self.view, self.ceiling, context)
    }
}

impl Measure {
    pub(super) fn perform(
        mut self,
        workspace: &mut Workspace,
        context: Context<'_, '_>,
    ) -> Result<Option<Measurement>, JobError> {
        workspace.measure(&self.volume, &mut self.view, context)
    }
}

impl Extract {
    pub(super) fn perform(self, workspace: &mut Workspace, context: Context<'_, '_>) -> Result<Extraction, JobError> {
        workspace.extract(&self.volume, &self.view, self.making, context)
    }
}

impl Ask {
    pub(super) fn perform(self, workspace: &mut Workspace, context: Context<'_, '_>) -> Result<Answer, JobError> {
        workspace.answer(&self.volume, self.shown.as_ref(), self.question, context)
    }
}
