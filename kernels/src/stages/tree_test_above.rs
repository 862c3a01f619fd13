//! Tests the surroundings of those leaves of a cut of the vertex tree that are nodes of levels above the regions. The time is billed to the
//! stage `tree_cut`.

use super::BRICK_GROUP;
use super::args::kernel_args;
use super::tree_cut::{CutWork, Cutter, STAGE};
use super::tree_test::TreeTestArgs;
use crate::Result;
use crate::buffer::Buffer;

kernel_args! {}

impl Cutter<'_> {
    /// Marks nodes whose merging changes the topology. `work`: with a list of all remaining triangles.
    pub(super) fn test_above(&self, args: &TreeTestArgs, work: &CutWork, failed: &Buffer<u32>) -> Result<()> {
        let (cx, tree) = (self.cx, self.tree);
        let count = tree.nodes_above();
        // Those at which parts vanish have no triangles around them.
        let around: Buffer<u32> = cx.buffer(STAGE, count as usize + tree.vanishing_nodes().len())?;
        // The regions' tables are no longer needed.
        let edges = &work.edges;
        let capacity = 3 * self.triangles(work)? as usize + 1;
        self.launch_groups(
            STAGE,
            "tree_begin_above",
            capacity.max(around.len()).div_ceil(BRICK_GROUP),
            BRICK_GROUP,
            &[&(around.len() as u32), &(capacity as u32), &around, edges],
        )?;
        self.launch_wide(
            "tree_test_above",
            &[
                args,
                &(capacity as u32),
                &tree.built.regions,
                &tree.built.nodes,
                &tree.meshes,
                &tree.corners,
                &work.leaves,
                &work.meshes,
                &work.left,
                &around,
                edges,
                &work.marks,
                &work.marked,
                failed,
            ],
        )?;
        self.launch_groups(
            STAGE,
            "tree_mark_above",
            (count as usize).div_ceil(BRICK_GROUP),
            BRICK_GROUP,
            &[
                args,
                &count,
                &tree.built.regions,
                &tree.built.nodes,
                &work.tops,
                &around,
                &work.marks,
                &work.marked,
                failed,
            ],
        )
    }
}
