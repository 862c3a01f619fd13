//! Which prefixes of an edit are worth making. Pure: decides on counts, before anything is meshed.

use std::collections::VecDeque;

use isopeel_kernels::Level;

use crate::device_worker::{Plan, PrefixCount};

/// Levels that a first or a middle prefix may have, coarse first. Below 2 a prefix is nearly the final surface.
const COARSE: [u8; 4] = [5, 4, 3, 2];

/// Share of the final bytes that the first prefix stays under: it is there at once.
const FIRST_SHARE: f64 = 0.03;

/// Share of the final bytes that all prefixes before the final one stay under; what they cost delays the final surface.
const OVERHEAD_SHARE: f64 = 0.35;

/// Triangles of the final surface from which a middle prefix is made at all. Below, the final surface is there a few
/// hundred milliseconds after the first prefix, even on a CPU device.
const MIDDLE_FROM_TRIANGLES: u64 = 300_000;

/// Bytes of a chunk beside its triangles: the header and what the codecs put around any mesh.
const CHUNK_BYTES: f64 = 160.0;
/// Bytes of a triangle in a chunk. Coarse meshes have larger differences from vertex to vertex.
const TRIANGLE_BYTES: f64 = 4.5;
const COARSE_TRIANGLE_BYTES: f64 = 8.0;

/// The levels to count before [`prefixes`] can decide. `same_surface`: the client shows a final surface of the same field,
/// feature and isovalue. Only part of it may change; coarse prefixes would replace all of it twice.
pub(super) fn candidates(same_surface: bool) -> Vec<Level> {
    let coarse = if same_surface { &[] } else { COARSE.as_slice() };
    // Levels there are, every one of them.
    coarse
        .iter()
        .filter_map(|&level| Level::new(level).ok())
        .chain([Level::FINEST])
        .collect()
}

/// The prefixes to make, coarse first, the final surface last.
pub(super) fn prefixes(plan: &Plan) -> VecDeque<Level> {
    let finest = |prefix: &&PrefixCount| prefix.level == Level::FINEST;
    let whole = plan
        .prefixes
        .iter()
        .find(finest)
        .map_or(0, |prefix| prefix.count.triangles);
    let bytes = |triangles: u64, each: f64| {
        // No region without a triangle is sent.
        let chunks = plan.regions.min(usize::try_from(triangles).unwrap_or(usize::MAX));
        chunks as f64 * CHUNK_BYTES + triangles as f64 * each
    };
    let whole_bytes = bytes(whole, TRIANGLE_BYTES);
    let share = |prefix: &PrefixCount| bytes(prefix.count.triangles, COARSE_TRIANGLE_BYTES) / whole_bytes;
    let mut coarse: Vec<_> = plan.prefixes.iter().filter(|prefix| !finest(prefix)).collect();
    coarse.sort_by_key(|prefix| prefix.level);
    let mut levels = VecDeque::from([Level::FINEST]);
    // The finest that is small enough.
    let Some(first) = coarse
        .iter()
        .find(|prefix| prefix.count.triangles > 0 && share(prefix) < FIRST_SHARE)
    else {
        return levels;
    };
    if whole >= MIDDLE_FROM_TRIANGLES {
        let rest = OVERHEAD_SHARE - share(first);
        let middle = coarse
            .iter()
            .find(|prefix| prefix.level < first.level && share(prefix) < rest);
        if let Some(middle) = middle {
            levels.push_front(middle.level);
        }
    }
    levels.push_front(first.level);
    levels
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use isopeel_kernels::Count;

    use super::*;
    use crate::edit::View;
    use crate::volumes::{Dataset, Geometry};

    /// With triangles of levels 5, 4, 3, 2 and 0.
    fn plan(regions: usize, triangles: [u64; 5]) -> Plan {
        let dataset = Dataset {
            id: "test".into(),
            title: "Test".into(),
            geometry: Geometry {
                dims: [2; 3],
                spacing: [1.0; 3],
                origin: [0.0; 3],
                direction: Geometry::IDENTITY,
            },
            steps: 1,
            fields: Vec::new(),
            notice: None,
            opening: None,
        };
        let prefixes = candidates(false)
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
            view: View::plain(&dataset),
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
    fn a_change_of_the_shown_surface_goes_straight_to_it() {
        assert_eq!(candidates(true), [Level::FINEST]);
    }
}
