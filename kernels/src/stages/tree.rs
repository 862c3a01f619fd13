//! The vertex tree, a hierarchy over the vertices of the full dual mesh: the inputs of its construction, and the tables made from its
//! nodes.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, Grid, Region, RegionMesh, TreeCluster, TreeMembers, TreeRegion};
use crate::tree::Built;
use crate::{Pyramid, Result, Volume, constants};
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "tree";

kernel_args! {
    /// Arguments of `tree_points`.
    TreePointsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What positions depend on: whether the volume is capped.
        params: CutParams,
    }
    /// Arguments of `tree_gather`.
    TreeGatherArgs {
        /// Extent of the volume, in blocks of the level instead of regions.
        grid: Grid,
        /// First block of this launch.
        first_region: u32,
        /// 0: the triangles are counted; 1: they are written, and the numbers of those of other blocks; 2: without these.
        fill: u32,
    }
}

/// Numbers the border vertices of each region: writes how many precede each word of `borders`. Returns the count of each region.
pub fn borders(
    cx: &Context,
    volume: &Volume,
    regions: usize,
    borders: &Buffer<u32>,
    border_base: &Buffer<u32>,
) -> Result<Vec<u32>> {
    let counts = cx.buffer(STAGE, regions)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_borders")?,
        regions,
        cx.tuning.region_group,
        &[borders, border_base, &counts],
    )?;
    cx.read(STAGE, &counts, regions)
}

/// Words of a region's mask of border vertices.
pub const HALO_WORDS: usize = constants::HALO_WORDS as usize;

/// Writes the positions of the points of cells and sheets.
pub fn points(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    params: &CutParams,
    points: &Buffer<[i32; 4]>,
) -> Result<()> {
    let args = TreePointsArgs {
        grid: volume.layout(),
        params: *params,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_points")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[&args, &pyramid.regions, &pyramid.vertex_records, points],
    )
}

/// The clusters that have risen to a level from the one below, without their positions.
#[derive(Clone, Copy)]
pub struct Risen<'a> {
    pub clusters: &'a Buffer<TreeCluster>,
    pub members: &'a Buffer<TreeMembers>,
}

/// A level of the tree while it is built: its blocks, and the mesh that it begins with.
#[derive(Clone, Copy)]
pub struct Level<'a> {
    /// 0: the blocks are regions.
    pub number: u32,
    /// There is no level above.
    pub is_last: bool,
    /// Extent of the volume, in blocks instead of regions.
    pub grid: Grid,
    pub params: &'a CutParams,
    /// Place of each block, and its points or clusters.
    pub regions: &'a Buffer<Region>,
    /// Number of the block at each place of the grid, or [`crate::layout::NONE`].
    pub region_index: &'a Buffer<u32>,
    pub meshes: &'a Buffer<RegionMesh>,
    /// Three points or clusters a triangle.
    pub corners: &'a Buffer<u32>,
    /// Position of each point or cluster, and its slot or flags.
    pub points: &'a Buffer<[i32; 4]>,
    /// Number of points of cells and sheets.
    pub cell_points: u32,
    /// At level 0 any buffers.
    pub risen: Risen<'a>,
}

/// The first level at which merges that turn or fold the surface are not forbidden but cost more.
const FIRST_SOFT: u32 = 3;

impl Level<'_> {
    /// Whether merges that turn or fold the surface are not forbidden but cost more.
    pub fn is_soft(&self) -> bool {
        self.is_last || self.number >= FIRST_SOFT
    }
}

/// What [`gather`] writes.
#[derive(Clone, Copy)]
pub enum Gathered<'a> {
    /// The number of triangles.
    Count,
    /// The triangles.
    Triangles(&'a Buffer<u32>),
    /// The triangles, and the numbers of those that belong to other blocks' meshes.
    Beside(&'a Buffer<u32>, &'a Buffer<u32>),
}

/// Counts the triangles that have a corner in each of some blocks, or writes them to working memory.
pub fn gather(
    cx: &Context,
    volume: &Volume,
    level: &Level<'_>,
    blocks: Range<usize>,
    tree_regions: &Buffer<TreeRegion>,
    output: Gathered<'_>,
) -> Result<()> {
    // If nothing is written, any buffers serve as these arguments.
    let (fill, triangles, beside) = match output {
        Gathered::Count => (0, level.corners, level.corners),
        Gathered::Beside(triangles, beside) => (1, triangles, beside),
        Gathered::Triangles(triangles) => (2, triangles, level.corners),
    };
    let args = TreeGatherArgs {
        grid: level.grid,
        first_region: blocks.start as u32,
        fill,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_gather")?,
        blocks.len(),
        cx.tuning.region_group,
        &[
            &args,
            level.region_index,
            level.regions,
            level.meshes,
            level.corners,
            tree_regions,
            triangles,
            beside,
        ],
    )
}

impl Built {
    /// Allocates a tree of `points` points, without its blocks.
    pub fn new(cx: &Context, points: usize) -> Result<Self> {
        Ok(Self {
            regions: cx.buffer(STAGE, 0)?,
            node_count: 0,
            round_ends: cx.buffer(STAGE, 0)?,
            nodes: cx.buffer(STAGE, points)?,
            node_errors: cx.buffer(STAGE, points)?,
            node_levels: cx.buffer(STAGE, points)?,
            node_parents: cx.buffer(STAGE, points)?,
            point_parents: cx.buffer(STAGE, points)?,
        })
    }
}

/// Returns for each triangle of the full mesh the node whose merge collapses it. Needs the finished tree of all regions.
pub fn collapses(cx: &Context, volume: &Volume, mesh: &Level<'_>, built: &Built) -> Result<Buffer<u32>> {
    let collapsed_by = cx.buffer(STAGE, mesh.corners.len() / 3)?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_collapse")?,
        mesh.meshes.len(),
        cx.tuning.region_group,
        &[
            mesh.meshes,
            mesh.corners,
            &built.point_parents,
            &built.node_parents,
            &collapsed_by,
        ],
    )?;
    Ok(collapsed_by)
}

/// Returns the corners of the full mesh at each point, and the end of each point's range of corners.
pub fn point_corners(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    mesh: &Level<'_>,
    built: &Built,
    beside: &Buffer<u32>,
) -> Result<(Buffer<u32>, Buffer<u32>)> {
    // Sized for the corners of all regions' lists of triangles. Entries for corners outside the region stay unused.
    let numbers = cx.buffer(STAGE, mesh.corners.len() + 3 * beside.len())?;
    let ends = cx.buffer(STAGE, mesh.points.len())?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_corners")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[
            &(mesh.points.len() as u32),
            &pyramid.regions,
            &built.regions,
            mesh.meshes,
            mesh.corners,
            beside,
            &numbers,
            &ends,
        ],
    )?;
    Ok((numbers, ends))
}

/// Returns the rounds during which each leaf existed, two bytes per leaf.
pub fn lives(cx: &Context, volume: &Volume, pyramid: &Pyramid, points: usize, built: &Built) -> Result<Buffer<u8>> {
    let lives = cx.buffer(STAGE, 2 * (points + built.nodes.len()))?;
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_lives")?,
        pyramid.host_regions.len(),
        cx.tuning.region_group,
        &[
            &(points as u32),
            &pyramid.regions,
            &built.regions,
            &built.point_parents,
            &built.node_parents,
            &built.round_ends,
            &lives,
        ],
    )?;
    Ok(lives)
}
