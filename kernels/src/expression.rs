//! Expressions over fields: a list of operations, each of which uses results of earlier ones. They have no loops and no addresses, so
//! they end soon and read only one sample of each field.

use crate::{Error, Result, constants};

/// Maximum operations of an expression.
pub const MAX_NODES: usize = constants::EXPRESSION_OPERATIONS as usize;

/// Index of an earlier operation.
pub type Node = u8;

macro_rules! functions {
    ($(#[doc = $of:literal])* $name:ident { $($(#[doc = $doc:literal])* $variant:ident $text:literal $code:literal $value:expr;)* }) => {
        $(#[doc = $of])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[doc = $doc])* $variant),*
        }

        impl $name {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// As users write it.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $text),*
                }
            }

            /// As OpenCL C writes it.
            #[cfg(test)]
            const fn code(self) -> &'static str {
                match self {
                    $(Self::$variant => $code),*
                }
            }
        }

        functions!(@values $name { $($variant $value;)* });
    };
    (@values Unary { $($variant:ident $value:expr;)* }) => {
        impl Unary {
            fn value(self, x: f32) -> f32 {
                let function: fn(f32) -> f32 = match self {
                    $(Self::$variant => $value),*
                };
                function(x)
            }
        }
    };
    (@values Binary { $($variant:ident $value:expr;)* }) => {
        impl Binary {
            fn value(self, x: f32, y: f32) -> f32 {
                let function: fn(f32, f32) -> f32 = match self {
                    $(Self::$variant => $value),*
                };
                function(x, y)
            }
        }
    };
    (@values Comparison { $($variant:ident $value:expr;)* }) => {
        impl Comparison {
            fn value(self, x: f32, y: f32) -> bool {
                let function: fn(&f32, &f32) -> bool = match self {
                    $(Self::$variant => $value),*
                };
                function(&x, &y)
            }
        }
    };
}

// A new function is a line here: variant, name for users, OpenCL C, Rust (`make generated` writes `cl/lib/operations.h`); and its twin in the
// reference crate's `expression.rs`.
functions! {
    /// A function of one number.
    Unary {
        /// −x.
        Negate "-" "-" |x| -x;
        /// Absolute value.
        Abs "abs" "fabs" f32::abs;
        /// Square root.
        Sqrt "sqrt" "sqrt" f32::sqrt;
        /// e to the power of x.
        Exp "exp" "exp" f32::exp;
        /// Natural logarithm.
        Log "log" "log" f32::ln;
        /// Logarithm to base 2.
        Log2 "log2" "log2" f32::log2;
        /// Logarithm to base 10.
        Log10 "log10" "log10" f32::log10;
        /// Sine of radians.
        Sin "sin" "sin" f32::sin;
        /// Cosine of radians.
        Cos "cos" "cos" f32::cos;
        /// Tangent of radians.
        Tan "tan" "tan" f32::tan;
        /// The largest whole number that is not above x.
        Floor "floor" "floor" f32::floor;
        /// The smallest whole number that is not below x.
        Ceil "ceil" "ceil" f32::ceil;
    }
}

functions! {
    /// A function of two numbers.
    Binary {
        /// Sum.
        Add "+" "+" |x, y| x + y;
        /// Difference.
        Subtract "-" "-" |x, y| x - y;
        /// Product.
        Multiply "*" "*" |x, y| x * y;
        /// Quotient.
        Divide "/" "/" |x, y| x / y;
        /// x to the power of y.
        Power "^" "pow" f32::powf;
        /// The smaller one.
        Min "min" "fmin" f32::min;
        /// The larger one.
        Max "max" "fmax" f32::max;
    }
}

functions! {
    /// A comparison of two numbers.
    Comparison {
        /// x < y.
        Below "<" "<" f32::lt;
        /// x ≤ y.
        AtMost "<=" "<=" f32::le;
        /// x > y.
        Above ">" ">" f32::gt;
        /// x ≥ y.
        AtLeast ">=" ">=" f32::ge;
        /// x = y.
        Is "==" "==" f32::eq;
        /// x ≠ y.
        IsNot "!=" "!=" f32::ne;
    }
}

/// One operation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Op {
    /// A number.
    Number(f32),
    /// The sample of a field, by its place among the fields of the expression.
    Field(u8),
    /// A function of a number.
    Unary(Unary, Node),
    /// A function of two numbers.
    Binary(Binary, Node, Node),
    /// A condition: a comparison of two numbers.
    Compare(Comparison, Node, Node),
    /// A condition: both hold.
    And(Node, Node),
    /// A condition: one of two holds, or both.
    Or(Node, Node),
    /// A condition: another does not hold.
    Not(Node),
    /// The first number if the condition holds, else the second one.
    Select(Node, Node, Node),
}

/// Type of an operation's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Number,
    /// A condition.
    Condition,
}

impl Op {
    /// Returns the operations whose results it uses, and the required types of these results.
    fn operands(self) -> Vec<(Node, Kind)> {
        use Kind::{Condition, Number};
        match self {
            Self::Number(_) | Self::Field(_) => Vec::new(),
            Self::Unary(_, x) => vec![(x, Number)],
            Self::Binary(_, x, y) | Self::Compare(_, x, y) => vec![(x, Number), (y, Number)],
            Self::And(x, y) | Self::Or(x, y) => vec![(x, Condition), (y, Condition)],
            Self::Not(x) => vec![(x, Condition)],
            Self::Select(c, x, y) => vec![(c, Condition), (x, Number), (y, Number)],
        }
    }

    /// Returns the type of its result.
    pub fn kind(self) -> Kind {
        match self {
            Self::Compare(..) | Self::And(..) | Self::Or(..) | Self::Not(_) => Kind::Condition,
            _ => Kind::Number,
        }
    }

    /// Encoding that `cl/evaluate.cl` reads: the number of the operation and its operands, a byte each; a number's bits or a field's place.
    fn encoded(self) -> [u32; 2] {
        let word = |operation: u32, [a, b, c]: [Node; 3]| {
            operation | u32::from(a) << 8 | u32::from(b) << 16 | u32::from(c) << 24
        };
        let [word, value] = match self {
            // As bits, so that nothing is rounded.
            Self::Number(x) => [constants::OPERATION_NUMBER, x.to_bits()],
            Self::Field(i) => [constants::OPERATION_FIELD, i.into()],
            Self::Unary(function, x) => [word(UNARY + function as u32, [x, 0, 0]), 0],
            Self::Binary(function, x, y) => [word(BINARY + function as u32, [x, y, 0]), 0],
            Self::Compare(comparison, x, y) => [word(COMPARISON + comparison as u32, [x, y, 0]), 0],
            Self::And(x, y) => [word(constants::OPERATION_AND, [x, y, 0]), 0],
            Self::Or(x, y) => [word(constants::OPERATION_OR, [x, y, 0]), 0],
            Self::Not(x) => [word(constants::OPERATION_NOT, [x, 0, 0]), 0],
            Self::Select(c, x, y) => [word(constants::OPERATION_SELECT, [x, y, c]), 0],
        };
        [word, value]
    }
}

/// Number of the first function of one number in `cl/evaluate.cl`.
const UNARY: u32 = constants::OPERATION_FUNCTIONS;
/// Number of the first function of two numbers.
const BINARY: u32 = UNARY + Unary::ALL.len() as u32;
/// Number of the first comparison.
const COMPARISON: u32 = BINARY + Binary::ALL.len() as u32;

/// An expression as the device reads it.
pub(crate) struct Encoded {
    /// Its operations.
    pub operations: Vec<[u32; 2]>,
    /// Number of fields.
    pub fields: u32,
}

/// The text of `cl/lib/operations.h`: the cases of functions and comparisons, which make `value` of the operands `x` and `y`.
#[cfg(test)]
pub(crate) fn header() -> String {
    let unary = Unary::ALL.iter().map(|function| match function.code() {
        sign @ "-" => format!("{sign}x"),
        name => format!("{name}(x)"),
    });
    let binary = Binary::ALL.iter().map(|function| match function.code() {
        sign if sign.len() == 1 => format!("x {sign} y"),
        name => format!("{name}(x, y)"),
    });
    let comparisons = Comparison::ALL
        .iter()
        .map(|comparison| format!("PICK(x {} y, 1.0f, 0.0f)", comparison.code()));
    let cases = (UNARY..).zip(unary.chain(binary).chain(comparisons));
    let cases: String = cases
        .map(|(number, value)| format!(" \\\n    case {number}u: value = {value}; break;"))
        .collect();
    format!("#define OPERATION_CASES{cases}\n")
}

/// An expression whose value is a number, of one field or several.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    ops: Vec<Op>,
    fields: u8,
}

impl Expression {
    /// The expression whose value is that of the last operation.
    ///
    /// # Errors
    /// No operation or too many; an operand that is not an earlier operation or has the wrong type; a condition as the result; a number
    /// that is not finite; no field or more than eight.
    pub fn new(ops: Vec<Op>) -> Result<Self> {
        let fail = |why: String| {
            Err(Error::Invalid {
                what: "expression",
                why,
            })
        };
        if !(1..=MAX_NODES).contains(&ops.len()) {
            return fail(format!("{} operations, expected 1 to {MAX_NODES}", ops.len()));
        }
        for (at, op) in ops.iter().enumerate() {
            let fits = |(node, kind): (Node, Kind)| usize::from(node) < at && ops[usize::from(node)].kind() == kind;
            if !op.operands().into_iter().all(fits) {
                return fail(format!("operation {at}, {op:?}, uses others that do not fit"));
            }
            if matches!(op, Op::Number(x) if !x.is_finite()) {
                return fail(format!("{op:?}, expected a finite number"));
            }
        }
        let ordinals = ops.iter().filter_map(|op| match op {
            Op::Field(i) => Some(*i),
            _ => None,
        });
        let Some(last) = ordinals.max().filter(|&i| u32::from(i) < constants::EXPRESSION_FIELDS) else {
            return fail(format!("of no field, or more than {}", constants::EXPRESSION_FIELDS));
        };
        if ops[ops.len() - 1].kind() != Kind::Number {
            return fail("a condition, expected a number".to_owned());
        }
        Ok(Self { ops, fields: last + 1 })
    }

    /// How many fields it has.
    pub fn fields(&self) -> usize {
        usize::from(self.fields)
    }

    /// Its operations.
    pub fn ops(&self) -> &[Op] {
        &self.ops
    }

    /// Evaluates the expression for one sample of each field; a missing sample is NaN. Returns NaN if a sample is missing or the value is
    /// not finite.
    pub fn value(&self, fields: &[f32]) -> f32 {
        if fields[..self.fields()].iter().any(|v| v.is_nan()) {
            return f32::NAN;
        }
        let mut numbers = [0.0f32; MAX_NODES];
        let mut conditions = [false; MAX_NODES];
        for (at, op) in self.ops.iter().enumerate() {
            let number = |node: Node| numbers[usize::from(node)];
            let holds = |node: Node| conditions[usize::from(node)];
            match *op {
                Op::Number(x) => numbers[at] = x,
                Op::Field(i) => numbers[at] = fields[usize::from(i)],
                Op::Unary(function, x) => numbers[at] = function.value(number(x)),
                Op::Binary(function, x, y) => numbers[at] = function.value(number(x), number(y)),
                Op::Compare(comparison, x, y) => conditions[at] = comparison.value(number(x), number(y)),
                Op::And(x, y) => conditions[at] = holds(x) && holds(y),
                Op::Or(x, y) => conditions[at] = holds(x) || holds(y),
                Op::Not(x) => conditions[at] = !holds(x),
                Op::Select(c, x, y) => numbers[at] = if holds(c) { number(x) } else { number(y) },
            }
        }
        let value = numbers[self.ops.len() - 1];
        if value.is_finite() { value } else { f32::NAN }
    }

    /// As `cl/evaluate.cl` reads it.
    pub(crate) fn encoded(&self) -> Encoded {
        Encoded {
            operations: self.ops.iter().map(|op| op.encoded()).collect(),
            fields: self.fields.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_refused() {
        let refused = |ops: Vec<Op>, words: &str| {
            let error = Expression::new(ops).expect_err(words).to_string();
            assert!(error.contains(words), "expected {words:?} in: {error}");
        };
        let compare = Op::Compare(Comparison::Below, 0, 0);
        refused(Vec::new(), "0 operations");
        refused(vec![Op::Field(0); 65], "65 operations");
        refused(vec![Op::Field(0), Op::Unary(Unary::Sin, 1)], "operation 1");
        refused(vec![Op::Field(0), compare, Op::Unary(Unary::Sin, 1)], "operation 2");
        refused(vec![Op::Field(0), compare], "a condition");
        refused(vec![Op::Field(0), Op::Not(0), Op::Field(0)], "operation 1");
        refused(vec![Op::Number(1.0)], "of no field");
        refused(vec![Op::Field(8)], "or more than 8");
        refused(
            vec![Op::Field(0), Op::Number(f32::INFINITY)],
            "expected a finite number",
        );
    }

    #[test]
    fn values_and_encoding() {
        let ops = vec![
            Op::Field(0),
            Op::Number(0.5),
            Op::Compare(Comparison::Above, 0, 1),
            Op::Unary(Unary::Log, 0),
            Op::Binary(Binary::Power, 0, 1),
            Op::Select(2, 3, 4),
        ];
        let expression = Expression::new(ops).expect("an expression");
        assert_eq!(expression.value(&[1.0]), 0.0);
        assert_eq!(expression.value(&[0.25]), 0.5);
        assert!(expression.value(&[f32::NAN]).is_nan() && expression.value(&[-1.0]).is_nan());
        let operations = expression.encoded().operations;
        assert_eq!(operations[1], [constants::OPERATION_NUMBER, 0.5f32.to_bits()]);
        assert_eq!(operations[2], [(COMPARISON + Comparison::Above as u32) | 1 << 16, 0]);
        assert_eq!(
            operations[5],
            [constants::OPERATION_SELECT | 3 << 8 | 4 << 16 | 2 << 24, 0]
        );
    }
}
