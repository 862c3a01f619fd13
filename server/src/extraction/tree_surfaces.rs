//! Surfaces as cuts of the vertex tree: where an error or a budget decides.

use std::rc::Rc;
use std::time::{Duration, Instant};

use isopeel_kernels::{Cancel, CutParams, Error, MeasuredError, Surface, Topology, TreeGoal, VertexTree};

use super::worker_state::{JobError, Nodes, OnDevice, WorkerState};
use super::{Refinement, WorkError};
use crate::view::View;
use crate::view::quality::{Fitted, MaxError, TopologyName};
use crate::volumes::VolumeStep;

impl WorkerState {
    /// The final surface of a view as a cut of the vertex tree; `None` where the tree cannot be as small as the budget, and the guards
    /// give way.
    pub(super) fn improve(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        ceiling_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<Option<Refinement>, JobError> {
        let start = Instant::now();
        self.with_pyramid(volume, view, Nodes::All, cancel, |on, view| {
            let surface = on.tree_surface(view, ceiling_triangles, false, cancel)?;
            Ok(surface.map(|surface| on.tree_refinement(surface, view, start.elapsed())))
        })
    }
}

impl OnDevice<'_> {
    /// The vertex tree, if it is built.
    pub(super) fn cached_tree(&mut self) -> Option<Rc<VertexTree>> {
        let tree = self.trees.get(&self.key)?;
        tree.is_of(self.pyramid).then(|| Rc::clone(tree))
    }

    /// The vertex tree, which is built where it is not there. `None`: the surface is too large for a tree on this device; cubes take
    /// less.
    ///
    /// # Errors
    /// [`WorkError::NoTree`] where small parts are to be removed, for cubes have them all; and the device's errors.
    fn tree(
        &mut self,
        view: &View,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<Option<Rc<VertexTree>>, WorkError> {
        if let Some(tree) = self.cached_tree() {
            return Ok(Some(tree));
        }
        let tree = match self.engine.build_tree(self.volume, self.pyramid, params, cancel) {
            Err(error @ (Error::OutOfDeviceMemory { .. } | Error::Invalid { .. })) => {
                tracing::warn!(%error, "no vertex tree");
                return match view.min_part > 0.0 {
                    true => Err(WorkError::NoTree(error)),
                    false => Ok(None),
                };
            }
            tree => Rc::new(tree?),
        };
        self.trees
            .insert(self.key.clone(), tree.device_bytes(), Rc::clone(&tree));
        Ok(Some(tree))
    }

    /// The guard on the error, where one was set; world units.
    fn error_guard(&self, view: &View) -> f32 {
        match view.max_error {
            MaxError::At(distance) => distance.world(self.spacing),
            MaxError::Auto | MaxError::None => f32::INFINITY,
        }
    }

    /// How far a view's error and budget cut the tree. A share is one of what is left without small parts.
    fn tree_goal(
        &mut self,
        view: &View,
        tree: &Rc<VertexTree>,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<TreeGoal, Error> {
        let error = view.error.map_or(f32::NEG_INFINITY, |error| error.world(self.spacing));
        let mut full = self.pyramid.full_triangles();
        if view.min_part > 0.0 {
            let removed = self
                .engine
                .small_parts(self.volume, self.pyramid, tree, params, view.min_part, cancel)?;
            full -= removed.full_triangles;
            // The tree is larger by its parts.
            self.trees
                .insert(self.key.clone(), tree.device_bytes(), Rc::clone(tree));
        }
        Ok(TreeGoal {
            tolerance: error.min(self.error_guard(view)),
            max_triangles: view.max_triangles(full).unwrap_or(u64::MAX),
            min_part: view.min_part,
        })
    }

    /// The error of the surface that [`OnDevice::tree_surface`] made of a view.
    pub(super) fn measure_tree(
        &mut self,
        view: &View,
        cancel: &dyn Cancel,
    ) -> Result<Option<MeasuredError>, WorkError> {
        let params = self.params_of(view);
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(None);
        };
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let measured = self
            .engine
            .measure_tree_error(self.volume, self.pyramid, &tree, &params, goal, cancel)?;
        Ok(Some(measured))
    }

    /// Cuts the tree to a view's error and budget. `None`: there is no space for a tree; or even the smallest cut, which keeps the
    /// topology, is above the budget, and the guard on the topology gives way. Where small parts are to be removed it does not, for cubes
    /// have them all.
    ///
    /// # Errors
    /// [`WorkError::OverBudget`] where a guard does not give way, [`WorkError::NoTree`], and the device's errors.
    pub(super) fn tree_surface(
        &mut self,
        view: &mut View,
        ceiling: u64,
        state_error: bool,
        cancel: &dyn Cancel,
    ) -> Result<Option<Surface>, WorkError> {
        let params = CutParams {
            state_error,
            ..self.params_of(view)
        };
        let Some(tree) = self.tree(view, &params, cancel)? else {
            return Ok(None);
        };
        let goal = self.tree_goal(view, &tree, &params, cancel)?;
        let guard = self.error_guard(view);
        let cut = |goal| {
            self.engine
                .tree_surface(self.volume, self.pyramid, &tree, &params, goal, cancel)
        };
        let (surface, made) = cut(goal)?;
        let triangles = surface.statistics.triangles;
        if made.tolerance > guard {
            let guarded = TreeGoal {
                tolerance: guard,
                max_triangles: u64::MAX,
                ..goal
            };
            return Err(WorkError::OverBudget {
                minimum: cut(guarded)?.0.statistics.triangles,
                budget: goal.max_triangles,
            });
        }
        if triangles > goal.max_triangles {
            return match view.topology {
                TopologyName::Auto | TopologyName::Free if view.min_part == 0.0 => Ok(None),
                _ => Err(WorkError::OverBudget {
                    minimum: triangles,
                    budget: goal.max_triangles,
                }),
            };
        }
        if triangles > ceiling {
            return Err(WorkError::TooManyTriangles { triangles, ceiling });
        }
        view.fitted = Some(Fitted {
            threshold: made.tolerance,
            topology: Topology::Preserve,
            triangles: goal.max_triangles,
            is_tree_cut: true,
        });
        Ok(Some(self.with_pyramid_stages(surface)))
    }

    /// A cut of the tree as the last step towards its view. It has no states of cubes: what follows it is made as a whole.
    pub(super) fn tree_refinement(&mut self, surface: Surface, view: &View, wall: Duration) -> Refinement {
        Refinement {
            surface,
            view: view.clone(),
            cut: self.cuts.new_id(),
            target: None,
            is_final: true,
            can_improve: false,
            wall,
            meshing: wall,
        }
    }
}
