//! One launcher for each file in `cl/`, by the same name. A launcher knows its kernels' arguments and nothing else.

pub(crate) mod args;
pub(crate) mod generate;

/// Declares the product's stages: one file in `cl/` and one module here, of the same name.
macro_rules! stages {
    ($($stage:ident $(: $built:ident)?)*) => {
        $(pub(crate) mod $stage;)*

        /// Sources of the product's programs.
        pub(crate) const SOURCES: &[crate::sources::Source] = &[$(crate::sources::Source {
            file: concat!(stringify!($stage), ".cl"),
            stage: stringify!($stage),
            reads_samples: stages!(@reads $($built)?),
        }),*];

        /// Structs of arguments of all kernels.
        #[cfg(test)]
        pub(crate) fn declarations() -> Vec<args::Declaration> {
            [generate::declarations(), $($stage::declarations()),*].into_iter().flatten().collect()
        }
    };
    (@reads samples) => { true };
    (@reads) => { false };
}

// In order of execution. A new stage is a line here, a file in `cl/`, its launcher and its twin.
stages! {
    minmax: samples
    histogram: samples
    activate
    classify: samples
    derive
    construct: samples
    cut
    fit
    march: samples
    patch
    pack: samples
    dual
    error: samples
    tree
    tree_begin
    tree_build
    tree_rise
    tree_part
    tree_cut
    tree_test
    tree_test_above
    tree_mesh
    tree_relax
    slice: samples
    overview: samples
    probe
    distribution
    curve
    distance: samples
    interpolate: samples
    evaluate
    mask
    distance_field
}

use crate::Volume;
use crate::buffer::Buffer;
use std::ops::Range;

/// Work-items of a group that works on one brick, and of any other fixed group: `reqd_work_group_size` in `cl/`.
pub(crate) const BRICK_GROUP: usize = 64;

/// The active regions and bricks of one slab or one launch.
pub(crate) struct SlabWork<'a> {
    pub samples: &'a Buffer<u8>,
    pub z0: u32,
    pub regions: Range<usize>,
    pub bricks: Range<usize>,
}

/// Splits active regions (in linear order) and their bricks by slab; slabs without work are left out.
pub(crate) fn slab_work<'a>(volume: &'a Volume, regions: &[crate::layout::Region], bricks: usize) -> Vec<SlabWork<'a>> {
    let [rx, ry, _] = volume.grid.regions();
    let first_at = |layer: u32| {
        let linear = u64::from(layer) * u64::from(rx) * u64::from(ry);
        regions.partition_point(|r| u64::from(r.region) < linear)
    };
    let brick_at = |region: usize| regions.get(region).map_or(bricks, |r| r.brick_base as usize);
    volume
        .slabs
        .iter()
        .map(|slab| {
            let regions = first_at(slab.layers.start)..first_at(slab.layers.end);
            let bricks = brick_at(regions.start)..brick_at(regions.end);
            SlabWork {
                samples: &slab.samples,
                z0: slab.z0,
                regions,
                bricks,
            }
        })
        .filter(|work| !work.regions.is_empty())
        .collect()
}

/// Splits the work of slabs into launches of up to `max_bricks`, or one region.
pub(crate) fn launches<'a>(
    work: &[SlabWork<'a>],
    regions: &[crate::layout::Region],
    max_bricks: usize,
) -> Vec<SlabWork<'a>> {
    let mut launches = Vec::new();
    for slab in work {
        let region_count = slab.regions.end;
        let brick_at = |region: usize| {
            regions[..region_count]
                .get(region)
                .map_or(slab.bricks.end, |r| r.brick_base as usize)
        };
        let mut first = slab.regions.start;
        for end in first + 1..=region_count {
            if end == region_count || brick_at(end + 1) - brick_at(first) > max_bricks {
                let bricks = brick_at(first)..brick_at(end);
                launches.push(SlabWork {
                    regions: first..end,
                    bricks,
                    ..*slab
                });
                first = end;
            }
        }
    }
    launches
}
