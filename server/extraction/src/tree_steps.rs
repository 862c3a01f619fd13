//! Coarser cuts of the vertex tree that are sent before the final one, so that a viewer on a slow connection sees a change soon.
//!
//! Each cut is a whole surface, which the next one replaces, so all bytes before the final surface are overhead. Therefore there are few
//! coarser cuts, each several times as large as the one before. A connection that can send the final surface within one step gets no
//! coarser cut.

use super::Step;
use super::chunk_bytes::{self, BYTES_OF_100_COARSE_TRIANGLES, BYTES_OF_100_TRIANGLES};

/// The final surface is sent at once if it has at most [`Step::line_bytes`] divided by this number.
const AT_ONCE_DIVISOR: u64 = 4;

/// The first cut has [`Step::line_bytes`] divided by this number. At 20 Mbit/s and a round trip of 40 ms, the change is visible after 110 ms,
/// of which the cut itself is on the line for 20 ms.
const FIRST_DIVISOR: u64 = 30;
/// Minimum bytes of the first cut, some 5,000 triangles. Smaller cuts show too little, and their chunks are mostly headers.
const MIN_FIRST_BYTES: u64 = 48 << 10;

/// Each further cut has the bytes of the cut before multiplied by this number.
const GROWTH: u64 = 4;
/// Minimum of that factor. The final surface is sent instead of a cut that would grow by less.
const MIN_GROWTH: u64 = 2;
/// A second coarser cut is made only if the final surface has more than [`Step::line_bytes`] multiplied by this number.
const LONG_STEPS: u64 = 8;

/// The largest coarser cut has the bytes of the final surface divided by this number.
const TARGET_DIVISOR: u64 = 5;
/// If keeping the topology needs more triangles than the target, the cut may have up to the bytes of the final surface divided by this
/// number.
const MAX_DIVISOR: u64 = 3;

/// Minimum triangles of a coarser cut. A cut of fewer triangles shows too little of a surface.
const MIN_TRIANGLES: u64 = 1000;

/// Triangles of a coarser cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CoarserCut {
    /// Triangles that the cut should have.
    pub triangles: u64,
    /// Maximum triangles of the cut if its topology needs more than `triangles`. If it needs even more, the final surface is sent at once.
    pub max_triangles: u64,
}

/// Returns the next coarser cut; `None` if the final one is next. `regions`: number of regions that have cells of the surface; `expected`:
/// triangles of the final surface.
pub(crate) fn next_coarser_cut(step: Step, regions: u64, expected: u64) -> Option<CoarserCut> {
    let final_bytes = chunk_bytes::of_triangles(expected, regions, BYTES_OF_100_TRIANGLES);
    // The client shows a surface of which every region changes only as a whole, so only the final surface may replace it.
    if step.shown.is_replaced_at_once() || final_bytes <= step.line_bytes / AT_ONCE_DIVISOR {
        return None;
    }
    let coarse_bytes = |triangles| chunk_bytes::of_triangles(triangles, regions, BYTES_OF_100_COARSE_TRIANGLES);
    let largest = final_bytes / TARGET_DIVISOR;
    let is_long = final_bytes > step.line_bytes.saturating_mul(LONG_STEPS);
    let bytes = match step.made_triangles {
        0 => (step.line_bytes / FIRST_DIVISOR).max(MIN_FIRST_BYTES).min(largest),
        made if is_long && largest >= coarse_bytes(made) * MIN_GROWTH => (coarse_bytes(made) * GROWTH).min(largest),
        _ => return None,
    };
    let triangles_of = |bytes: u64| chunk_bytes::triangles_of(bytes, regions, BYTES_OF_100_COARSE_TRIANGLES);
    let (triangles, max_triangles) = (triangles_of(bytes), triangles_of(final_bytes / MAX_DIVISOR));
    (triangles >= MIN_TRIANGLES).then_some(CoarserCut {
        triangles,
        max_triangles,
    })
}

#[cfg(test)]
mod tests {
    use super::{BYTES_OF_100_COARSE_TRIANGLES, BYTES_OF_100_TRIANGLES, chunk_bytes, next_coarser_cut};
    use crate::{CutId, Shown, Step};

    const REGIONS: u64 = 250;

    /// A step on a connection that sends `bytes` in 400 ms.
    fn step(bytes: u64, made_triangles: u64) -> Step {
        Step {
            shown: Shown::Cut(CutId::new(1)),
            target: None,
            made_triangles,
            fresh_triangles: u64::MAX,
            triangles: u64::MAX,
            bytes: u64::MAX,
            line_bytes: bytes,
        }
    }

    /// The triangles of all coarser cuts.
    fn all(bytes: u64, expected: u64) -> Vec<u64> {
        let next = |&made: &u64| Some(next_coarser_cut(step(bytes, made), REGIONS, expected)?.triangles);
        std::iter::successors(next(&0), next).collect()
    }

    #[test]
    fn a_connection_that_sends_the_surface_at_once_gets_it_in_one_step() {
        assert!(all(u64::MAX, 1_000_000).is_empty());
        assert!(all(20_000_000, 1_000_000).is_empty());
    }

    #[test]
    fn slower_connections_get_more_steps_and_few_superseded_bytes() {
        for (bytes, steps) in [(1_000_000, 1), (250_000, 1), (20_000, 2)] {
            let expected = 300_000;
            let found = all(bytes, expected);
            assert_eq!(found.len(), steps, "{bytes} bytes a step: {found:?}");
            let bytes = |&triangles: &u64| chunk_bytes::of_triangles(triangles, REGIONS, BYTES_OF_100_COARSE_TRIANGLES);
            let superseded: u64 = found.iter().map(bytes).sum();
            let whole = chunk_bytes::of_triangles(expected, REGIONS, BYTES_OF_100_TRIANGLES);
            assert!(superseded * 10 <= whole * 3, "{superseded} of {whole}: {found:?}");
        }
    }

    #[test]
    fn the_first_cut_is_on_the_line_for_a_short_time() {
        // 400 ms of 20 and 5 Mbit/s, and the longest time in ms. The coding for slow lines takes two thirds of the bytes.
        for (bytes, longest) in [(1_500_000, 30), (375_000, 60)] {
            let [first, ..] = all(bytes, 165_000)[..] else {
                panic!("one step at {bytes} bytes in 400 ms");
            };
            let time = chunk_bytes::of_triangles(first, REGIONS, BYTES_OF_100_COARSE_TRIANGLES) * 400 / bytes;
            assert!(time <= longest, "{first} triangles take {time} ms");
        }
    }

    #[test]
    fn no_coarser_cut_if_only_the_final_surface_may_be_shown_or_headers_dominate() {
        let alike = Step {
            shown: Shown::Alike,
            ..step(20_000, 0)
        };
        assert_eq!(next_coarser_cut(alike, REGIONS, 300_000), None);
        assert!(all(10_000, 10_000).is_empty());
        assert_eq!(next_coarser_cut(step(20_000, 0), 100_000, 300_000), None);
    }
}
