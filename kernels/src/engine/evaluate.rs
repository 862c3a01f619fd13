//! Fields computed by an expression over resident fields.

use crate::buffer::Buffer;
use crate::stages::evaluate::{self, Input};
use crate::volume::{Slab, slab_planes};
use crate::{Cancel, Engine, Error, Expression, Result, SampleType, Volume};

impl Engine {
    /// Returns the field of f32 that an expression computes. `fields`: those of the expression, in the order of their places.
    ///
    /// # Errors
    /// Fewer fields than the expression has, or fields on different grids; [`Error::Cancelled`]; or an error of the device.
    pub fn evaluate(&self, expression: &Expression, fields: &[&Volume], cancel: &dyn Cancel) -> Result<Volume> {
        let slabs = self.evaluate_slabs(expression, fields, cancel)?;
        // Never empty: an expression has at least one field.
        let (grid, lengths) = (fields[0].grid, fields[0].inverse_lengths.clone());
        self.resident(grid, SampleType::F32, None, slabs, lengths, cancel)
    }

    /// Returns the samples of the field that an expression computes, slab by slab.
    pub(super) fn evaluate_slabs(
        &self,
        expression: &Expression,
        fields: &[&Volume],
        cancel: &dyn Cancel,
    ) -> Result<Vec<Slab>> {
        let fail = |why: String| {
            Err(Error::Invalid {
                what: "expression",
                why,
            })
        };
        let count = expression.fields();
        let Some((first, fields)) = fields.first().zip(fields.get(..count)) else {
            return fail(format!("{} fields, expected {count}", fields.len()));
        };
        let grid = first.grid;
        if let Some(other) = fields.iter().find(|field| field.grid != grid) {
            return fail(format!(
                "fields of {:?} and {:?} samples, expected one grid",
                grid.dims, other.grid.dims
            ));
        }
        let (encoded, mut pace) = (expression.encoded(), evaluate::pace(&self.cx));
        self.slabs_like(first, SampleType::F32, evaluate::STAGE, |number, out, samples| {
            // Unused places of fields get the first field, which is never read there.
            let inputs = std::array::from_fn(|i| fields.get(i).unwrap_or(first).input(number));
            evaluate::run(&self.cx, &encoded, inputs, out, samples, &mut pace, cancel)
        })
    }

    /// Slabs like those of a volume, as all fields of its grid have them. `fill` takes the number of a slab, its buffer and its count of samples.
    pub(super) fn slabs_like(
        &self,
        volume: &Volume,
        sample_type: SampleType,
        stage: &'static str,
        mut fill: impl FnMut(usize, &Buffer<u8>, u64) -> Result<()>,
    ) -> Result<Vec<Slab>> {
        let grid = &volume.grid;
        let plane = grid.dims[0] as usize * grid.dims[1] as usize;
        let slabs = volume.slabs.iter().enumerate().map(|(number, Slab { layers, .. })| {
            let planes = slab_planes(grid, layers);
            let count = planes.len() * plane;
            let samples = self.cx.buffer(stage, count * sample_type.bytes())?;
            fill(number, &samples, count as u64)?;
            Ok(Slab {
                samples,
                z0: planes.start,
                layers: layers.clone(),
            })
        });
        slabs.collect()
    }
}

impl Volume {
    /// Returns a slab as the input of a stage.
    pub(super) fn input(&self, slab: usize) -> Input<'_> {
        Input {
            samples: &self.slabs[slab].samples,
            sample_type: self.sample_type,
            missing: self.missing,
        }
    }
}
