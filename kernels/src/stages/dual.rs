//! The mesher that is watertight by construction.

use super::args::kernel_args;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::{CutParams, Grid, RegionMesh, TreeRegion, Vertex};
use crate::{Result, Volume, constants};

/// Name of the stage.
pub const STAGE: &str = "dual";

kernel_args! {
    /// Arguments of `dual_count`.
    DualCountArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Active bricks.
        brick_count: u32,
        /// 1: samples are missing somewhere.
        has_missing: u32,
    }
    /// Arguments of `dual_emit`.
    DualEmitArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the cut depends on.
        params: CutParams,
        /// Active bricks.
        brick_count: u32,
        /// 1: samples are missing somewhere.
        has_missing: u32,
        /// What is written for corners: `CORNERS_INDICES` and its like.
        corners: u32,
    }
}

/// Words of a region's mask of ghosts and border vertices.
const HALO_WORDS: usize = constants::HALO_WORDS as usize;

/// What [`count`] computes for each slot, brick and region.
pub struct Counted {
    /// Parts with work to do, those to be meshed first.
    parts: Buffer<u32>,
    /// Number of parts to be meshed.
    mesh_parts: usize,
    /// Of each brick, whether all its active cells are leaves.
    fine: Buffer<u8>,
    /// Of each slot, whether the mesh of its own region has its vertex.
    used: Buffer<u8>,
    /// Edges around which each leaf emits a polygon, one bit each.
    emitted_edges: Buffer<u32>,
    /// Triangles of levels 0 to 3 of each brick, then of levels 4 and 5 of each region.
    brick_triangles: Buffer<u32>,
    /// Index of the first of these triangles among those of the region.
    first_triangles: Buffer<u32>,
    /// Of each slot, index of its vertex in its region's mesh.
    compact_index: Buffer<u32>,
    /// Of each region, a mask of its ghosts and border vertices (`cl/lib/ghosts.h`).
    ghosts: Buffer<u32>,
    /// Of each word of these masks, index of its first vertex in the region's mesh.
    ghost_base: Buffer<u32>,
    /// Of each region, a mask of the border vertices of its own leaves.
    pub borders: Buffer<u32>,
}

/// Work of the mesher in a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Counts and the mesh.
    Mesh,
    /// Counts only, for the vertices that meshed neighbours share with the region.
    Count,
    /// Nothing.
    None,
}

/// Returns the regions that have the given work.
fn regions_at(work: &[Work], wanted: Work) -> Vec<u32> {
    let regions = (0..).zip(work);
    regions
        .filter(|(_, work)| **work == wanted)
        .map(|(region, _)| region)
        .collect()
}

/// Appends the parts of regions in their order: their bricks, then their coarse levels.
fn append_parts(parts: &mut Vec<u32>, pyramid: &Pyramid, regions: &[u32]) {
    let bricks = pyramid.bricks.len() as u32;
    for &index in regions {
        let region = &pyramid.host_regions[index as usize];
        let [low, high] = region.brick_mask;
        parts.extend(region.brick_base..region.brick_base + low.count_ones() + high.count_ones());
        parts.push(bricks + index);
    }
}

/// Counts triangles and vertices by region. `work`: the work of each region.
pub fn count(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    state: &Buffer<u8>,
    work: &[Work],
) -> Result<(Counted, Vec<RegionMesh>)> {
    let (slots, bricks, regions) = (pyramid.nodes.len(), pyramid.bricks.len(), pyramid.host_regions.len());
    let made = regions_at(work, Work::Mesh);
    let mut parts = Vec::with_capacity(bricks + regions);
    append_parts(&mut parts, pyramid, &made);
    let mesh_parts = parts.len();
    append_parts(&mut parts, pyramid, &regions_at(work, Work::Count));
    let counted = Counted {
        parts: cx.upload(STAGE, &parts)?,
        mesh_parts,
        fine: cx.buffer(STAGE, bricks)?,
        used: cx.buffer(STAGE, slots)?,
        emitted_edges: cx.buffer(STAGE, slots)?,
        brick_triangles: cx.buffer(STAGE, 4 * bricks + 2 * regions)?,
        first_triangles: cx.buffer(STAGE, 4 * bricks + 2 * regions)?,
        compact_index: cx.buffer(STAGE, slots)?,
        ghosts: cx.buffer(STAGE, regions * HALO_WORDS)?,
        ghost_base: cx.buffer(STAGE, regions * HALO_WORDS)?,
        borders: cx.buffer(STAGE, regions * HALO_WORDS)?,
    };
    let used_elsewhere: Buffer<u8> = cx.buffer(STAGE, slots)?;
    // Regions without a mesh keep their zeros.
    let meshes = cx.upload(STAGE, &vec![RegionMesh::default(); regions])?;
    let made_regions = cx.upload(STAGE, &made)?;
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let brick_count = bricks as u32;
    cx.launch(
        STAGE,
        &kernel("dual_begin")?,
        regions,
        cx.tuning.region_group,
        &[
            &pyramid.regions,
            &pyramid.bricks,
            state,
            &counted.fine,
            &counted.used,
            &used_elsewhere,
            &counted.ghosts,
            &counted.borders,
        ],
    )?;
    let args = DualCountArgs {
        grid: volume.layout(),
        brick_count,
        has_missing: volume.has_missing().into(),
    };
    cx.launch(
        STAGE,
        &kernel("dual_count")?,
        parts.len(),
        cx.tuning.brick_group,
        &[
            &args,
            &counted.parts,
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            state,
            &pyramid.near,
            &counted.fine,
            &counted.used,
            &used_elsewhere,
            &counted.emitted_edges,
            &counted.brick_triangles,
            &counted.ghosts,
            &counted.borders,
        ],
    )?;
    cx.launch(
        STAGE,
        &kernel("dual_scan")?,
        made.len(),
        cx.tuning.region_group,
        &[
            &brick_count,
            &made_regions,
            &pyramid.regions,
            &counted.used,
            &used_elsewhere,
            &counted.ghosts,
            &counted.borders,
            &counted.brick_triangles,
            &counted.first_triangles,
            &counted.compact_index,
            &counted.ghost_base,
            &meshes,
        ],
    )?;
    let meshes = cx.read(STAGE, &meshes, regions)?;
    Ok((counted, meshes))
}

/// What [`emit`] reads.
pub struct Input<'a> {
    pub params: &'a CutParams,
    pub state: &'a Buffer<u8>,
    pub counted: &'a Counted,
    pub meshes: &'a Buffer<RegionMesh>,
    pub corners: Corners<'a>,
}

/// Selects what is written in addition to or instead of the indices of a mesh.
#[derive(Clone, Copy)]
pub enum Corners<'a> {
    /// Nothing else.
    Indices,
    /// The slot behind every index, for [`super::error`].
    Slots(&'a Buffer<u32>),
    /// Numbers of points instead of indices, and no vertices, for [`super::tree`].
    Points {
        /// Points before each word of [`Counted::borders`], in its region.
        border_base: &'a Buffer<u32>,
        /// Of each region.
        tree_regions: &'a Buffer<TreeRegion>,
        /// Receives the positions of those on the volume's faces.
        points: &'a Buffer<[i32; 4]>,
    },
}

/// Fills `vertices` and `indices`.
pub fn emit(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    input: &Input<'_>,
    vertices: &Buffer<Vertex>,
    indices: &Buffer<u32>,
) -> Result<()> {
    let counted = input.counted;
    // Arguments that a mode does not use get any other buffer.
    let (corners, corner_slots, border_base, tree_regions, points): (u32, &dyn Arg, &dyn Arg, &dyn Arg, &dyn Arg) =
        match &input.corners {
            Corners::Indices => (constants::CORNERS_INDICES, indices, indices, indices, indices),
            Corners::Slots(slots) => (constants::CORNERS_SLOTS, *slots, indices, indices, indices),
            Corners::Points {
                border_base,
                tree_regions,
                points,
            } => (constants::CORNERS_POINTS, indices, *border_base, *tree_regions, *points),
        };
    let args = DualEmitArgs {
        grid: volume.layout(),
        params: *input.params,
        brick_count: pyramid.bricks.len() as u32,
        has_missing: volume.has_missing().into(),
        corners,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "dual_emit")?,
        counted.mesh_parts,
        cx.tuning.brick_group,
        &[
            &args,
            &counted.parts,
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            input.state,
            &pyramid.near,
            &counted.fine,
            &pyramid.vertex_records,
            &counted.used,
            &counted.emitted_edges,
            &counted.brick_triangles,
            &counted.first_triangles,
            &counted.compact_index,
            &counted.ghosts,
            &counted.ghost_base,
            input.meshes,
            vertices,
            indices,
            corner_slots,
            &counted.borders,
            border_base,
            tree_regions,
            points,
        ],
    )
}
