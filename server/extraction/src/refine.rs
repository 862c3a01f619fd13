//! One step from the surface that a client shows to that of its view: decides which part is made next, within limits on triangles and
//! bytes.
//!
//! - If nothing is shown, or a surface of another isovalue or feature, the step makes the final surface if it is small enough, else the
//!   finest prefix that is small enough. If fitting a budget takes long, a prefix that depends on no budget is made first.
//! - If another cut of the same surface is shown, such as a prefix, the step replaces the leaves of some regions by the final ones, up to
//!   the limits of the step, and makes the meshes of these regions and their neighbours. Each such step shows a mixed cut, which is
//!   watertight like any other. On a slow line the finest prefix that is small enough comes before that.
//! - If an error or a budget decides, the final surface is a cut of the vertex tree, provided that the tree is built or soon will be: on a
//!   GPU, unless the full surface is too large. Otherwise the tree is cut when the viewer is at rest ([`Refinement::can_improve`]), and
//!   until then the surface is a cut of cubes. If parts are to be removed, the cut of cubes is an intermediate step, and the cut of the
//!   tree the last one. On a slow line a cut of the tree comes after coarser ones ([`tree_steps`]).

use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, Cut, CutParams, DeviceKind, Differences, Kept, Level, MAX_LEVEL, Surface, lock};
use isopeel_view::View;
use isopeel_view::quality::Budget;
use isopeel_volumes::VolumeStep;

use super::chunk_bytes::{self, BYTES_OF_100_COARSE_TRIANGLES, BYTES_OF_100_TRIANGLES};
use super::context::JobContext;
use super::decisions::{Decided, TreeMaking};
use super::job_error::JobError;
use super::on_device::{Nodes, OnDevice};
use super::tree_steps;
use super::workspace::Workspace;
use super::{CutId, Refinement, Shown, Step, WorkError};

/// Triangles of a closed surface per leaf.
const TRIANGLES_PER_LEAF: u64 = 2;

/// The last step may have up to this percentage of a step's triangles, so that a small remainder needs no further step.
const LAST_STEP_PERCENT: u64 = 150;

/// If a view has an error but no budget, the final surface is assumed to have the full surface's triangles divided by this number.
const EXPECTED_DIVISOR: u64 = 4;

/// A prefix that is made before the budget is fitted has at most this share of the budget's triangles, in percent.
const UNFITTED_PERCENT: u64 = 20;

/// A prefix that follows a coarser one may have the bytes of this many steps. Refining region by region instead would send these bytes more
/// than once, and the surface would look uneven meanwhile.
const NEXT_PREFIX_STEPS: u64 = 6;

/// A step replaces at least the target's leaves divided by this number. Each step resends the regions at its border, so on a slow line
/// smaller steps would send everything three times.
const MAX_STEPS: u64 = 12;

/// Maximum triangles of a new surface's first prefix, however fast the device is: any client can draw them at once, even in software.
const MAX_PREFIX_TRIANGLES: u64 = 30_000;

/// A new surface's first prefix has at most this share of the final bytes, in percent, so that it arrives at once.
const FRESH_PERCENT: u64 = 3;

/// Result of a step.
struct StepResult {
    surface: Surface,
    cut: CutId,
    target: Option<CutId>,
    is_final: bool,
    meshing: Duration,
}

impl Workspace {
    /// Makes a step.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn refine(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        step: Step,
        ceiling_triangles: u64,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Refinement, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, context, |job, view, cancel| {
            let is_first = step.shown == Shown::Another && step.target.is_none();
            let full = job.pyramid.full_triangles();
            let builds_tree = job.builds_tree_soon();
            let tree_first = view.is_by_error() && job.cuts_tree(view, step);
            let expected = match view.budget {
                _ if tree_first => Some(view.max_triangles(full).unwrap_or(full / EXPECTED_DIVISOR).min(full)),
                Some(Budget::Triangles(budget)) if view.fitted.is_none() => Some(budget.of(full)),
                _ => None,
            };
            if is_first
                && let Some(expected) = expected
                && let Some(prefix) = unfitted_prefix(job, expected, step)
            {
                return Ok(make_unfitted(job, view, prefix, cancel)?.refinement(
                    view,
                    false,
                    job.time_without_pauses(start),
                ));
            }
            let shown_regions = job.shown_regions(step.shown);
            let shown_regions = shown_regions.as_deref();
            if tree_first
                && let Some(expected) = expected
                && let Some(coarser) = tree_steps::next_coarser_cut(step, job.regions(), expected)
                && let Some(made) = job.tree_prefix(view, coarser, shown_regions, cancel)?
                // A cut without additional triangles is no progress. It occurs if parts are removed: then every cut has few triangles.
                && made.surface.statistics.triangles > step.made_triangles
            {
                return Ok(job.tree_prefix_refinement(made, view, job.time_without_pauses(start)));
            }
            let making_tree = TreeMaking {
                shown: shown_regions,
                ..TreeMaking::whole(ceiling_triangles)
            };
            let cached = step.target.and_then(|id| Some((id, lock(job.cuts).get(id)?)));
            let cached = cached.filter(|(_, target)| !tree_first && target.is_of(job.pyramid));
            let (params, target_id, target, can_improve) = match cached {
                Some((id, target)) => (job.params_of(view), id, target, view.is_by_error()),
                None if view.is_by_error() => match job.decide(view, making_tree, tree_first, cancel)? {
                    Decided::Tree(made) => {
                        return Ok(job.tree_refinement(*made, view, job.time_without_pauses(start)));
                    }
                    Decided::Cubes {
                        params,
                        cut: target,
                        can_improve,
                    } => {
                        let id = lock(job.cuts).insert(Arc::clone(&target));
                        (params, id, target, can_improve)
                    }
                },
                None => {
                    let (params, target) = job.cut_within(view, ceiling_triangles, cancel)?;
                    let target = Arc::new(target);
                    let id = lock(job.cuts).insert(Arc::clone(&target));
                    (params, id, target, false)
                }
            };
            let shown = match step.shown {
                Shown::Cut(id) => lock(job.cuts).get(id),
                Shown::Another | Shown::Alike | Shown::AlikeCut(_) => None,
            };
            let meshing = Instant::now();
            let maker = StepMaker {
                job,
                params: &params,
                target: &target,
                step,
                cancel,
            };
            let (surface, cut) = maker.make(shown.as_deref())?;
            // A cut of cubes still contains the parts that are to be removed, so a cut of the tree follows.
            let is_final = cut.is_none() && !view.removes_parts();
            let result = StepResult {
                surface: job.complete(surface, cancel)?,
                is_final,
                cut: cut.map_or(target_id, |cut| lock(job.cuts).insert(Arc::new(cut))),
                target: Some(target_id),
                meshing: meshing.elapsed(),
            };
            Ok(result.refinement(
                view,
                is_final && can_improve && !builds_tree,
                job.time_without_pauses(start),
            ))
        })
    }
}

impl OnDevice<'_> {
    /// Returns the number of regions that have cells of the surface.
    fn regions(&self) -> u64 {
        self.pyramid.active_regions() as u64
    }

    /// Whether a step of a view that an error or a budget decides cuts the vertex tree, instead of cubes first.
    fn cuts_tree(&self, view: &View, step: Step) -> bool {
        let Some(target) = step.target else {
            // The budget of bytes was fitted with a cut of the tree. A cut of cubes with the same number of triangles would exceed it.
            let is_fitted =
                matches!(view.budget, Some(Budget::Bytes(_))) && view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
            // A surface that replaces another one at once has to be final.
            let is_needed = view.removes_parts() && step.shown.is_replaced_at_once();
            return is_fitted || is_needed || self.builds_tree_soon() || self.cached_tree().is_some();
        };
        view.removes_parts() && step.shown == Shown::Cut(target)
    }
}

impl StepResult {
    /// Returns the result with the view and the time of the step.
    fn refinement(self, view: &View, can_improve: bool, wall: Duration) -> Refinement {
        Refinement {
            surface: self.surface,
            view: view.clone(),
            cut: self.cut,
            target: self.target,
            is_final: self.is_final,
            can_improve,
            wall,
            meshing: self.meshing,
        }
    }
}

/// Returns the prefix that is made before a budget is fitted or the vertex tree is built, if one is needed. Fitting searches for a
/// threshold and counts several cuts: on a CPU this takes about as long as building the pyramid. `expected`: triangles of the final
/// surface.
fn unfitted_prefix(job: &OnDevice<'_>, expected: u64, step: Step) -> Option<Level> {
    let step_triangles = match job.engine.device().kind {
        DeviceKind::Cpu => step.fresh_triangles,
        DeviceKind::Gpu | DeviceKind::Other => step.triangles,
    };
    if is_last(expected / TRIANGLES_PER_LEAF, step_triangles) {
        return None;
    }
    let fits = |level: &Level| {
        let triangles = job.pyramid.nodes(*level) * TRIANGLES_PER_LEAF;
        triangles <= prefix_triangles(step) && triangles * 100 <= expected.saturating_mul(UNFITTED_PERCENT)
    };
    finest_prefix(MAX_LEVEL.get(), fits)
}

/// Returns the finest prefix level that fits, up to a coarsest one.
fn finest_prefix(coarsest: u8, fits: impl FnMut(&Level) -> bool) -> Option<Level> {
    (1..=coarsest).filter_map(|level| Level::new(level).ok()).find(fits)
}

/// Makes the surface of a prefix at threshold 0. Such a prefix is a step towards the surface of any threshold.
fn make_unfitted(job: &OnDevice<'_>, view: &View, prefix: Level, cancel: &dyn Cancel) -> Result<StepResult, WorkError> {
    let start = Instant::now();
    let params = CutParams {
        beta: 0.0,
        tolerance: None,
        ..job.params_of(view)
    };
    let cut = job.engine.cut(job.volume, job.pyramid, &params, prefix)?;
    let surface = job
        .engine
        .surface(job.volume, job.pyramid, &params, &cut, None, cancel)?;
    Ok(StepResult {
        surface: job.complete(surface, cancel)?,
        is_final: false,
        cut: lock(job.cuts).insert(Arc::new(cut)),
        target: None,
        meshing: start.elapsed(),
    })
}

/// Whether `leaves` are few enough for the last step, given the `triangles` of a step.
fn is_last(leaves: u64, triangles: u64) -> bool {
    leaves * TRIANGLES_PER_LEAF * 100 <= triangles.saturating_mul(LAST_STEP_PERCENT)
}

/// Estimates the bytes of this number of leaves in this number of regions.
fn bytes_of(leaves: u64, regions: u64, bytes_of_100_triangles: u64) -> u64 {
    chunk_bytes::of_triangles(leaves * TRIANGLES_PER_LEAF, regions, bytes_of_100_triangles)
}

/// Returns the maximum triangles of a new surface's first prefix.
fn prefix_triangles(step: Step) -> u64 {
    step.fresh_triangles.min(MAX_PREFIX_TRIANGLES)
}

/// A surface and its cut; `None` if the cut is the target.
type SurfaceOfCut = (Surface, Option<Cut>);

/// Inputs of a step, which makes the step's surface.
struct StepMaker<'a> {
    job: &'a OnDevice<'a>,
    params: &'a CutParams,
    target: &'a Cut,
    step: Step,
    cancel: &'a dyn Cancel,
}

impl StepMaker<'_> {
    /// Makes the surface of the step. `shown`: the cut that the client shows, if it is cached.
    fn make(&self, shown: Option<&Cut>) -> Result<SurfaceOfCut, WorkError> {
        let job = self.job;
        let differences = match shown {
            Some(shown) => job.engine.differences(job.volume, job.pyramid, shown, self.target)?,
            None => None,
        };
        match (shown, differences) {
            (Some(shown), Some(differences)) => self.replace_leaves(shown, &differences),
            _ if self.step.shown == Shown::Another => self.first_surface(),
            // The shown cut, or its pyramid, may have been evicted.
            _ => self.whole_target(),
        }
    }

    /// Makes the whole surface of a cut. With `kept`, makes only the regions that differ from the shown cut.
    fn surface(&self, cut: &Cut, kept: Option<Kept<'_>>) -> Result<Surface, WorkError> {
        let job = self.job;
        Ok(job
            .engine
            .surface(job.volume, job.pyramid, self.params, cut, kept, self.cancel)?)
    }

    /// Makes the whole surface of the target.
    fn whole_target(&self) -> Result<SurfaceOfCut, WorkError> {
        Ok((self.surface(self.target, None)?, None))
    }

    /// Makes the first surface of a generation: a prefix, or the target.
    fn first_surface(&self) -> Result<SurfaceOfCut, WorkError> {
        let Some(prefix) = self.first_prefix() else {
            return self.whole_target();
        };
        let job = self.job;
        let cut = job.engine.cut(job.volume, job.pyramid, self.params, prefix)?;
        Ok((self.surface(&cut, None)?, Some(cut)))
    }

    /// Returns the finest prefix that is small enough, or else the coarsest. `None` if the target itself can be made in the first step.
    fn first_prefix(&self) -> Option<Level> {
        let target = self.target.prefix_leaves(Level::FINEST);
        if is_last(target, self.step.fresh_triangles) {
            return None;
        }
        let fits = |level: &Level| {
            let leaves = self.target.prefix_leaves(*level);
            leaves * TRIANGLES_PER_LEAF <= prefix_triangles(self.step) && self.is_small(leaves)
        };
        let is_one_step = is_last(target, self.step.triangles) && self.is_sent_in_a_step(target, self.regions());
        finest_prefix(MAX_LEVEL.get(), fits).or_else(|| (!is_one_step).then_some(MAX_LEVEL))
    }

    /// Whether a prefix of this number of leaves takes at most [`FRESH_PERCENT`] of the final surface's bytes.
    fn is_small(&self, leaves: u64) -> bool {
        let final_leaves = self.target.prefix_leaves(Level::FINEST);
        self.prefix_bytes(leaves) * 100
            <= bytes_of(final_leaves, self.regions(), BYTES_OF_100_TRIANGLES) * FRESH_PERCENT
    }

    fn regions(&self) -> u64 {
        self.job.regions()
    }

    /// Estimates the bytes of a prefix of this number of leaves.
    fn prefix_bytes(&self, leaves: u64) -> u64 {
        bytes_of(leaves, self.regions(), BYTES_OF_100_COARSE_TRIANGLES)
    }

    /// Whether one step can send `leaves` of the target in `regions`.
    fn is_sent_in_a_step(&self, leaves: u64, regions: u64) -> bool {
        bytes_of(leaves, regions, BYTES_OF_100_TRIANGLES) <= self.step.bytes
    }

    /// Returns the finest prefix that the step allows and that is finer than the shown one. Used on a slow line, because a prefix improves
    /// the whole surface at once for a small share of the final bytes.
    fn next_prefix(&self, shown: &Cut) -> Option<Level> {
        let allowed = self.step.bytes.saturating_mul(NEXT_PREFIX_STEPS);
        let fits = |level: &Level| {
            let leaves = self.target.prefix_leaves(*level);
            is_last(leaves, self.step.triangles) && self.prefix_bytes(leaves) <= allowed
        };
        finest_prefix(shown.prefix().get().saturating_sub(1), fits)
    }

    /// Replaces the shown leaves by the target's, region by region until the step's limits are reached. On a slow line, makes a finer
    /// prefix instead if there is one.
    fn replace_leaves(&self, shown: &Cut, differences: &Differences) -> Result<SurfaceOfCut, WorkError> {
        let job = self.job;
        let remade = differences.meshes.iter().enumerate().filter(|(_, remake)| **remake);
        let remade: Vec<u64> = remade.map(|(region, _)| self.target.region_leaves(region)).collect();
        let leaves = remade.iter().sum();
        let is_line_slow = !self.is_sent_in_a_step(leaves, remade.len() as u64);
        if is_last(leaves, self.step.triangles) && !is_line_slow {
            return Ok((self.surface(self.target, Some(Kept { shown, differences }))?, None));
        }
        if is_line_slow && let Some(prefix) = self.next_prefix(shown) {
            let cut = job.engine.cut(job.volume, job.pyramid, self.params, prefix)?;
            if let Some(differences) = &job.engine.differences(job.volume, job.pyramid, shown, &cut)? {
                return Ok((self.surface(&cut, Some(Kept { shown, differences }))?, Some(cut)));
            }
        }
        let mut is_replaced = vec![false; differences.leaves.len()];
        let minimum = self.target.prefix_leaves(Level::FINEST) / MAX_STEPS;
        let (mut leaves, mut regions) = (0, 0);
        for region in job.pyramid.regions_in_morton_order() {
            let is_full =
                leaves * TRIANGLES_PER_LEAF >= self.step.triangles || !self.is_sent_in_a_step(leaves, regions);
            if is_full && leaves >= minimum {
                break;
            }
            if differences.leaves[region] {
                is_replaced[region] = true;
                leaves += self.target.region_leaves(region);
                regions += 1;
            }
        }
        let mixed = job
            .engine
            .mix(job.volume, job.pyramid, shown, self.target, &is_replaced)?;
        let differences = &differences.to_mix(job.pyramid, &is_replaced);
        Ok((self.surface(&mixed, Some(Kept { shown, differences }))?, Some(mixed)))
    }
}
