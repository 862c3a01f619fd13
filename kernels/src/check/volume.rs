//! The volume of the check: an ellipsoid of lower values, rough on one side and open at a face of the volume, and a small ball far from it.

use super::answers::{ISOVALUE, VALUE_END};
use crate::{Error, Grid, SampleType, Samples};

/// Samples along each axis: 4 x 2 x 2 regions, the last ones with a few cells.
pub(super) const DIMS: [u32; 3] = [104, 36, 34];

pub(super) fn grid() -> Result<Grid, Error> {
    Grid::new(DIMS, [1.0; 3])
}

/// Values of the samples, x fastest: integers that all sample types have.
pub(super) fn values() -> impl Iterator<Item = u32> {
    let count = DIMS.iter().product::<u32>();
    (0..count).map(|i| {
        let [x, y, z] = [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]];
        // `centre`: in half samples.
        let square = |at: u32, centre: u32| (2 * at).abs_diff(centre).pow(2);
        let ellipsoid = (3 * square(x, 180) + 4 * square(y, 43) + 5 * square(z, 43)) / 64;
        let ball = 3 * (square(x, 11) + square(y, 9) + square(z, 10)) / 2;
        // Rough on one side, so that decimation has a choice.
        let rough = if x >= 94 { (7 * x + 13 * y + 5 * z) % 11 } else { 0 };
        (ellipsoid + rough).min(ball).min(VALUE_END)
    })
}

pub(super) fn samples(sample_type: SampleType) -> Samples {
    match sample_type {
        SampleType::U8 => Samples::U8(values().map(|v| v as u8).collect()),
        SampleType::I8 => Samples::I8(values().map(|v| v as i8).collect()),
        SampleType::U16 => Samples::U16(values().map(|v| v as u16).collect()),
        SampleType::I16 => Samples::I16(values().map(|v| v as i16).collect()),
        SampleType::F32 => Samples::F32(values().map(|v| v as f32).collect()),
    }
}

/// Means of blocks of samples, and the smallest and largest of them.
pub(super) fn block_means(factors: [u32; 3], dims: [u32; 3]) -> (Vec<f32>, [f32; 2]) {
    let mut sums = vec![[0u32; 2]; dims.iter().product::<u32>() as usize];
    for (i, value) in (0..).zip(values()) {
        let at = [i % DIMS[0], i / DIMS[0] % DIMS[1], i / DIMS[0] / DIMS[1]];
        let [x, y, z] = [0, 1, 2].map(|axis: usize| at[axis] / factors[axis]);
        let [sum, count] = &mut sums[((z * dims[1] + y) * dims[0] + x) as usize];
        *sum += value;
        *count += 1;
    }
    let means: Vec<f32> = sums.iter().map(|[sum, count]| *sum as f32 / *count as f32).collect();
    let range = means.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], &v| {
        [lo.min(v), hi.max(v)]
    });
    (means, range)
}

/// Cells whose corners are not all on one side of the isovalue.
pub(super) fn active_cells() -> u64 {
    let inside: Vec<bool> = values().map(|value| value as f32 >= ISOVALUE).collect();
    let [nx, ny, nz] = DIMS.map(|n| n as usize);
    let mut count = 0;
    for (z, y, x) in (0..nz - 1).flat_map(|z| (0..ny - 1).flat_map(move |y| (0..nx - 1).map(move |x| (z, y, x)))) {
        let corner = |i: usize| inside[((z + (i >> 2)) * ny + y + (i >> 1 & 1)) * nx + x + (i & 1)];
        count += u64::from((1..8).any(|i| corner(i) != corner(0)));
    }
    count
}
