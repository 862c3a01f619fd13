//! One step from the surface that a client shows to that of its view: what is made next, within about so many triangles.
//!
//! - Nothing shown, or a surface of another isovalue or feature: the final surface if it is small enough, else the finest prefix
//!   that is.
//! - Another cut of the surface that is shown, be it a prefix: regions take their final leaves, as many as the step allows, and the
//!   meshes of these and their neighbours are made. Each step shows a mixed cut, which is watertight like any other.

use std::rc::Rc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, Cut, CutParams, Differences, Level, MAX_LEVEL, Surface};

use super::worker_state::{JobError, Nodes, OnDevice, WorkerState};
use super::{CutId, Shown, Step, WorkError};
use crate::view::View;
use crate::volumes::VolumeStep;

/// Triangles of a leaf of a closed surface.
const TRIANGLES_PER_LEAF: u64 = 2;

/// Share of a step's triangles, in percent, up to which it is the last one, rather than leave a small rest for one more.
const LAST_STEP_PERCENT: u64 = 150;

/// One leaf of a new surface's first prefix stands for at least so many of the final one, so that it is at most 3 % of the bytes: coarse
/// triangles take twice as many.
const FRESH_SHARE: u64 = 70;

/// What a step has made, on the device's thread.
pub(super) struct Made {
    pub surface: Surface,
    pub cut: CutId,
    pub target: CutId,
    pub is_final: bool,
    pub meshing: Duration,
}

impl WorkerState {
    /// Makes a step.
    pub(super) fn refine(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        step: Step,
        ceiling_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<Made, JobError> {
        self.with_pyramid(volume, view, Nodes::All, cancel, |on, view| {
            let kept = step.target.and_then(|id| Some((id, on.cuts.get(id)?)));
            let (params, target_id, target) = match kept {
                Some((id, target)) if target.is_of(on.pyramid) => (on.params_of(view), id, target),
                _ => {
                    let (params, target) = on.target(view, cancel)?;
                    on.check_ceiling(&target, ceiling_triangles, cancel)?;
                    let target = Rc::new(target);
                    (params, on.cuts.keep(Rc::clone(&target)), target)
                }
            };
            let shown = match step.shown {
                Shown::Cut(id) => on.cuts.get(id),
                Shown::Another | Shown::Alike => None,
            };
            let start = Instant::now();
            let next = Next {
                on,
                params: &params,
                target: &target,
                step,
                cancel,
            };
            let (surface, cut) = next.make(shown.as_deref())?;
            Ok(Made {
                surface: on.with_pyramid_stages(surface),
                is_final: cut.is_none(),
                cut: cut.map_or(target_id, |cut| on.cuts.keep(Rc::new(cut))),
                target: target_id,
                meshing: start.elapsed(),
            })
        })
    }
}

/// Whether so many leaves are few enough for the last step.
fn is_last(leaves: u64, triangles: u64) -> bool {
    leaves * TRIANGLES_PER_LEAF * 100 <= triangles.saturating_mul(LAST_STEP_PERCENT)
}

/// A surface and its cut, where that is not the target.
type SurfaceOfCut = (Surface, Option<Cut>);

/// What a step is made from.
struct Next<'a> {
    on: &'a OnDevice<'a>,
    params: &'a CutParams,
    target: &'a Cut,
    step: Step,
    cancel: &'a dyn Cancel,
}

impl Next<'_> {
    fn make(&self, shown: Option<&Cut>) -> Result<SurfaceOfCut, WorkError> {
        let on = self.on;
        let differences = match shown {
            Some(shown) => on.engine.differences(on.volume, on.pyramid, shown, self.target)?,
            None => None,
        };
        match (shown, differences) {
            (Some(shown), Some(differences)) => self.refined(shown, &differences),
            _ if self.step.shown == Shown::Another => self.fresh(),
            // Also where the cut that is shown, or its pyramid, was let go.
            _ => Ok((self.surface(self.target, None)?, None)),
        }
    }

    /// A surface of a cut, or of what differs from the one that is shown.
    fn surface(&self, cut: &Cut, shown: Option<&Cut>) -> Result<Surface, WorkError> {
        let on = self.on;
        Ok(on
            .engine
            .surface(on.volume, on.pyramid, self.params, cut, shown, self.cancel)?)
    }

    /// The first surface of a generation: the target, or the finest prefix that is small enough, or else the coarsest.
    fn fresh(&self) -> Result<SurfaceOfCut, WorkError> {
        let triangles = self.step.fresh_triangles;
        if is_last(self.target.prefix_leaves(Level::FINEST), triangles) {
            return Ok((self.surface(self.target, None)?, None));
        }
        let max_leaves = (self.target.prefix_leaves(Level::FINEST) / FRESH_SHARE).min(triangles / TRIANGLES_PER_LEAF);
        let fits = |level: &Level| self.target.prefix_leaves(*level) <= max_leaves;
        let levels = (1..=MAX_LEVEL.get()).filter_map(|level| Level::new(level).ok());
        let prefix = levels.clone().find(fits).unwrap_or(MAX_LEVEL);
        let on = self.on;
        let cut = on.engine.cut(on.volume, on.pyramid, self.params, prefix)?;
        if cut.prefix_leaves(Level::FINEST) >= self.target.prefix_leaves(Level::FINEST) {
            return Ok((self.surface(self.target, None)?, None));
        }
        Ok((self.surface(&cut, None)?, Some(cut)))
    }

    /// What is shown with the target's leaves in as many regions as the step allows.
    fn refined(&self, shown: &Cut, differences: &Differences) -> Result<SurfaceOfCut, WorkError> {
        let on = self.on;
        let remade = differences.meshes.iter().enumerate().filter(|(_, remake)| **remake);
        let leaves = remade.map(|(region, _)| self.target.region_leaves(region)).sum();
        if is_last(leaves, self.step.triangles) {
            return Ok((self.surface(self.target, Some(shown))?, None));
        }
        let mut take = vec![false; differences.leaves.len()];
        let mut triangles = 0;
        for region in on.pyramid.regions_in_morton_order() {
            if triangles >= self.step.triangles {
                break;
            }
            if differences.leaves[region] {
                take[region] = true;
                triangles += self.target.region_leaves(region) * TRIANGLES_PER_LEAF;
            }
        }
        let mixed = on.engine.mix(on.volume, on.pyramid, shown, self.target, &take)?;
        Ok((self.surface(&mixed, Some(shown))?, Some(mixed)))
    }
}
