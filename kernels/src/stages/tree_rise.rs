//! From one level of the vertex tree to the next. The time is billed to the stage `tree`.

use super::BRICK_GROUP;
use super::args::kernel_args;
use super::tree::{Level, STAGE};
use super::tree_build::Work;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Grid, RegionMesh, TreeCluster, TreeMembers, TreeRegion};
use crate::tree::Built;
use crate::{Result, Volume};
use std::ops::Range;

kernel_args! {
    /// Arguments of `tree_commit`, `tree_rise` and `tree_risen`.
    TreeRiseArgs {
        /// Extent of the volume, in blocks of the level instead of regions.
        grid: Grid,
        /// First block of this launch.
        first_region: u32,
        /// Level of the blocks.
        level: u32,
        /// Points of the surface.
        points: u32,
    }
}

/// Clusters without their neighbours: their data, and their positions and flags.
pub struct Clusters {
    pub clusters: Buffer<TreeCluster>,
    pub members: Buffer<TreeMembers>,
    pub points: Buffer<[i32; 4]>,
}

impl Clusters {
    /// Allocates `count` clusters.
    pub fn new(cx: &Context, count: usize) -> Result<Self> {
        Ok(Self {
            clusters: cx.buffer(STAGE, count)?,
            members: cx.buffer(STAGE, count)?,
            points: cx.buffer(STAGE, count)?,
        })
    }
}

/// What some blocks of a level have left.
pub struct Roots {
    pub blocks: Range<usize>,
    /// Of each block, its first node and its first root in `clusters`.
    bases: Buffer<[u32; 2]>,
    clusters: Clusters,
}

fn args(level: &Level<'_>, first: usize, points: u32) -> TreeRiseArgs {
    TreeRiseArgs {
        grid: level.grid,
        first_region: first as u32,
        level: level.number,
        points,
    }
}

/// Appends the nodes of some blocks to the tree. `built_blocks`: these blocks, with the first node of each.
pub fn commit(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    blocks: Range<usize>,
    (built_blocks, tree_regions): (&[TreeRegion], &Buffer<TreeRegion>),
    work: &Work<'_>,
    built: &Built,
) -> Result<Roots> {
    let mut count = 0;
    let bases: Vec<[u32; 2]> = built_blocks
        .iter()
        .map(|block| {
            let base = [block.node_base, count];
            count += block.clusters;
            base
        })
        .collect();
    let roots = Roots {
        bases: cx.upload(STAGE, &bases)?,
        clusters: Clusters::new(cx, count as usize)?,
        blocks,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_commit")?,
        roots.blocks.len(),
        cx.tuning.region_group,
        &[
            &args(level, roots.blocks.start, built.point_parents.len() as u32),
            level.regions,
            tree_regions,
            &roots.bases,
            level.points,
            level.risen.clusters,
            &work.nodes,
            &work.node_errors,
            &work.node_levels,
            &work.node_parents,
            &work.cluster_parents,
            &work.clusters,
            &work.members,
            &work.positions,
            &work.lists,
            &built.nodes,
            &built.node_errors,
            &built.node_levels,
            &built.node_parents,
            &built.point_parents,
            &roots.clusters.clusters,
            &roots.clusters.members,
            &roots.clusters.points,
        ],
    )?;
    Ok(roots)
}

/// Makes the roots of some blocks clusters of the next level. `to`: the first one of each block; `risen_of`: receives the number of the
/// cluster of each leaf that is a root.
pub fn rise(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    tree_regions: &Buffer<TreeRegion>,
    (roots, to): (&Roots, &[u32]),
    next: &Clusters,
    risen_of: &Buffer<u32>,
) -> Result<()> {
    let to = cx.upload(STAGE, to)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_rise")?,
        roots.blocks.len(),
        cx.tuning.region_group,
        &[
            &args(level, roots.blocks.start, 0),
            level.regions,
            tree_regions,
            &roots.bases,
            &to,
            &roots.clusters.clusters,
            &roots.clusters.members,
            &roots.clusters.points,
            &next.clusters,
            &next.members,
            &next.points,
            risen_of,
        ],
    )
}

/// Returns the next level's cluster of each point or cluster of a level.
pub fn risen(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    built: &Built,
    risen_of: &Buffer<u32>,
) -> Result<Buffer<u32>> {
    let count = level.points.len();
    let next = cx.buffer(STAGE, count)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_risen")?,
        count.div_ceil(BRICK_GROUP),
        BRICK_GROUP,
        &[
            &args(level, 0, built.point_parents.len() as u32),
            &(count as u32),
            level.risen.clusters,
            &built.point_parents,
            &built.node_parents,
            risen_of,
            &next,
        ],
    )?;
    Ok(next)
}

/// Sets the parents of some leaves: pairs of a leaf and a node.
pub fn link(cx: &Context, volume: &Volume, built: &Built, leaves: &[[u32; 2]]) -> Result<()> {
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_link")?,
        leaves.len().div_ceil(BRICK_GROUP),
        BRICK_GROUP,
        &[
            &(leaves.len() as u32),
            &(built.point_parents.len() as u32),
            &cx.upload(STAGE, leaves)?,
            &built.point_parents,
            &built.node_parents,
        ],
    )
}

/// Counts the triangles of each block of a level that remain in the next one.
pub fn count_survivors(cx: &Context, volume: &Volume, level: &Level<'_>, next: &Buffer<u32>) -> Result<Vec<u32>> {
    let counts = cx.buffer(STAGE, level.meshes.len())?;
    launch_survivors(cx, volume, level, 0, [next, &counts, level.corners])?;
    cx.read(STAGE, &counts, counts.len())
}

/// Returns the remaining triangles, `total` of them. `firsts`: the first one of each block.
pub fn survivors(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    next: &Buffer<u32>,
    (firsts, total): (&[u32], usize),
) -> Result<Buffer<u32>> {
    let corners = cx.buffer(STAGE, 3 * total)?;
    launch_survivors(cx, volume, level, 1, [next, &cx.upload(STAGE, firsts)?, &corners])?;
    Ok(corners)
}

fn launch_survivors(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    fill: u32,
    [next, counts, corners]: [&Buffer<u32>; 3],
) -> Result<()> {
    let meshes: &Buffer<RegionMesh> = level.meshes;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_survivors")?,
        meshes.len(),
        cx.tuning.region_group,
        &[&fill, meshes, level.corners, next, counts, corners],
    )
}
