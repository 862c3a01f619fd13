//! Smooths a condition on the host: computes for each sample the share of the samples around it that meet the condition, weighted by a
//! Gaussian.

use rayon::prelude::*;

/// Radius at which the Gaussian is cut off, in standard deviations.
const RADIUS: f32 = 3.0;

/// Returns, for each sample, the weighted share of samples around it whose value is neither 0 nor NaN. Beyond the volume's faces, the
/// samples on the faces are repeated. `sigma`: standard deviation in samples along each axis, above 0; `dims`: samples along x, y, z.
pub(crate) fn smoothed(dims: [u32; 3], mut values: Vec<f32>, sigma: f32) -> Vec<f32> {
    let [nx, ny, _] = dims.map(|n| n as usize);
    for value in &mut values {
        *value = if *value != 0.0 && !value.is_nan() { 1.0 } else { 0.0 };
    }
    let weights = weights(sigma);
    let mut sums = vec![0.0; values.len()];
    // Adds planes of the volume along z, then rows of each plane along y.
    for (outer, inner) in [(values.len(), nx * ny), (nx * ny, nx)] {
        sums.par_chunks_mut(inner).enumerate().for_each(|(chunk, sums)| {
            let begin = chunk * inner;
            let outer_begin = begin / outer * outer;
            sums.fill(0.0);
            for (offset, &weight) in (-(weights.len() as isize - 1)..).zip(weights.iter().rev().chain(&weights[1..])) {
                let neighbour = ((begin - outer_begin) / inner)
                    .saturating_add_signed(offset)
                    .min(outer / inner - 1);
                let neighbours = &values[outer_begin + neighbour * inner..][..inner];
                sums.iter_mut()
                    .zip(neighbours)
                    .for_each(|(sum, value)| *sum += weight * value);
            }
        });
        std::mem::swap(&mut values, &mut sums);
    }
    let rows = values.par_chunks(nx).zip(sums.par_chunks_mut(nx));
    rows.for_each(|(row, sums)| smooth_row(&weights, row, sums));
    sums
}

/// Returns the weights of the sample itself and of its neighbours on one side. Over both sides the weights add up to 1.
fn weights(sigma: f32) -> Vec<f32> {
    let count = (RADIUS * sigma).ceil() as usize;
    let weight = |i: usize| (-0.5 * (i as f32 / sigma).powi(2)).exp();
    let sum = weight(0) + 2.0 * (1..=count).map(weight).sum::<f32>();
    (0..=count).map(|i| weight(i) / sum).collect()
}

/// Smooths a row along x.
fn smooth_row(weights: &[f32], row: &[f32], sums: &mut [f32]) {
    for (i, sum) in sums.iter_mut().enumerate() {
        let neighbours = weights.iter().enumerate().skip(1);
        let pairs = neighbours.map(|(k, weight)| weight * (row[i.saturating_sub(k)] + row[(i + k).min(row.len() - 1)]));
        *sum = weights[0] * row[i] + pairs.sum::<f32>();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_a_sum_over_all_samples() {
        let dims = [7, 5, 4];
        let inside = |x: i32, y: i32, z: i32| (x * 5 + y * 3 + z * 7) % 4 == 0;
        let at = |i: usize| [i % 7, i / 7 % 5, i / 35].map(|at| at as i32);
        // Samples inside may have any value but 0. Missing samples are outside.
        let value = |[x, y, z]: [i32; 3]| match (inside(x, y, z), (x + y) % 2) {
            (true, _) => 3.0,
            (false, 0) => f32::NAN,
            (false, _) => 0.0,
        };
        let found = smoothed(dims, (0..140).map(|i| value(at(i))).collect(), 0.8);
        let (mut total, reach) = (0.0, 3);
        let gauss = |k: i32| (-0.5 * (f64::from(k) / 0.8).powi(2)).exp();
        (-reach..=reach).for_each(|k| total += gauss(k));
        for (i, found) in found.into_iter().enumerate() {
            let [x, y, z] = at(i);
            let mut sum = 0.0;
            for (dx, dy, dz) in (-reach..=reach)
                .flat_map(|dx| (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dz| (dx, dy, dz))))
            {
                let near = |at: i32, by: i32, n: i32| (at + by).clamp(0, n - 1);
                if inside(near(x, dx, 7), near(y, dy, 5), near(z, dz, 4)) {
                    sum += gauss(dx) * gauss(dy) * gauss(dz) / f64::powi(total, 3);
                }
            }
            assert!(
                (f64::from(found) - sum).abs() < 1e-6,
                "{:?}: {found}, expected {sum}",
                at(i)
            );
        }
    }

    #[test]
    fn a_plane_stays_halfway_between_its_samples() {
        let values = (0..8 * 4 * 4).map(|i| f32::from(i % 8 < 3)).collect();
        let found = smoothed([8, 4, 4], values, 0.8);
        assert!((found[2] + found[3] - 1.0).abs() < 1e-6 && found[2] > 0.5, "{found:?}");
    }
}
