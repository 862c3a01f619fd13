//! Which prefixes of an edit are worth making. Pure.

use isopeel_kernels::Level;

/// Level of the first prefix: cubes of 16 cells, at most 8 in a region.
const FIRST: u8 = 4;
/// Level of the prefix between the first and the final surface.
const MIDDLE: u8 = 2;

/// Full-resolution triangles from which a middle prefix is made at all. Below, the final surface is there a few hundred
/// milliseconds after the first prefix, even on a CPU device.
const MIDDLE_FROM_TRIANGLES: u64 = 1_000_000;

/// Share of the final surface's triangles that a middle prefix may have; what it costs delays the final surface.
const MIDDLE_SHARE: f64 = 0.35;

/// What is known when the next prefix is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Known {
    /// The client shows a final surface of the same field, feature and isovalue. Only part of it may change; coarse
    /// prefixes would replace all of it twice.
    pub same_surface: bool,
    /// Full-resolution triangles, once a prefix of this edit was made.
    pub full_triangles: u64,
    /// Triangles of the middle prefix over those of the final surface, in the last edit that made both.
    pub middle_share: Option<f64>,
}

/// The prefix after `last`, coarse first; `None` after the final surface.
pub(super) fn next_prefix(last: Option<Level>, known: Known) -> Option<Level> {
    let level = match last.map(Level::get) {
        Some(0) => return None,
        None if !known.same_surface => FIRST,
        Some(level) if level > MIDDLE && middle_pays(known) => MIDDLE,
        None | Some(_) => 0,
    };
    // All constants above are levels that there are.
    Some(Level::new(level).unwrap_or(Level::FINEST))
}

/// Whether a level is that of a middle prefix.
pub(super) fn is_middle(level: Level) -> bool {
    level.get() == MIDDLE
}

fn middle_pays(known: Known) -> bool {
    known.full_triangles >= MIDDLE_FROM_TRIANGLES && known.middle_share.is_none_or(|share| share <= MIDDLE_SHARE)
}

#[cfg(test)]
mod tests {
    use super::{Known, next_prefix};

    fn prefixes(known: Known) -> Vec<u8> {
        let mut last = None;
        std::iter::from_fn(|| {
            last = next_prefix(last, known);
            last.map(|l| l.get())
        })
        .collect()
    }

    #[test]
    fn coarse_first_and_the_final_surface_last() {
        assert_eq!(prefixes(Known::default()), [4, 0]);
        let large = Known {
            full_triangles: 3_000_000,
            ..Known::default()
        };
        assert_eq!(prefixes(large), [4, 2, 0]);
    }

    #[test]
    fn a_change_of_the_shown_surface_goes_straight_to_it() {
        let same = Known {
            same_surface: true,
            full_triangles: 3_000_000,
            middle_share: Some(0.1),
        };
        assert_eq!(prefixes(same), [0]);
    }

    #[test]
    fn a_middle_prefix_that_costs_too_much_is_left_out() {
        let dear = Known {
            same_surface: false,
            full_triangles: 3_000_000,
            middle_share: Some(0.6),
        };
        assert_eq!(prefixes(dear), [4, 0]);
    }
}
