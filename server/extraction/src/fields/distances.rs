//! Distances of samples to the nearest sample inside, on the host: one axis after another, by the lower envelope of parabolas along each
//! line (Felzenszwalb and Huttenlocher, 2012).

use rayon::prelude::*;

/// Number of samples that a task copies.
const TASK_SAMPLES: usize = 1 << 16;

/// Returns the Euclidean distance of each sample to the nearest sample inside. A sample is inside if its value is neither 0 nor NaN. `None`
/// if no sample is inside. `positions`: positions of the samples along x, y, z, ascending.
pub(crate) fn distances(positions: &[Vec<f64>; 3], mut values: Vec<f32>) -> Option<Vec<f32>> {
    if values.iter().all(|&value| !is_inside(value)) {
        return None;
    }
    // Computes in units of the smallest cell, so that squares stay in the range of a float.
    let lengths = positions
        .iter()
        .flat_map(|along| along.windows(2).map(|pair| pair[1] - pair[0]));
    let unit = lengths.fold(f64::INFINITY, f64::min);
    for value in &mut values {
        *value = if is_inside(*value) { 0.0 } else { f32::INFINITY };
    }
    let mut lines = vec![0.0; values.len()];
    let mut stride = 1;
    for along in positions {
        let along: Vec<f64> = along.iter().map(|position| position / unit).collect();
        let length = along.len();
        lines.par_chunks_mut(length).enumerate().for_each(|(line, lowest)| {
            let start = line / stride * stride * length + line % stride;
            let squares = (0..length).map(|i| f64::from(values[start + i * stride]));
            envelope(&squares.collect::<Vec<_>>(), &along, lowest);
        });
        values
            .par_chunks_mut(TASK_SAMPLES)
            .enumerate()
            .for_each(|(task, values)| {
                for (i, value) in (task * TASK_SAMPLES..).zip(values) {
                    let line = i / (stride * length) * stride + i % stride;
                    *value = lines[line * length + i / stride % length];
                }
            });
        stride *= length;
    }
    values
        .par_iter_mut()
        .for_each(|value| *value = (f64::from(*value).sqrt() * unit) as f32);
    Some(values)
}

fn is_inside(value: f32) -> bool {
    value != 0.0 && !value.is_nan()
}

/// Computes for each position of a line the minimum of `squares` plus the squared distance along the line, and stores it in `lowest`.
fn envelope(squares: &[f64], positions: &[f64], lowest: &mut [f32]) {
    // Parabolas of the envelope: for each the index of its sample, and the position from which on it is the lowest.
    let mut parabolas: Vec<(usize, f64)> = Vec::new();
    for (i, &square) in squares.iter().enumerate() {
        if square == f64::INFINITY {
            continue;
        }
        let from = loop {
            let Some(&(before, from)) = parabolas.last() else {
                break f64::NEG_INFINITY;
            };
            let distance = positions[i] - positions[before];
            let crossing = 0.5 * (positions[i] + positions[before]) + 0.5 * (square - squares[before]) / distance;
            if crossing > from {
                break crossing;
            }
            parabolas.pop();
        };
        parabolas.push((i, from));
    }
    let mut current = 0;
    for (lowest, &position) in lowest.iter_mut().zip(positions) {
        while parabolas.get(current + 1).is_some_and(|&(_, from)| from < position) {
            current += 1;
        }
        let value = parabolas
            .get(current)
            .map(|&(i, _)| squares[i] + (position - positions[i]).powi(2));
        *lowest = value.unwrap_or(f64::INFINITY) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::distances;

    /// Positions along an axis by a few lengths in turns.
    fn axis(count: usize, lengths: [f64; 3]) -> Vec<f64> {
        let mut at = 0.0;
        let after = (1..count).map(|i| {
            at += lengths[i % 3];
            at
        });
        [0.0].into_iter().chain(after).collect()
    }

    #[test]
    fn distances_are_the_minimum_over_all_samples_inside() {
        for (lengths, rarity) in [
            ([1.0; 3], 7),
            ([0.25, 3.0, 1.0], 31),
            ([2e25, 1e25, 7e25], 200),
            ([1e-9; 3], 1),
        ] {
            let positions = [axis(9, lengths), axis(2, lengths.map(|l| 2.0 * l)), axis(12, lengths)];
            let place = |i: usize| [positions[0][i % 9], positions[1][i / 9 % 2], positions[2][i / 18]];
            let mut values: Vec<f32> = (0..216u64)
                .map(|i| {
                    if i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33 & 0xffff < 65536 / rarity {
                        -2.0
                    } else {
                        0.0
                    }
                })
                .collect();
            values[100] = f32::NAN;
            values[77] = 1.0;
            let inside: Vec<usize> = (0..216).filter(|&i| values[i] != 0.0 && i != 100).collect();
            let found = distances(&positions, values).expect("there are some inside");
            for (i, &found) in found.iter().enumerate() {
                let between = |&k: &usize| {
                    (0..3)
                        .map(|axis| (place(i)[axis] - place(k)[axis]).powi(2))
                        .sum::<f64>()
                };
                let expected = inside.iter().map(between).fold(f64::INFINITY, f64::min).sqrt();
                assert!(
                    (f64::from(found) - expected).abs() <= 1e-6 * expected,
                    "{found} at {i}, expected {expected}"
                );
            }
        }
        let even = [axis(2, [1.0; 3]), axis(2, [1.0; 3]), axis(2, [1.0; 3])];
        assert_eq!(
            distances(&even, vec![0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            None
        );
    }
}
