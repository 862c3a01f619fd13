//! A volume at a low resolution, a launch at a time.

use super::BRICK_GROUP;
use super::args::kernel_args;
use super::slice::own_planes;
use crate::context::Context;
use crate::layout::Grid;
use crate::pace::Pace;
use crate::{Error, Result, Volume};
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "overview";

kernel_args! {
    /// Arguments of `overview`.
    OverviewArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Samples of a block along x.
        factor_x: u32,
        /// Samples of a block along y.
        factor_y: u32,
        /// Samples of a block along z.
        factor_z: u32,
        /// Blocks of a row.
        width: u32,
        /// Rows of blocks of a plane.
        height: u32,
        /// The first row of blocks of this launch.
        first_row: u32,
        /// Blocks of this launch.
        count: u32,
        /// The first plane of samples that this launch reads.
        first_plane: u32,
        /// The plane of samples after its last one.
        end_plane: u32,
        /// What values are multiplied by before they are added.
        scale: f32,
        /// Whether maxima are wanted, not sums.
        is_maximum: u32,
    }
}

/// Samples of the first launch.
const FIRST_SAMPLES: u64 = 1 << 20;

/// The code of the largest value; that of the smallest one is 1, and 0 is nothing.
const LARGEST_CODE: f32 = 255.0;

/// Values that differ by at most this share of the largest one are equal: a few units in the last place, which are rounding.
const FLAT: f32 = 4.0 * f32::EPSILON;

/// What stands for the samples of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum OverviewMode {
    /// Their mean.
    Mean,
    /// Their maximum.
    Maximum,
}

/// A volume at a low resolution: a value for each block of samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Overview {
    /// Values along each axis.
    pub dims: [u32; 3],
    /// Samples of a block along each axis. The last block along an axis may have fewer.
    pub factors: [u32; 3],
    /// Smallest and largest of the values; both 0 if there is none.
    pub range: [f32; 2],
    /// The values, x fastest: from 1, the smallest, to 255, the largest; 0 for a block whose samples are all missing or not finite.
    pub codes: Vec<u8>,
}

/// Blocks of an overview, and what stands for each.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
struct Blocks {
    mode: OverviewMode,
    /// Samples of the volume along each axis.
    samples: [u32; 3],
    /// Samples of a block along each axis.
    factors: [u32; 3],
    /// Blocks along each axis.
    dims: [u32; 3],
}

/// A part of an overview: one launch of some milliseconds.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OverviewPart {
    blocks: Blocks,
    slab: usize,
    /// The first of the slab's rows of blocks.
    row: u32,
    pace: Pace,
}

/// Values of a part of an overview.
#[derive(Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct OverviewValues {
    /// Slab and row of the part.
    place: (usize, u32),
    /// The first block.
    first: usize,
    /// For each block the first sample with the sum of the scaled differences from it, or the maximum.
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    values: Vec<[f32; 2]>,
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    counts: Vec<u32>,
    /// The part that follows.
    next: Option<OverviewPart>,
}

/// An overview that is being made.
#[derive(Debug)]
pub struct OverviewWork {
    blocks: Blocks,
    next: Option<OverviewPart>,
    /// Sums of scaled samples, or maxima.
    values: Vec<f64>,
    counts: Vec<u32>,
}

#[cfg(feature = "serde")]
crate::checked_serde!(Blocks, Blocks::check);

#[cfg(feature = "serde")]
crate::checked_serde!(OverviewValues, |found| {
    let is_usable = found.values.len() == found.counts.len();
    is_usable
        .then_some(())
        .ok_or("more or fewer values of an overview than counts")
});

impl Blocks {
    /// Checks that the blocks are those of the volume.
    #[cfg(feature = "serde")]
    fn check(&self) -> std::result::Result<(), &'static str> {
        let count = self
            .samples
            .iter()
            .try_fold(1u64, |count, &n| count.checked_mul(n.into()));
        let is_usable = count.is_some_and(|count| count.checked_next_power_of_two().is_some())
            && (0..3).all(|axis| {
                let (samples, factor) = (self.samples[axis], self.factors[axis]);
                (1..=samples).contains(&factor) && self.dims[axis] == samples.div_ceil(factor)
            });
        is_usable
            .then_some(())
            .ok_or("blocks of an overview that are not those of its volume")
    }

    /// A power of two, with which no sum of a block's values overflows.
    fn scale(&self) -> f32 {
        let block: u64 = self.factors.iter().map(|&n| u64::from(n)).product();
        1.0 / block.next_power_of_two() as f32
    }
}

impl OverviewWork {
    /// Begins with a volume of `samples` along each axis. The overview has at most `side` values along each axis.
    pub fn new(samples: [u32; 3], mode: OverviewMode, side: u32) -> Self {
        let factors = samples.map(|n| n.div_ceil(side.max(1)).max(1));
        let dims = [0, 1, 2].map(|axis| samples[axis].div_ceil(factors[axis]));
        let count = dims.iter().map(|&n| n as usize).product();
        let nothing = match mode {
            OverviewMode::Mean => 0.0,
            OverviewMode::Maximum => f64::NEG_INFINITY,
        };
        let row = u64::from(samples[0]) * u64::from(factors[1]) * u64::from(factors[2]);
        let blocks = Blocks {
            mode,
            samples,
            factors,
            dims,
        };
        Self {
            blocks,
            next: Some(OverviewPart {
                blocks,
                slab: 0,
                row: 0,
                pace: Pace::new(FIRST_SAMPLES / row.max(1), 1, u64::from(dims[1]) * u64::from(dims[2])),
            }),
            values: vec![nothing; count],
            counts: vec![0; count],
        }
    }

    /// Returns the next part; `None` once all are done.
    pub fn next(&self) -> Option<&OverviewPart> {
        self.next.as_ref()
    }

    /// Adds the values of the next part.
    ///
    /// # Panics
    /// They are those of another part.
    pub fn add(&mut self, found: OverviewValues) {
        let next = self.next.as_ref().map(|part| (part.slab, part.row));
        assert_eq!(next, Some(found.place), "slab and row of the next part of an overview");
        let scale = f64::from(self.blocks.scale());
        for (i, (value, &count)) in found.values.iter().zip(&found.counts).enumerate() {
            let own = &mut self.values[found.first + i];
            let [value, differences] = value.map(f64::from);
            match self.blocks.mode {
                OverviewMode::Mean => *own += value * f64::from(count) * scale + differences,
                OverviewMode::Maximum => *own = own.max(value),
            }
            self.counts[found.first + i] += count;
        }
        self.next = found.next;
    }

    /// The overview, once it is complete.
    pub fn complete(&self) -> Option<Overview> {
        if self.next.is_some() {
            return None;
        }
        let values = || {
            self.values
                .iter()
                .zip(&self.counts)
                .map(|(&value, &count)| self.value(value, count))
        };
        let range = (values().flatten()).fold(None, |range: Option<[f32; 2]>, v| {
            Some(range.map_or([v; 2], |[lo, hi]| [lo.min(v), hi.max(v)]))
        });
        let [lo, hi] = range.unwrap_or_default();
        // Halves: the span from end to end of the type would overflow.
        let span = 0.5 * hi - 0.5 * lo;
        let is_flat = span <= 0.5 * FLAT * lo.abs().max(hi.abs());
        let (hi, span) = if is_flat { (lo, 0.0) } else { (hi, span) };
        let code = |v: f32| {
            let share = if span > 0.0 { (0.5 * v - 0.5 * lo) / span } else { 0.0 };
            1 + (share * (LARGEST_CODE - 1.0)).round() as u8
        };
        Some(Overview {
            dims: self.blocks.dims,
            factors: self.blocks.factors,
            range: [lo, hi],
            codes: values().map(|value| value.map_or(0, code)).collect(),
        })
    }

    /// The value of a block.
    fn value(&self, value: f64, count: u32) -> Option<f32> {
        match self.blocks.mode {
            _ if count == 0 => None,
            OverviewMode::Mean => Some((value / (f64::from(count) * f64::from(self.blocks.scale()))) as f32),
            OverviewMode::Maximum => Some(value as f32),
        }
    }
}

/// Returns the values of a part.
pub fn values_of(cx: &Context, volume: &Volume, part: &OverviewPart) -> Result<OverviewValues> {
    let blocks = part.blocks;
    if volume.grid.dims != blocks.samples {
        let why = format!(
            "a volume of {:?} samples, expected one of {:?}",
            volume.grid.dims, blocks.samples
        );
        return Err(Error::Invalid { what: "overview", why });
    }
    let Some(slab) = volume.slabs.get(part.slab) else {
        let why = format!("slab {}, expected one of {}", part.slab, volume.slabs.len());
        return Err(Error::Invalid { what: "overview", why });
    };
    let start = Instant::now();
    let planes = own_planes(volume, &slab.layers);
    let [width, height, _] = blocks.dims;
    let depth = blocks.factors[2];
    // A block may lie in two slabs, each of which has some of its planes.
    let [first, end] = [planes.start / depth * height, planes.end.div_ceil(depth) * height];
    let row = first.saturating_add(part.row);
    if row >= end {
        let why = format!("row {row}, expected one below {end}");
        return Err(Error::Invalid { what: "overview", why });
    }
    let max_rows = cx.limit_bytes / (u64::from(width) * size_of::<[f32; 2]>() as u64);
    let rows = part.pace.units().min(u64::from(end - row)).min(max_rows.max(1)) as u32;
    let count = rows * width;
    let args = OverviewArgs {
        grid: volume.layout(),
        z0: slab.z0,
        factor_x: blocks.factors[0],
        factor_y: blocks.factors[1],
        factor_z: depth,
        width,
        height,
        first_row: row,
        count,
        first_plane: planes.start,
        end_plane: planes.end,
        scale: blocks.scale(),
        is_maximum: u32::from(blocks.mode == OverviewMode::Maximum),
    };
    let kernel = cx.kernel(volume.sample_type, "overview")?;
    let values = cx.buffer::<[f32; 2]>(STAGE, count as usize)?;
    let counts = cx.buffer::<u32>(STAGE, count as usize)?;
    let groups = (count as usize).div_ceil(BRICK_GROUP);
    cx.launch(
        STAGE,
        &kernel,
        groups,
        BRICK_GROUP,
        &[&args, &slab.samples, &values, &counts],
    )?;
    let values = cx.read(STAGE, &values, count as usize)?;
    let counts = cx.read(STAGE, &counts, count as usize)?;
    let mut pace = part.pace.clone();
    pace.took(rows.into(), start.elapsed());
    let next = match row + rows < end {
        true => Some((part.slab, part.row + rows)),
        false => Some((part.slab + 1, 0)).filter(|(slab, _)| *slab < volume.slabs.len()),
    };
    Ok(OverviewValues {
        place: (part.slab, part.row),
        first: row as usize * width as usize,
        values,
        counts,
        next: next.map(|(slab, row)| OverviewPart {
            blocks,
            slab,
            row,
            pace,
        }),
    })
}
