//! Builds the nodes of the vertex tree. The time is billed to the stage `tree`.

use super::args::kernel_args;
use super::tree::{Mesh, STAGE};
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, Grid, TreeCluster, TreeMembers, TreeRegion};
use crate::tree::Built;
use crate::{Pyramid, Result, Volume};
use std::cmp::Reverse;
use std::ops::Range;

kernel_args! {
    /// Arguments of `tree_build`.
    TreeBuildArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What positions depend on: whether the volume is capped.
        params: CutParams,
        /// First region of this launch.
        first_region: u32,
        /// Points of cells and sheets of all regions.
        cell_points: u32,
    }
}

/// On a CPU, the order in which the regions of each launch are built.
pub struct Queue {
    order: Buffer<u32>,
    claimed: Buffer<u32>,
}

impl Queue {
    /// Orders the regions of each launch by falling triangle count, so that no core starts a large region last.
    pub fn new(cx: &Context, batches: &[Range<usize>], regions: &[TreeRegion]) -> Result<Self> {
        let mut order: Vec<u32> = (0..regions.len() as u32).collect();
        for batch in batches {
            order[batch.clone()].sort_by_key(|&region| Reverse(regions[region as usize].triangle_count));
        }
        Ok(Self {
            order: cx.upload(STAGE, &order)?,
            claimed: cx.filled(STAGE, regions.len(), 0)?,
        })
    }
}

/// Working memory of some regions.
pub struct Work<'a> {
    queue: &'a Queue,
    pub triangles: Buffer<u32>,
    rings: Buffer<u32>,
    costs: Buffer<f32>,
    clusters: Buffer<TreeCluster>,
    members: Buffer<TreeMembers>,
    positions: Buffer<[f32; 4]>,
    merged_positions: Buffer<[f32; 4]>,
    lists: Buffer<u32>,
}

impl<'a> Work<'a> {
    /// Allocates for regions that have `triangles` triangles and `points` points in total.
    pub fn new(cx: &Context, queue: &'a Queue, triangles: usize, points: usize) -> Result<Self> {
        let entries = 2 * (3 * triangles + points);
        Ok(Self {
            queue,
            triangles: cx.buffer(STAGE, 3 * triangles)?,
            // The last ring is read as a whole number of vectors, and so are its costs.
            rings: cx.buffer(STAGE, entries + cx.tuning.lanes)?,
            costs: cx.buffer(STAGE, entries + cx.tuning.lanes)?,
            clusters: cx.buffer(STAGE, points)?,
            members: cx.buffer(STAGE, points)?,
            positions: cx.buffer(STAGE, points)?,
            merged_positions: cx.buffer(STAGE, points)?,
            lists: cx.buffer(STAGE, 3 * points)?,
        })
    }
}

/// Builds the tree of some regions, whose triangles are in `work`.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    mesh: &Mesh<'_>,
    regions: Range<usize>,
    work: &Work<'_>,
    built: &Built,
) -> Result<()> {
    let args = TreeBuildArgs {
        grid: volume.layout(),
        params: *mesh.params,
        first_region: regions.start as u32,
        cell_points: mesh.cell_points,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_build")?,
        regions.len(),
        cx.tuning.wide_group,
        &[
            &args,
            &pyramid.regions,
            &pyramid.nodes,
            &pyramid.vertex_records,
            mesh.points,
            &built.regions,
            &work.queue.order,
            &work.queue.claimed,
            &work.triangles,
            &work.rings,
            &work.costs,
            &work.clusters,
            &work.members,
            &work.positions,
            &work.merged_positions,
            &work.lists,
            &built.nodes,
            &built.node_errors,
            &built.node_levels,
            &built.node_parents,
            &built.point_parents,
            &built.round_ends,
        ],
    )
}
