//! Cuts of the vertex tree, refined at the places where their triangles intersect.

use super::tree_cut::TreeMesh;
use crate::cancel::check_cancelled;
use crate::mesh_regions::MeshRegions;
use crate::mesh_regions::triangles;
use crate::stages::tree_cut::{CutWork, Cutter, LEAF_NUMBER, STAGE};
use crate::tree::TreeGoal;
use crate::{Cancel, CutParams, Engine, Pyramid, Region, Result, Surface, VertexTree, Volume};

/// Maximum number of refined cuts. Each round forbids merges one level further down, so a fault that the full surface does not have
/// disappears after at most as many rounds as the tree has levels.
const MAX_ROUNDS: usize = 24;

/// A vertex of a surface: the place of its region in the list, and its number there.
pub type RegionVertex = [u32; 2];

/// Finds vertices at which a surface must be refined; returns none if it has no fault. May poll for cancellation.
pub type FindFaults<'a> = &'a dyn Fn(&[Region], &dyn Cancel) -> Result<Vec<RegionVertex>>;

/// Cost of a refinement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RefinementCost {
    /// Triangles of the first cut.
    pub triangles: u64,
    /// Cuts that were made after the first one.
    pub rounds: u32,
}

impl Engine {
    /// As [`Engine::tree_surface`], then forbids the merges at the vertices that `find_faults` returns, and above them in the tree. Repeats
    /// until it finds no fault or none that can be refined, at most 24 times. If there is a budget, more is merged elsewhere. The cut is
    /// not kept for queries.
    ///
    /// # Errors
    /// As [`Engine::tree_surface`], and what `find_faults` returns.
    #[expect(clippy::too_many_arguments, reason = "as `tree_surface`, and the test")]
    pub fn refined_tree_surface(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        find_faults: FindFaults<'_>,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, f32, RefinementCost)> {
        let before = self.cx.pool.restart();
        let cutter = self.cutter_for(volume, pyramid, tree, params, goal, cancel)?;
        let (mut work, mut tolerance) = self.cut_tree(&cutter, params, goal, cancel)?;
        let importances = cutter.importances(params)?;
        let limit = goal.limit();
        let mut cost = RefinementCost {
            triangles: cutter.triangles(&work)?,
            rounds: 0,
        };
        for _ in 0..MAX_ROUNDS {
            let faulty = self.faulty_nodes(&cutter, params, &work, find_faults, cancel)?;
            if faulty.is_empty() {
                break;
            }
            cutter.forbid(&mut work, &faulty)?;
            (tolerance, _) = self.repair_cut(&cutter, importances.as_deref(), goal, limit, &mut work, cancel)?;
            cost.rounds += 1;
        }
        let (surface, _) = self.surface_of_tree_cut(&cutter, params, &work, None, before, cancel)?;
        Ok((surface, tolerance, cost))
    }

    /// Returns the merged nodes whose vertices are faulty, so that the cut must be refined there.
    fn faulty_nodes(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        work: &CutWork,
        find_faults: FindFaults<'_>,
        cancel: &dyn Cancel,
    ) -> Result<Vec<u32>> {
        let params = CutParams {
            state_error: false,
            ..params.clone()
        };
        let (meshes, _) = self.count_tree_cut(cutter, work)?;
        check_cancelled(cancel)?;
        let (all, offset_sums) = (MeshRegions::all(cutter.pyramid), cutter.offsets(work)?);
        let TreeMesh {
            mesh, vertex_leaves, ..
        } = self.mesh_tree_cut(cutter, &params, work, &meshes, &all, offset_sums, cancel)?;
        let filled = mesh.regions.iter().filter(|mesh| triangles(mesh) > 0);
        let bases: Vec<usize> = filled.map(|mesh| 3 * mesh.triangle_base as usize).collect();
        let regions = self.read_back(mesh)?;
        let faults = find_faults(&regions, cancel)?;
        if faults.is_empty() {
            return Ok(Vec::new());
        }
        let leaves = self.cx.read(STAGE, &vertex_leaves, vertex_leaves.len())?;
        let points = cutter.tree.point_count();
        let leaf = |[region, vertex]: &RegionVertex| leaves[bases[*region as usize] + *vertex as usize] & LEAF_NUMBER;
        // Points are the finest level and cannot be refined.
        let mut nodes: Vec<u32> = faults
            .iter()
            .map(leaf)
            .filter_map(|leaf| leaf.checked_sub(points))
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        Ok(nodes)
    }
}
