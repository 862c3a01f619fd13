//! The twin of distances against all pairs of samples.

use isopeel_reference::distance_field::squares;
use proptest::prelude::*;

/// Positions along an axis: up to six, one cell or many.
fn axis() -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(0.1f64..4.0, 1..6).prop_map(|lengths| {
        let mut at = 0.0;
        let after = lengths.into_iter().map(|length| {
            at += length;
            at
        });
        [0.0].into_iter().chain(after).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn squares_are_the_minimum_over_all_pairs(x in axis(), y in axis(), z in axis(), chance in 0u64..8, seed in any::<u64>()) {
        let positions = [x, y, z];
        let [nx, ny, nz] = positions.each_ref().map(Vec::len);
        let place = |i: usize| [positions[0][i % nx], positions[1][i / nx % ny], positions[2][i / nx / ny]];
        let is_in = |i: usize| (seed ^ i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 61 < chance;
        let inside: Vec<bool> = (0..nx * ny * nz).map(is_in).collect();
        for (i, got) in squares(&positions, &inside).into_iter().enumerate() {
            let between = |k: usize| (0..3).map(|axis| (place(i)[axis] - place(k)[axis]).powi(2)).sum::<f64>();
            let want = (0..inside.len()).filter(|&k| inside[k]).map(between).fold(f64::INFINITY, f64::min);
            prop_assert!(got == want || (got - want).abs() <= 1e-12 * want, "{} at {}, expected {}", got, i, want);
        }
    }
}
