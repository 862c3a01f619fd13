//! The mesher that is watertight by construction.

use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Counters, CutParams, RegionMesh, Vertex};
use crate::program::region_group;
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "dual";

/// Words of a region's mask of ghosts: `SHELL_WORDS` in `cl/dual.cl`.
const SHELL_WORDS: usize = 817;

/// What [`count`] finds out for each slot and region.
pub struct Counted {
    /// Slots whose vertex their own region uses, and those that another region uses.
    used: Buffer<u8>,
    used_elsewhere: Buffer<u8>,
    triangle_counts: Buffer<u8>,
    /// Place of a used vertex among those of its region.
    places: Buffer<u32>,
    ghosts: Buffer<u32>,
}

/// Counts vertices and triangles by region.
pub fn count(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    state: &Buffer<u8>,
) -> Result<(Counted, Vec<RegionMesh>)> {
    let (slots, regions) = (pyramid.nodes.len(), pyramid.host_regions.len());
    let counted = Counted {
        used: cx.zeroed(STAGE, slots)?,
        used_elsewhere: cx.zeroed(STAGE, slots)?,
        triangle_counts: cx.buffer(STAGE, slots)?,
        places: cx.buffer(STAGE, slots)?,
        ghosts: cx.buffer(STAGE, regions * SHELL_WORDS)?,
    };
    let meshes: Buffer<RegionMesh> = cx.buffer(STAGE, regions)?;
    cx.launch(
        STAGE,
        cx.kernels(volume.sample_type)?.get("dual_count"),
        regions,
        region_group(cx.found.info.kind),
        &[
            &volume.layout(),
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            state,
            &counted.used,
            &counted.used_elsewhere,
            &counted.triangle_counts,
            &counted.places,
            &counted.ghosts,
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
    /// Room for the slot behind every index, for [`super::error`].
    pub corner_slots: Option<&'a Buffer<u32>>,
}

/// Fills `vertices` and `indices`, and counts the different vertices.
pub fn emit(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    input: &Input<'_>,
    vertices: &Buffer<Vertex>,
    indices: &Buffer<u32>,
    counters: &Buffer<Counters>,
) -> Result<()> {
    cx.launch(
        STAGE,
        cx.kernels(volume.sample_type)?.get("dual_emit"),
        pyramid.host_regions.len(),
        region_group(cx.found.info.kind),
        &[
            &volume.layout(),
            &pyramid.region_index,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            input.state,
            input.params,
            &pyramid.placements,
            &input.counted.used,
            &input.counted.used_elsewhere,
            &input.counted.triangle_counts,
            &input.counted.places,
            &input.counted.ghosts,
            input.meshes,
            vertices,
            indices,
            counters,
            &u32::from(input.corner_slots.is_some()),
            input.corner_slots.unwrap_or(indices),
        ],
    )
}
