//! Units of time since a date, in the calendars of CF (<https://cfconventions.org>, section 4.4).

use std::fmt;

use isopeel_kernels::interned::{self, StaticText};
use serde::{Deserialize, Serialize};

const DAY_MS: i64 = 86_400_000;

/// Maximum days around the epoch that are converted to dates: some ten million years.
const MAX_DAYS: f64 = 4e9;

/// Days before each month of a year that is no leap year.
const DAYS_BEFORE: [i64; 13] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334, 365];

/// First day of the Gregorian calendar, 15 October 1582, as [`Calendar::days`] of the proleptic one counts.
const FIRST_GREGORIAN: i64 = -141_427;

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// `ms` / `parts` milliseconds.
    Exact {
        #[serde(deserialize_with = "interned::deserialize")]
        symbol: StaticText,
        ms: i64,
        parts: i64,
    },
    /// Calendar months, twelve of which are a year.
    Months {
        #[serde(deserialize_with = "interned::deserialize")]
        symbol: StaticText,
        count: i64,
    },
}

impl Unit {
    /// A unit by its name or symbol, in the singular or plural.
    pub fn parse(text: &str) -> Option<Self> {
        let word = text.trim().to_lowercase();
        let exact = |symbol, ms, parts| Some(Self::Exact { symbol, ms, parts });
        match word.strip_suffix('s').filter(|one| one.len() > 1).unwrap_or(&word) {
            "ns" | "nsec" | "nanosec" | "nanosecond" => exact("ns", 1, 1_000_000),
            "us" | "µs" | "μs" | "usec" | "microsec" | "microsecond" => exact("µs", 1, 1000),
            "ms" | "msec" | "millisec" | "millisecond" => exact("ms", 1, 1),
            "s" | "sec" | "second" => exact("s", 1000, 1),
            "min" | "minute" => exact("min", 60_000, 1),
            "h" | "hr" | "hour" => exact("h", 3_600_000, 1),
            "d" | "day" => exact("d", DAY_MS, 1),
            "week" => exact("weeks", 7 * DAY_MS, 1),
            "month" | "mon" => Some(Self::Months {
                symbol: "months",
                count: 1,
            }),
            "year" | "yr" | "a" => Some(Self::Months {
                symbol: "years",
                count: 12,
            }),
            // `ns`, `us`, `ms` without their last letter.
            "n" | "u" | "µ" | "m" if word.ends_with('s') => Self::parse(&format!("{word}ec")),
            _ => None,
        }
    }

    /// Returns the symbol that is shown behind a number.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Exact { symbol, .. } | Self::Months { symbol, .. } => symbol,
        }
    }
}

/// Rules for the lengths of years and months.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Calendar {
    /// Gregorian since 15 October 1582, Julian before.
    Standard,
    ProlepticGregorian,
    Julian,
    NoLeap,
    AllLeap,
    Days360,
    /// No dates: times are only durations.
    None,
}

impl Calendar {
    /// Returns a calendar by its name in CF; the standard one if the name is empty, [`Self::None`] if it is unknown.
    pub fn named(name: &str) -> Self {
        match name.trim().to_ascii_lowercase().as_str() {
            "" | "standard" | "gregorian" => Self::Standard,
            "proleptic_gregorian" => Self::ProlepticGregorian,
            "julian" => Self::Julian,
            "noleap" | "365_day" => Self::NoLeap,
            "all_leap" | "366_day" => Self::AllLeap,
            "360_day" => Self::Days360,
            _ => Self::None,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::ProlepticGregorian => "proleptic_gregorian",
            Self::Julian => "julian",
            Self::NoLeap => "noleap",
            Self::AllLeap => "all_leap",
            Self::Days360 => "360_day",
            Self::None => "none",
        }
    }

    /// Returns the days from the calendar's own epoch to a date. The Gregorian and Julian calendars share an epoch, 1 January 1970 of the
    /// Gregorian calendar.
    fn days(self, [year, month, day]: [i64; 3]) -> i64 {
        match self {
            Self::Days360 => year * 360 + (month - 1) * 30 + day - 1,
            Self::NoLeap | Self::None => year * 365 + DAYS_BEFORE[month as usize - 1] + day - 1,
            Self::AllLeap => year * 366 + DAYS_BEFORE[month as usize - 1] + i64::from(month > 2) + day - 1,
            Self::ProlepticGregorian => {
                let from_march = year - i64::from(month < 3);
                marched(year, month, day) - from_march.div_euclid(100) + from_march.div_euclid(400) - 719_468
            }
            Self::Julian => marched(year, month, day) - 719_470,
            Self::Standard => {
                let days = Self::ProlepticGregorian.days([year, month, day]);
                if [year, month, day] >= [1582, 10, 15] {
                    days
                } else {
                    Self::Julian.days([year, month, day])
                }
            }
        }
    }

    /// Returns the date of a day: the inverse of [`Self::days`].
    fn date(self, days: i64) -> [i64; 3] {
        let within = |year: i64, day: i64, leap: bool| {
            let before = |month: i64| DAYS_BEFORE[month as usize] + i64::from(leap && month >= 2);
            let month = (1..=12).find(|&month| day < before(month)).unwrap_or(12);
            [year, month, day - before(month - 1) + 1]
        };
        match self {
            Self::Days360 => [
                days.div_euclid(360),
                days.rem_euclid(360) / 30 + 1,
                days.rem_euclid(30) + 1,
            ],
            Self::NoLeap | Self::None => within(days.div_euclid(365), days.rem_euclid(365), false),
            Self::AllLeap => within(days.div_euclid(366), days.rem_euclid(366), true),
            Self::Standard if days < FIRST_GREGORIAN => Self::Julian.date(days),
            Self::Standard | Self::ProlepticGregorian | Self::Julian => {
                let calendar = if self == Self::Julian {
                    self
                } else {
                    Self::ProlepticGregorian
                };
                // A year that begins no later than the day; mostly the right one.
                let mut year = 1970 + (days as f64 / 365.2425).floor() as i64 - 1;
                year -= (calendar.days([year, 1, 1]) - days).max(0) / 365 + 1;
                while calendar.days([year + 1, 1, 1]) <= days {
                    year += 1;
                }
                let first = calendar.days([year, 1, 1]);
                let leap = calendar.days([year + 1, 1, 1]) - first == 366;
                within(year, days - first, leap)
            }
        }
    }

    fn month_days(self, [year, month]: [i64; 2]) -> i64 {
        let next = if month == 12 {
            [year + 1, 1, 1]
        } else {
            [year, month + 1, 1]
        };
        self.days(next) - self.days([year, month, 1])
    }
}

/// Days of the Julian calendar from 1 March of year 0.
fn marched(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month < 3 {
        (year - 1, month + 9)
    } else {
        (year, month - 3)
    };
    365 * year + year.div_euclid(4) + (153 * month + 2) / 5 + day - 1
}

/// A unit of time since a point in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Since {
    unit: Unit,
    /// Year, month, day.
    date: [i64; 3],
    /// Milliseconds of the day, in UTC.
    ms: i64,
    calendar: Calendar,
}

/// Precision with which times are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Precision {
    Day,
    Minute,
    Second,
    Millisecond,
}

impl Precision {
    /// Returns the precision that these times need.
    pub fn of(since: &Since, values: &[f64]) -> Self {
        let of = |ms: i64| match ms {
            ms if ms % DAY_MS == 0 => Self::Day,
            ms if ms % 60_000 == 0 => Self::Minute,
            ms if ms % 1000 == 0 => Self::Second,
            _ => Self::Millisecond,
        };
        let times = values.iter().filter_map(|&value| since.point(value));
        times.map(|(_, ms)| of(ms)).max().unwrap_or(Self::Day)
    }
}

impl Since {
    /// Parses a text such as `days since 1850-01-01 12:00:00 +1:00`; `None` for any other text, and if the calendar has no dates.
    pub fn parse(text: &str, calendar: Calendar) -> Option<Self> {
        let (unit, rest) = text.trim().split_once(" since ")?;
        let rest = rest.trim();
        // A space or a T separates date and time.
        let (day, rest) = rest.split_at(rest.find([' ', 'T']).unwrap_or(rest.len()));
        let date = date(day, calendar)?;
        let mut words = rest.strip_prefix('T').unwrap_or(rest).split_whitespace();
        let clock = words.next().unwrap_or("0");
        // A zone may follow the time directly, as in 00:00:00Z or 00:00+01:00.
        let at = clock.find(['Z', '+', '-']).unwrap_or(clock.len());
        let (clock, zone) = clock.split_at(at);
        let zone = [zone, words.next().unwrap_or_default()].concat();
        let since = Self {
            unit: Unit::parse(unit)?,
            date,
            ms: clock_ms(clock)? - zone_ms(&zone)?,
            calendar,
        };
        (calendar != Calendar::None && words.next().is_none()).then_some(since)
    }

    pub fn calendar(&self) -> Calendar {
        self.calendar
    }

    /// Returns the days and the milliseconds of the day of a value; `None` for values out of range.
    fn point(&self, value: f64) -> Option<(i64, i64)> {
        let epoch = self.calendar.days(self.date);
        let (days, ms) = match self.unit {
            Unit::Exact { ms, parts, .. } => {
                let ms = value * (ms as f64) / (parts as f64);
                if ms.is_nan() || ms.abs() > MAX_DAYS * DAY_MS as f64 {
                    return None;
                }
                (epoch, ms.round() as i64)
            }
            Unit::Months { count, .. } => {
                let months = value * count as f64;
                if months.is_nan() || months.abs() > MAX_DAYS / 31.0 {
                    return None;
                }
                let whole = months.floor() as i64;
                let month = self.date[0] * 12 + self.date[1] - 1 + whole;
                let month = [month.div_euclid(12), month.rem_euclid(12) + 1];
                let length = self.calendar.month_days(month);
                let part = ((months - whole as f64) * (length * DAY_MS) as f64).round() as i64;
                (self.calendar.days([month[0], month[1], self.date[2].min(length)]), part)
            }
        };
        let ms = ms + self.ms;
        Some((days + ms.div_euclid(DAY_MS), ms.rem_euclid(DAY_MS)))
    }

    /// Returns a value as a date for display: `1850-01-16`, `1850-01-16 12:00`.
    pub fn label(&self, value: f64, precision: Precision) -> Option<String> {
        let (days, ms) = self.point(value)?;
        let [year, month, day] = self.calendar.date(days);
        let sign = if year < 0 { "-" } else { "" };
        let date = format!("{sign}{:04}-{month:02}-{day:02}", year.abs());
        let (hour, minute, second) = (ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60);
        Some(match precision {
            Precision::Day => date,
            Precision::Minute => format!("{date} {hour:02}:{minute:02}"),
            Precision::Second => format!("{date} {hour:02}:{minute:02}:{second:02}"),
            Precision::Millisecond => format!("{date} {hour:02}:{minute:02}:{second:02}.{:03}", ms % 1000),
        })
    }
}

impl fmt::Display for Since {
    /// In UTC.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = match self.unit.symbol() {
            "d" => "days",
            "h" => "hours",
            "min" => "minutes",
            "s" => "seconds",
            other => other,
        };
        let days = self.calendar.days(self.date) + self.ms.div_euclid(DAY_MS);
        let [year, month, day] = self.calendar.date(days);
        write!(out, "{unit} since {year:04}-{month:02}-{day:02}")?;
        match self.ms.rem_euclid(DAY_MS) {
            0 => Ok(()),
            ms => write!(
                out,
                " {:02}:{:02}:{:02}",
                ms / 3_600_000,
                ms / 60_000 % 60,
                ms / 1000 % 60
            ),
        }
    }
}

/// Parses a date that exists in the calendar.
fn date(text: &str, calendar: Calendar) -> Option<[i64; 3]> {
    let (sign, text) = match text.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, text),
    };
    let mut parts = text
        .split('-')
        .map(|part| part.parse::<u32>().ok().filter(|&n| n <= 9_999_999));
    let year = sign * i64::from(parts.next()??);
    let mut next = || parts.next().map_or(Some(1), |part| part.map(i64::from));
    let (month, day) = (next()?, next()?);
    let fits =
        (1..=12).contains(&month) && day >= 1 && day <= calendar.month_days([year, month]) && parts.next().is_none();
    fits.then_some([year, month, day])
}

/// Parses a time such as `12:30:15.5` into milliseconds.
fn clock_ms(text: &str) -> Option<i64> {
    let mut parts = text
        .split(':')
        .map(|part| part.parse::<f64>().ok().filter(|n| (0.0..=60.0).contains(n)));
    let hours = parts.next()??;
    let mut next = || parts.next().unwrap_or(Some(0.0));
    let (minutes, seconds) = (next()?, next()?);
    parts
        .next()
        .is_none()
        .then(|| (((hours * 60.0 + minutes) * 60.0 + seconds) * 1000.0).round() as i64)
}

/// Parses a time zone, `Z`, `UTC`, `+01:00`, `-6` or `+0130`, into milliseconds before UTC; 0 for the empty text.
fn zone_ms(text: &str) -> Option<i64> {
    let (sign, text) = match text.as_bytes() {
        [] | b"Z" | b"UTC" | b"GMT" => return Some(0),
        [b'+', ..] => (1, &text[1..]),
        [b'-', ..] => (-1, &text[1..]),
        _ => return None,
    };
    let (hours, minutes) = match text.split_once(':') {
        Some(parts) => parts,
        None if text.len() == 4 && text.is_ascii() => text.split_at(2),
        None => (text, "0"),
    };
    let number = |text: &str| text.parse::<u32>().ok().filter(|&n| n < 60).map(i64::from);
    Some(sign * (number(hours)? * 60 + number(minutes)?) * 60_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(unit: &str, calendar: &str, value: f64) -> Option<String> {
        let since = Since::parse(unit, Calendar::named(calendar))?;
        since.label(value, Precision::of(&since, &[value]))
    }

    #[test]
    fn calendars_as_cftime_has_them() {
        for (unit, calendar, value, expected) in [
            ("days since 1970-01-01", "proleptic_gregorian", 19_000.0, "2022-01-08"),
            ("days since 1970-01-01", "standard", -141_427.0, "1582-10-15"),
            ("days since 1970-01-01", "standard", -141_428.0, "1582-10-04"),
            ("days since 1970-01-01", "proleptic_gregorian", -141_428.0, "1582-10-14"),
            ("days since 0001-01-01", "standard", 0.0, "0001-01-01"),
            ("days since 0001-01-01", "julian", 365.0, "0002-01-01"),
            ("days since 1900-02-28", "julian", 1.0, "1900-02-29"),
            ("days since 1900-02-28", "gregorian", 1.0, "1900-03-01"),
            ("days since 2000-02-28", "noleap", 1.0, "2000-03-01"),
            ("days since 2001-02-28", "all_leap", 1.0, "2001-02-29"),
            ("days since 2000-02-30", "360_day", 1.0, "2000-03-01"),
            ("days since 1850-01-01", "noleap", 36_500.0, "1950-01-01"),
            ("days since 1850-01-01", "360_day", 36_000.0, "1950-01-01"),
            (
                "hours since 1900-01-01 00:00:0.0",
                "gregorian",
                1_000_000.0,
                "2014-01-29 16:00",
            ),
            ("minutes since 2000-01-01T12:00Z", "", 1.5, "2000-01-01 12:01:30"),
            (
                "seconds since 2000-1-1 12:00:00 +01:00",
                "",
                0.25,
                "2000-01-01 11:00:00.250",
            ),
            ("ns since 2020-01-01", "", 6e13, "2020-01-01 16:40"),
            ("months since 2000-01-31", "", 1.0, "2000-02-29"),
            ("months since 2000-01-01", "", 13.5, "2001-02-15"),
            ("years since 1850-06-01", "noleap", 12.0, "1862-06-01"),
            ("weeks since 2000-01-01 00:00 UTC", "", -1.0, "1999-12-25"),
            ("days since -0044-03-15", "julian", 0.0, "-0044-03-15"),
        ] {
            assert_eq!(
                label(unit, calendar, value).as_deref(),
                Some(expected),
                "{value} {unit}, {calendar}"
            );
        }
    }

    #[test]
    fn what_is_no_date_is_none() {
        for unit in [
            "days",
            "days since",
            "days since x",
            "days since 0000-00-00",
            "days since 2001-02-29",
            "days since 2000-13-01",
            "days since 2000-01-01-01",
            "days since 2000-01-01 25:61",
            "days since 2000-01-01 00:00 somewhere else",
            "moons since 2000-01-01",
            "days since 99999999999-01-01",
            "days since 2000-01-01 \u{e9}",
            "",
        ] {
            assert_eq!(Since::parse(unit, Calendar::Standard), None, "{unit}");
        }
        assert_eq!(Since::parse("days since 2000-01-01", Calendar::named("lunar")), None);
        assert_eq!(label("days since 2000-01-01", "", 1e300), None);
        assert_eq!(label("months since 2000-01-01", "", f64::NAN), None);
    }

    #[test]
    fn every_day_has_a_date_and_back() {
        use Calendar::{AllLeap, Days360, Julian, NoLeap, ProlepticGregorian, Standard};
        for calendar in [Standard, ProlepticGregorian, Julian, NoLeap, AllLeap, Days360] {
            for days in (-1_000_000..1_000_000).step_by(37).chain(-141_440..-141_410) {
                assert_eq!(calendar.days(calendar.date(days)), days, "{calendar:?}");
            }
        }
    }
}
