//! Tests whether a cut of the vertex tree has the surface's topology. The time is billed to the stage `tree_cut`.

use super::args::kernel_args;
use super::tree_cut::{CutWork, Cutter, STAGE};
use crate::Result;
use crate::buffer::Buffer;
use crate::layout::Grid;

kernel_args! {
    /// Arguments of `tree_test`.
    TreeTestArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// 1: parts are left out; 0: none are.
        removes: u32,
        /// Leaves before those that are nodes of levels above the regions.
        first_above: u32,
    }
}

impl Cutter<'_> {
    /// Marks nodes whose merging changes the topology. Returns whether there are any; then the keys must be computed again. The first test
    /// of a tolerance lists the remaining triangles.
    pub fn test(&self, work: &CutWork) -> Result<bool> {
        let failed = self.cx.filled(STAGE, 1, 0)?;
        if work.is_first {
            self.test_all(work, &failed)?;
        } else {
            self.test_changed(work, &failed)?;
        }
        if self.merges_above(work)? {
            if !work.is_first {
                self.list(work)?;
            }
            self.test_above(&self.args(work), work, &failed)?;
        }
        Ok(self.cx.read(STAGE, &failed, 1)?[0] != 0)
    }

    fn args(&self, work: &CutWork) -> TreeTestArgs {
        TreeTestArgs {
            grid: self.volume.layout(),
            cell_points: self.tree.cell_points,
            points: self.tree.point_count(),
            tolerance: work.tolerance,
            removes: self.left_out.is_some().into(),
            first_above: self.tree.first_above(),
        }
    }

    fn test_all(&self, work: &CutWork, failed: &Buffer<u32>) -> Result<()> {
        self.launch_wide(
            "tree_test",
            &[
                &self.args(work),
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.lives,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &self.tree.beside,
                &self.tree.point_corners,
                &self.tree.corner_ends,
                &work.keys,
                &work.tops,
                &work.leaves,
                &work.meshes,
                &work.left,
                &work.around,
                &work.edges,
                &work.marks,
                &work.marked,
                &work.broken,
                &work.stale,
                failed,
            ],
        )
    }

    fn test_changed(&self, work: &CutWork, failed: &Buffer<u32>) -> Result<()> {
        self.launch_wide(
            "tree_retest",
            &[
                &self.args(work),
                &self.pyramid.region_index,
                &work.renewed,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.lives,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &self.tree.point_corners,
                &self.tree.corner_ends,
                &work.keys,
                &work.leaves,
                &work.changed,
                &work.changed_counts,
                &work.around,
                &work.edges,
                &work.marks,
                &work.marked,
                &work.broken,
                &work.stale,
                failed,
            ],
        )
    }

    /// Lists the remaining triangles again in the regions that repairs have changed.
    pub fn list(&self, work: &CutWork) -> Result<()> {
        self.launch_wide(
            "tree_list",
            &[
                &self.args(work),
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &work.keys,
                &work.leaves,
                &work.stale,
                &work.meshes,
                &work.left,
            ],
        )
    }
}
