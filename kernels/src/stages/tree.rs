//! The vertex tree, a hierarchy over the vertices of the full dual mesh: the inputs of its construction, and the tables made from its
//! nodes.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, Grid, RegionMesh, TreeRegion};
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
        /// Extent of the volume.
        grid: Grid,
        /// First region of this launch.
        first_region: u32,
        /// 1: the triangles are written; 0: they are counted.
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

/// The full dual mesh as triangles between points.
pub struct Mesh<'a> {
    pub params: &'a CutParams,
    pub meshes: &'a Buffer<RegionMesh>,
    /// Three points a triangle.
    pub corners: &'a Buffer<u32>,
    pub points: &'a Buffer<[i32; 4]>,
    /// Number of points of cells and sheets.
    pub cell_points: u32,
}

/// Counts the triangles that have a corner in each region. With `output`, writes the triangles of some regions to working memory, and
/// the numbers of those that belong to other regions' meshes.
pub fn gather(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    mesh: &Mesh<'_>,
    regions: Range<usize>,
    tree_regions: &Buffer<TreeRegion>,
    output: Option<[&Buffer<u32>; 2]>,
) -> Result<()> {
    let args = TreeGatherArgs {
        grid: volume.layout(),
        first_region: regions.start as u32,
        fill: output.is_some().into(),
    };
    // If nothing is written, any buffers serve as these arguments.
    let [triangles, beside] = output.unwrap_or([mesh.corners; 2]);
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "tree_gather")?,
        regions.len(),
        cx.tuning.region_group,
        &[
            &args,
            &pyramid.region_index,
            &pyramid.regions,
            mesh.meshes,
            mesh.corners,
            tree_regions,
            triangles,
            beside,
        ],
    )
}

impl Built {
    /// Allocates a tree of `points` points.
    pub fn new(cx: &Context, points: usize, regions: Buffer<TreeRegion>) -> Result<Self> {
        Ok(Self {
            round_ends: cx.buffer(STAGE, regions.len() * constants::TREE_ROUNDS as usize)?,
            regions,
            nodes: cx.buffer(STAGE, points)?,
            node_errors: cx.buffer(STAGE, points)?,
            node_levels: cx.buffer(STAGE, points)?,
            node_parents: cx.buffer(STAGE, points)?,
            point_parents: cx.buffer(STAGE, points)?,
        })
    }
}

/// Returns for each triangle of the full mesh the node whose merge collapses it. Needs the finished tree of all regions.
pub fn collapses(cx: &Context, volume: &Volume, mesh: &Mesh<'_>, built: &Built) -> Result<Buffer<u32>> {
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
    mesh: &Mesh<'_>,
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
