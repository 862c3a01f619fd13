//! Times of the steps of a volume: numbers of files, durations, or dates; and their labels.

mod calendar;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use calendar::{Calendar, Precision, Since};

/// Maximum steps whose labels are all sent and printed: some 20 kB.
pub const MAX_LABELS: u32 = 1024;

/// Largest deviation from even times, relative to their distance, that is taken for rounding.
const EVEN: f64 = 1e-6;

/// Longest unit that is shown, in characters.
const MAX_UNIT: usize = 24;

/// Times of the steps of a volume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeAxis {
    values: Values,
    meaning: Meaning,
    /// Distance of neighbours, from which the number of decimals follows.
    resolution: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Values {
    Even { start: f64, spacing: f64, steps: u32 },
    Listed(Arc<[f64]>),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Meaning {
    /// Numbers in the names of files, written with this many digits.
    Number(usize),
    /// Durations; the unit may be empty.
    Elapsed(String),
    Date(Since, Precision),
}

impl TimeAxis {
    /// Numbers of files, written with this many digits.
    pub fn numbers(numbers: &[u64], digits: usize) -> Option<Self> {
        let values = numbers.iter().map(|&number| number as f64).collect();
        Self::new(values, Meaning::Number(digits.min(MAX_UNIT)))
    }

    /// Steps at even distances. `None` if the numbers are no times: they must be finite, and the distance above 0.
    pub fn even(start: f64, spacing: f64, steps: u32, unit: &str) -> Option<Self> {
        let is_time = start.is_finite() && spacing.is_finite() && spacing > 0.0 && steps > 0;
        is_time.then(|| Self {
            values: Values::Even { start, spacing, steps },
            meaning: Meaning::Elapsed(symbol(unit)),
            resolution: spacing,
        })
    }

    /// Times in the order of the steps. A unit may contain a reference date (`days since 1850-01-01`), in a calendar of CF; any other unit
    /// is one of durations. `None` if the values are no times.
    pub fn listed(values: Vec<f64>, unit: &str, calendar: Option<&str>) -> Option<Self> {
        let since = Since::parse(unit, Calendar::named(calendar.unwrap_or_default()));
        let meaning = match since {
            Some(since) => {
                let precision = Precision::of(&since, &values);
                Meaning::Date(since, precision)
            }
            None => Meaning::Elapsed(symbol(unit.split(" since ").next().unwrap_or_default())),
        };
        Self::new(values, meaning)
    }

    fn new(values: Vec<f64>, meaning: Meaning) -> Option<Self> {
        let (&first, &last) = (values.first()?, values.last()?);
        let spacing = (last - first) / (values.len().max(2) - 1) as f64;
        let is_even = |(i, value): (usize, &f64)| (value - first - i as f64 * spacing).abs() <= EVEN * spacing.abs();
        let gaps = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let smallest = gaps.filter(|gap| *gap > 0.0).fold(f64::INFINITY, f64::min);
        let resolution = if smallest.is_finite() { smallest } else { first.abs() };
        let values = if spacing.is_finite() && values.iter().enumerate().all(is_even) {
            Values::Even {
                start: first,
                spacing,
                steps: u32::try_from(values.len()).ok()?,
            }
        } else {
            Values::Listed(values.into())
        };
        Some(Self {
            values,
            meaning,
            resolution,
        })
    }

    /// Number of steps.
    pub fn steps(&self) -> u32 {
        match &self.values {
            Values::Even { steps, .. } => *steps,
            Values::Listed(values) => u32::try_from(values.len()).unwrap_or(u32::MAX),
        }
    }

    /// Returns the time of a step in the axis' unit; `None` if there is no such step.
    pub fn value(&self, step: u32) -> Option<f64> {
        match &self.values {
            Values::Even { start, spacing, steps } => (step < *steps).then(|| start + f64::from(step) * spacing),
            Values::Listed(values) => values.get(step as usize).copied(),
        }
    }

    /// Returns the time between neighbours, if it is constant.
    pub fn spacing(&self) -> Option<f64> {
        match &self.values {
            Values::Even { spacing, .. } => Some(*spacing),
            Values::Listed(_) => None,
        }
    }

    /// Returns what values count: the symbol of a unit (`s`), or a reference date (`days since 1850-01-01`); `None` if that is not known.
    pub fn unit(&self) -> Option<String> {
        match &self.meaning {
            Meaning::Number(_) => None,
            Meaning::Elapsed(unit) => (!unit.is_empty()).then(|| unit.clone()),
            Meaning::Date(since, _) => Some(since.to_string()),
        }
    }

    /// Returns the name of the calendar of dates, as CF names it.
    pub fn calendar(&self) -> Option<&'static str> {
        match &self.meaning {
            Meaning::Date(since, _) => Some(since.calendar().name()),
            Meaning::Number(_) | Meaning::Elapsed(_) => None,
        }
    }

    /// Returns the label of a step for display: `1850-01-16`, `12.5 s`, `step 007`.
    pub fn label(&self, step: u32) -> String {
        let counted = || format!("step {step}");
        let Some(value) = self.value(step).filter(|value| value.is_finite()) else {
            return counted();
        };
        match &self.meaning {
            Meaning::Number(digits) => format!("step {value:0digits$.0}", digits = *digits),
            Meaning::Elapsed(unit) if unit.is_empty() => format!("t = {}", self.rounded(value)),
            Meaning::Elapsed(unit) => format!("{} {unit}", self.rounded(value)),
            Meaning::Date(since, precision) => since.label(value, *precision).unwrap_or_else(counted),
        }
    }

    /// Returns the label of each step, if there are at most [`MAX_LABELS`].
    pub fn labels(&self) -> Option<Vec<String>> {
        (self.steps() <= MAX_LABELS).then(|| (0..self.steps()).map(|step| self.label(step)).collect())
    }

    /// Returns times that are not even, if there are at most [`MAX_LABELS`].
    pub fn uneven_values(&self) -> Option<&[f64]> {
        match &self.values {
            Values::Listed(values) if self.steps() <= MAX_LABELS => Some(values),
            Values::Listed(_) | Values::Even { .. } => None,
        }
    }

    /// Formats a value to a thousandth of the distance between neighbours, with at most 9 decimals.
    fn rounded(&self, value: f64) -> String {
        if value != 0.0 && !(1e-6..1e12).contains(&value.abs()) {
            return format!("{value:.6e}");
        }
        let decimals = (3.0 - self.resolution.log10().floor()).clamp(0.0, 9.0) as usize;
        let text = format!("{value:.decimals$}");
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        }
    }
}

/// Returns a unit of time as it is shown.
fn symbol(unit: &str) -> String {
    let unit = unit.trim();
    match calendar::Unit::parse(unit) {
        Some(unit) => unit.symbol().to_owned(),
        None if unit == "1" => String::new(),
        None => unit.chars().filter(|c| !c.is_control()).take(MAX_UNIT).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_time() {
        let axis = TimeAxis::even(0.0, 0.1, 4, "sec").unwrap();
        assert_eq!(axis.labels().unwrap(), ["0 s", "0.1 s", "0.2 s", "0.3 s"]);
        assert_eq!((axis.unit().as_deref(), axis.calendar()), (Some("s"), None));
        let axis = TimeAxis::listed(vec![0.0, 12.5, 100.0], "", None).unwrap();
        assert_eq!(axis.labels().unwrap(), ["t = 0", "t = 12.5", "t = 100"]);
        assert_eq!(
            (axis.spacing(), axis.uneven_values()),
            (None, Some([0.0, 12.5, 100.0].as_slice()))
        );
        let axis = TimeAxis::listed(vec![1e-9, 2e-9], "furlongs", None).unwrap();
        assert_eq!(axis.label(1), "2.000000e-9 furlongs");
        assert!(TimeAxis::even(0.0, 0.0, 4, "s").is_none() && TimeAxis::even(f64::NAN, 1.0, 4, "s").is_none());
    }

    #[test]
    fn numbers_of_files_keep_their_zeros() {
        let axis = TimeAxis::numbers(&[7, 8, 12], 3).unwrap();
        assert_eq!(axis.labels().unwrap(), ["step 007", "step 008", "step 012"]);
    }

    #[test]
    fn times_that_are_none_are_counted() {
        let axis = TimeAxis::listed(vec![0.0, f64::NAN, 2.0], "s", None).unwrap();
        assert_eq!(axis.labels().unwrap(), ["0 s", "step 1", "2 s"]);
        assert_eq!(axis.label(9), "step 9");
        assert_eq!(TimeAxis::listed(Vec::new(), "s", None), None);
    }

    #[test]
    fn many_steps_are_not_listed() {
        let even = TimeAxis::even(0.0, 1.0, 1_000_000, "s").unwrap();
        assert_eq!((even.labels(), even.label(999_999)), (None, "999999 s".to_owned()));
        let uneven = TimeAxis::listed((0..5000).map(|i| f64::from(i * i)).collect(), "s", None).unwrap();
        assert_eq!((uneven.labels(), uneven.uneven_values()), (None, None));
    }

    #[test]
    fn dates() {
        let axis = TimeAxis::listed(vec![15.5, 45.0], "days since 1850-01-01", Some("noleap")).unwrap();
        assert_eq!(axis.labels().unwrap(), ["1850-01-16 12:00", "1850-02-15 00:00"]);
        assert_eq!(axis.unit().as_deref(), Some("days since 1850-01-01"));
        assert_eq!(axis.calendar(), Some("noleap"));
        let axis = TimeAxis::listed(vec![0.0, 31.0], "days since 2000-01-01 00:00:00", None).unwrap();
        assert_eq!(axis.labels().unwrap(), ["2000-01-01", "2000-02-01"]);
        // An invalid reference date: the unit is taken for one of durations.
        let axis = TimeAxis::listed(vec![0.0, 31.0], "days since the flood", None).unwrap();
        assert_eq!(axis.label(1), "31 d");
    }
}
