//! Makes the clusters that blocks of the vertex tree begin with. The time is billed to the stage `tree`.

use super::args::kernel_args;
use super::tree::{Level, STAGE};
use super::tree_build::{TreeBuildArgs, Work};
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::TreeRegion;
use crate::{Pyramid, Result, Volume};
use std::ops::Range;

kernel_args! {}

/// Makes the clusters of some blocks of a level, whose triangles are in `work`.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    level: &Level<'_>,
    blocks: Range<usize>,
    work: &Work<'_>,
    tree_regions: &Buffer<TreeRegion>,
) -> Result<()> {
    let args = TreeBuildArgs::new(level, blocks.start, 0);
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_begin")?,
        blocks.len(),
        cx.tuning.wide_group,
        &[
            &args,
            level.regions,
            &pyramid.nodes,
            &pyramid.vertex_records,
            level.points,
            level.risen.clusters,
            level.risen.members,
            tree_regions,
            &work.triangles,
            &work.rings,
            &work.costs,
            &work.clusters,
            &work.members,
            &work.positions,
            &work.merged_positions,
            &work.lists,
            &work.cluster_parents,
        ],
    )
}
