//! Values of a field at the vertices of a surface, trilinear between its samples.

use isopeel_kernels::Samples;

use super::mesh::FieldValues;
use crate::volumes::{Field, ReadError, ReadProgress, VolumeStep};

/// A field with the samples of a time step.
pub(super) struct FieldSamples<'a> {
    pub field: &'a Field,
    pub samples: Samples,
    pub dims: [u32; 3],
}

impl<'a> FieldSamples<'a> {
    /// Reads the samples of a field at a volume's time step.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub(super) fn read(volume: &VolumeStep, field: &'a Field) -> Result<Self, ReadError> {
        Ok(Self {
            field,
            samples: field.source.read(volume.step(), &ReadProgress::default())?,
            dims: volume.dataset().geometry.dims,
        })
    }

    /// The values at positions of index space, `padding` samples further in.
    pub(super) fn at(&self, positions: &[[f32; 3]], padding: f32) -> FieldValues {
        let index = |position: &[f32; 3]| position.map(|at| f64::from(at - padding));
        FieldValues {
            name: self.field.name.clone(),
            unit: self.field.unit.clone(),
            values: positions.iter().map(|position| self.value(index(position))).collect(),
        }
    }

    /// The value at a position of index space; outside of the grid, as on the faces of a cap, that of the nearest place inside. NaN if a sample
    /// that counts is missing.
    fn value(&self, position: [f64; 3]) -> f32 {
        let mut low = [0; 3];
        let mut share = [0.0; 3];
        for axis in 0..3 {
            let last = f64::from(self.dims[axis] - 1);
            let at = position[axis].clamp(0.0, last);
            let cell = at.floor().min(last - 1.0);
            (low[axis], share[axis]) = (cell as usize, at - cell);
        }
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        let mut sum = 0.0;
        for corner in 0..8 {
            let offset = [0, 1, 2].map(|axis| corner >> axis & 1);
            let weight: f64 = (0..3)
                .map(|axis| {
                    if offset[axis] == 1 {
                        share[axis]
                    } else {
                        1.0 - share[axis]
                    }
                })
                .product();
            // One that does not count may be missing.
            if weight > 0.0 {
                let [x, y, z] = [0, 1, 2].map(|axis| low[axis] + offset[axis]);
                let sample = self.samples.get(x + nx * (y + ny * z));
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
    use super::*;
    use crate::volumes::testing;

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
        let field = FieldSamples {
            field: &field,
            samples: Samples::F32(all),
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
