//! The option `--steps`.

use std::ops::RangeInclusive;
use std::str::FromStr;

/// A selection of time steps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Steps {
    /// All steps.
    All,
    /// The steps in these ranges.
    Ranges(Vec<RangeInclusive<u32>>),
}

impl FromStr for Steps {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.eq_ignore_ascii_case("all") {
            return Ok(Self::All);
        }
        let range = |part: &str| {
            let (first, last) = part.split_once("..").unwrap_or((part, part));
            let range = first.trim().parse().ok()?..=last.trim().parse().ok()?;
            (!range.is_empty()).then_some(range)
        };
        let ranges: Option<Vec<_>> = text.split(',').map(range).collect();
        let refused =
            || format!("{text:?}, expected all, or numbers and ranges from a lower to a higher one, such as 0,5..9");
        ranges.map(Self::Ranges).ok_or_else(refused)
    }
}

impl Steps {
    /// Returns the selected steps of a volume with `count` steps, in ascending order.
    pub(super) fn of(&self, count: u32) -> Vec<u32> {
        let is_selected = |step: &u32| match self {
            Self::All => true,
            Self::Ranges(ranges) => ranges.iter().any(|range| range.contains(step)),
        };
        (0..count).filter(is_selected).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_all_or_numbers_and_ranges() {
        let of = |text: &str| text.parse::<Steps>().unwrap().of(8);
        assert_eq!(of("all"), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(of("5, 0..2,1"), [0, 1, 2, 5]);
        assert_eq!(of("6..20"), [6, 7]);
        for text in ["", "x", "3..1", "-1", "1..", "1,,2"] {
            let refused = text.parse::<Steps>().unwrap_err();
            assert!(
                refused.contains("expected all, or numbers and ranges"),
                "{text}: {refused}"
            );
        }
    }
}
