//! Cuts of the vertex tree, fitted to a budget and meshed.

use super::fit::ERROR_KEYS;
use super::peel::{Mesh, joined};
use super::tree_part::left_out;
use crate::buffer::Buffer;
use crate::cancel::check_cancelled;
use crate::cut::sum_levels;
use crate::layout::{RegionMesh, TreeCutRegion};
use crate::lock::lock;
use crate::mesh_regions::{MeshRegions, TreeRegions, triangles};
use crate::stages::fit::{INNER_BINS, Keys};
use crate::stages::tree_cut::{CutWork, Cutter};
use crate::stages::tree_mesh::CutMesh;
use crate::stages::{cut, error, tree_cut};
use crate::tree::{TreeCut, TreeGoal};
use crate::{
    Cancel, CutParams, Engine, Error, ErrorEstimate, Level, Never, Pyramid, Result, Surface, SurfaceStatistics,
    VertexTree, Volume,
};
use std::sync::Arc;

/// Maximum number of cuts that are tried until no merge changes the topology. Each repair forbids at least one merge.
const MAX_REPAIRS: usize = 64;

/// The share 1 / `REPAIR_SHARE` of a budget's triangles is reserved for merges that repairs undo. Most cuts need fewer, so they are not
/// fitted again.
const REPAIR_SHARE: u64 = 64;

/// The mesh of a cut on the device.
pub(super) struct TreeMesh {
    pub mesh: Mesh,
    /// The leaf of each vertex: from a region's first corner on.
    pub vertex_leaves: Buffer<u32>,
    /// Sums of the offsets around each node, which decide how far it moves.
    offset_sums: Buffer<u32>,
}

/// The surface of a cut of a vertex tree.
pub struct TreeSurface {
    /// The surface, or the regions in which it differs from a shown one.
    pub surface: Surface,
    /// Tolerance of the cut.
    pub tolerance: f32,
    /// Tells in which regions the surface of another cut differs; `None` if the error was measured.
    pub regions: Option<TreeRegions>,
}

impl Engine {
    /// Cuts a tree and meshes the cut. The topology is that of the full dual mesh without removed parts, and without those that vanish if
    /// the goal allows that. So there is a minimum number of triangles: if the budget is below this minimum, or below what the guard allows,
    /// the surface exceeds the budget. With `shown`, the regions of a surface that is shown, only the regions that differ from it are made
    /// ([`Surface::remade`]); all are if it is of another tree or feature, or if the error is measured.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    #[expect(
        clippy::too_many_arguments,
        reason = "the surface's data, what it is cut for, and what is shown"
    )]
    pub fn tree_surface(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        shown: Option<&TreeRegions>,
        cancel: &dyn Cancel,
    ) -> Result<TreeSurface> {
        let before = self.cx.pool.restart();
        let cutter = self.cutter_for(volume, pyramid, tree, params, goal, cancel)?;
        let (work, tolerance) = self.cut_tree(&cutter, params, goal, cancel)?;
        let (surface, regions) = self.surface_of_tree_cut(&cutter, params, &work, shown, before, cancel)?;
        keep(&cutter, params, goal, work);
        Ok(TreeSurface {
            surface,
            tolerance,
            regions,
        })
    }

    /// As [`Engine::tree_surface`], but the cut is not kept for queries and measuring, as a finer cut replaces it soon.
    ///
    /// # Errors
    /// As [`Engine::tree_surface`].
    #[expect(clippy::too_many_arguments, reason = "as `tree_surface`")]
    pub fn tree_prefix(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        shown: Option<&TreeRegions>,
        cancel: &dyn Cancel,
    ) -> Result<TreeSurface> {
        let before = self.cx.pool.restart();
        let cutter = self.cutter_for(volume, pyramid, tree, params, goal, cancel)?;
        let (work, tolerance) = self.cut_tree(&cutter, params, goal, cancel)?;
        let (surface, regions) = self.surface_of_tree_cut(&cutter, params, &work, shown, before, cancel)?;
        Ok(TreeSurface {
            surface,
            tolerance,
            regions,
        })
    }

    /// Returns how many nodes of a cut move, because the sums of their offsets are not 0. For the check.
    pub(crate) fn moved_nodes(
        &self,
        (volume, pyramid, tree): (&Volume, &Pyramid, &VertexTree),
        params: &CutParams,
        goal: &TreeGoal,
    ) -> Result<u64> {
        let cutter = self.cutter(volume, pyramid, tree, params);
        let (work, _) = self.cut_tree(&cutter, params, goal, &Never)?;
        let (meshes, _) = self.count_tree_cut(&cutter, &work)?;
        let (regions, offset_sums) = (MeshRegions::all(pyramid), cutter.offsets(&work)?);
        let made = self.mesh_tree_cut(&cutter, params, &work, &meshes, &regions, offset_sums, &Never)?;
        let sums = self.cx.read("check", &made.offset_sums, 2 * tree.built.nodes.len())?;
        Ok(sums.chunks_exact(2).filter(|sums| sums[0] != 0 || sums[1] != 0).count() as u64)
    }

    /// The mesh of a cut on the host, and its regions. `shown`: as in [`Engine::tree_surface`]. `before`: bytes of the pool when the work
    /// began.
    pub(super) fn surface_of_tree_cut(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        work: &CutWork,
        shown: Option<&TreeRegions>,
        before: u64,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, Option<TreeRegions>)> {
        let Cutter {
            cx,
            volume,
            pyramid,
            tree,
            ..
        } = *cutter;
        let (meshes, statistics) = self.count_tree_cut(cutter, work)?;
        check_cancelled(cancel)?;
        let offset_sums = cutter.offsets(work)?;
        let (made, remade, now);
        if params.state_error {
            // The error is measured by active regions.
            (made, remade, now) = (MeshRegions::all(pyramid), None, None);
        } else {
            let words = cutter.sign(work, &offset_sums)?;
            let signed = TreeRegions::new(tree.id, params.feature_range, joined(pyramid, &meshes), &words);
            (made, remade) = match shown.and_then(|shown| signed.since(shown)) {
                Some((made, different)) => (made, Some(different)),
                None => (signed.regions().clone(), None),
            };
            now = Some(signed);
        }
        let TreeMesh { mesh, .. } = self.mesh_tree_cut(cutter, params, work, &meshes, &made, offset_sums, cancel)?;
        let error = mesh.errors.as_ref().map(|(_, whole)| *whole);
        let regions = self.read_back(mesh)?;
        let device_bytes = pyramid.device_bytes() + tree.device_bytes() + cx.pool.peak().saturating_sub(before);
        let surface = Surface {
            regions,
            remade,
            prefix: Level::FINEST,
            statistics: SurfaceStatistics {
                error,
                stages: cx.take_times()?,
                device_bytes: volume.table_bytes() + pyramid.peak_bytes.max(device_bytes),
                volume_bytes: volume.sample_bytes() + pyramid.feature_bytes,
                ..statistics
            },
        };
        Ok((surface, now))
    }

    /// Returns a cutter of a tree, which must belong to this pyramid.
    pub(crate) fn cutter<'a>(
        &'a self,
        volume: &'a Volume,
        pyramid: &'a Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
    ) -> Cutter<'a> {
        assert!(
            tree.is_of(pyramid) && tree.cap == params.cap,
            "a tree of another pyramid"
        );
        Cutter {
            cx: &self.cx,
            volume,
            pyramid,
            tree,
            left_out: None,
            may_vanish: false,
            weights: None,
        }
    }

    /// Returns a cutter for a goal: it leaves out the parts that the goal removes, lets small parts vanish if the goal allows that, and has the
    /// goal's weights.
    pub(super) fn cutter_for<'a>(
        &'a self,
        volume: &'a Volume,
        pyramid: &'a Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<Cutter<'a>> {
        let cutter = self.cutter(volume, pyramid, tree, params);
        let left_out = left_out(&cutter, params, &goal.without, cancel)?;
        let weights = match &goal.weights {
            Some(weights) => Some(cutter.upload_weights(weights, goal.max_tolerance)?),
            None => None,
        };
        Ok(Cutter {
            left_out,
            weights,
            may_vanish: goal.may_vanish,
            ..cutter
        })
    }

    /// The cut of a goal, repaired until no merge changes the topology, and its tolerance.
    pub(super) fn cut_tree(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        goal: &TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<(CutWork, f32)> {
        params.check()?;
        let importances = cutter.importances(params)?;
        let limit = goal.limit();
        let (work, tolerance, first) = self.repaired_cut(cutter, importances.as_deref(), goal, limit, cancel)?;
        let has_budget = cutter.full_triangles() > goal.max_triangles;
        if !has_budget || first >= limit || cutter.triangles(&work)? <= goal.max_triangles {
            return Ok((work, tolerance));
        }
        // A merge that was forbidden at a lower tolerance may be allowed at the limit, together with the merges around it.
        drop(work);
        let goal = TreeGoal {
            tolerance: limit,
            ..goal.clone()
        };
        let (work, tolerance, _) = self.repaired_cut(cutter, importances.as_deref(), &goal, limit, cancel)?;
        Ok((work, tolerance))
    }

    /// As [`Engine::cut_tree`] with one attempt: raises the tolerance from repair to repair until the budget is met or `limit` is
    /// reached. Also returns the first tolerance.
    fn repaired_cut(
        &self,
        cutter: &Cutter<'_>,
        importances: Option<&Buffer<u32>>,
        goal: &TreeGoal,
        limit: f32,
        cancel: &dyn Cancel,
    ) -> Result<(CutWork, f32, f32)> {
        let mut work = cutter.begin()?;
        let (tolerance, first) = self.repair_cut(cutter, importances, goal, limit, &mut work, cancel)?;
        Ok((work, tolerance, first))
    }

    /// Repeats a cut, keeping its marks, until its topology is that of the full surface. Returns the last and the first tolerance.
    pub(super) fn repair_cut(
        &self,
        cutter: &Cutter<'_>,
        importances: Option<&Buffer<u32>>,
        goal: &TreeGoal,
        limit: f32,
        work: &mut CutWork,
        cancel: &dyn Cancel,
    ) -> Result<(f32, f32)> {
        let fit = |work: &CutWork| -> Result<f32> {
            let fitted = self.fit_tree(cutter, work, goal.max_triangles)?;
            Ok(goal.tolerance.max(fitted).min(limit))
        };
        let has_budget = cutter.full_triangles() > goal.max_triangles;
        cutter.keys(importances, work)?;
        self.cx.pause(tree_cut::STAGE, cancel)?;
        let first = fit(work)?;
        let mut tolerance = first;
        cutter.leaves(work, tolerance)?;
        for _ in 0..MAX_REPAIRS {
            check_cancelled(cancel)?;
            if !cutter.test(work)? {
                if !work.is_first {
                    cutter.list(work)?;
                }
                return Ok((tolerance, first));
            }
            cutter.keys(importances, work)?;
            cutter.leaves(work, tolerance)?;
            // Repairs may break the budget.
            if has_budget && tolerance < limit && cutter.triangles(work)? > goal.max_triangles {
                let fitted = fit(work)?;
                if fitted > tolerance {
                    tolerance = fitted;
                    cutter.leaves(work, tolerance)?;
                }
            }
        }
        Err(Error::Invalid {
            what: "vertex tree",
            why: format!("{MAX_REPAIRS} cuts changed the topology"),
        })
    }

    /// Returns the triangles of each region, and the statistics of a cut that are known before it is meshed.
    pub(super) fn count_tree_cut(
        &self,
        cutter: &Cutter<'_>,
        work: &CutWork,
    ) -> Result<(Vec<RegionMesh>, SurfaceStatistics)> {
        let (sums, meshes) = (cutter.sums(work)?, cutter.meshes(work)?);
        let (vanished, shown) = match cutter.tree.vanishing {
            Some(block) => (sums[block].leaves.iter().map(|&n| u64::from(n)).sum(), &sums[..block]),
            None => (0, &sums[..]),
        };
        let leaves = sum_levels(shown.iter().map(|block| &block.leaves));
        let removed = cutter.left_out.as_ref().map(|left_out| left_out.removed);
        // If parts are left out, points without triangles are left out too.
        let isolated = match removed {
            Some(_) => 0,
            None => cutter.tree.isolated_points,
        };
        let statistics = SurfaceStatistics {
            full_triangles: cutter.pyramid.full_triangles - removed.map_or(0, |removed| removed.full_triangles),
            mesher_triangles: Some(cutter.full_triangles()),
            removed,
            vanished_parts: vanished,
            active_cells: cutter.pyramid.active_cells,
            leaves,
            triangles: meshes.iter().map(|mesh| triangles(mesh) as u64).sum(),
            vertices: leaves.iter().sum::<u64>().saturating_sub(isolated),
            estimate: estimate(cutter, &sums),
            ..Default::default()
        };
        Ok((meshes, statistics))
    }

    /// The mesh of a cut in some regions, with its error if `params` ask for it. `meshes`: triangles of each active region. `offset_sums`:
    /// from [`Cutter::offsets`].
    #[expect(clippy::too_many_arguments, reason = "the cut, and what is made of it")]
    pub(super) fn mesh_tree_cut(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        work: &CutWork,
        meshes: &[RegionMesh],
        made: &MeshRegions,
        offset_sums: Buffer<u32>,
        cancel: &dyn Cancel,
    ) -> Result<TreeMesh> {
        let Cutter {
            cx,
            volume,
            pyramid,
            tree,
            ..
        } = *cutter;
        let layout = cut::layout(params, Level::FINEST);
        let mut made_meshes = made.meshes(meshes);
        let (device_meshes, _, triangles) = self.with_bases(tree_cut::STAGE, &mut made_meshes)?;
        let mesh = CutMesh {
            corners: cutter.emit(work, &made.level_starts(&made_meshes, meshes), triangles)?,
            meshes: device_meshes,
            corner_regions: cx.upload(tree_cut::STAGE, &made.corner_regions(pyramid.grid.regions()))?,
        };
        let (indices, vertex_leaves, mut regions) = cutter.index(&mesh, &table_bases(&made_meshes))?;
        let CutMesh {
            corners,
            corner_regions,
            ..
        } = mesh;
        let corner_slots = params
            .state_error
            .then(|| error::tree_corners(cx, volume, pyramid, tree, &corners))
            .transpose()?;
        drop(corners);
        check_cancelled(cancel)?;
        let (device_meshes, vertex_count, _) = self.with_bases(tree_cut::STAGE, &mut regions)?;
        let vertices = cx.buffer(tree_cut::STAGE, vertex_count)?;
        cutter.vertices(
            &layout,
            &offset_sums,
            &corner_regions,
            &device_meshes,
            &vertex_leaves,
            &vertices,
        )?;
        self.cx.pause(tree_cut::STAGE, cancel)?;
        let errors = match &corner_slots {
            Some(corner_slots) => {
                let full = self.full_cut(volume, pyramid, params)?;
                let input = error::Input {
                    params: &layout,
                    state: &full.state,
                    regions: &regions,
                    meshes: &device_meshes,
                    corner_slots,
                    indices: &indices,
                    vertices: &vertices,
                    tree: Some(error::TreeLeaves {
                        tree,
                        leaves: &work.leaves,
                        offset_sums: &offset_sums,
                    }),
                };
                Some(error::run(cx, volume, pyramid, &input, cancel)?)
            }
            None => None,
        };
        let mesh = Mesh {
            keys: made.keys.clone(),
            regions,
            vertices,
            indices,
            errors,
        };
        Ok(TreeMesh {
            mesh,
            vertex_leaves,
            offset_sums,
        })
    }

    /// Returns the cut whose surface [`Engine::tree_surface`] makes: the last cut if it was for the same goal, otherwise a new one.
    pub(super) fn tree_cut(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        goal: &TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<Arc<TreeCut>> {
        let last = lock(&cutter.tree.last_cut).clone();
        if let Some(last) = last.filter(|last| last.is_for(params, goal)) {
            return Ok(last);
        }
        let (work, _) = self.cut_tree(cutter, params, goal, cancel)?;
        Ok(keep(cutter, params, goal, work))
    }

    /// Returns the tolerance for a budget. Reserves triangles for repairs, except if many merges share one tolerance, so that the reserve
    /// would leave too much of the budget unused.
    fn fit_tree(&self, cutter: &Cutter<'_>, work: &CutWork, max_triangles: u64) -> Result<f32> {
        if cutter.full_triangles() <= max_triangles {
            return Ok(f32::NEG_INFINITY);
        }
        let spare = max_triangles / REPAIR_SHARE;
        let (tolerance, triangles) = self.tolerance_of(cutter, work, max_triangles - spare)?;
        if triangles + 2 * spare >= max_triangles {
            return Ok(tolerance);
        }
        Ok(self.tolerance_of(cutter, work, max_triangles)?.0)
    }

    /// Returns the minimum tolerance whose cut has at most `max_triangles` before repairs, and its triangles; `f32::MAX` if no cut has so
    /// few. Marked nodes have an infinite key.
    fn tolerance_of(&self, cutter: &Cutter<'_>, work: &CutWork, max_triangles: u64) -> Result<(f32, u64)> {
        let full = cutter.full_triangles();
        let wanted = full.saturating_sub(max_triangles);
        if wanted == 0 {
            return Ok((f32::NEG_INFINITY, full));
        }
        let mut range = ERROR_KEYS;
        loop {
            let removed = cutter.histogram(&work.keys, range)?;
            let mut sum = 0u64;
            let bin = removed.iter().position(|&n| {
                sum += u64::from(n);
                sum >= wanted
            });
            let Some(bin) = bin.filter(|&bin| bin <= INNER_BINS) else {
                return Ok((f32::MAX, full - sum));
            };
            if bin == 0 || range.shift == 0 {
                let tolerance = f32::from_bits(range.first + ((bin as u32) << range.shift) - 1);
                return Ok((tolerance, full - sum));
            }
            // Search again inside the bin: all keys below it fall into the first of the new bins.
            range = Keys {
                first: range.first + ((bin as u32 - 1) << range.shift),
                shift: range.shift.saturating_sub(INNER_BINS.ilog2()),
            };
        }
    }
}

/// Keeps a cut as the tree's last one.
fn keep(cutter: &Cutter<'_>, params: &CutParams, goal: &TreeGoal, work: CutWork) -> Arc<TreeCut> {
    let (keys, leaves) = work.into_keys_and_leaves();
    let cut = Arc::new(TreeCut {
        params: params.clone(),
        goal: goal.clone(),
        keys,
        leaves,
        left_out: cutter.left_out.clone(),
    });
    *lock(&cutter.tree.last_cut) = Some(Arc::clone(&cut));
    cut
}

/// Returns the offset of each region's hash table of vertices, and the end of the last one. At least a quarter of the entries stay
/// free, even if all corners are leaves of other regions.
fn table_bases(meshes: &[RegionMesh]) -> Vec<u32> {
    let mut end = 0u32;
    let ends = meshes.iter().map(|mesh| {
        end += (4 * triangles(mesh) as u32 + 1).next_power_of_two();
        end
    });
    std::iter::once(0).chain(ends).collect()
}

/// Estimates the distance of a cut's surface to the full one from the quadrics of its leaves.
fn estimate(cutter: &Cutter<'_>, sums: &[TreeCutRegion]) -> ErrorEstimate {
    ErrorEstimate {
        rms: cutter.rms(sums.iter().map(|region| f64::from(region.error2)).sum()),
        worst_leaf: sums.iter().map(|region| region.worst).fold(0.0, f32::max),
    }
}
