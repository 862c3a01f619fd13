//! Divides a budget among several surfaces.

use super::quality::{Budget, ShareBudget, TriangleBudget};

impl Budget {
    /// Returns the budget's part for a surface of `full` triangles, if all surfaces together have `all` triangles. The parts are in
    /// proportion to the triangles of the surfaces. Each part is at least 1; apart from that, their sum does not exceed the budget.
    #[must_use]
    pub fn part(self, full: u64, all: u64) -> Self {
        let portion = |whole: u64| ((u128::from(whole) * u128::from(full) / u128::from(all.max(1))) as u64).max(1);
        match self {
            Self::Bytes(bytes) => Self::Bytes(portion(bytes)),
            Self::Triangles(TriangleBudget::AtMost(triangles)) => {
                Self::Triangles(TriangleBudget::AtMost(portion(triangles)))
            }
            // Without a maximum, a share of all surfaces together is the same share of each surface.
            Self::Triangles(share @ TriangleBudget::Share(ShareBudget { max: None, .. })) => Self::Triangles(share),
            Self::Triangles(TriangleBudget::Share(whole @ ShareBudget { max: Some(max), .. })) => {
                let part = ShareBudget {
                    max: Some(portion(max)),
                    ..whole
                };
                let (whole, part) = (TriangleBudget::Share(whole), TriangleBudget::Share(part));
                let is_maximum_reached = part.of(full) < whole.of(full);
                Self::Triangles(if is_maximum_reached { part } else { whole })
            }
        }
    }

    /// Returns the budget less `reserved`, but at least 1. A share without a maximum is unchanged, because it is a share of each surface.
    #[must_use]
    pub fn without(self, reserved: u64) -> Self {
        let remaining = |whole: u64| whole.saturating_sub(reserved).max(1);
        match self {
            Self::Bytes(bytes) => Self::Bytes(remaining(bytes)),
            Self::Triangles(TriangleBudget::AtMost(triangles)) => {
                Self::Triangles(TriangleBudget::AtMost(remaining(triangles)))
            }
            Self::Triangles(TriangleBudget::Share(ShareBudget { share, max })) => {
                Self::Triangles(TriangleBudget::Share(ShareBudget {
                    share,
                    max: max.map(remaining),
                }))
            }
        }
    }

    /// Converts the budget to a number of triangles or bytes, for a full surface of `full` triangles.
    #[must_use]
    pub fn as_number(self, full: u64) -> Self {
        match self {
            Self::Triangles(budget) => Self::Triangles(TriangleBudget::AtMost(budget.of(full))),
            Self::Bytes(_) => self,
        }
    }

    /// Returns the minimum budget for several surfaces with which a surface of `full` triangles gets `part` triangles. `all`: triangles of
    /// all surfaces together.
    pub fn whole_of(part: u64, full: u64, all: u64) -> u64 {
        let whole = (u128::from(part) * u128::from(all)).div_ceil(u128::from(full.max(1)));
        u64::try_from(whole).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::{Budget, ShareBudget, TriangleBudget};

    #[test]
    fn parts_of_a_budget_are_in_proportion_and_never_above_it() {
        let number = |budget, full| match Budget::as_number(budget, full) {
            Budget::Triangles(TriangleBudget::AtMost(n)) | Budget::Bytes(n) => n,
            other @ Budget::Triangles(_) => panic!("{other:?}"),
        };
        let share = |share, max| Budget::Triangles(TriangleBudget::Share(ShareBudget { share, max }));
        for full in [
            [3, 5, 7, 11],
            [1000, 1, 0, 2],
            [900_000, 1_100_000, 40, 7],
            [u64::MAX / 8; 4],
        ] {
            let all: u64 = full.iter().sum();
            for budget in [
                Budget::Triangles(TriangleBudget::AtMost(100)),
                Budget::Bytes(1 << 40),
                share(0.3, Some(50)),
            ] {
                let parts = full.map(|full| number(budget.part(full, all), full));
                let small = parts.iter().filter(|&&part| part == 1).count() as u64;
                assert!(
                    parts.iter().sum::<u64>() <= number(budget, all) + small,
                    "{budget:?} of {full:?}: {parts:?}"
                );
            }
        }
        assert_eq!(Budget::Bytes(100).part(30, 90), Budget::Bytes(33));
        assert_eq!(
            share(0.25, Some(100)).part(300, 400),
            share(0.25, Some(100)),
            "the maximum is not reached"
        );
        assert_eq!(share(0.25, Some(100)).part(300, 600), share(0.25, Some(50)));
        assert_eq!(share(0.25, None).part(300, 600), share(0.25, None));
        assert_eq!(Budget::Bytes(100).without(30), Budget::Bytes(70));
        assert_eq!(share(0.25, Some(100)).without(100), share(0.25, Some(1)));
        assert_eq!(share(0.25, None).without(100), share(0.25, None));
        for (part, full, all) in [(10, 30, 90), (7, 3, 100), (1, 1, u64::MAX), (5, 0, 9)] {
            let whole = Budget::whole_of(part, full, all);
            let given = number(Budget::Bytes(whole).part(full, all), full);
            assert!(given >= part || full == 0, "{whole} for {part} of {full} in {all}");
        }
    }
}
