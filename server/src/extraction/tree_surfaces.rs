//! Surfaces as cuts of the vertex tree: where an error or a budget decides.

use std::rc::Rc;
use std::time::{Duration, Instant};

use isopeel_kernels::{
    Cancel, CutParams, DeviceKind, Error, MeasuredError, PartFilter, Surface, Topology, TreeGoal, VertexTree,
};

use super::questions::index_inside;
use super::turns::Turn;
use super::worker_state::{JobError, Nodes, OnDevice, WorkerState};
use super::{Refinement, WorkError};
use crate::metrics;
use crate::view::View;
use crate::view::quality::{Fitted, MaxError, TopologyName};
use crate::volumes::VolumeStep;

/// Full surfaces of more triangles are cut as cubes before their tree is built: on an H200 a tree of so many takes about 20 ms.
const MAX_FULL_TRIANGLES: u64 = 1_500_000;

impl WorkerState {
    /// The final surface of a view as a cut of the vertex tree; `None` where the tree cannot be as small as the budget, and the guards
    /// give way.
    pub(super) fn improve(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        ceiling_triangles: u64,
        turn: &mut Turn<'_, Self>,
    ) -> Result<Option<Refinement>, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, turn, |on, view, cancel| {
            let surface = on.tree_surface(view, ceiling_triangles, false, cancel)?;
            Ok(surface.map(|surface| on.tree_refinement(surface, view, on.own_time(start))))
        })
    }
}

impl OnDevice<'_> {
    /// The vertex tree, if it is built.
    pub(super) fn cached_tree(&self) -> Option<Rc<VertexTree>> {
        let mut trees = self.trees.borrow_mut();
        let tree = trees.get(&self.key)?;
        tree.is_of(self.pyramid).then(|| Rc::clone(tree))
    }

    /// Whether it is built so soon that others can wait for it.
    pub(super) fn builds_tree_soon(&self) -> bool {
        self.engine.device().kind != DeviceKind::Cpu && self.pyramid.full_triangles() <= MAX_FULL_TRIANGLES
    }

    /// The vertex tree, which is built where it is not there. `None`: the surface is too large for a tree on this device; cubes take
    /// less.
    ///
    /// # Errors
    /// [`WorkError::NoTree`] where parts are to be removed, for cubes have them all; [`JobError::TakesLong`] where a short job would
    /// build it; and the device's errors.
    pub(super) fn tree(
        &self,
        view: &View,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<Option<Rc<VertexTree>>, JobError> {
        if let Some(tree) = self.cached_tree() {
            metrics::looked_up("tree", true);
            return Ok(Some(tree));
        }
        metrics::looked_up("tree", false);
        if !self.pauses && !self.builds_tree_soon() {
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
            tree => Rc::new(tree?),
        };
        self.keep_tree(&tree);
        Ok(Some(tree))
    }

    /// The guard on the error, where one was set; world units.
    fn error_guard(&self, view: &View) -> f32 {
        match view.max_error {
            MaxError::At(distance) => distance.world(self.spacing),
            MaxError::Auto | MaxError::None => f32::INFINITY,
        }
    }

    /// How far a view's error and budget cut the tree. A share is one of what is left without removed parts.
    pub(super) fn tree_goal(
        &self,
        view: &View,
        tree: &Rc<VertexTree>,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<TreeGoal, JobError> {
        let mut full = self.pyramid.full_triangles();
        let without = self.part_filter(view);
        if without.removes() {
            let removed = self
                .engine
                .removed_parts(self.volume, self.pyramid, tree, params, &without, cancel)?;
            full -= removed.full_triangles;
            self.keep_tree(tree);
        }
        Ok(TreeGoal {
            tolerance: view.error.map_or(f32::NEG_INFINITY, |error| error.world(self.spacing)),
            max_triangles: view.max_triangles(full).unwrap_or(u64::MAX),
            max_tolerance: self.error_guard(view),
            without,
        })
    }

    /// Which parts a view leaves out.
    fn part_filter(&self, view: &View) -> PartFilter {
        let index_of = |position| index_inside(&self.index_space, self.volume.grid().dims, position);
        PartFilter {
            min_area: view.min_part,
            chosen: view.parts.as_ref().map(|parts| parts.to_kernel(index_of)),
        }
    }

    /// Keeps a tree, which is larger once its parts are known.
    pub(super) fn keep_tree(&self, tree: &Rc<VertexTree>) {
        self.trees
            .borrow_mut()
            .insert(self.key.clone(), tree.device_bytes(), Rc::clone(tree));
    }

    /// The error of the surface that [`OnDevice::tree_surface`] made of a view.
    pub(super) fn measure_tree(&self, view: &View, cancel: &dyn Cancel) -> Result<Option<MeasuredError>, JobError> {
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

    /// Cuts the tree to a view's error and budget. `None`: there is no space for a tree; or even the smallest cut, which keeps the
    /// topology, is above the budget, and the guard on the topology gives way. Where parts are to be removed it does not, for cubes have
    /// them all.
    ///
    /// # Errors
    /// [`WorkError::OverBudget`] where a guard does not give way, [`WorkError::NoTree`], [`JobError::TakesLong`], and the device's errors.
    pub(super) fn tree_surface(
        &self,
        view: &mut View,
        ceiling: u64,
        state_error: bool,
        cancel: &dyn Cancel,
    ) -> Result<Option<Surface>, JobError> {
        let params = CutParams {
            state_error,
            ..self.params_of(view)
        };
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(None);
        };
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let (surface, tolerance) =
            self.engine
                .tree_surface(self.volume, self.pyramid, &tree, &params, &goal, cancel)?;
        let triangles = surface.statistics.triangles;
        if triangles > goal.max_triangles {
            let is_guarded =
                tolerance == goal.max_tolerance || view.topology == TopologyName::Preserve || view.removes_parts();
            return match is_guarded {
                false => Ok(None),
                true => Err(JobError::Failed(WorkError::OverBudget {
                    minimum: triangles,
                    budget: goal.max_triangles,
                })),
            };
        }
        if triangles > ceiling {
            return Err(WorkError::TooManyTriangles { triangles, ceiling }.into());
        }
        view.fitted = Some(Fitted {
            threshold: tolerance,
            topology: Topology::Preserve,
            triangles: goal.max_triangles,
            is_tree_cut: true,
        });
        Ok(Some(self.with_all_stages(surface)))
    }

    /// A cut of the tree as the last step towards its view. It has no states of cubes: what follows it is made as a whole.
    pub(super) fn tree_refinement(&self, surface: Surface, view: &View, wall: Duration) -> Refinement {
        Refinement {
            surface,
            view: view.clone(),
            cut: self.cuts.borrow_mut().new_id(),
            target: None,
            is_final: true,
            can_improve: false,
            wall,
            meshing: wall,
        }
    }
}
