//! Range and distribution of a field.

use isopeel_kernels::Histogram;

/// Bins of a histogram.
pub const BINS: usize = 256;

/// Returns the planes that a histogram counts in a volume of `dims` samples. If it has more than `samples`, only one block of `depth`
/// planes is counted in each group of blocks (docs/algorithm.md, 2.3).
pub fn counted_planes(dims: [u32; 3], depth: u32, samples: u64) -> Vec<u32> {
    let all = dims.iter().map(|&n| u64::from(n)).product::<u64>();
    let planes: Vec<u32> = (0..dims[2]).collect();
    if all <= samples {
        return planes;
    }
    let blocks: Vec<_> = planes.chunks(depth as usize).collect();
    let groups = blocks.chunks(all.div_ceil(samples) as usize);
    let chosen = groups.zip(0u32..).map(|(group, number)| {
        let hash = number.wrapping_mul(0x9e37_79b9) / 65536;
        group[hash as usize % group.len()]
    });
    chosen.flatten().copied().collect()
}

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
