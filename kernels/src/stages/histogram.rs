//! Range and 256 bins of a field or of a derived feature, a launch at a time.

use super::args::kernel_args;
use super::{BRICK_GROUP, derive};
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::Grid;
use crate::pace::Pace;
use crate::volume::Slab;
use crate::{Feature, Histogram, REGION_CELLS, Result, Volume};
use std::time::Instant;

/// Name of the stage.
pub const STAGE: &str = "histogram";

kernel_args! {
    /// Arguments of `histogram_range`.
    HistogramRangeArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
        kind: u32,
        /// First plane of this launch.
        first_plane: u32,
        /// First row of this launch, in that plane.
        first_row: u32,
        /// Samples of this launch.
        count: u32,
    }
    /// Arguments of `histogram_bins`.
    HistogramBinsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
        kind: u32,
        /// First plane of this launch.
        first_plane: u32,
        /// First row of this launch, in that plane.
        first_row: u32,
        /// Samples of this launch.
        count: u32,
        /// Minimum of the range.
        lo: f32,
        /// Maximum of the range.
        hi: f32,
    }
}

/// Work-groups of one launch at most: enough for a large GPU, few enough that a CPU reads long runs.
const MAX_GROUPS: usize = 1024;

/// Samples that a work-item of a small launch reads.
const ITEM_SAMPLES: usize = 64;

/// Samples of the first launch, and of one launch at most, so that 32-bit counters hold.
const LAUNCH_SAMPLES: [u64; 2] = [1 << 20, 1 << 31];

/// The same if `derive` computes the values before each launch: 64 MiB of them at most.
const DERIVED_SAMPLES: [u64; 2] = [1 << 18, 1 << 24];

/// Maximum samples of a volume that is counted in full. Of a larger volume only a share is counted, so that opening it takes seconds.
const COUNTED_SAMPLES: u64 = 1 << 27;

/// Planes of a block of `derive`.
const DERIVED_PLANES: u32 = 8;

/// Extents of bricks that are read back at once.
pub(crate) const TABLE_EXTENTS: usize = 1 << 20;

/// Number of bins.
const BINS: usize = 256;

/// State of a histogram under construction.
#[derive(Clone, Debug)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct HistogramWork {
    pass: Pass,
    range: [f32; 2],
    #[cfg_attr(feature = "serde", serde(with = "crate::bulk"))]
    bins: Vec<u64>,
    pace: Pace,
    counted_samples: u64,
}

#[cfg(feature = "serde")]
crate::checked_serde!(HistogramWork, |work| {
    let is_usable = work.bins.len() == BINS && work.counted_samples > 0;
    is_usable
        .then_some(())
        .ok_or("work on a histogram without bins or samples")
});

/// What the next launch does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Pass {
    /// Chooses the first pass, which depends on the feature.
    First,
    /// Widens the range by the extents of bricks; `next` is the next brick.
    Table { next: usize },
    /// Widens the range by the rows from this one on, in the order of [`Share`].
    Range { next: u64 },
    /// Counts the values of the rows from this one on, in the same order.
    Bins { next: u64 },
    /// The histogram is complete.
    Done,
}

impl Default for HistogramWork {
    fn default() -> Self {
        Self {
            pass: Pass::First,
            range: [f32::INFINITY, f32::NEG_INFINITY],
            bins: vec![0; BINS],
            pace: Pace::new(1, 1, 1),
            counted_samples: COUNTED_SAMPLES,
        }
    }
}

impl HistogramWork {
    /// As the default, with another limit for counting all samples, so that tests count small volumes as if they were large.
    #[cfg(feature = "testing")]
    pub fn of_share(counted_samples: u64) -> Self {
        Self {
            counted_samples,
            ..Self::default()
        }
    }

    /// The histogram, once it is complete.
    pub fn complete(&self) -> Option<Histogram> {
        let [lo, hi] = self.range;
        (self.pass == Pass::Done).then(|| Histogram {
            range: if lo > hi { [0.0, 0.0] } else { self.range },
            bins: self.bins.clone(),
        })
    }

    fn widen(&mut self, ranges: impl IntoIterator<Item = [f32; 2]>) {
        for [lo, hi] in ranges {
            self.range = [self.range[0].min(lo), self.range[1].max(hi)];
        }
    }

    /// Continues with the bins if the range contains a value, otherwise completes.
    fn begin_bins(&mut self) {
        let is_empty = self.range[0] > self.range[1];
        self.pass = if is_empty { Pass::Done } else { Pass::Bins { next: 0 } };
    }
}

/// What the kernels read in one launch.
struct Launch<'a> {
    /// `FEATURE_NONE`, `FEATURE_GRADIENT` or `FEATURE_STORED`.
    kind: u32,
    slab: &'a Slab,
    first_plane: u32,
    first_row: u32,
    count: u32,
    /// Values that replace the slab's samples, if `derive` computes them.
    values: Option<Buffer<f32>>,
}

impl Launch<'_> {
    fn samples(&self) -> &dyn Arg {
        match &self.values {
            Some(values) => values,
            None => &self.slab.samples,
        }
    }

    fn groups(&self) -> usize {
        (self.count as usize)
            .div_ceil(BRICK_GROUP * ITEM_SAMPLES)
            .min(MAX_GROUPS)
    }
}

/// The planes of a volume that are counted: all in one block, or one block of each `stride` blocks, which a hash chooses, so that no period of the
/// data hides values. It depends on the volume's size alone, as the opening isovalue does then.
struct Share {
    /// Rows of a plane.
    ny: u32,
    /// Planes of the volume.
    nz: u32,
    /// Planes of a block.
    depth: u32,
    stride: u32,
}

/// Rows that follow each other.
struct Run {
    plane: u32,
    /// First row, in that plane.
    row: u32,
    /// The first plane after the block.
    end: u32,
}

impl Share {
    fn new([nx, ny, nz]: [u32; 3], depth: u32, counted_samples: u64) -> Self {
        let samples = u64::from(nx) * u64::from(ny) * u64::from(nz);
        let stride = samples.div_ceil(counted_samples) as u32;
        Self {
            ny,
            nz,
            depth: if stride > 1 { depth } else { nz },
            stride,
        }
    }

    fn block_rows(&self) -> u64 {
        u64::from(self.depth) * u64::from(self.ny)
    }

    /// The rows from the `next` one of those that are counted to the end of their block.
    fn run(&self, next: u64) -> Run {
        let (group, in_block) = ((next / self.block_rows()) as u32, next % self.block_rows());
        let first = group * self.stride;
        let blocks = self.stride.min(self.nz.div_ceil(self.depth) - first);
        let chosen = first + (group.wrapping_mul(0x9e37_79b9) >> 16) % blocks;
        Run {
            plane: chosen * self.depth + (in_block / u64::from(self.ny)) as u32,
            row: (in_block % u64::from(self.ny)) as u32,
            end: ((chosen + 1) * self.depth).min(self.nz),
        }
    }

    /// The row after `rows` of a run, if there is one.
    fn after(&self, next: u64, rows: u64, is_end: bool) -> Option<u64> {
        let group = next / self.block_rows();
        let after = if is_end {
            (group + 1) * self.block_rows()
        } else {
            next + rows
        };
        let groups = self.nz.div_ceil(self.depth).div_ceil(self.stride);
        (after < u64::from(groups) * self.block_rows()).then_some(after)
    }
}

/// A histogram of a volume in the making.
struct Maker<'a> {
    cx: &'a Context,
    volume: &'a Volume,
    feature: Feature<'a>,
    source: Option<derive::Source<'a>>,
}

/// Does the next part of a histogram, which takes some milliseconds.
pub fn step(cx: &Context, volume: &Volume, feature: Feature<'_>, work: &mut HistogramWork) -> Result<()> {
    let source = derive::Source::of(volume, feature);
    let maker = Maker {
        cx,
        volume,
        feature,
        source,
    };
    match work.pass {
        Pass::First => {
            let row = u64::from(volume.grid.dims[0]);
            let [first, largest] = if maker.source.is_some() {
                DERIVED_SAMPLES
            } else {
                LAUNCH_SAMPLES
            };
            work.pace = Pace::new(first / row, 1, (largest / row).max(1));
            // The table has the extents of a field's own samples.
            work.pass = match feature {
                Feature::None => Pass::Table { next: 0 },
                _ => Pass::Range { next: 0 },
            };
            step(cx, volume, feature, work)
        }
        Pass::Table { next } => {
            let count = TABLE_EXTENTS.min(volume.table.len() - next);
            let extents = cx.read_at(STAGE, &volume.table, next, count)?;
            // Bricks without cells, or without values, have an empty extent.
            work.widen(extents.into_iter().filter(|[lo, hi]| lo <= hi));
            let is_finite = work.range[0] > f32::NEG_INFINITY && work.range[1] < f32::INFINITY;
            if next + count < volume.table.len() {
                work.pass = Pass::Table { next: next + count };
            } else if is_finite || work.range[0] > work.range[1] {
                work.begin_bins();
            } else {
                // Infinite samples hide the largest of the others.
                work.range = [f32::INFINITY, f32::NEG_INFINITY];
                work.pass = Pass::Range { next: 0 };
            }
            Ok(())
        }
        Pass::Range { next } => match maker.launch(next, work, Maker::range)? {
            Some(next) => {
                work.pass = Pass::Range { next };
                Ok(())
            }
            None => {
                work.begin_bins();
                Ok(())
            }
        },
        Pass::Bins { next } => {
            let next = maker.launch(next, work, Maker::bins)?;
            work.pass = next.map_or(Pass::Done, |next| Pass::Bins { next });
            Ok(())
        }
        Pass::Done => Ok(()),
    }
}

impl Maker<'_> {
    /// Does one launch from a row on, in the order of [`Share`]; returns the row after it, if there is one.
    fn launch(
        &self,
        next: u64,
        work: &mut HistogramWork,
        run: impl FnOnce(&Self, &Launch<'_>, &mut HistogramWork) -> Result<()>,
    ) -> Result<Option<u64>> {
        let start = Instant::now();
        let [nx, ny, _] = self.volume.grid.dims;
        let depth = if self.source.is_some() { DERIVED_PLANES } else { 1 };
        let share = Share::new(self.volume.grid.dims, depth, work.counted_samples);
        let Run { plane, row, end } = share.run(next);
        let (slab, slab_end) = self.slab_of(plane);
        let rows_to = |end: u32| u64::from(end - plane) * u64::from(ny) - u64::from(row);
        let block_rows = u64::from(DERIVED_PLANES * ny);
        let rows = match &self.source {
            Some(_) => (work.pace.units() / block_rows).max(1) * block_rows,
            None => work.pace.units(),
        };
        let rows = rows.min(rows_to(slab_end.min(end)));
        let values = match &self.source {
            Some(source) => {
                let planes = (rows / u64::from(ny)) as u32;
                Some(derive::samples(self.cx, source, self.volume, slab, plane, planes)?)
            }
            None => None,
        };
        let launch = Launch {
            kind: self.feature.kind_after_derive(self.volume),
            slab,
            first_plane: plane,
            first_row: row,
            count: rows as u32 * nx,
            values,
        };
        // Reading the results waits for the launch.
        run(self, &launch, work)?;
        work.pace.took(rows, start.elapsed());
        Ok(share.after(next, rows, rows == rows_to(end)))
    }

    /// Returns the slab that owns a plane, and the first plane after those that it owns.
    fn slab_of(&self, plane: u32) -> (&Slab, u32) {
        let grid = self.volume.grid;
        let layer = (plane / REGION_CELLS).min(grid.regions()[2] - 1);
        let slab = self.volume.slabs.iter().find(|slab| slab.layers.contains(&layer));
        let slab = slab.unwrap_or(&self.volume.slabs[0]);
        // The last layer also has the planes after its last cell.
        let is_last = slab.layers.end == grid.regions()[2];
        let end = if is_last {
            grid.dims[2]
        } else {
            slab.layers.end * REGION_CELLS
        };
        (slab, end)
    }

    fn range(&self, launch: &Launch<'_>, work: &mut HistogramWork) -> Result<()> {
        let groups = launch.groups();
        let ranges = self.cx.buffer::<[f32; 2]>(STAGE, groups)?;
        let args = HistogramRangeArgs {
            grid: self.volume.layout(),
            z0: launch.slab.z0,
            kind: launch.kind,
            first_plane: launch.first_plane,
            first_row: launch.first_row,
            count: launch.count,
        };
        let kernel = &self.cx.kernel(self.volume.sample_type, "histogram_range")?;
        self.cx
            .launch(STAGE, kernel, groups, BRICK_GROUP, &[&args, launch.samples(), &ranges])?;
        work.widen(self.cx.read(STAGE, &ranges, groups)?);
        Ok(())
    }

    fn bins(&self, launch: &Launch<'_>, work: &mut HistogramWork) -> Result<()> {
        let counters = self.cx.zeroed::<u32>(STAGE, work.bins.len())?;
        let [lo, hi] = work.range;
        let args = HistogramBinsArgs {
            grid: self.volume.layout(),
            z0: launch.slab.z0,
            kind: launch.kind,
            first_plane: launch.first_plane,
            first_row: launch.first_row,
            count: launch.count,
            lo,
            hi,
        };
        let kernel = &self.cx.kernel(self.volume.sample_type, "histogram_bins")?;
        let all: [&dyn Arg; 3] = [&args, launch.samples(), &counters];
        self.cx.launch(STAGE, kernel, launch.groups(), BRICK_GROUP, &all)?;
        for (bin, count) in work.bins.iter_mut().zip(self.cx.read(STAGE, &counters, BINS)?) {
            *bin += u64::from(count);
        }
        Ok(())
    }
}
