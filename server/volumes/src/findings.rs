//! What reading samples finds: values that the device's type cannot hold, labels that would merge, minor defects of files.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Notices, ReadError};

/// What has been found in a field's samples so far. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Findings(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    notices: Notices,
    needs_ranks: bool,
    ranks: Option<Arc<LabelRanks>>,
    /// The field's value for a sample that is missing.
    missing: Option<f32>,
}

impl Findings {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a notice, and writes it to the log the first time.
    pub(super) fn report(&self, path: &Path, text: impl Into<String>) {
        let notice = Notices::of(text);
        let mut state = self.state();
        let before = state.notices.clone();
        state.notices.extend(notice.clone());
        if state.notices != before {
            notice.log(path);
        }
    }

    /// Returns new findings for another field, with the notices so far, which apply to it as well.
    pub(super) fn of_another_field(&self) -> Self {
        let notices = self.notices();
        Self(Arc::new(Mutex::new(State {
            notices,
            ..State::default()
        })))
    }

    /// Returns the notices so far.
    pub(super) fn notices(&self) -> Notices {
        self.state().notices.clone()
    }

    /// Whether labels need ranks that are not known yet.
    pub(super) fn needs_ranks(&self) -> bool {
        let state = self.state();
        state.needs_ranks && state.ranks.is_none()
    }

    /// Records that the samples must be read again with ranks for labels.
    pub(super) fn ask_for_ranks(&self) {
        self.state().needs_ranks = true;
    }

    /// Sets the value of missing samples: it is no label.
    pub(super) fn set_missing(&self, missing: Option<f32>) {
        self.state().missing = missing;
    }

    pub(super) fn missing(&self) -> Option<f32> {
        self.state().missing
    }

    pub(super) fn set_ranks(&self, path: &Path, ranks: LabelRanks) {
        self.report(path, ranks.notice());
        self.state().ranks = Some(Arc::new(ranks));
    }

    /// Returns the labels and their ranks, if the field has ranks.
    pub(super) fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.state().ranks.clone()
    }
}

/// The error for labels in several time steps that need ranks: the ranks would differ from step to step.
pub(super) fn merging_steps(path: &Path) -> ReadError {
    let why = "labels above 16777216 that 32-bit floats do not tell apart, in several time steps: expected one step, or labels that are \
               numbered anew";
    ReadError::new(path, "data", why)
}

/// Ranks of labels, ordered by their numbers: 0 stays 0, labels above 0 are 1, 2, 3, …, those below are −1, −2, ….
#[derive(Debug, PartialEq, Eq)]
pub struct LabelRanks {
    values: Vec<i128>,
    /// Index of 0 in `values`; if 0 is not in it, the index at which it would be inserted, less one.
    zero: i64,
    has_zero: bool,
    /// The number that means a missing sample.
    missing: Option<i128>,
}

impl Serialize for LabelRanks {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (&self.values, self.missing).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for LabelRanks {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (values, missing) = <(Vec<i128>, Option<i128>)>::deserialize(deserializer)?;
        if values.is_empty() || !values.is_sorted_by(|a, b| a < b) {
            return Err(serde::de::Error::custom("labels that do not ascend"));
        }
        Ok(Self::ordered(values, missing))
    }
}

impl LabelRanks {
    /// Ranks all `values`, except the one that equals the value `missing` as a float.
    pub(super) fn new(mut values: BTreeSet<i128>, missing: Option<f32>) -> Self {
        let mut same = values.iter().copied().filter(|number| Some(*number as f32) == missing);
        // If several equal it, the float does not tell which one is meant.
        let missing = same.next().filter(|_| same.next().is_none());
        if let Some(missing) = missing {
            values.remove(&missing);
        }
        Self::ordered(values.into_iter().collect(), missing)
    }

    /// Ranks values that ascend.
    fn ordered(values: Vec<i128>, missing: Option<i128>) -> Self {
        let (zero, has_zero) = match values.binary_search(&0) {
            Ok(at) => (at as i64, true),
            Err(at) => (at as i64 - 1, false),
        };
        Self {
            values,
            zero,
            has_zero,
            missing,
        }
    }

    fn rank_at(&self, index: usize) -> f32 {
        let rank = index as i64 - self.zero;
        // Without a label 0 there is no rank 0: negative labels move down by one.
        let is_below = self.values[index] < 0 && !self.has_zero;
        (if is_below { rank - 1 } else { rank }) as f32
    }

    /// Returns the rank of a label. For a number that is no label: half a rank beside its neighbour. For the missing value: NaN.
    pub fn position(&self, number: i128) -> f32 {
        if self.missing == Some(number) {
            return f32::NAN;
        }
        match self.values.binary_search(&number) {
            Ok(at) => self.rank_at(at),
            Err(0) => self.rank_at(0) - 0.5,
            Err(at) => self.rank_at(at - 1) + 0.5,
        }
    }

    /// Returns the labels with their ranks, ascending.
    pub fn iter(&self) -> impl Iterator<Item = (f32, i128)> + '_ {
        (0..self.values.len()).map(|at| (self.rank_at(at), self.values[at]))
    }

    fn notice(&self) -> String {
        let large = self.values.iter().rev().take(2).rev().map(ToString::to_string);
        format!(
            "labels are shown by their rank among the {} there are, in the order of their numbers (0 stays 0), as 32-bit floats do not tell all \
             apart: {} are {}; conditions such as `labels == {}` take the numbers of the file",
            self.values.len(),
            large.collect::<Vec<_>>().join(" and "),
            self.iter()
                .skip(self.values.len().saturating_sub(2))
                .map(|(rank, _)| rank.to_string())
                .collect::<Vec<_>>()
                .join(" and "),
            self.values.last().copied().unwrap_or_default()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LABEL: i128 = 1 << 24;

    #[test]
    fn ranks_are_in_the_order_of_the_numbers() {
        let of = |numbers: &[i128]| LabelRanks::new(numbers.iter().copied().collect(), None);
        let ranks = of(&[-LABEL * 8, -7, 3, 1 << 63]);
        assert_eq!(
            [-LABEL * 8, -7, 3, 1 << 63].map(|n| ranks.position(n)),
            [-2.0, -1.0, 1.0, 2.0]
        );
        let ranks = of(&[-7, 0, 3]);
        assert_eq!([-7, 0, 3].map(|n| ranks.position(n)), [-1.0, 0.0, 1.0]);
        assert_eq!(of(&[5]).position(1), 0.5);
    }

    #[test]
    fn the_missing_number_is_no_label() {
        let numbers = [0, 7, LABEL + 1, (1 << 31) - 1];
        let ranks = LabelRanks::new(numbers.into(), Some(2_147_483_648.0));
        assert!(ranks.position((1 << 31) - 1).is_nan());
        assert_eq!(ranks.iter().collect::<Vec<_>>(), [(0.0, 0), (1.0, 7), (2.0, LABEL + 1)]);
    }
}
