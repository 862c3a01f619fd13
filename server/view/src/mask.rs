//! Masks. A mask restricts the surface to samples at which a field of the same volume has certain values: `labels==3`.

use std::hash::{Hash, Hasher};

use isopeel_kernels::{ValueSet, checked_serde};
use serde::{Deserialize, Serialize};

use super::error::{EditError, quoted};

/// The operators by their symbols. A symbol that begins with another symbol comes before that one.
const OPERATORS: [(&str, Operator); 6] = [
    ("==", Operator::Is),
    ("!=", Operator::IsNot),
    (">=", Operator::AtLeast),
    ("<=", Operator::AtMost),
    (">", Operator::Above),
    ("<", Operator::Below),
];

/// Maximum number of values and ranges in a list.
const MAX_RANGES: usize = 64;

/// How values are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Operator {
    Is,
    IsNot,
    AtLeast,
    AtMost,
    Above,
    Below,
}

/// Restricts a surface to samples at which a field of the same volume has these values. Missing samples are outside every mask.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Mask {
    /// The field.
    pub field: String,
    operator: Operator,
    /// Minimum and maximum of each range. For a number both are equal. If the operator is neither `==` nor `!=`, there is exactly one
    /// number.
    ranges: Vec<[f32; 2]>,
    /// The ends of the ranges as exact integers, if they are written as whole numbers, because floats may round them.
    integers: Vec<[Option<i128>; 2]>,
    text: String,
}

checked_serde!(Mask, |mask| {
    let is_usable = !mask.ranges.is_empty() && mask.ranges.iter().flatten().all(|end| end.is_finite());
    is_usable.then_some(()).ok_or("a mask without finite numbers")
});

// Equality is total, because no number is NaN.
impl Eq for Mask {}

impl Hash for Mask {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.text.hash(state);
    }
}

/// Returns a name without the quotation marks around it, if any.
fn unquoted(name: &str) -> &str {
    let between = |mark| name.strip_prefix(mark).and_then(|rest| rest.strip_suffix(mark));
    between('"').or_else(|| between('`')).unwrap_or(name)
}

impl Mask {
    /// Reads `FIELD==V`, with `==`, `!=`, `<`, `<=`, `>` or `>=`. Behind `==` and `!=` there may be a range `LOW..HIGH`, which includes
    /// both ends, or a list of numbers and ranges: `labels==1,4..7`. Ignores spaces around names and numbers, and quotation marks around a
    /// name.
    ///
    /// # Errors
    /// The expected text, and the character at which it is missing.
    pub fn parse(text: &str, fields: &[&str]) -> Result<Self, EditError> {
        let refuse = |offset: usize, why: String| {
            let character = text[..offset].chars().count() + 1;
            EditError {
                field: "mask",
                why: format!("{text:?}, character {character}: {why}"),
            }
        };
        let starts = text.char_indices().map(|(offset, _)| offset);
        let mut operators = starts.filter_map(|offset| {
            let (symbol, operator) = OPERATORS
                .iter()
                .find(|(symbol, _)| text[offset..].starts_with(symbol))?;
            Some((offset, *symbol, *operator))
        });
        let Some((symbol_offset, symbol, operator)) = operators.next() else {
            return Err(refuse(
                text.len(),
                "expected ==, !=, <, <=, > or >= behind a field's name".into(),
            ));
        };
        let name = text[..symbol_offset].trim();
        // A field of exactly this name takes precedence, as in expressions, which may contain masks.
        let field = if fields.contains(&name) { name } else { unquoted(name) };
        if !fields.contains(&field) {
            let begin = text.len() - text.trim_start().len();
            return Err(refuse(
                begin.min(symbol_offset),
                format!("no field {field:?}, expected one of {}", quoted(fields)),
            ));
        }
        let (mut ranges, mut integers, mut from) = (Vec::new(), Vec::new(), symbol_offset + symbol.len());
        for item in text[from..].split(',') {
            ranges.push(parse_range(item).map_err(|(offset, why)| refuse(from + offset, why))?);
            let (low, high) = item.split_once("..").unwrap_or((item, item));
            integers.push([low, high].map(|number| number.trim().parse().ok()));
            from += item.len() + 1;
        }
        let is_list = matches!(operator, Operator::Is | Operator::IsNot);
        if !is_list && (ranges.len() > 1 || ranges[0][0] < ranges[0][1]) {
            return Err(refuse(
                symbol_offset + symbol.len(),
                format!("expected one number behind {symbol}"),
            ));
        }
        if ranges.len() > MAX_RANGES {
            return Err(refuse(
                symbol_offset + symbol.len(),
                format!("{} values, expected at most {MAX_RANGES}", ranges.len()),
            ));
        }
        Ok(Self {
            field: field.to_owned(),
            operator,
            ranges,
            integers,
            text: text.trim().to_owned(),
        })
    }

    /// Returns the mask as it was written.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Returns the operator, and the minimum and maximum of each range with which values are compared.
    pub(super) fn comparison(&self) -> (Operator, &[[f32; 2]]) {
        (self.operator, &self.ranges)
    }

    /// Returns the same mask for a field that has ranks in place of the numbers in its file. `rank` returns the rank of a number.
    #[must_use]
    pub fn by_ranks(&self, rank: impl Fn(i128) -> Option<f32>) -> Self {
        let mut mask = self.clone();
        for (range, integers) in mask.ranges.iter_mut().zip(&self.integers) {
            for (end, number) in range.iter_mut().zip(integers) {
                *end = number.and_then(&rank).unwrap_or(*end);
            }
        }
        mask
    }

    /// Returns the values of the field that are inside the mask.
    pub fn values(&self) -> ValueSet {
        let first = self.ranges[0][0];
        let (ranges, is_complement) = match self.operator {
            Operator::Is => (self.ranges.clone(), false),
            Operator::IsNot => (self.ranges.clone(), true),
            Operator::AtLeast => (vec![[first, f32::INFINITY]], false),
            Operator::AtMost => (vec![[f32::NEG_INFINITY, first]], false),
            Operator::Above => (vec![[f32::NEG_INFINITY, first]], true),
            Operator::Below => (vec![[first, f32::INFINITY]], true),
        };
        ValueSet { ranges, is_complement }
    }
}

/// Parses a number or `LOW..HIGH`. An error has the byte of the text at which it was found.
fn parse_range(text: &str) -> Result<[f32; 2], (usize, String)> {
    let number = |part: &str, start: usize| {
        let offset = start + part.len() - part.trim_start().len();
        let value = part.trim().parse::<f32>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| (offset, format!("expected a finite number, found {:?}", part.trim())))
    };
    let Some((low, high)) = text.split_once("..") else {
        let value = number(text, 0)?;
        return Ok([value, value]);
    };
    let ends = [number(low, 0)?, number(high, low.len() + 2)?];
    if ends[0] > ends[1] {
        return Err((0, "expected a range whose first number is not above the second".into()));
    }
    Ok(ends)
}

#[cfg(test)]
mod tests {
    use super::Mask;

    #[test]
    fn numbers_become_ranks() {
        let rank = |number: i128| Some((number - 16_777_210) as f32);
        let mask = Mask::parse("labels==16777217,16777219..16777221", &["labels"]).expect("a mask");
        let mask = mask.by_ranks(rank);
        let inside: Vec<i32> = (0..14).filter(|&value| mask.values().holds(value as f32)).collect();
        assert_eq!(inside, [7, 9, 10, 11]);
    }

    const FIELDS: &[&str] = &["labels", "p (bone)", "é"];

    fn inside(text: &str) -> Vec<i32> {
        let mask = Mask::parse(text, FIELDS).expect(text);
        (-1..6).filter(|&v| mask.values().holds(v as f32)).collect()
    }

    #[test]
    fn values_ranges_and_lists() {
        assert_eq!(inside("labels==3"), [3]);
        assert_eq!(inside(" labels != 3 "), [-1, 0, 1, 2, 4, 5]);
        assert_eq!(inside("labels>=4"), [4, 5]);
        assert_eq!(inside("labels>4"), [5]);
        assert_eq!(inside("p (bone)<1"), [-1, 0]);
        assert_eq!(inside("p (bone)<=-0.5"), [-1]);
        assert_eq!(inside("labels==1..3, 5"), [1, 2, 3, 5]);
        assert_eq!(inside("labels!=0,2..9"), [-1, 1]);
        assert_eq!(inside("\"labels\"==1,3"), [1, 3]);
        assert_eq!(inside(" `p (bone)` >= 4"), [4, 5]);
        for text in ["labels==3", "labels!=3", "labels<3", "labels>3"] {
            assert!(
                !Mask::parse(text, FIELDS).expect(text).values().holds(f32::NAN),
                "missing samples are outside"
            );
        }
    }

    #[test]
    fn errors_point_at_the_character() {
        for (text, expected) in [
            ("labels", "character 7: expected ==, !="),
            ("labels=3", "character 9: expected ==, !="),
            (" bone==3", "character 2: no field \"bone\""),
            ("labels==", "character 9: expected a finite number, found \"\""),
            ("labels== x", "character 10: expected a finite number, found \"x\""),
            ("é==1,z", "character 6: expected a finite number"),
            ("labels==1..nan", "character 12: expected a finite number"),
            ("labels==5..2", "character 9: expected a range"),
            ("labels>1,2", "character 8: expected one number behind >"),
            ("==1", "character 1: no field \"\""),
        ] {
            let why = Mask::parse(text, FIELDS).expect_err(text).why;
            assert!(why.contains(expected), "{why:?} has no {expected:?}");
        }
    }
}
