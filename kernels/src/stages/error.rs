//! How far a dual mesh is from the surface it stands for.

use super::args::kernel_args;
use super::{BRICK_GROUP, SlabWork};
use crate::Pyramid;
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{Grid, CutParams, NONE, RegionError, RegionMesh, Vertex};
use crate::surface::SurfaceError;
use crate::{Result, Volume};

/// Name of the stage.
pub const STAGE: &str = "error";

kernel_args! {
    /// Arguments of `error_positions`.
    ErrorPositionsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// Compact index of the first region of this launch.
        first_region: u32,
        /// What the cut depends on.
        params: CutParams,
    }
    /// Arguments of `error_crossings`.
    ErrorCrossingsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// Compact index of the first region of this launch.
        first_region: u32,
        /// Active regions.
        region_count: u32,
    }
    /// Arguments of `error_centres`.
    ErrorCentresArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// First layer of regions of this launch, counted in regions along z.
        first_layer: u32,
        /// Layer of regions after the last.
        end_layer: u32,
        /// Active regions.
        region_count: u32,
    }
}

/// What the stage reads.
pub struct Input<'a> {
    pub params: &'a CutParams,
    pub state: &'a Buffer<u8>,
    pub meshes: &'a Buffer<RegionMesh>,
    /// Slot behind every index of the mesh.
    pub corner_slots: &'a Buffer<u32>,
    pub indices: &'a Buffer<u32>,
    pub vertices: &'a Buffer<Vertex>,
}

/// Sums over distances of one kind.
#[derive(Clone, Copy, Default)]
struct Distances {
    sum2: f64,
    count: u64,
    max: f32,
}

impl Distances {
    fn add(&mut self, more: &RegionError) {
        self.sum2 += f64::from(more.sum2);
        self.count += u64::from(more.count);
        self.max = self.max.max(more.max);
    }

    fn mean2(&self) -> f64 {
        if self.count == 0 {
            0.0
        } else {
            self.sum2 / self.count as f64
        }
    }
}

/// The distances both ways as one figure: the mean of the two mean squares, and the greater maximum.
fn both(crossings: &Distances, centres: &Distances) -> SurfaceError {
    SurfaceError {
        rms: ((crossings.mean2() + centres.mean2()) / 2.0).sqrt() as f32,
        max: crossings.max.max(centres.max),
    }
}

/// Error of each active region, and of the whole surface.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    slabs: &[SlabWork<'_>],
    input: &Input<'_>,
) -> Result<(Vec<SurfaceError>, SurfaceError)> {
    let kernels = cx.kernels(volume.sample_type)?;
    let local = cx.tuning.region_group;
    let grid = volume.layout();
    let (regions, slots, corners) = (
        pyramid.host_regions.len(),
        pyramid.nodes.len(),
        input.corner_slots.len(),
    );
    let positions: Buffer<[f32; 4]> = cx.buffer(STAGE, slots)?;
    let heads: Buffer<u32> = cx.filled(STAGE, slots, NONE)?;
    let next: Buffer<u32> = cx.buffer(STAGE, corners)?;
    let unmeshed: Buffer<f32> = cx.buffer(STAGE, slots)?;
    let errors: Buffer<RegionError> = cx.buffer(STAGE, regions)?;
    let region_count = regions as u32;
    for slab in slabs {
        let args = ErrorPositionsArgs { grid, z0: slab.z0, iso: pyramid.iso, first_region: slab.regions.start as u32, params: *input.params };
        cx.launch(
            STAGE,
            kernels.get("error_positions"),
            slab.regions.len(),
            local,
            &[
                &args,
                slab.samples,
                &pyramid.regions,
                &pyramid.nodes,
                &pyramid.vertex_records,
                &positions,
            ],
        )?;
    }
    let count = corners as u32;
    let groups = corners.div_ceil(BRICK_GROUP);
    cx.launch(
        STAGE,
        kernels.get("error_link"),
        groups,
        BRICK_GROUP,
        &[&count, input.corner_slots, &heads, &next],
    )?;
    cx.launch(
        STAGE,
        kernels.get("error_unmeshed"),
        regions,
        local,
        &[
            &pyramid.regions,
            &pyramid.nodes,
            input.state,
            &(slots as u32),
            &heads,
            &positions,
            &unmeshed,
        ],
    )?;
    for slab in slabs {
        let args = ErrorCrossingsArgs { grid, z0: slab.z0, iso: pyramid.iso, first_region: slab.regions.start as u32, region_count };
        cx.launch(
            STAGE,
            kernels.get("error_crossings"),
            slab.regions.len(),
            local,
            &[
                &args,
                slab.samples,
                &pyramid.regions,
                &pyramid.bricks,
                &pyramid.nodes,
                input.state,
                input.corner_slots,
                &positions,
                input.meshes,
                input.indices,
                input.vertices,
                &heads,
                &next,
                &unmeshed,
                &errors,
            ],
        )?;
    }
    let mut crossings = vec![Distances::default(); regions];
    for (sum, more) in crossings.iter_mut().zip(cx.read(STAGE, &errors, regions)?) {
        sum.add(&more);
    }
    let mut centres = vec![Distances::default(); regions];
    for slab in &volume.slabs {
        let args = ErrorCentresArgs { grid, z0: slab.z0, iso: pyramid.iso, first_layer: slab.layers.start, end_layer: slab.layers.end, region_count };
        cx.launch(
            STAGE,
            kernels.get("error_centres"),
            regions,
            local,
            &[
                &args,
                &slab.samples,
                &pyramid.regions,
                input.corner_slots,
                &positions,
                input.meshes,
                input.indices,
                input.vertices,
                &errors,
            ],
        )?;
        for (sum, more) in centres.iter_mut().zip(cx.read(STAGE, &errors, regions)?) {
            sum.add(&more);
        }
    }
    let whole = |parts: &[Distances]| {
        parts.iter().fold(Distances::default(), |mut all, part| {
            all.sum2 += part.sum2;
            all.count += part.count;
            all.max = all.max.max(part.max);
            all
        })
    };
    let all = both(&whole(&crossings), &whole(&centres));
    Ok((crossings.iter().zip(&centres).map(|(a, b)| both(a, b)).collect(), all))
}
