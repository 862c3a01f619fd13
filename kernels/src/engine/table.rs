//! Builds the min/max table of a volume in short launches, so that other jobs get the device soon.

use crate::buffer::Buffer;
use crate::pace::Pace;
use crate::stages::minmax;
use crate::volume::Slab;
use crate::{Cancel, Engine, Grid, Result, SampleType, Volume, cancel};
use std::sync::Arc;

/// Samples of the first launch, and of one launch at most.
const LAUNCH_SAMPLES: [u64; 2] = [1 << 22, 1 << 30];

/// Progress of building a volume's table.
pub(super) struct TableWork {
    masks: Buffer<[u32; 2]>,
    /// The next run of regions, counted from the volume's first one.
    next: u32,
    pace: Pace,
}

impl Engine {
    /// A volume of slabs that are filled, with its min/max table.
    pub(crate) fn resident(
        &self,
        grid: Grid,
        sample_type: SampleType,
        missing: Option<f32>,
        slabs: Vec<Slab>,
        inverse_lengths: Option<Arc<Buffer<f32>>>,
        cancel: &dyn Cancel,
    ) -> Result<Volume> {
        let mut volume = self.without_table(grid, sample_type, missing, slabs, inverse_lengths)?;
        self.make_table(&mut volume, cancel)?;
        Ok(volume)
    }

    /// A volume whose table has undefined contents.
    pub(super) fn without_table(
        &self,
        grid: Grid,
        sample_type: SampleType,
        missing: Option<f32>,
        slabs: Vec<Slab>,
        inverse_lengths: Option<Arc<Buffer<f32>>>,
    ) -> Result<Volume> {
        let regions = grid.regions().iter().map(|&r| r as usize).product::<usize>();
        Ok(Volume {
            grid,
            sample_type,
            missing: missing.unwrap_or(f32::NAN),
            slabs,
            table: self.cx.buffer(minmax::STAGE, regions * 64)?,
            missing_masks: Vec::new(),
            inverse_lengths,
        })
    }

    /// Fills a volume's min/max table from its samples.
    pub(crate) fn make_table(&self, volume: &mut Volume, cancel: &dyn Cancel) -> Result<()> {
        let mut work = self.begin_table(volume)?;
        while !self.continue_table_of(volume, &mut work)? {
            cancel::check_cancelled(cancel)?;
        }
        self.end_table(volume, work)
    }

    pub(super) fn begin_table(&self, volume: &Volume) -> Result<TableWork> {
        let grid = volume.layout();
        let run_samples = u64::from(crate::REGION_CELLS).pow(3) * self.cx.tuning.regions_in_run as u64;
        let [first, largest] = LAUNCH_SAMPLES.map(|samples| (samples / run_samples).max(1));
        Ok(TableWork {
            masks: self
                .cx
                .zeroed(minmax::STAGE, grid.regions.iter().map(|&r| r as usize).product())?,
            next: 0,
            pace: Pace::new(first, 1, largest),
        })
    }

    /// Fills the next part of a table. True once it is complete.
    pub(super) fn continue_table_of(&self, volume: &Volume, work: &mut TableWork) -> Result<bool> {
        let grid = volume.layout();
        let layer = minmax::runs(&self.cx, &grid, 1);
        let all = minmax::runs(&self.cx, &grid, grid.regions[2]);
        let slab = volume
            .slabs
            .iter()
            .find(|slab| slab.layers.contains(&(work.next / layer)));
        let Some(slab) = slab else { return Ok(true) };
        let end = slab.layers.end * layer;
        let count = (end - work.next).min(u32::try_from(work.pace.units()).unwrap_or(u32::MAX));
        let runs = work.next..work.next + count;
        self.cx.paced(minmax::STAGE, &mut work.pace, count.into(), || {
            let sample_type = volume.sample_type;
            minmax::run(&self.cx, sample_type, &grid, slab, runs, &volume.table, &work.masks)
        })?;
        work.next += count;
        Ok(work.next == all)
    }

    pub(super) fn end_table(&self, volume: &mut Volume, work: TableWork) -> Result<()> {
        volume.missing_masks = self.cx.read(minmax::STAGE, &work.masks, work.masks.len())?;
        Ok(())
    }
}
