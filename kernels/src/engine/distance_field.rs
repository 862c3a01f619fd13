//! Distances to the samples at which an expression is true.

use crate::stages::distance_field::{self, Axes, MAX_LENGTH, STAGE, Work};
use crate::volume::Slab;
use crate::{Cancel, Engine, Error, Expression, Result, SampleType, Volume};

impl Engine {
    /// Returns the Euclidean distance of each sample, in world units, to the nearest inside sample. A sample is inside if the expression
    /// is neither 0 nor missing there; its distance is 0. Returns `None` if no sample is inside. `fields`: those of the expression, in
    /// the order of their places. `world`: world units per unit of the grid's spacing.
    ///
    /// # Errors
    /// As [`Engine::evaluate`]; more than 65536 samples along x or y.
    pub fn distance_field(
        &self,
        expression: &Expression,
        fields: &[&Volume],
        world: f32,
        cancel: &dyn Cancel,
    ) -> Result<Option<Volume>> {
        let values = self.evaluate_slabs(expression, fields, cancel)?;
        // Never empty: an expression has at least one field.
        let Some(first) = fields.first() else { return Ok(None) };
        let grid = first.grid;
        if let Some(length) = grid.dims[..2].iter().find(|&&length| length > MAX_LENGTH) {
            return Err(Error::Invalid {
                what: "distances",
                why: format!("{length} samples along x or y, expected {MAX_LENGTH} or fewer"),
            });
        }
        let like = |slab: &Slab| {
            Ok(Slab {
                samples: self.cx.buffer(STAGE, slab.samples.len())?,
                z0: slab.z0,
                layers: slab.layers.clone(),
            })
        };
        let distances = values.iter().map(like).collect::<Result<Vec<_>>>()?;
        let axes = self.axes(first, world)?;
        let work = Work {
            cx: &self.cx,
            grid: first.layout(),
            axes: &axes,
            cancel,
        };
        work.columns(&values, &distances)?;
        for (values, distances) in values.iter().zip(&distances) {
            work.lines(1, distances, values)?;
            work.lines(0, values, distances)?;
        }
        drop(values);
        // If no sample is inside, all distances are infinite; otherwise none is. So the first one decides.
        let Some(slab) = distances.first() else { return Ok(None) };
        let first_value: Vec<u8> = self.cx.read(STAGE, &slab.samples, size_of::<f32>())?;
        if !bytemuck::pod_read_unaligned::<f32>(&first_value).is_finite() {
            return Ok(None);
        }
        let lengths = first.inverse_lengths.clone();
        self.resident(grid, SampleType::F32, None, distances, lengths, cancel)
            .map(Some)
    }

    /// Returns the positions of a volume's samples along the axes. The unit is the smallest spacing, so that squares stay in the range
    /// of a float.
    fn axes(&self, volume: &Volume, world: f32) -> Result<distance_field::Axes> {
        let unit = volume.grid.smallest_spacing();
        let dims = volume.grid.dims.map(|n| n as usize);
        let (positions, scale) = match &volume.inverse_lengths {
            // The sample's index is its position: exact in a float.
            None => {
                let numbers = |n: usize| (0..n).map(|i| i as f32).collect();
                (dims.map(numbers), volume.grid.spacing.map(|spacing| spacing / unit))
            }
            Some(inverse) => {
                let mut rest = &self.cx.read(STAGE, inverse, inverse.len())?[..];
                let along = |n: usize| {
                    let (own, others) = rest.split_at(n - 1);
                    rest = others;
                    positions(own, unit)
                };
                (dims.map(along), [1.0; 3])
            }
        };
        let [x, y, z] = positions.map(|along: Vec<f32>| self.cx.upload(STAGE, &along));
        Ok(Axes {
            positions: [x?, y?, z?],
            scale,
            unit: unit * world,
            is_even: volume.inverse_lengths.is_none(),
        })
    }
}

/// Positions of samples in units, from one over the lengths of the cells between them.
fn positions(inverse_lengths: &[f32], unit: f32) -> Vec<f32> {
    let mut at = 0.0;
    let after = inverse_lengths.iter().map(|&inverse| {
        at += 1.0 / f64::from(inverse);
        (at / f64::from(unit)) as f32
    });
    [0.0].into_iter().chain(after).collect()
}
