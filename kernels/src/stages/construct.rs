//! Nodes of levels 0 to 5.

use super::args::kernel_args;
use super::{BRICK_GROUP, SlabWork};
use crate::buffer::Buffer;
use crate::context::{Context, LocalBytes};
use crate::layout::{Brick, Grid, Moments, Node, Quadric, Region, VertexRecord};
use crate::{Cancel, Feature, Result, SampleType, Volume, constants};

/// Name of the stage.
pub const STAGE: &str = "construct";

kernel_args! {
    /// Arguments of `construct`.
    ConstructArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// `FEATURE_NONE`, `FEATURE_FIELD`, `FEATURE_GRADIENT` or `FEATURE_STORED`.
        feature_kind: u32,
        /// Sample type of the feature's field, `TYPE_U8` to `TYPE_F32`.
        feature_type: u32,
        /// Samples of the feature's field equal to this count as NaN.
        feature_missing: f32,
        /// Compact index of the first brick of this launch.
        first_brick: u32,
        /// 1: nodes of all levels; 0: cells alone.
        whole: u32,
    }
    /// Arguments of `construct_top`.
    ConstructTopArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// 1: nodes of all levels; 0: cells alone.
        whole_pyramid: u32,
        /// Compact index of the first region of this launch.
        first_region: u32,
        /// Active regions.
        region_count: u32,
    }
    /// Arguments of `link`.
    LinkArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Active bricks.
        brick_count: u32,
    }
}

/// Local memory of a brick for its cubes. The less a group takes, the more groups a GPU runs concurrently.
const CUBES_BYTES: usize = (constants::CUBE_ROWS * constants::CUBES) as usize * size_of::<f32>();

/// Local memory of a brick if only cells are made: six rows, or `POSITIONS_CAPACITY` in `cl/lib/device_*.h`, which is more on a CPU.
const fn cells_bytes(brick_group: usize) -> usize {
    512 * if brick_group == 1 { 4 } else { 3 } * size_of::<u16>()
}

/// Local memory of a brick. It first holds the feature at the brick's samples (a block of `cl/lib/brick_feature.h`), then its cubes.
const fn local_bytes(brick_group: usize, whole: bool, has_block: bool) -> usize {
    const BLOCK_BYTES: usize = 11 * 11 * 11 * size_of::<f32>();
    let cubes = if whole { CUBES_BYTES } else { cells_bytes(brick_group) };
    if has_block && cubes < BLOCK_BYTES {
        BLOCK_BYTES
    } else {
        cubes
    }
}

/// Returns the number of a sample type in `cl/`.
pub(super) fn type_number(sample_type: SampleType) -> u32 {
    match sample_type {
        SampleType::U8 => constants::TYPE_U8,
        SampleType::I8 => constants::TYPE_I8,
        SampleType::U16 => constants::TYPE_U16,
        SampleType::I16 => constants::TYPE_I16,
        SampleType::F32 => constants::TYPE_F32,
    }
}

/// Inputs of the stage.
pub struct Input<'a> {
    pub volume: &'a Volume,
    pub feature: Feature<'a>,
    pub iso: f32,
    /// Whether levels 1 to 5 are made too, not only the cells.
    pub whole: bool,
    pub work: &'a [SlabWork<'a>],
    pub regions: &'a Buffer<Region>,
    pub bricks: &'a Buffer<Brick>,
    pub case_facts: &'a Buffer<u32>,
}

/// Fills `nodes` and `vertex_records`; returns the number of undecimated triangles of each region.
pub fn run(
    cx: &Context,
    input: &Input<'_>,
    nodes: &Buffer<Node>,
    vertex_records: &Buffer<VertexRecord>,
    cancel: &dyn Cancel,
) -> Result<Vec<u32>> {
    let kernel = |name| cx.kernel(input.volume.sample_type, name);
    let grid = input.volume.layout();
    let (kind, whole) = (input.feature.kind_after_derive(input.volume), u32::from(input.whole));
    let has_block = matches!(kind, constants::FEATURE_FIELD | constants::FEATURE_GRADIENT);
    let group = cx.tuning.brick_group;
    let moments: Buffer<Moments> = cx.buffer(STAGE, input.bricks.len())?;
    let quadrics: Buffer<Quadric> = cx.buffer(STAGE, input.bricks.len())?;
    let safe: Buffer<u8> = cx.buffer(STAGE, input.bricks.len())?;
    let totals: Buffer<u32> = cx.buffer(STAGE, input.regions.len())?;
    for slab in input.work {
        // Fields of one grid have the same slabs. Without a field the volume's samples serve as the argument and are never read.
        let (samples, sample_type, missing) = match input.feature {
            Feature::Field(field) => {
                let same = field
                    .slabs
                    .iter()
                    .find(|s| s.z0 == slab.z0)
                    .map_or(slab.samples, |s| &s.samples);
                (same, field.sample_type, field.missing)
            }
            _ => (slab.samples, input.volume.sample_type, f32::NAN),
        };
        let args = ConstructArgs {
            grid,
            z0: slab.z0,
            iso: input.iso,
            feature_kind: kind,
            feature_type: type_number(sample_type),
            feature_missing: missing,
            first_brick: slab.bricks.start as u32,
            whole,
        };
        cx.launch(
            STAGE,
            &kernel("construct")?,
            slab.bricks.len(),
            group,
            &[
                &args,
                slab.samples,
                samples,
                input.regions,
                input.bricks,
                input.case_facts,
                nodes,
                vertex_records,
                &moments,
                &quadrics,
                &safe,
                &LocalBytes(local_bytes(group, input.whole, has_block)),
            ],
        )?;
        let args = ConstructTopArgs {
            grid,
            z0: slab.z0,
            iso: input.iso,
            whole_pyramid: whole,
            first_region: slab.regions.start as u32,
            region_count: slab.regions.len() as u32,
        };
        cx.launch(
            STAGE,
            &kernel("construct_top")?,
            slab.regions.len().div_ceil(BRICK_GROUP),
            BRICK_GROUP,
            &[
                &args,
                slab.samples,
                input.regions,
                input.bricks,
                &moments,
                &quadrics,
                &safe,
                nodes,
                vertex_records,
                &totals,
            ],
        )?;
        cx.pause(STAGE, cancel)?;
    }
    cx.read(STAGE, &totals, input.regions.len())
}

/// Fills `near`: the 27 bricks around each brick.
pub fn link(
    cx: &Context,
    volume: &Volume,
    region_index: &Buffer<u32>,
    regions: &Buffer<Region>,
    bricks: &Buffer<Brick>,
    near: &Buffer<u32>,
) -> Result<()> {
    let args = LinkArgs {
        grid: volume.layout(),
        brick_count: bricks.len() as u32,
    };
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "link")?,
        (near.len() / 3).div_ceil(BRICK_GROUP),
        BRICK_GROUP,
        &[&args, region_index, regions, bricks, near],
    )
}
