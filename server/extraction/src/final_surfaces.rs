//! Makes final surfaces of views, and measures how far they are from the undecimated surfaces.

use std::sync::Arc;
use std::time::Instant;

use isopeel_kernels::{Cancel, CutParams, Mesher, RefinementCost, Surface};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;

use super::context::JobContext;
use super::decisions::{Decided, TreeMaking};
use super::job_error::JobError;
use super::on_device::{Nodes, OnDevice};
use super::results::{Making, Refining};
use super::workspace::Workspace;
use super::{Extraction, MeasuredError, Measurement};

impl Workspace {
    /// Makes the final surface as `making` says, from a cached pyramid if there is one. The surface's stages are those of this job alone. It
    /// has no values for colours: files have the values of any number of fields instead.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn extract(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Extraction, JobError> {
        let start = Instant::now();
        let mut view = View {
            color_field: None,
            ..view.clone()
        };
        let (surface, refined, wall) =
            self.with_pyramid(volume, &mut view, Nodes::OfTheView, context, |job, view, cancel| {
                let (surface, refined) = job.final_surface(view, making, cancel)?;
                Ok((surface, refined, job.time_without_pauses(start)))
            })?;
        Ok(Extraction {
            surface,
            view,
            wall,
            measured: None,
            refined,
        })
    }

    /// Measures the error of a view's final surface, which the dual mesher has made. The surface is a cut of the vertex tree if
    /// `view.fitted` says so and the tree can be built, else a cut of cubes. `None` if the surface has no triangles.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn measure(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Option<Measurement>, JobError> {
        self.with_pyramid(volume, view, Nodes::OfTheView, context, |job, view, cancel| {
            let is_tree_cut = view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
            let tree_error = if is_tree_cut {
                job.measure_tree(view, cancel)?
            } else {
                None
            };
            let measured = match tree_error {
                Some(measured) => measured,
                None => {
                    let params = job.params_of(view);
                    job.engine.measure_error(job.volume, job.pyramid, &params, cancel)?
                }
            };
            let in_world = |error| MeasuredError::in_world(error, job.smallest);
            let regions = measured.regions.into_iter();
            Ok(in_world(measured.whole).map(|whole| Measurement {
                whole,
                regions: regions
                    .filter_map(|(region, error)| Some((region, in_world(error)?)))
                    .collect(),
            }))
        })
    }
}

impl OnDevice<'_> {
    /// Makes the final surface. Returns it with the cost of refining, if it was refined.
    fn final_surface(
        &self,
        view: &mut View,
        making: Making,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, Option<RefinementCost>), JobError> {
        let Making {
            ceiling,
            measures,
            refining,
        } = making;
        let refines = refining != Refining::Never;
        let (params, cut) = if view.is_by_error() {
            // If the surface is to be refined, its error is measured after the refinement.
            let making_tree = TreeMaking {
                state_error: measures && !refines,
                ..TreeMaking::whole(ceiling)
            };
            match self.decide(view, making_tree, true, cancel)? {
                Decided::Tree(_) if refines => {
                    let (surface, cost) = self.refined_tree_surface(view, making, cancel)?;
                    return Ok((surface, Some(cost)));
                }
                Decided::Tree(made) => return Ok((made.surface, None)),
                Decided::Cubes { params, cut, .. } => (params, cut),
            }
        } else {
            let (params, cut) = self.cut_within(view, ceiling, cancel)?;
            (params, Arc::new(cut))
        };
        let params = CutParams {
            state_error: measures && params.mesher == Mesher::Dual,
            ..params
        };
        let surface = self
            .engine
            .surface(self.volume, self.pyramid, &params, &cut, None, cancel)?;
        Ok((self.complete(surface, cancel)?, None))
    }
}
