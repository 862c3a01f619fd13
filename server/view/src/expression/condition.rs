//! `distance(CONDITION)` and `smooth(SAMPLES, CONDITION)`: compiles the condition to a number that is 0 if the condition does not hold.

use isopeel_kernels::expression::{Comparison, Kind, Op};

use super::{DISTANCE, Fault, Program, SMOOTH, syntax};
use crate::mask::{Mask, Operator};

/// Range of the standard deviations that `smooth` accepts, in samples.
pub const SIGMAS: std::ops::RangeInclusive<f32> = 0.1..=10.0;

/// A part of a text, with the byte at which it begins.
type TextPart<'a> = (usize, &'a str);

/// Returns the condition of a text that is `distance(CONDITION)`; `None` if the text is another expression.
pub(super) fn parse_distance(text: &str) -> Result<Option<TextPart<'_>>, Fault> {
    call_argument(text, DISTANCE, "distance(CONDITION)")
}

/// Returns the standard deviation and the condition of a text that is `smooth(SAMPLES, CONDITION)`; `None` if the text is another
/// expression.
pub(super) fn parse_smooth(text: &str) -> Result<Option<(f32, TextPart<'_>)>, Fault> {
    let Some((from, inner)) = call_argument(text, SMOOTH, "smooth(SAMPLES, CONDITION)")? else {
        return Ok(None);
    };
    let (sigma, condition) = inner.split_once(',').unwrap_or((inner, ""));
    match sigma.trim().parse() {
        Ok(number) if SIGMAS.contains(&number) => Ok(Some((number, (from + sigma.len() + 1, condition)))),
        _ => {
            let [low, high] = [SIGMAS.start(), SIGMAS.end()];
            Err((
                from,
                format!(
                    "{:?}, expected a number of samples, {low} to {high}, and behind a comma a condition",
                    sigma.trim()
                ),
            ))
        }
    }
}

/// Returns the argument, if the whole text is a call of `function`.
fn call_argument<'a>(text: &'a str, function: &str, form: &str) -> Result<Option<TextPart<'a>>, Fault> {
    let inner = text.trim_start().strip_prefix(function);
    let Some(inner) = inner.and_then(|rest| rest.trim_start().strip_prefix('(')) else {
        return Ok(None);
    };
    let from = text.len() - inner.len();
    match inner.trim_end().strip_suffix(')') {
        Some(condition) => Ok(Some((from, condition))),
        None => Err((
            text.trim_end().len(),
            format!("expected \")\" at the end: {form} stands alone"),
        )),
    }
}

impl Program<'_> {
    /// Adds operations whose result is 0 if a condition does not hold. The condition begins at byte `offset` of the text. A condition is a
    /// mask or an expression. A numeric expression holds if its value is not 0.
    pub(super) fn indicator(&mut self, offset: usize, condition: &str) -> Result<(), Fault> {
        let node = match Mask::parse(condition, self.field_names) {
            Ok(mask) => {
                let ranked = mask.by_ranks(|number| (self.rank)(&mask.field, number));
                self.mask(offset, &ranked)?
            }
            Err(_) => {
                let in_whole_text = |(inner_offset, why): Fault| (offset + inner_offset, why);
                let tree = syntax::parse(condition).map_err(in_whole_text)?;
                self.node(&tree).map_err(in_whole_text)?
            }
        };
        if self.ops[usize::from(node)].kind() == Kind::Condition {
            let [one, zero] = [self.add(offset, Op::Number(1.0))?, self.add(offset, Op::Number(0.0))?];
            self.add(offset, Op::Select(node, one, zero))?;
        }
        Ok(())
    }

    /// Adds operations whose result is the condition of a mask.
    fn mask(&mut self, offset: usize, mask: &Mask) -> Result<u8, Fault> {
        let value = self.field(offset, &mask.field)?;
        let (operator, ranges) = mask.comparison();
        let comparison = match operator {
            Operator::Is | Operator::IsNot => Comparison::Is,
            Operator::AtLeast => Comparison::AtLeast,
            Operator::AtMost => Comparison::AtMost,
            Operator::Above => Comparison::Above,
            Operator::Below => Comparison::Below,
        };
        let mut any_range = None;
        for &[low, high] in ranges {
            let first = self.add(offset, Op::Number(low))?;
            let holds = if low < high {
                let last = self.add(offset, Op::Number(high))?;
                let above = self.add(offset, Op::Compare(Comparison::AtLeast, value, first))?;
                let below = self.add(offset, Op::Compare(Comparison::AtMost, value, last))?;
                self.add(offset, Op::And(above, below))?
            } else {
                self.add(offset, Op::Compare(comparison, value, first))?
            };
            any_range = Some(match any_range {
                None => holds,
                Some(others) => self.add(offset, Op::Or(others, holds))?,
            });
        }
        match any_range {
            Some(condition) if operator == Operator::IsNot => self.add(offset, Op::Not(condition)),
            Some(condition) => Ok(condition),
            None => Err((offset, "a mask without a number".to_owned())),
        }
    }
}
