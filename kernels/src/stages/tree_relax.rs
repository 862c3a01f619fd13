//! Offsets of the nodes of a cut of the vertex tree. The time is billed to the stage `tree_cut`.

use super::args::kernel_args;
use super::tree_cut::{CutWork, Cutter, STAGE};
use crate::Result;
use crate::buffer::Buffer;
use crate::layout::Grid;

kernel_args! {
    /// Arguments of `tree_offsets`.
    TreeOffsetsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Points of the surface.
        points: u32,
        /// Leaves before those that are nodes of levels above the regions.
        first_above: u32,
    }
}

impl Cutter<'_> {
    /// Returns two sums of offsets for each node (`cl/lib/tree_offset.h`): over the triangles of its own region, and over those of other
    /// regions.
    pub fn offsets(&self, work: &CutWork) -> Result<Buffer<u32>> {
        let Self {
            cx,
            volume,
            pyramid,
            tree,
            ..
        } = *self;
        let sums = cx.zeroed(STAGE, 2 * tree.built.nodes.len())?;
        let args = TreeOffsetsArgs {
            grid: volume.layout(),
            points: tree.point_count(),
            first_above: tree.first_above(),
        };
        self.launch_wide(
            "tree_offsets",
            &[
                &args,
                &pyramid.regions,
                &tree.built.regions,
                &tree.meshes,
                &tree.corners,
                &work.leaves,
                &work.left,
                &work.meshes,
                &tree.built.nodes,
                &tree.points,
                &sums,
            ],
        )?;
        Ok(sums)
    }
}
