//! Surfaces that are cuts of the vertex tree, for views that an error or a budget decides.

use std::sync::Arc;
use std::time::{Duration, Instant};

use isopeel_kernels::{
    Cancel, CutParams, DeviceKind, Error, MeasuredError, PartFilter, RefinementCost, Surface, Topology, TreeGoal,
    TreeRegions, TreeSurface, VertexTree, lock,
};
use isopeel_view::View;
use isopeel_view::quality::{ErrorLimit, Fitted, MaxError, PixelError, TopologyName};
use isopeel_volumes::VolumeStep;

use super::camera::{CameraTolerances, ErrorCurve, SeenSurface};
use super::context::JobContext;
use super::decisions::{Decided, TreeCut, TreeMaking, milder_refusal};
use super::intersections::{CapFaces, intersecting_vertices};
use super::job_error::JobError;
use super::on_device::{Nodes, OnDevice};
use super::questions::index_inside;
use super::results::{Making, Refining};
use super::tree_steps::CoarserCut;
use super::workspace::Workspace;
use super::{CutId, Refinement, Shown, WorkError};

/// Maximum triangles of a full surface whose tree is built before the first step. On an H200 building such a tree takes about 20 ms. A
/// larger surface is first shown as a cut of cubes.
const MAX_FULL_TRIANGLES: u64 = 1_500_000;

/// Whether parts may vanish at any budget. If parts are removed, the others stay: the largest part, which never vanishes, may be among the
/// removed ones.
fn is_free(view: &View) -> bool {
    view.topology == TopologyName::Free && !view.removes_parts()
}

/// Whether parts have vanished from a view's tree cut to keep its budget.
fn has_given_way(view: &View) -> bool {
    let gave_way = |fitted: Fitted| fitted.is_tree_cut && fitted.topology == Topology::Free;
    view.fitted.is_some_and(gave_way) && !view.removes_parts()
}

/// The regions of a surface as a view's camera sees them, with what that means for a cut.
struct Seen {
    surface: SeenSurface,
    curve: ErrorCurve,
    tolerances: CameraTolerances,
}

impl Seen {
    /// States the error of a cut in the picture.
    fn error_of(&self, tolerance: f32, surface: &Surface, tree: &VertexTree) -> PixelError {
        let statistics = &surface.statistics;
        let is_full = statistics.mesher_triangles == Some(statistics.triangles);
        let guard = self.tolerances.guard;
        PixelError {
            within: self
                .surface
                .pixels_within(tolerance, guard, tree.region_areas(), &self.curve),
            limited_by: self.surface.limit(tolerance, self.tolerances, is_full),
        }
    }
}

impl Workspace {
    /// Makes the final surface of a view as a cut of the vertex tree. `None` if there is no tree, or if no cut of the tree is small enough.
    ///
    /// # Errors
    /// [`JobError`].
    pub fn improve(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        ceiling_triangles: u64,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Option<Refinement>, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, context, |job, view, cancel| {
            Ok(
                match job.tree_surface(view, TreeMaking::whole(ceiling_triangles), cancel)? {
                    TreeCut::Made(made) => Some(job.tree_refinement(*made, view, job.time_without_pauses(start))),
                    TreeCut::Refused(_) | TreeCut::NoTree => None,
                },
            )
        })
    }
}

impl OnDevice<'_> {
    /// Returns the vertex tree if it is cached.
    pub(crate) fn cached_tree(&self) -> Option<Arc<VertexTree>> {
        let mut trees = lock(self.trees);
        let tree = trees.get(&self.key)?;
        tree.is_of(self.pyramid).then(|| Arc::clone(tree))
    }

    /// Whether building the tree takes so little time that other jobs can wait for it.
    pub(crate) fn builds_tree_soon(&self) -> bool {
        self.engine.device().kind != DeviceKind::Cpu && self.pyramid.full_triangles() <= MAX_FULL_TRIANGLES
    }

    /// Returns the vertex tree. Builds the tree if it is not cached. `None` if the surface is too large for a tree on this device; a cut of
    /// cubes needs less memory.
    ///
    /// # Errors
    /// [`WorkError::NoTree`] if parts are to be removed, because cubes contain all parts; [`JobError::TakesLong`] if a short job would have
    /// to build the tree; and the device's errors.
    pub(crate) fn tree(
        &self,
        view: &View,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<Option<Arc<VertexTree>>, JobError> {
        if let Some(tree) = self.cached_tree() {
            self.observer.looked_up("tree", true);
            return Ok(Some(tree));
        }
        self.observer.looked_up("tree", false);
        if !self.may_take_long && !self.builds_tree_soon() {
            return Err(JobError::TakesLong);
        }
        let tree = match self.engine.build_tree(self.volume, self.pyramid, params, cancel) {
            Err(error @ (Error::OutOfDeviceMemory { .. } | Error::Invalid { .. })) => {
                tracing::warn!(%error, "no vertex tree");
                return match view.removes_parts() {
                    true => Err(JobError::Failed(WorkError::NoTree(error))),
                    false => Ok(None),
                };
            }
            tree => Arc::new(tree?),
        };
        self.cache_tree(&tree);
        Ok(Some(tree))
    }

    /// Returns the guard on the error, if one was set, in smallest spacings.
    fn error_guard(&self, view: &View) -> f32 {
        match view.max_error {
            MaxError::At(distance) => distance.in_spacings(self.smallest),
            MaxError::Auto | MaxError::None => f32::INFINITY,
        }
    }

    /// Returns the regions as the view's camera sees them; `None` if no camera is in force.
    fn seen(&self, view: &View, tree: &VertexTree, params: &CutParams) -> Result<Option<Seen>, JobError> {
        let seen_by = |camera| {
            let (coords, dims) = (self.pyramid.region_coords(), self.volume.grid().dims);
            SeenSurface::new(camera, coords, dims, &self.index_space, self.smallest)
        };
        let Some(surface) = view.camera_in_force().and_then(seen_by) else {
            return Ok(None);
        };
        let curve = self.engine.uniform_curve(self.volume, self.pyramid, tree, params)?;
        let curve = ErrorCurve::new(curve);
        let pixels = match view.error {
            Some(ErrorLimit::Pixels(pixels)) => Some(pixels),
            Some(ErrorLimit::Distance(_)) | None => None,
        };
        let asked = match (pixels, view.error) {
            (Some(pixels), _) => surface.tolerance(pixels, &curve),
            (None, Some(error)) => error.in_spacings(self.smallest),
            (None, None) => f32::NEG_INFINITY,
        };
        let tolerances = CameraTolerances {
            asked,
            seen: surface.seen_tolerance(pixels, &curve),
            guard: self.error_guard(view),
        };
        Ok(Some(Seen {
            surface,
            curve,
            tolerances,
        }))
    }

    /// Returns the limits of a view's error and budget for cutting the tree. A budget that is a share is a share of the full surface
    /// without removed parts.
    pub(crate) fn tree_goal(
        &self,
        view: &View,
        tree: &Arc<VertexTree>,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<TreeGoal, JobError> {
        let seen = self.seen(view, tree, params)?;
        self.tree_goal_of(view, tree, params, seen.as_ref(), cancel)
    }

    /// As [`OnDevice::tree_goal`], with the regions as the camera sees them.
    fn tree_goal_of(
        &self,
        view: &View,
        tree: &Arc<VertexTree>,
        params: &CutParams,
        seen: Option<&Seen>,
        cancel: &dyn Cancel,
    ) -> Result<TreeGoal, JobError> {
        let mut full = self.pyramid.full_triangles();
        let without = self.part_filter(view);
        if without.removes() {
            let removed = self
                .engine
                .removed_parts(self.volume, self.pyramid, tree, params, &without, cancel)?;
            full -= removed.full_triangles;
            self.cache_tree(tree);
        }
        Ok(TreeGoal {
            tolerance: match (seen, view.error) {
                (Some(seen), _) => seen.tolerances.asked.max(seen.tolerances.seen),
                (None, Some(error)) => error.in_spacings(self.smallest),
                (None, None) => f32::NEG_INFINITY,
            },
            max_triangles: view.max_triangles(full).unwrap_or(u64::MAX),
            max_tolerance: self.error_guard(view),
            without,
            may_vanish: is_free(view) || has_given_way(view),
            weights: seen.map(|seen| seen.surface.weights()),
        })
    }

    /// Returns the rules by which a view leaves out parts.
    fn part_filter(&self, view: &View) -> PartFilter {
        let index_of = |position| index_inside(&self.index_space, self.volume.grid().dims, position);
        PartFilter {
            min_area: ((view.min_part / (self.smallest * self.smallest)) as f32).min(f32::MAX),
            chosen: view.parts.as_ref().map(|parts| parts.to_kernel(index_of)),
        }
    }

    /// Caches a tree. Called again once the tree's parts are known, because its size grows then.
    pub(crate) fn cache_tree(&self, tree: &Arc<VertexTree>) {
        lock(self.trees).insert(self.key.clone(), tree.device_bytes(), Arc::clone(tree));
    }

    /// Measures the error of the surface that [`OnDevice::tree_surface`] made of a view.
    pub(crate) fn measure_tree(&self, view: &View, cancel: &dyn Cancel) -> Result<Option<MeasuredError>, JobError> {
        let params = self.params_of(view);
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(None);
        };
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let measured = self
            .engine
            .measure_tree_error(self.volume, self.pyramid, &tree, &params, &goal, cancel)?;
        Ok(Some(measured))
    }

    /// Cuts the tree to a view's error and budget.
    ///
    /// # Errors
    /// [`WorkError::NoTree`], [`JobError::TakesLong`], and the device's errors. If parts are to be removed, a refused cut is an error
    /// too, because cubes contain all parts.
    pub(crate) fn tree_surface(
        &self,
        view: &mut View,
        making: TreeMaking<'_>,
        cancel: &dyn Cancel,
    ) -> Result<TreeCut, JobError> {
        let TreeMaking {
            ceiling, state_error, ..
        } = making;
        let params = CutParams {
            state_error,
            ..self.params_of(view)
        };
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(TreeCut::NoTree);
        };
        let seen = self.seen(view, &tree, &params)?;
        let goal = TreeGoal {
            may_vanish: is_free(view),
            ..self.tree_goal_of(view, &tree, &params, seen.as_ref(), cancel)?
        };
        let (made, may_vanish) = self.cut_to_budget(view, &tree, &params, goal.clone(), making.shown, cancel)?;
        let triangles = made.surface.statistics.triangles;
        let refusal = if triangles > goal.max_triangles {
            Some(WorkError::OverBudget {
                minimum: triangles,
                budget: goal.max_triangles,
            })
        } else {
            (triangles > ceiling).then_some(WorkError::TooManyTriangles { triangles, ceiling })
        };
        if let Some(refusal) = refusal {
            return match view.removes_parts() {
                true => Err(refusal.into()),
                false => Ok(TreeCut::Refused(refusal)),
            };
        }
        view.fitted = Some(Fitted {
            threshold: made.tolerance,
            topology: if may_vanish { Topology::Free } else { Topology::Preserve },
            triangles: goal.max_triangles,
            is_tree_cut: true,
            pixels: seen.map(|seen| seen.error_of(made.tolerance, &made.surface, &tree)),
        });
        Ok(TreeCut::Made(Box::new(self.complete_cut(made, cancel)?)))
    }

    /// As [`OnDevice::complete`].
    fn complete_cut(&self, made: TreeSurface, cancel: &dyn Cancel) -> Result<TreeSurface, WorkError> {
        Ok(TreeSurface {
            surface: self.complete(made.surface, cancel)?,
            ..made
        })
    }

    /// Returns the regions of the cut of the tree that a client shows, if they are cached.
    pub(crate) fn shown_regions(&self, shown: Shown) -> Option<Arc<TreeRegions>> {
        match shown {
            Shown::Cut(id) | Shown::AlikeCut(id) => lock(self.cuts).get_tree(id),
            Shown::Another | Shown::Alike => None,
        }
    }

    /// Cuts the tree. If the topology is `auto` and no cut with all parts is within the budget, small parts vanish. Also returns whether
    /// the topology has given way.
    fn cut_to_budget(
        &self,
        view: &View,
        tree: &VertexTree,
        params: &CutParams,
        goal: TreeGoal,
        shown: Option<&TreeRegions>,
        cancel: &dyn Cancel,
    ) -> Result<(TreeSurface, bool), JobError> {
        let cut = |goal: &TreeGoal| {
            self.engine
                .tree_surface(self.volume, self.pyramid, tree, params, goal, shown, cancel)
        };
        let made = cut(&goal)?;
        let may_give_way = view.topology == TopologyName::Auto && !view.removes_parts();
        if made.surface.statistics.triangles <= goal.max_triangles || !may_give_way {
            return Ok((made, goal.may_vanish));
        }
        let made = cut(&TreeGoal {
            may_vanish: true,
            ..goal
        })?;
        let gave_way = made.surface.statistics.vanished_parts > 0;
        Ok((made, gave_way))
    }

    /// Makes a coarser cut of the tree than the view's final one. The coarser cut has the same topology unless it is free, but no guard on
    /// the error. `None` if there is no tree, or if no cut of the tree has so few triangles.
    pub(crate) fn tree_prefix(
        &self,
        view: &View,
        limits: CoarserCut,
        shown: Option<&TreeRegions>,
        cancel: &dyn Cancel,
    ) -> Result<Option<TreeSurface>, JobError> {
        let params = self.params_of(view);
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(None);
        };
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let coarser = TreeGoal {
            max_triangles: goal.max_triangles.min(limits.triangles),
            max_tolerance: f32::INFINITY,
            may_vanish: is_free(view),
            ..goal
        };
        let made = self
            .engine
            .tree_prefix(self.volume, self.pyramid, &tree, &params, &coarser, shown, cancel)?;
        let is_small = made.surface.statistics.triangles <= goal.max_triangles.min(limits.max_triangles);
        Ok(is_small.then(|| self.complete_cut(made, cancel)).transpose()?)
    }

    /// Returns the surface that [`OnDevice::tree_surface`] made of a view, refined at intersecting triangles.
    ///
    /// # Errors
    /// [`WorkError::OverBudget`] if the budget allows no such surface, and the device's errors.
    pub(crate) fn refined_tree_surface(
        &self,
        view: &mut View,
        making: Making,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, RefinementCost), JobError> {
        let params = CutParams {
            state_error: making.measures,
            ..self.params_of(view)
        };
        let no_tree = WorkError::Stopped;
        let tree = self.tree(view, &params, cancel)?.ok_or(no_tree)?;
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let faces = (making.refining == Refining::AtCaps).then(|| CapFaces::of_padded(self.volume.grid().dims));
        let (surface, tolerance, cost) = self.engine.refined_tree_surface(
            self.volume,
            self.pyramid,
            &tree,
            &params,
            &goal,
            &|regions, cancel| intersecting_vertices(regions, faces, self.long_work, cancel),
            cancel,
        )?;
        let triangles = surface.statistics.triangles;
        if triangles > goal.max_triangles {
            return Err(JobError::Failed(WorkError::OverBudget {
                minimum: triangles,
                budget: goal.max_triangles,
            }));
        }
        if triangles > making.ceiling {
            let ceiling = making.ceiling;
            return Err(JobError::Failed(WorkError::TooManyTriangles { triangles, ceiling }));
        }
        if let Some(fitted) = &mut view.fitted {
            fitted.threshold = tolerance;
        }
        Ok((self.complete(surface, cancel)?, cost))
    }

    /// Makes the surface of a view that an error or a budget decides: a cut of the tree, or a cut of cubes. `tree_first`: whether to cut
    /// the tree first, because the tree is cached or quickly built. Otherwise cubes are tried first, and a cut of the tree can replace them
    /// later. The order affects only the time to the final surface: a view is refused only if both cuts are.
    ///
    /// # Errors
    /// As [`OnDevice::tree_surface`] and [`OnDevice::fitted_cut`].
    pub(crate) fn decide(
        &self,
        view: &mut View,
        making: TreeMaking<'_>,
        tree_first: bool,
        cancel: &dyn Cancel,
    ) -> Result<Decided, JobError> {
        let mut tree_refusal = None;
        if tree_first {
            match self.tree_surface(view, making, cancel)? {
                TreeCut::Made(made) => return Ok(Decided::Tree(made)),
                TreeCut::Refused(refusal) => tree_refusal = Some(refusal),
                TreeCut::NoTree => {}
            }
        }
        let refusal = match self.cut_within(view, making.ceiling, cancel) {
            Err(refusal @ (WorkError::OverBudget { .. } | WorkError::TooManyTriangles { .. })) => refusal,
            target => {
                let (params, cut) = target?;
                return Ok(Decided::Cubes {
                    params,
                    cut: Arc::new(cut),
                    can_improve: !tree_first,
                });
            }
        };
        if !tree_first {
            match self.tree_surface(view, making, cancel)? {
                TreeCut::Made(made) => return Ok(Decided::Tree(made)),
                TreeCut::Refused(refusal) => tree_refusal = Some(refusal),
                TreeCut::NoTree => {}
            }
        }
        Err(milder_refusal(tree_refusal, refusal).into())
    }

    /// Returns a cut of the tree as the last step towards its view.
    pub(crate) fn tree_refinement(&self, made: TreeSurface, view: &View, wall: Duration) -> Refinement {
        Refinement {
            is_final: true,
            ..self.tree_prefix_refinement(made, view, wall)
        }
    }

    /// Returns a coarser cut of the tree as a step towards a view.
    pub(crate) fn tree_prefix_refinement(&self, made: TreeSurface, view: &View, wall: Duration) -> Refinement {
        Refinement {
            surface: made.surface,
            view: view.clone(),
            cut: match made.regions {
                Some(regions) => lock(self.cuts).insert_tree(regions),
                None => CutId::next(),
            },
            target: None,
            is_final: false,
            can_improve: false,
            wall,
            meshing: wall,
        }
    }
}
