//! Counts the triangles of the full surface of a view. This builds the view's pyramid, which the first step then uses.

use std::time::Instant;

use isopeel_view::View;
use isopeel_volumes::VolumeStep;

use super::FullCount;
use super::context::JobContext;
use super::job_error::JobError;
use super::on_device::Nodes;
use super::workspace::Workspace;

impl Workspace {
    /// Counts the triangles of the full surface of a view, and resolves the view.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn count(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        context: &mut JobContext<'_, Self>,
    ) -> Result<FullCount, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, context, |job, _, _| {
            Ok(FullCount {
                triangles: job.pyramid.full_triangles(),
                stages: job.new_pyramid_stages().to_vec(),
                wall: job.time_without_pauses(start),
            })
        })
    }
}
