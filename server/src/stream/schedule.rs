//! Which prefixes of a generation are made, decided on counts before anything is meshed.

use std::collections::VecDeque;

use isopeel_kernels::Level;

use crate::extraction::{Plan, PrefixCount};

/// Levels of prefixes before the final one, coarse first. Below 2 a prefix is nearly as large as the final surface.
const COARSE: [u8; 4] = [5, 4, 3, 2];

/// Maximum share of the final bytes for the first prefix, so that it arrives at once.
const FIRST_SHARE: f64 = 0.03;

/// Maximum share of the final bytes for all prefixes before the final one, which they delay.
const OVERHEAD_SHARE: f64 = 0.35;

/// Minimum triangles of a final surface with a middle prefix. A smaller one follows the first prefix within a few hundred milliseconds,
/// even on a CPU device.
const MIN_MIDDLE_TRIANGLES: u64 = 300_000;

/// Bytes of a chunk without its triangles: headers of chunk and codecs.
const CHUNK_BYTES: f64 = 160.0;
/// Bytes of a triangle in a chunk. Coarse meshes take more: their vertices differ by more.
const TRIANGLE_BYTES: f64 = 4.5;
const COARSE_TRIANGLE_BYTES: f64 = 8.0;

/// The levels to count before [`prefixes`] and [`preview`] can decide.
pub(super) fn levels_to_count() -> Vec<Level> {
    // All of these are valid levels.
    let coarse = COARSE.iter().filter_map(|&level| Level::new(level).ok());
    coarse.chain([Level::FINEST]).collect()
}

/// The plan's prefixes before the final one, the finest first, each with its share of the final bytes.
fn shares(plan: &Plan) -> Vec<(Level, f64)> {
    let bytes = |triangles: u64, each: f64| {
        // Every region that is sent has a triangle.
        let chunks = plan.regions.min(usize::try_from(triangles).unwrap_or(usize::MAX));
        chunks as f64 * CHUNK_BYTES + triangles as f64 * each
    };
    let whole = bytes(final_triangles(plan), TRIANGLE_BYTES);
    let share = |prefix: &PrefixCount| bytes(prefix.count.triangles, COARSE_TRIANGLE_BYTES) / whole;
    let coarse = plan.prefixes.iter().filter(|prefix| prefix.level != Level::FINEST);
    let mut shares: Vec<_> = coarse
        .filter(|prefix| prefix.count.triangles > 0)
        .map(|prefix| (prefix.level, share(prefix)))
        .collect();
    shares.sort_by_key(|&(level, _)| level);
    shares
}

fn final_triangles(plan: &Plan) -> u64 {
    let last = plan.prefixes.iter().find(|prefix| prefix.level == Level::FINEST);
    last.map_or(0, |prefix| prefix.count.triangles)
}

/// The prefixes to make, coarse first, the final surface last.
pub(super) fn prefixes(plan: &Plan) -> VecDeque<Level> {
    let shares = shares(plan);
    let mut levels = VecDeque::from([Level::FINEST]);
    // The finest one within its share.
    let Some(&(first, first_share)) = shares.iter().find(|&&(_, share)| share < FIRST_SHARE) else {
        return levels;
    };
    if final_triangles(plan) >= MIN_MIDDLE_TRIANGLES {
        let rest = OVERHEAD_SHARE - first_share;
        let middle = shares.iter().find(|&&(level, share)| level < first && share < rest);
        levels.extend(middle.map(|&(level, _)| level));
    }
    levels.push_back(first);
    levels.make_contiguous().reverse();
    levels
}

/// The first prefix for a surface like this one, before it is counted. Within half of [`FIRST_SHARE`], so that it stays small
/// where the next surface has half the bytes.
pub(super) fn predicted_first(plan: &Plan) -> Option<Level> {
    let within = |&(_, share): &(Level, f64)| share < FIRST_SHARE / 2.0;
    shares(plan).into_iter().find(within).map(|(level, _)| level)
}

/// The prefix nearest to the final surface within [`OVERHEAD_SHARE`]: for where the client already holds a similar surface.
pub(super) fn preview(plan: &Plan) -> Option<Level> {
    let within = |&(_, share): &(Level, f64)| share < OVERHEAD_SHARE;
    shares(plan).into_iter().find(within).map(|(level, _)| level)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use isopeel_kernels::Count;

    use super::*;
    use crate::view::View;

    /// With triangles of levels 5, 4, 3, 2 and 0.
    fn plan(regions: usize, triangles: [u64; 5]) -> Plan {
        let prefixes = levels_to_count()
            .into_iter()
            .zip(triangles)
            .map(|(level, triangles)| PrefixCount {
                level,
                count: Count {
                    triangles,
                    ..Count::default()
                },
            });
        Plan {
            view: View::plain(&[]),
            prefixes: prefixes.collect(),
            regions,
            wall: Duration::ZERO,
        }
    }

    fn levels(plan: &Plan) -> Vec<u8> {
        prefixes(plan).into_iter().map(Level::get).collect()
    }

    #[test]
    fn the_first_prefix_is_the_finest_that_is_small() {
        assert_eq!(levels(&plan(10, [100, 400, 2_000, 8_000, 100_000])), [4, 0]);
        assert_eq!(levels(&plan(10, [100, 1_500, 6_000, 20_000, 100_000])), [5, 0]);
    }

    #[test]
    fn large_surfaces_have_a_middle_within_the_overhead() {
        assert_eq!(levels(&plan(100, [900, 4_000, 20_000, 80_000, 1_000_000])), [4, 2, 0]);
        assert_eq!(levels(&plan(100, [900, 4_000, 50_000, 300_000, 1_000_000])), [4, 3, 0]);
        assert_eq!(levels(&plan(100, [900, 4_000, 300_000, 500_000, 1_000_000])), [4, 0]);
    }

    #[test]
    fn a_small_surface_goes_at_once() {
        assert_eq!(levels(&plan(10, [50, 100, 200, 400, 1_000])), [0]);
        assert_eq!(levels(&plan(0, [0; 5])), [0]);
    }

    #[test]
    fn a_predicted_prefix_would_be_small_for_half_the_surface() {
        let predicted = |triangles| predicted_first(&plan(10, triangles)).map(Level::get);
        assert_eq!(predicted([100, 400, 2_000, 8_000, 100_000]), Some(4));
        assert_eq!(
            predicted([100, 1_000, 2_000, 8_000, 100_000]),
            Some(5),
            "where 4 would be the first"
        );
        assert_eq!(predicted([700, 1_000, 2_000, 8_000, 100_000]), None);
    }

    #[test]
    fn a_preview_is_the_finest_within_the_overhead() {
        let preview = |regions, triangles| preview(&plan(regions, triangles)).map(Level::get);
        assert_eq!(preview(10, [100, 400, 2_000, 8_000, 100_000]), Some(2));
        assert_eq!(preview(10, [100, 400, 15_000, 60_000, 100_000]), Some(3));
        assert_eq!(preview(10, [900, 900, 900, 900, 1_000]), None);
    }
}
