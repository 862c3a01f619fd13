//! Vertices as they leave the device.

use super::SlabWork;
use super::args::kernel_args;
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Counters, CutParams, Grid, RegionMesh, Vertex, WorkVertex};
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "pack";

kernel_args! {
    /// Arguments of `pack`.
    PackArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// What the cut depends on.
        params: CutParams,
        /// Compact index of the first region of this launch.
        first_region: u32,
    }
}

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
    let kernel = |name| cx.kernel(volume.sample_type, name);
    let grid = volume.layout();
    for slab in slabs {
        let args = PackArgs {
            grid,
            z0: slab.z0,
            iso: pyramid.iso,
            params: *input.params,
            first_region: slab.regions.start as u32,
        };
        cx.launch(
            STAGE,
            &kernel("pack")?,
            slab.regions.len(),
            cx.tuning.region_group,
            &[
                &args,
                slab.samples,
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
