//! Distances to the nearest inside sample.

use super::BRICK_GROUP;
use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::Grid;
use crate::pace::Pace;
use crate::volume::Slab;
use crate::{Cancel, Result, SampleType};

/// Name of the stage.
pub const STAGE: &str = "distance_field";

/// Maximum samples along x and y: two indices are packed into a word.
pub const MAX_LENGTH: u32 = 1 << 16;

kernel_args! {
    /// Arguments of `distance_field_before` and `distance_field_after`.
    DistanceColumnsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Planes of the slab.
        planes: u32,
        /// The plane at which the neighbouring slab goes on.
        keep: u32,
        /// First column of this launch.
        first: u32,
        /// Columns of this launch.
        columns: u32,
        /// Units of one step between positions.
        scale: f32,
    }
    /// Arguments of `distance_field_envelope`.
    DistanceLinesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Axis of the lines: 0 or 1.
        axis: u32,
        /// First line of this launch.
        first: u32,
        /// Lines of this launch.
        lines: u32,
        /// 1: positions are the numbers of the samples.
        is_even: u32,
        /// 1: distances are written; 0: their squares.
        is_last: u32,
        /// Units of one step between positions.
        scale: f32,
        /// World units of a unit of length.
        unit: f32,
    }
}

/// Samples of the first launch of a pass.
const FIRST_SAMPLES: u64 = 1 << 18;

/// Samples of one launch at most.
const MAX_SAMPLES: u64 = 1 << 24;

/// Positions of the samples along the axes.
pub struct Axes {
    /// Positions along x, y and z: the samples' indices, or lengths in units.
    pub positions: [Buffer<f32>; 3],
    /// Units per step between positions, for each axis.
    pub scale: [f32; 3],
    /// World units of a unit of length.
    pub unit: f32,
    /// Whether positions are indices.
    pub is_even: bool,
}

/// One volume's work.
pub struct Work<'a> {
    pub cx: &'a Context,
    pub grid: Grid,
    pub axes: &'a Axes,
    pub cancel: &'a dyn Cancel,
}

impl Work<'_> {
    /// Writes the squared distances along z from the samples of all slabs to the nearest inside sample of `values`.
    pub fn columns(&self, values: &[Slab], squares: &[Slab]) -> Result<()> {
        let plane = self.grid.dims[0] as usize * self.grid.dims[1] as usize;
        let never = |bits: f32| self.cx.filled(STAGE, plane, bits.to_bits());
        let (last, next) = (never(f32::NEG_INFINITY)?, never(f32::INFINITY)?);
        for (i, slab) in values.iter().enumerate() {
            let keep = values.get(i + 1).map_or(u32::MAX, |after| after.z0);
            self.column("distance_field_before", slab, &squares[i], keep, &last)?;
        }
        for (i, slab) in values.iter().enumerate().rev() {
            let before = i.checked_sub(1).map(|i| &values[i]);
            let keep = before.map_or(u32::MAX, |before| before.z0 + self.planes(before) - 1);
            self.column("distance_field_after", slab, &squares[i], keep, &next)?;
        }
        Ok(())
    }

    fn planes(&self, slab: &Slab) -> u32 {
        let plane = u64::from(self.grid.dims[0]) * u64::from(self.grid.dims[1]);
        (slab.samples.bytes() / size_of::<f32>() as u64 / plane) as u32
    }

    fn column(&self, kernel: &str, values: &Slab, out: &Slab, keep: u32, nearest: &Buffer<u32>) -> Result<()> {
        let (columns, planes) = (nearest.len() as u64, self.planes(values));
        let group = (self.cx.tuning.lanes * BRICK_GROUP) as u64;
        let mut pace = pace_of(u64::from(planes) * group);
        let mut first = 0;
        while first < columns {
            let some = (pace.units() * group).min(columns - first);
            let args = DistanceColumnsArgs {
                grid: self.grid,
                z0: values.z0,
                planes,
                keep,
                first: first as u32,
                columns: some as u32,
                scale: self.axes.scale[2],
            };
            let all: [&dyn Arg; 5] = [&args, &self.axes.positions[2], &values.samples, &out.samples, nearest];
            self.launch(kernel, some.div_ceil(group), &all, &mut pace)?;
            first += some;
        }
        Ok(())
    }

    /// Extends squared distances by one more axis. For the last axis, x, writes distances instead of squares. `squares` and `out` belong to
    /// the same slab.
    pub fn lines(&self, axis: usize, squares: &Slab, out: &Slab) -> Result<()> {
        let length = u64::from(self.grid.dims[axis]);
        let lines = squares.samples.bytes() / size_of::<f32>() as u64 / length;
        let group = BRICK_GROUP as u64;
        let mut pace = pace_of(length * group);
        let mut first = 0;
        while first < lines {
            let some = (pace.units() * group).min(lines - first);
            let args = DistanceLinesArgs {
                grid: self.grid,
                axis: axis as u32,
                first: first as u32,
                lines: some as u32,
                is_even: self.axes.is_even.into(),
                is_last: (axis == 0).into(),
                scale: self.axes.scale[axis],
                unit: self.axes.unit,
            };
            let all: [&dyn Arg; 4] = [&args, &self.axes.positions[axis], &squares.samples, &out.samples];
            self.launch("distance_field_envelope", some.div_ceil(group), &all, &mut pace)?;
            first += some;
        }
        Ok(())
    }

    /// Launches a kernel and then pauses for other jobs.
    fn launch(&self, kernel: &str, groups: u64, args: &[&dyn Arg], pace: &mut Pace) -> Result<()> {
        let kernel = self.cx.kernel(SampleType::F32, kernel)?;
        self.cx.paced(STAGE, pace, groups, || {
            self.cx.launch(STAGE, &kernel, groups as usize, BRICK_GROUP, args)
        })?;
        self.cx.pause(STAGE, self.cancel)
    }
}

/// Pace of a pass, in work-groups. `group_samples`: samples of a work-group.
fn pace_of(group_samples: u64) -> Pace {
    let groups = |samples: u64| (samples / group_samples).max(1);
    Pace::new(groups(FIRST_SAMPLES), 1, groups(MAX_SAMPLES))
}
