//! Samples of a plane of a volume.

use crate::Field;

/// The values of the plane across an axis, the lower of the other axes fastest.
pub fn slice(field: &Field, axis: usize, index: u32) -> Vec<f32> {
    let samples = field.samples().filter(|at| at[axis] == index);
    samples.map(|at| field.at(at)).collect()
}
