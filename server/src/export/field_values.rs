//! Values of a field at the vertices of a surface, trilinear between its samples.

use isopeel_extraction::WorkError;
use isopeel_extraction::fields;
use isopeel_kernels::Samples;
use isopeel_mesh::mesh::FieldValues;
use isopeel_volumes::{Field, VolumeStep};
use tokio_util::sync::CancellationToken;

use crate::service::DeviceWorker;

/// A field, or an expression over fields, with the samples of a time step.
pub struct FieldSamples {
    field: Field,
    /// All samples, in pieces of `piece_len` samples; the last piece may have fewer.
    pieces: Vec<Samples>,
    piece_len: usize,
    dims: [u32; 3],
}

impl FieldSamples {
    /// Returns the samples of fields and expressions by their names. Reads them back from the device, because the fields of the surface are
    /// already resident there.
    ///
    /// # Errors
    /// Errors of the device, or of reading a file.
    pub async fn of(
        worker: &DeviceWorker,
        volume: &VolumeStep,
        names: &[String],
        token: &CancellationToken,
    ) -> Result<Vec<Self>, WorkError> {
        let mut field_samples = Vec::new();
        for name in names {
            let Some(field) = fields::field_or_computed(volume.dataset(), name) else {
                continue;
            };
            let (pieces, planes) = worker.samples(volume, name, token).await?;
            let dims = volume.dataset().geometry.dims;
            field_samples.push(Self {
                field,
                pieces,
                piece_len: planes as usize * dims[0] as usize * dims[1] as usize,
                dims,
            });
        }
        Ok(field_samples)
    }

    fn sample(&self, index: usize) -> f32 {
        self.pieces[index / self.piece_len].get(index % self.piece_len)
    }

    /// Returns the values at positions in a padded index space, in which all coordinates of the grid's first sample are `padding`.
    pub(super) fn at(&self, positions: &[[f32; 3]], padding: f32) -> FieldValues {
        let index = |position: &[f32; 3]| position.map(|coordinate| f64::from(coordinate - padding));
        FieldValues {
            name: self.field.name.clone(),
            unit: self.field.unit.clone(),
            values: positions.iter().map(|position| self.value(index(position))).collect(),
        }
    }

    /// Returns the value at a position in index space. A position outside the grid, as on the faces of a cap, gets the value of the nearest
    /// position inside. Returns NaN if a sample with a weight above 0 is missing.
    fn value(&self, position: [f64; 3]) -> f32 {
        let mut low = [0; 3];
        let mut fraction = [0.0; 3];
        for axis in 0..3 {
            let last = f64::from(self.dims[axis] - 1);
            let coordinate = position[axis].clamp(0.0, last);
            let cell = coordinate.floor().min(last - 1.0);
            (low[axis], fraction[axis]) = (cell as usize, coordinate - cell);
        }
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        let mut sum = 0.0;
        for corner in 0..8 {
            let offset = [0, 1, 2].map(|axis| corner >> axis & 1);
            let weight: f64 = (0..3)
                .map(|axis| {
                    if offset[axis] == 1 {
                        fraction[axis]
                    } else {
                        1.0 - fraction[axis]
                    }
                })
                .product();
            // A missing sample of weight 0 has no effect on the value.
            if weight > 0.0 {
                let [x, y, z] = [0, 1, 2].map(|axis| low[axis] + offset[axis]);
                let sample = self.sample(x + nx * (y + ny * z));
                if Some(sample) == self.field.missing {
                    return f32::NAN;
                }
                sum += weight * f64::from(sample);
            }
        }
        sum as f32
    }
}

#[cfg(test)]
mod tests {
    use isopeel_volumes::testing;

    use super::*;

    #[test]
    fn values_are_trilinear_and_missing_ones_are_none() {
        let dataset = testing::dataset("a", [3, 2, 2], &["f"]);
        let field = Field {
            missing: Some(-1.0),
            ..dataset.fields[0].clone()
        };
        let samples = |at: [usize; 3]| (at[0] + 10 * at[1] + 100 * at[2]) as f32;
        let mut all: Vec<f32> = Vec::new();
        for z in 0..2 {
            for y in 0..2 {
                all.extend((0..3).map(|x| samples([x, y, z])));
            }
        }
        all[2] = -1.0;
        let (low, high) = all.split_at(6);
        let field = FieldSamples {
            field,
            pieces: vec![Samples::F32(low.to_vec()), Samples::F32(high.to_vec())],
            piece_len: 6,
            dims: [3, 2, 2],
        };
        let values = field.at(
            &[
                [0.5, 0.25, 0.75],
                [0.0; 3],
                [1.0, 1.0, 1.0],
                [2.0, 1.0, 1.0],
                [1.5, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [-1.0, 0.5, 9.0],
            ],
            0.0,
        );
        assert_eq!(field.at(&[[2.0; 3]], 1.0).values, [111.0]);
        let expected = [0.5 + 2.5 + 75.0, 0.0, 111.0, 112.0, f32::NAN, 1.0, 105.0];
        for (found, expected) in values.values.iter().zip(expected) {
            assert!(
                found == &expected || (found.is_nan() && expected.is_nan()),
                "{:?}",
                values.values
            );
        }
    }
}
