//! One launcher for each file in `cl/`, by the same name. A launcher knows the order of its kernel's arguments and
//! nothing else.

pub(crate) mod activate;
pub(crate) mod classify;
pub(crate) mod construct;
pub(crate) mod cut;
pub(crate) mod dual;
pub(crate) mod error;
pub(crate) mod generate;
pub(crate) mod histogram;
pub(crate) mod march;
pub(crate) mod minmax;
pub(crate) mod pack;
pub(crate) mod patch;

use crate::Volume;
use crate::buffer::Buffer;
use std::ops::Range;

/// Work-items of a group that works on one brick, and of any other fixed group: `reqd_work_group_size` in `cl/`.
pub(crate) const BRICK_GROUP: usize = 64;

/// The active regions and bricks that one slab serves.
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
