//! The paper's mesher: marching cubes on every leaf, with refinement.

use super::SlabWork;
use super::args::kernel_args;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Grid, RegionMesh, WorkVertex};
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "march";

kernel_args! {
    /// Arguments of `march_mark` and `march_vertices`.
    MarchArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// Compact index of the first region of this launch.
        first_region: u32,
    }
}

/// Intermediate results of the mesher per slot: the edges that a cell owns and the vertices before it, and the refined vertices of
/// coarse leaves.
pub struct Marks {
    pub owners: Buffer<u32>,
    pub refined: Buffer<[u32; 2]>,
}

/// Finds the fine grid edges that carry vertices, and counts vertices and triangles by region.
pub fn gather(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    work: &[SlabWork<'_>],
    state: &Buffer<u8>,
    cases: &Buffer<u8>,
) -> Result<(Marks, Vec<RegionMesh>)> {
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let local = cx.tuning.region_group;
    let grid = volume.layout();
    let marks = Marks {
        owners: cx.zeroed(STAGE, pyramid.nodes.len())?,
        refined: cx.buffer(STAGE, pyramid.nodes.len())?,
    };
    for slab in work {
        let args = MarchArgs {
            grid,
            z0: slab.z0,
            iso: pyramid.iso,
            first_region: slab.regions.start as u32,
        };
        cx.launch(
            STAGE,
            &kernel("march_mark")?,
            slab.regions.len(),
            local,
            &[
                &args,
                slab.samples,
                &pyramid.regions,
                &pyramid.bricks,
                &pyramid.nodes,
                state,
                &marks.owners,
                &marks.refined,
            ],
        )?;
    }
    let meshes: Buffer<RegionMesh> = cx.buffer(STAGE, pyramid.host_regions.len())?;
    cx.launch(
        STAGE,
        &kernel("march_count")?,
        pyramid.host_regions.len(),
        local,
        &[&pyramid.regions, &pyramid.nodes, state, cases, &marks.owners, &meshes],
    )?;
    let meshes = cx.read(STAGE, &meshes, pyramid.host_regions.len())?;
    Ok((marks, meshes))
}

/// What [`assemble`] reads.
pub struct Gathered<'a> {
    pub state: &'a Buffer<u8>,
    pub cases: &'a Buffer<u8>,
    pub marks: &'a Marks,
    pub meshes: &'a Buffer<RegionMesh>,
}

/// Fills `vertices` with positions and `indices` with triangles.
pub fn assemble(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    work: &[SlabWork<'_>],
    gathered: &Gathered<'_>,
    vertices: &Buffer<WorkVertex>,
    indices: &Buffer<u32>,
) -> Result<()> {
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let local = cx.tuning.region_group;
    let grid = volume.layout();
    let Gathered {
        state,
        cases,
        marks,
        meshes,
    } = gathered;
    for slab in work {
        let args = MarchArgs {
            grid,
            z0: slab.z0,
            iso: pyramid.iso,
            first_region: slab.regions.start as u32,
        };
        cx.launch(
            STAGE,
            &kernel("march_vertices")?,
            slab.regions.len(),
            local,
            &[
                &args,
                slab.samples,
                &pyramid.regions,
                &pyramid.nodes,
                &marks.owners,
                *meshes,
                vertices,
            ],
        )?;
    }
    cx.launch(
        STAGE,
        &kernel("march_triangles")?,
        pyramid.host_regions.len(),
        local,
        &[
            &grid,
            &pyramid.regions,
            &pyramid.bricks,
            &pyramid.nodes,
            *state,
            &marks.refined,
            *cases,
            &marks.owners,
            *meshes,
            indices,
        ],
    )
}
