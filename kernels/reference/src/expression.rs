//! Expressions, from the last operation down.

use std::cmp::Ordering;

use isopeel_kernels::expression::{Binary, Comparison, Expression, Op, Unary};

/// Returns the value for one sample of each field; a missing sample is NaN. The result of each function passes through `rounded`, with the
/// relative error that a device may have.
pub fn value(expression: &Expression, fields: &[f32], rounded: &mut dyn FnMut(f32, f32) -> f32) -> f32 {
    let ops = expression.ops();
    let known = (0..expression.fields()).all(|i| !fields[i].is_nan());
    let value = Twin { ops, fields }.number(ops.len() - 1, rounded);
    if known && value.is_finite() { value } else { f32::NAN }
}

struct Twin<'a> {
    ops: &'a [Op],
    fields: &'a [f32],
}

/// Units in the last place of a float.
const ULP: f32 = f32::EPSILON;

impl Twin<'_> {
    fn number(&self, at: usize, rounded: &mut dyn FnMut(f32, f32) -> f32) -> f32 {
        match self.ops[at] {
            Op::Number(x) => x,
            Op::Field(i) => self.fields[i as usize],
            Op::Unary(function, x) => {
                let x = self.number(x.into(), rounded);
                // The errors that OpenCL allows each function.
                let (value, ulps) = match function {
                    Unary::Negate => (-x, 0.0),
                    Unary::Abs => (if x < 0.0 { -x } else { x }, 0.0),
                    Unary::Sqrt => (x.sqrt(), 3.0),
                    Unary::Exp => (x.exp(), 3.0),
                    Unary::Log => (x.ln(), 3.0),
                    Unary::Log2 => (x.log2(), 3.0),
                    Unary::Log10 => (x.log10(), 3.0),
                    Unary::Sin => (x.sin(), 4.0),
                    Unary::Cos => (x.cos(), 4.0),
                    Unary::Tan => (x.sin() / x.cos(), 8.0),
                    Unary::Floor => (x.floor(), 0.0),
                    Unary::Ceil => (-(-x).floor(), 0.0),
                };
                rounded(value, ulps * ULP)
            }
            Op::Binary(function, x, y) => {
                let (x, y) = (self.number(x.into(), rounded), self.number(y.into(), rounded));
                let (value, ulps) = match function {
                    Binary::Add => (x + y, 0.0),
                    Binary::Subtract => (x - y, 0.0),
                    Binary::Multiply => (x * y, 0.0),
                    Binary::Divide => (x / y, 2.5),
                    Binary::Power => (x.powf(y), 16.0),
                    Binary::Min => (if y < x || x.is_nan() { y } else { x }, 0.0),
                    Binary::Max => (if y > x || x.is_nan() { y } else { x }, 0.0),
                };
                rounded(value, ulps * ULP)
            }
            Op::Select(c, x, y) => {
                let chosen = if self.condition(c.into(), rounded) { x } else { y };
                self.number(chosen.into(), rounded)
            }
            condition => panic!("{condition:?} is no number"),
        }
    }

    fn condition(&self, at: usize, rounded: &mut dyn FnMut(f32, f32) -> f32) -> bool {
        match self.ops[at] {
            Op::Compare(comparison, x, y) => {
                let (x, y) = (self.number(x.into(), rounded), self.number(y.into(), rounded));
                let order = x.partial_cmp(&y);
                match comparison {
                    Comparison::Below => order.is_some_and(Ordering::is_lt),
                    Comparison::AtMost => order.is_some_and(Ordering::is_le),
                    Comparison::Above => order.is_some_and(Ordering::is_gt),
                    Comparison::AtLeast => order.is_some_and(Ordering::is_ge),
                    Comparison::Is => order.is_some_and(Ordering::is_eq),
                    Comparison::IsNot => order.is_none_or(Ordering::is_ne),
                }
            }
            Op::And(x, y) => self.condition(x.into(), rounded) & self.condition(y.into(), rounded),
            Op::Or(x, y) => self.condition(x.into(), rounded) | self.condition(y.into(), rounded),
            Op::Not(x) => !self.condition(x.into(), rounded),
            number => panic!("{number:?} is no condition"),
        }
    }
}
