//! Uploads a field's samples to the device in pieces: the host never holds all of them.

use super::table::TableWork;
use crate::volume::{Slab, slab_layers, slab_planes};
use crate::{Engine, Error, Grid, RectilinearGrid, Result, SampleType, Samples, Volume};
use std::sync::Arc;

/// A field of which a part is on the device.
pub struct Upload {
    /// Its table is made when all samples are there.
    volume: Volume,
    table: Option<TableWork>,
    /// Samples so far.
    done: u64,
}

impl Engine {
    /// Allocates a field. `missing` samples count as NaN.
    ///
    /// # Errors
    /// No device memory.
    pub fn begin_upload(
        &self,
        rectilinear: &RectilinearGrid,
        sample_type: SampleType,
        missing: Option<f32>,
    ) -> Result<Upload> {
        let Grid { dims, spacing } = *rectilinear.grid();
        let grid = Grid::new(dims, spacing)?;
        let plane = plane_bytes(&grid, sample_type);
        let slabs = slab_layers(&grid, self.cx.limit_bytes)?.into_iter().map(|layers| {
            let planes = slab_planes(&grid, &layers);
            Ok(Slab {
                samples: self.cx.buffer("upload", planes.len() * plane)?,
                z0: planes.start,
                layers,
            })
        });
        let slabs = slabs.collect::<Result<_>>()?;
        let lengths = rectilinear.inverse_lengths();
        let lengths = lengths.map(|lengths| self.cx.upload("upload", &lengths));
        let lengths = lengths.transpose()?.map(Arc::new);
        Ok(Upload {
            volume: self.without_table(grid, sample_type, missing, slabs, lengths)?,
            table: None,
            done: 0,
        })
    }

    /// Puts the next samples on the device, x fastest. If it failed, it may be called again with the same samples.
    ///
    /// # Errors
    /// More samples than the grid has, or of another type, or an error of the device.
    pub fn continue_upload(&self, upload: &mut Upload, samples: &Samples) -> Result<()> {
        let (from, more) = (upload.done, samples.len() as u64);
        let Volume { grid, sample_type, .. } = upload.volume;
        if samples.sample_type() != sample_type || more > grid.sample_count() - from {
            let (count, name) = (grid.sample_count(), sample_type.name());
            return Err(wrong(format!(
                "{more} of {} after {from}, expected {count} of {name} in all",
                samples.sample_type().name()
            )));
        }
        let width = sample_type.bytes() as u64;
        let plane = plane_bytes(&grid, sample_type) as u64;
        let (begin, bytes) = (from * width, samples.as_bytes());
        for slab in &mut upload.volume.slabs {
            // Neighbouring slabs share planes.
            let first = u64::from(slab.z0) * plane;
            let start = begin.max(first);
            let end = (begin + bytes.len() as u64).min(first + slab.samples.bytes());
            if start < end {
                let part = &bytes[(start - begin) as usize..(end - begin) as usize];
                let at = (start - first) as usize;
                self.cx.write_at("upload", &mut slab.samples, at, part)?;
            }
        }
        upload.done += more;
        Ok(())
    }

    /// Makes the next part of the min/max table, which takes some milliseconds. True once it is complete.
    ///
    /// # Errors
    /// Fewer samples than the grid has, or no device memory.
    pub fn continue_table(&self, upload: &mut Upload) -> Result<bool> {
        let expected = upload.volume.grid.sample_count();
        if upload.done != expected {
            return Err(wrong(format!("{}, expected {expected}", upload.done)));
        }
        let mut work = match upload.table.take() {
            Some(work) => work,
            None => self.begin_table(&upload.volume)?,
        };
        let is_complete = self.continue_table_of(&upload.volume, &mut work)?;
        upload.table = Some(work);
        Ok(is_complete)
    }

    /// Completes the min/max table and returns the field.
    ///
    /// # Errors
    /// As [`Engine::continue_table`].
    pub fn finish_upload(&self, mut upload: Upload) -> Result<Volume> {
        while !self.continue_table(&mut upload)? {}
        let Upload { mut volume, table, .. } = upload;
        if let Some(work) = table {
            self.end_table(&mut volume, work)?;
        }
        Ok(volume)
    }

    /// Puts a field on the device and makes its min/max table. `missing` samples count as NaN.
    ///
    /// # Errors
    /// Too few samples for the grid, or no device memory.
    pub fn upload(&self, grid: impl Into<RectilinearGrid>, samples: &Samples, missing: Option<f32>) -> Result<Volume> {
        let mut upload = self.begin_upload(&grid.into(), samples.sample_type(), missing)?;
        self.continue_upload(&mut upload, samples)?;
        self.finish_upload(upload)
    }
}

fn plane_bytes(grid: &Grid, sample_type: SampleType) -> usize {
    grid.dims[0] as usize * grid.dims[1] as usize * sample_type.bytes()
}

fn wrong(why: String) -> Error {
    Error::Invalid {
        what: "volume samples",
        why,
    }
}
