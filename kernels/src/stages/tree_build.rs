//! Builds the nodes of the vertex tree. The time is billed to the stage `tree`.

use super::args::kernel_args;
use super::tree::{Level, STAGE};
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, Grid, TreeCluster, TreeMembers, TreeNode, TreeRegion};
use crate::{Result, Volume};
use std::cmp::Reverse;
use std::ops::Range;

kernel_args! {
    /// Arguments of `tree_build`.
    TreeBuildArgs {
        /// Extent of the volume, in blocks of the level instead of regions.
        grid: Grid,
        /// What positions depend on: whether the volume is capped.
        params: CutParams,
        /// First block of this launch.
        first_region: u32,
        /// Points of cells and sheets of all regions.
        cell_points: u32,
        /// Level of the blocks.
        level: u32,
        /// 1: there is no level above.
        is_last: u32,
        /// 1: merges that turn or fold the surface are not forbidden but cost more.
        is_soft: u32,
        /// Maximum number of rounds of this launch.
        rounds: u32,
    }
}

/// On a CPU, the order in which the blocks of each launch are built.
pub struct Queue {
    order: Buffer<u32>,
}

impl Queue {
    /// Orders the blocks of each launch by falling triangle count, so that no core starts a large block last.
    pub fn new(cx: &Context, batches: &[Range<usize>], regions: &[TreeRegion]) -> Result<Self> {
        let mut order: Vec<u32> = (0..regions.len() as u32).collect();
        for batch in batches {
            order[batch.clone()].sort_by_key(|&region| Reverse(regions[region as usize].triangle_count));
        }
        Ok(Self {
            order: cx.upload(STAGE, &order)?,
        })
    }
}

/// Working memory of some blocks.
pub struct Work<'a> {
    queue: &'a Queue,
    pub triangles: Buffer<u32>,
    pub(super) rings: Buffer<u32>,
    pub(super) costs: Buffer<f32>,
    pub(super) clusters: Buffer<TreeCluster>,
    pub(super) members: Buffer<TreeMembers>,
    pub(super) positions: Buffer<[f32; 4]>,
    pub(super) merged_positions: Buffer<[f32; 4]>,
    pub(super) lists: Buffer<u32>,
    /// Nodes as in [`crate::tree::Built`], but numbered in the launch.
    pub(super) nodes: Buffer<TreeNode>,
    pub(super) node_errors: Buffer<u32>,
    pub(super) node_levels: Buffer<u8>,
    pub(super) node_parents: Buffer<u32>,
    /// The node that each of the blocks' first clusters merges into.
    pub(super) cluster_parents: Buffer<u32>,
}

impl<'a> Work<'a> {
    /// Allocates for blocks that have `triangles` triangles and `clusters` clusters in total.
    pub fn new(cx: &Context, queue: &'a Queue, triangles: usize, clusters: usize) -> Result<Self> {
        let entries = 2 * (3 * triangles + clusters);
        Ok(Self {
            queue,
            triangles: cx.buffer(STAGE, 3 * triangles)?,
            // The last ring is read as a whole number of vectors, and so are its costs.
            rings: cx.buffer(STAGE, entries + cx.tuning.lanes)?,
            costs: cx.buffer(STAGE, entries + cx.tuning.lanes)?,
            clusters: cx.buffer(STAGE, clusters)?,
            members: cx.buffer(STAGE, clusters)?,
            positions: cx.buffer(STAGE, clusters)?,
            merged_positions: cx.buffer(STAGE, clusters)?,
            lists: cx.buffer(STAGE, 3 * clusters)?,
            nodes: cx.buffer(STAGE, clusters)?,
            node_errors: cx.buffer(STAGE, clusters)?,
            node_levels: cx.buffer(STAGE, clusters)?,
            node_parents: cx.buffer(STAGE, clusters)?,
            cluster_parents: cx.buffer(STAGE, clusters)?,
        })
    }
}

impl TreeBuildArgs {
    /// Of a launch for blocks of a level from `first` on.
    pub(super) fn new(level: &Level<'_>, first: usize, rounds: u32) -> Self {
        Self {
            grid: level.grid,
            params: *level.params,
            first_region: first as u32,
            cell_points: level.cell_points,
            level: level.number,
            is_last: level.is_last.into(),
            is_soft: level.is_soft().into(),
            rounds,
        }
    }
}

/// Makes up to `rounds` rounds of merges in some blocks of a level that have begun.
pub fn run(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    blocks: Range<usize>,
    rounds: u32,
    work: &Work<'_>,
    (tree_regions, round_ends): (&Buffer<TreeRegion>, &Buffer<u32>),
) -> Result<()> {
    let args = TreeBuildArgs::new(level, blocks.start, rounds);
    let claimed = cx.filled(STAGE, 1, 0)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_build")?,
        blocks.len(),
        cx.tuning.wide_group,
        &[
            &args,
            level.regions,
            level.points,
            tree_regions,
            &work.queue.order,
            &claimed,
            &work.rings,
            &work.costs,
            &work.clusters,
            &work.members,
            &work.positions,
            &work.merged_positions,
            &work.lists,
            &work.nodes,
            &work.node_errors,
            &work.node_levels,
            &work.node_parents,
            &work.cluster_parents,
            round_ends,
        ],
    )
}
