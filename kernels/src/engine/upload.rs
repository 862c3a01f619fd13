//! A field's samples on their way to the device, in pieces: the host never holds all of them.

use crate::buffer::Buffer;
use crate::volume::{Slab, slab_layers, slab_planes};
use crate::{Engine, Error, Grid, RectilinearGrid, Result, SampleType, Samples, Volume};
use std::rc::Rc;

/// A field of which a part is on the device.
pub struct Upload {
    grid: Grid,
    sample_type: SampleType,
    missing: Option<f32>,
    slabs: Vec<Slab>,
    inverse_lengths: Option<Rc<Buffer<f32>>>,
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
        let lengths = rectilinear.inverse_lengths();
        let lengths = lengths.map(|lengths| self.cx.upload("upload", &lengths));
        Ok(Upload {
            sample_type,
            missing,
            slabs: slabs.collect::<Result<_>>()?,
            inverse_lengths: lengths.transpose()?.map(Rc::new),
            done: 0,
            grid,
        })
    }

    /// Puts the next samples on the device, x fastest. May be called again with the same where it failed.
    ///
    /// # Errors
    /// More samples than the grid has, or of another type, or what the device says.
    pub fn continue_upload(&self, upload: &mut Upload, samples: &Samples) -> Result<()> {
        let (from, more) = (upload.done, samples.len() as u64);
        if samples.sample_type() != upload.sample_type || more > upload.grid.sample_count() - from {
            let (count, name) = (upload.grid.sample_count(), upload.sample_type.name());
            return Err(wrong(format!(
                "{more} of {} after {from}, expected {count} of {name} in all",
                samples.sample_type().name()
            )));
        }
        let width = upload.sample_type.bytes() as u64;
        let plane = plane_bytes(&upload.grid, upload.sample_type) as u64;
        let (begin, bytes) = (from * width, samples.as_bytes());
        for slab in &mut upload.slabs {
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

    /// Makes the min/max table.
    ///
    /// # Errors
    /// Fewer samples than the grid has, or no device memory.
    pub fn finish_upload(&self, upload: Upload) -> Result<Volume> {
        let expected = upload.grid.sample_count();
        if upload.done != expected {
            return Err(wrong(format!("{}, expected {expected}", upload.done)));
        }
        let Upload {
            sample_type, missing, ..
        } = upload;
        self.resident(upload.grid, sample_type, missing, upload.slabs, upload.inverse_lengths)
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
