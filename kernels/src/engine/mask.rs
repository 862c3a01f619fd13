//! Masked fields: samples outside the mask are missing.

use crate::stages::evaluate;
use crate::stages::histogram::TABLE_EXTENTS;
use crate::stages::mask::{self, Outside};
use crate::{Cancel, Engine, Error, Result, ValueSet, Volume};

impl Engine {
    /// Returns the field masked by `labels`: a sample is missing if its label is missing or is not in `inside`. The sample type is wider
    /// than the field's own if that type has no free value for missing samples.
    ///
    /// # Errors
    /// Labels on another grid; [`Error::Cancelled`]; or an error of the device.
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
        let slabs = self.slabs_like(field, outside.sample_type, mask::STAGE, |number, out, samples| {
            let inputs = [field, labels].map(|volume| volume.input(number));
            mask::run(&self.cx, inside, inputs, outside, (out, samples), &mut pace, cancel)
        })?;
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

    /// Returns the value for samples outside the mask and the sample type that can hold it. The field keeps its own missing value if it
    /// has one.
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
