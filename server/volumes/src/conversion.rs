//! Converts stored numbers to the types of the device, and records what is lost.
//!
//! Numbers of 32 and 64 bits become 32-bit floats, which hold whole numbers up to 2²⁴. If different labels above that would become equal,
//! the field is read again and its values become ranks, in the order of the numbers ([`LabelRanks`]). Other numbers are rounded, with a
//! notice.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use super::findings::{LabelRanks, merging_steps};
use super::scalar::Scalar;
use super::{Findings, ReadError, Sink};

/// 32-bit floats hold every whole number up to this one.
const EXACT: i128 = 1 << 24;
/// Maximum different numbers above [`EXACT`] that are compared. Fields with more are not taken for labels.
const MAX_LARGE: usize = 1 << 16;
/// Maximum labels that get ranks.
const MAX_RANKS: usize = 1 << 20;
/// Rounding that is worth a notice, relative to the range of values: half a bin of a histogram is 2,000 times that.
const ROUNDING: f64 = 1e-6;

/// Computes the values of a row from its stored numbers, which the first argument returns by their indices.
pub(super) type ConvertRow<'a, S, T> = dyn Fn(&dyn Fn(usize) -> S, &mut [T]) + 'a;

impl Findings {
    /// Reads one of `steps` time steps with `read`, which hands samples to the sink, and evaluates the losses of the conversion. Reads
    /// twice if labels need ranks.
    ///
    /// # Errors
    /// Errors of `read`; [`ReadError::again`] if all samples must be read again because labels need ranks; labels that need ranks in a file
    /// of several time steps.
    pub(super) fn read(
        &self,
        (path, steps): (&Path, u32),
        sink: &mut Sink<'_>,
        mut read: impl FnMut(&Conversion, &mut Sink<'_>) -> Result<(), ReadError>,
    ) -> Result<(), ReadError> {
        if self.needs_ranks() {
            let survey = Conversion {
                survey: Some(Mutex::default()),
                ..Conversion::default()
            };
            read(&survey, &mut |_| Ok(()))?;
            self.set_ranks(path, survey.into_ranks(path, self.missing())?);
        }
        let conversion = Conversion {
            ranks: self.ranks(),
            ..Conversion::default()
        };
        read(&conversion, sink)?;
        let losses = conversion.losses.into_inner().unwrap_or_else(PoisonError::into_inner);
        if losses.merge_labels() {
            if steps > 1 {
                return Err(merging_steps(path));
            }
            self.ask_for_ranks();
            return Err(ReadError {
                can_retry: true,
                ..ReadError::new(path, "data", "its labels need ranks, expected to be read once more")
            });
        }
        losses.notices().into_iter().for_each(|text| self.report(path, text));
        Ok(())
    }
}

/// Converts the numbers of one reading to 32-bit floats.
#[derive(Debug, Default)]
pub struct Conversion {
    ranks: Option<Arc<LabelRanks>>,
    /// Collects all whole numbers, to rank them later.
    survey: Option<Mutex<BTreeSet<i128>>>,
    losses: Mutex<Losses>,
}

impl Conversion {
    /// Converts numbers as they are stored.
    pub(super) fn convert<S: Scalar>(&self, stored: impl Fn(usize) -> S, values: &mut [f32]) {
        if let Some(ranks) = &self.ranks {
            let mut last: Option<(i128, f32)> = None;
            for (i, value) in values.iter_mut().enumerate() {
                *value = match (stored(i).integer(), last) {
                    (None, _) => f32::NAN,
                    (Some(number), Some((before, rank))) if before == number => rank,
                    (Some(number), _) => {
                        let rank = ranks.position(number);
                        last = Some((number, rank));
                        rank
                    }
                };
            }
            return;
        }
        if let Some(survey) = &self.survey {
            return collect(stored, values.len(), survey);
        }
        for (i, value) in values.iter_mut().enumerate() {
            *value = stored(i).to_f32();
        }
        let is_lossy = S::IS_WIDE && (S::IS_FLOAT || (0..values.len()).any(|i| stored(i).is_large()));
        if is_lossy {
            let mut losses = Losses::default();
            losses.compare(&stored, values);
            self.add(losses);
        }
    }

    /// Converts numbers that are computed from stored ones.
    pub(super) fn convert_computed(&self, computed: impl Fn(usize) -> f64, values: &mut [f32]) {
        let mut losses = Losses::default();
        for (i, value) in values.iter_mut().enumerate() {
            let exact = computed(i);
            *value = exact as f32;
            losses.round(exact, *value);
        }
        losses.samples = values.len() as u64;
        self.add(losses);
    }

    fn add(&self, losses: Losses) {
        self.losses.lock().unwrap_or_else(PoisonError::into_inner).add(losses);
    }

    fn into_ranks(self, path: &Path, missing: Option<f32>) -> Result<LabelRanks, ReadError> {
        let numbers = self
            .survey
            .map(|survey| survey.into_inner().unwrap_or_else(PoisonError::into_inner));
        let numbers = numbers.unwrap_or_default();
        if numbers.len() > MAX_RANKS {
            let why = format!(
                "more than {MAX_RANKS} labels, some of which 32-bit floats do not tell apart; expected fewer, or numbers below {EXACT}"
            );
            return Err(ReadError::new(path, "data", why));
        }
        Ok(LabelRanks::new(numbers, missing))
    }
}

fn collect<S: Scalar>(stored: impl Fn(usize) -> S, count: usize, survey: &Mutex<BTreeSet<i128>>) {
    let (mut found, mut last) = (BTreeSet::new(), None);
    for i in 0..count {
        let number = stored(i).integer();
        if number != last {
            found.extend(number);
            last = number;
        }
    }
    let mut survey = survey.lock().unwrap_or_else(PoisonError::into_inner);
    // One more than there may be says that there are too many.
    for number in found {
        if survey.len() <= MAX_RANKS {
            survey.insert(number);
        }
    }
}

/// What 32-bit floats do not hold of some numbers.
#[derive(Debug)]
struct Losses {
    samples: u64,
    /// Minimum and maximum of the finite numbers.
    range: [f64; 2],
    /// Largest difference to a rounded number.
    error: f64,
    /// Finite numbers beyond the largest float.
    overflows: u64,
    /// Whole numbers above [`EXACT`] that are rounded, and how many of them are equal to the sample before.
    inexact: u64,
    repeated: u64,
    /// A number for each float above [`EXACT`], and whether there were two for one.
    large: HashMap<u32, i128>,
    merges: bool,
    /// Whether there are numbers that are not whole.
    has_fractions: bool,
}

impl Default for Losses {
    fn default() -> Self {
        Self {
            samples: 0,
            range: [f64::INFINITY, f64::NEG_INFINITY],
            error: 0.0,
            overflows: 0,
            inexact: 0,
            repeated: 0,
            large: HashMap::new(),
            merges: false,
            has_fractions: false,
        }
    }
}

impl Losses {
    fn round(&mut self, exact: f64, value: f32) {
        if !exact.is_finite() {
        } else if !value.is_finite() {
            self.overflows += 1;
        } else {
            self.range = [self.range[0].min(exact), self.range[1].max(exact)];
            self.error = self.error.max((exact - f64::from(value)).abs());
        }
    }

    fn compare<S: Scalar>(&mut self, stored: &impl Fn(usize) -> S, values: &[f32]) {
        self.samples += values.len() as u64;
        let mut last = None;
        for (i, &value) in values.iter().enumerate() {
            let number = stored(i);
            self.round(number.to_f64(), value);
            let is_large = number.is_large();
            if S::IS_FLOAT && number.integer().is_none() && number.to_f64().is_finite() {
                self.has_fractions = true;
            }
            let number = if is_large { number.integer() } else { None };
            let Some(exact) = number else {
                last = None;
                continue;
            };
            let is_repeated = last == number;
            last = number;
            let difference = exact - value as i128;
            if difference != 0 {
                self.inexact += 1;
                self.repeated += u64::from(is_repeated);
                self.error = self.error.max(difference.abs() as f64);
            }
            if !is_repeated {
                self.remember(value.to_bits(), exact);
            }
        }
    }

    fn remember(&mut self, bits: u32, exact: i128) {
        if self.large.len() < MAX_LARGE || self.large.contains_key(&bits) {
            self.merges |= *self.large.entry(bits).or_insert(exact) != exact;
        }
    }

    fn add(&mut self, other: Self) {
        self.samples += other.samples;
        self.range = [self.range[0].min(other.range[0]), self.range[1].max(other.range[1])];
        self.error = self.error.max(other.error);
        self.overflows += other.overflows;
        self.inexact += other.inexact;
        self.repeated += other.repeated;
        self.merges |= other.merges;
        self.has_fractions |= other.has_fractions;
        for (bits, exact) in other.large {
            self.remember(bits, exact);
        }
    }

    /// Whether different labels have become one. Labels are whole numbers of which most are equal to their neighbour, and which are few.
    fn merge_labels(&self) -> bool {
        self.merges && !self.has_fractions && 2 * self.repeated >= self.inexact && self.large.len() < MAX_LARGE
    }

    fn notices(&self) -> Vec<String> {
        let mut notices = Vec::new();
        if self.overflows > 0 {
            notices.push(format!(
                "{} samples are beyond ±3.4e38, the largest number of the device's 32-bit floats, and count as not finite: scale them, for \
                 example divide by 1e10, when they are written",
                self.overflows
            ));
        }
        let [low, high] = self.range;
        let is_rounded = self.error > ROUNDING * (high - low) && high > low;
        if self.inexact > 0 || is_rounded {
            let error = self.error;
            let which = if self.inexact > 0 {
                format!("{} whole numbers above 16777216", self.inexact)
            } else {
                format!("samples from {low} to {high}")
            };
            notices.push(format!("{which} are rounded to 32-bit floats, by {error:.3e} at most"));
        }
        notices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LABEL: i128 = 1 << 24;

    /// Reads some numbers, once more if that is wanted.
    fn read<S: Scalar>(findings: &Findings, numbers: &[S], steps: u32) -> Result<Vec<f32>, ReadError> {
        let path = Path::new("labels");
        let mut got = Vec::new();
        for _ in 0..2 {
            let mut sink = |samples| {
                let isopeel_kernels::Samples::F32(values) = samples else {
                    unreachable!("floats")
                };
                got = values;
                Ok(())
            };
            let outcome = findings.read((path, steps), &mut sink, |conversion, sink| {
                let mut values = vec![0.0; numbers.len()];
                conversion.convert(|i| numbers[i], &mut values);
                sink(isopeel_kernels::Samples::F32(values))
            });
            match outcome {
                Err(error) if error.can_retry => {}
                other => return other.map(|()| got),
            }
        }
        panic!("read twice, and once more");
    }

    fn labels<S: Scalar>(of: fn(i128) -> S) {
        let findings = Findings::default();
        let numbers = [0, 0, LABEL, LABEL, LABEL, LABEL + 1, LABEL + 1, LABEL + 1, LABEL + 1, 0].map(of);
        let values = read(&findings, &numbers, 1).unwrap();
        assert_eq!(values, [0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 0.0]);
        let ranks = findings.ranks().expect("ranks");
        assert_eq!(
            [LABEL, LABEL + 1, LABEL + 2, 0, 5].map(|n| ranks.position(n)),
            [1.0, 2.0, 2.5, 0.0, 0.5]
        );
        assert!(
            findings
                .notices()
                .text()
                .unwrap()
                .contains("16777216 and 16777217 are 1 and 2")
        );
        // As it is read from then on.
        assert_eq!(read(&findings, &numbers, 1).unwrap()[5], 2.0);
        assert!(
            read(&Findings::default(), &numbers, 2)
                .unwrap_err()
                .why
                .contains("several time steps")
        );
    }

    #[test]
    fn labels_never_merge() {
        labels(|n| n as i32);
        labels(|n| n as u32);
        labels(|n| n as i64);
        labels(|n| n as u64);
        labels(|n| n as f64);
    }

    #[test]
    fn other_numbers_are_rounded_with_a_notice() {
        // Neighbours differ: no labels.
        let findings = Findings::default();
        let numbers: Vec<i32> = (0..2000).map(|i| (1 << 24) + (i * 7919) % 4001).collect();
        let values = read(&findings, &numbers, 1).unwrap();
        assert_eq!(values[1], numbers[1] as f32);
        let text = findings.notices().text().unwrap();
        assert!(text.contains("whole numbers above 16777216 are rounded"), "{text}");
        // Not all are whole.
        let findings = Findings::default();
        read(
            &findings,
            &[0.5, 16_777_216.0, 16_777_217.0, 16_777_217.0, 16_777_217.0],
            1,
        )
        .unwrap();
        assert!(findings.ranks().is_none() && !findings.notices().is_empty());
        // Nothing is lost, and nothing is said.
        let findings = Findings::default();
        read(&findings, &[0u64, 7, 1 << 24, 1 << 40], 1).unwrap();
        read(&findings, &[0.1f64, 0.2, -3.5], 1).unwrap();
        read(&findings, &[f64::NAN, f64::INFINITY, 1.0], 1).unwrap();
        assert!(findings.notices().is_empty(), "{:?}", findings.notices());
    }

    #[test]
    fn doubles_beyond_floats_are_named() {
        let findings = Findings::default();
        let values = read(&findings, &[1e41f64, -1e39, 2.0], 1).unwrap();
        assert!(values[0].is_infinite());
        assert!(findings.notices().text().unwrap().starts_with("2 samples are beyond"));
        // Small differences of large numbers.
        let findings = Findings::default();
        read(&findings, &[1e9 + 0.25, 1e9 + 0.5, 1e9 + 0.75], 1).unwrap();
        assert!(
            findings
                .notices()
                .text()
                .unwrap()
                .contains("rounded to 32-bit floats, by")
        );
    }
}
