//! Vertices as they leave the device.

use super::SlabWork;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Counters, CutParams, RegionMesh, Vertex, WorkVertex};
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "pack";

/// What the stage reads.
pub struct Input<'a> {
    pub params: &'a CutParams,
    pub state: &'a Buffer<u8>,
    pub owners: &'a Buffer<u32>,
    pub meshes: &'a Buffer<RegionMesh>,
    pub work: &'a Buffer<WorkVertex>,
}

/// Fills `vertices` with positions, normals and attributes, and counts the different ones.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    slabs: &[SlabWork<'_>],
    input: &Input<'_>,
    vertices: &Buffer<Vertex>,
    counters: &Buffer<Counters>,
) -> Result<()> {
    let kernels = cx.kernels(volume.sample_type)?;
    let grid = volume.layout();
    for slab in slabs {
        let first = slab.regions.start as u32;
        cx.launch(
            STAGE,
            kernels.get("pack"),
            slab.regions.len(),
            cx.tuning.region_group,
            &[
                &grid,
                slab.samples,
                &slab.z0,
                &pyramid.iso,
                input.params,
                &first,
                &pyramid.region_index,
                &pyramid.regions,
                &pyramid.bricks,
                &pyramid.nodes,
                input.state,
                input.owners,
                input.meshes,
                input.work,
                vertices,
                counters,
            ],
        )?;
    }
    Ok(())
}
