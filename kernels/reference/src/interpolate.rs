//! A field at points, trilinear between its samples.

use crate::Field;

/// The value at a point in cells; NaN if a sample with a weight above 0 is missing. Outside the volume it is that of the nearest point inside.
pub fn interpolate(field: &Field, point: [f32; 3]) -> f32 {
    let dims = field.grid.dims;
    let at: [f32; 3] = std::array::from_fn(|i| point[i].clamp(0.0, (dims[i] - 1) as f32));
    let low: [u32; 3] = std::array::from_fn(|i| (at[i].floor() as u32).min(dims[i] - 2));
    let mut sum = 0.0;
    for (corner, sample) in field.cell_corners(low).into_iter().enumerate() {
        let mut weight = 1.0;
        for axis in 0..3 {
            let t = at[axis] - low[axis] as f32;
            weight *= if corner >> axis & 1 == 1 { t } else { 1.0 - t };
        }
        if weight > 0.0 {
            sum += weight * sample;
        }
    }
    sum
}
