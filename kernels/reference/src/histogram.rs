//! Range and distribution of a field.

use isopeel_kernels::Histogram;

/// Bins of a histogram.
pub const BINS: usize = 256;

/// Range over the finite values, and how many fall into each of 256 equal bins of it; all in the first when the range
/// is a single value.
pub fn histogram(values: &[f32]) -> Histogram {
    let finite = || values.iter().copied().filter(|v| v.is_finite());
    let mut bins = vec![0; BINS];
    let Some(lo) = finite().reduce(f32::min) else {
        return Histogram {
            range: [0.0, 0.0],
            bins,
        };
    };
    let hi = finite().fold(lo, f32::max);
    // Halves: the span from end to end of the type would overflow.
    let span = 0.5 * hi - 0.5 * lo;
    for v in finite() {
        let bin = if span > 0.0 {
            ((0.5 * v - 0.5 * lo) / span * BINS as f32).floor() as usize
        } else {
            0
        };
        bins[bin.min(BINS - 1)] += 1;
    }
    Histogram { range: [lo, hi], bins }
}
