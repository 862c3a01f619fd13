//! Whether a cut of the vertex tree has the surface's topology. Its time counts as that of the cuts.

use super::args::kernel_args;
use super::tree_cut::{CutWork, Cutter, STAGE};
use crate::Result;
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
        /// 1: there was no cut of the same tolerance before this one.
        first: u32,
        /// 1: parts are left out; 0: none are.
        removes: u32,
    }
}

impl Cutter<'_> {
    /// Lists the triangles that are left, and marks nodes whose merging changes the topology. Whether there are any; then the keys are to
    /// be made again.
    pub fn test(&self, work: &CutWork) -> Result<bool> {
        let failed = self.cx.filled(STAGE, 1, 0)?;
        let args = TreeTestArgs {
            grid: self.volume.layout(),
            cell_points: self.tree.cell_points,
            points: self.tree.point_count(),
            tolerance: work.tolerance,
            first: work.is_first.into(),
            removes: self.left_out.is_some().into(),
        };
        self.launch_wide(
            "tree_test",
            &[
                &args,
                &self.pyramid.region_index,
                &work.renewed,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.collapsed_by,
                &self.tree.beside,
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
                &failed,
            ],
        )?;
        Ok(self.cx.read(STAGE, &failed, 1)?[0] != 0)
    }
}
