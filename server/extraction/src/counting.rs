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
        self.with_pyramid(volume, view, Nodes::All, context, |on, _, _| {
            Ok(FullCount {
                triangles: on.pyramid.full_triangles(),
                stages: on.new_pyramid_stages().to_vec(),
                wall: on.own_time(start),
            })
        })
    }
}
