//! Fields of which only what is inside a mask counts.

use crate::stages::evaluate::{self, Input};
use crate::stages::mask::{self, Outside};
use crate::volume::{Slab, slab_planes};
use crate::{Cancel, Engine, Error, Result, ValueSet, Volume};

/// Extents of bricks that are read at a time.
const TABLE_EXTENTS: usize = 1 << 20;

impl Engine {
    /// The field with its samples missing where `labels` has a value that is not `inside`, or none. Its type is wider where the field's own has
    /// no value for missing samples.
    ///
    /// # Errors
    /// Labels on another grid; [`Error::Cancelled`]; or what the device says.
    pub fn mask(&self, field: &Volume, labels: &Volume, inside: &ValueSet, cancel: &dyn Cancel) -> Result<Volume> {
        let grid = field.grid;
        if labels.grid != grid {
            let why = format!(
                "fields of {:?} and {:?} samples, expected one grid",
                grid.dims, labels.grid.dims
            );
            return Err(Error::Invalid { what: "mask", why });
        }
        let outside = self.outside_of(field)?;
        let mut pace = evaluate::pace(&self.cx);
        let plane = grid.dims[0] as usize * grid.dims[1] as usize;
        let mut slabs = Vec::new();
        // Fields of one grid have the same slabs.
        for (own, of_labels) in field.slabs.iter().zip(&labels.slabs) {
            let planes = slab_planes(&grid, &own.layers);
            let count = planes.len() * plane;
            let samples = self.cx.buffer(mask::STAGE, count * outside.sample_type.bytes())?;
            let inputs = [&input(field, own), &input(labels, of_labels)];
            let out = (&samples, count as u64);
            mask::run(&self.cx, inside, inputs, outside, out, &mut pace, cancel)?;
            slabs.push(Slab {
                samples,
                z0: planes.start,
                layers: own.layers.clone(),
            });
        }
        let missing = Some(outside.value).filter(|value| !value.is_nan());
        self.resident(
            grid,
            outside.sample_type,
            missing,
            slabs,
            field.inverse_lengths.clone(),
            cancel,
        )
    }

    /// The value that missing samples of a field have, where some will be, and the type that has it.
    fn outside_of(&self, field: &Volume) -> Result<Outside> {
        if !field.missing.is_nan() {
            return Ok(Outside {
                sample_type: field.sample_type,
                value: field.missing,
            });
        }
        let (mut extent, mut next) = ([f32::INFINITY, f32::NEG_INFINITY], 0);
        while next < field.table.len() {
            let count = TABLE_EXTENTS.min(field.table.len() - next);
            for [low, high] in self.cx.read_at(mask::STAGE, &field.table, next, count)? {
                extent = [extent[0].min(low), extent[1].max(high)];
            }
            next += count;
        }
        let (sample_type, value) = field.sample_type.with_free_value(extent);
        Ok(Outside { sample_type, value })
    }
}

fn input<'a>(field: &Volume, slab: &'a Slab) -> Input<'a> {
    Input {
        samples: &slab.samples,
        sample_type: field.sample_type,
        missing: field.missing,
    }
}
