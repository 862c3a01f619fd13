//! Expressions over the fields of a volume: `log(rho)`, `magnitude(u,v,w)`, `if(p > 0, rho/p, 0)`, `distance(labels == 3)` and
//! `smooth(0.8, labels == 3)`.

mod condition;
mod syntax;

use isopeel_kernels::Expression;
use isopeel_kernels::expression::{Binary, Comparison, Kind, MAX_NODES, Op, Unary};

use super::error::{EditError, quoted};
use syntax::{NodeKind, Tree};

pub use condition::SIGMAS;

/// Maximum bytes of an expression's text: enough for 64 operations on names of some letters.
const MAX_BYTES: usize = 1024;
/// Maximum number of fields in an expression: as many as the device's program supports.
const MAX_FIELDS: usize = 8;
/// Functions that are not a single operation of the device.
const COMPOSED_FUNCTIONS: [&str; 6] = ["pow", "clamp", "magnitude", "if", DISTANCE, SMOOTH];
/// Function of the distance to a condition. A call of it must be the whole expression.
const DISTANCE: &str = "distance";
/// Function that smooths a condition. A call of it must be the whole expression.
const SMOOTH: &str = "smooth";

/// An expression that gives a field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldExpression {
    /// Fields of the volume that the expression uses, in the order of their numbers in `expression`.
    pub fields: Vec<String>,
    /// Computation on these fields.
    pub expression: Expression,
    /// Whether the field's values are distances to the nearest sample at which the expression is neither 0 nor missing, instead of the
    /// expression's values.
    pub is_distance: bool,
    /// Standard deviation of a Gaussian, in samples. If set, the field's values are the weighted share, 0 to 1, of the surrounding samples
    /// at which the expression is neither 0 nor missing, instead of the expression's values.
    pub smoothing: Option<f32>,
}

/// Returns the rank of a number among the labels of the named field; `None` if that field has no ranks in place of its numbers.
pub type RankOf<'a> = &'a dyn Fn(&str, i128) -> Option<f32>;

/// A fault: the byte of the text at which it was found, and its description.
type Fault = (usize, String);

impl FieldExpression {
    /// Parses an expression over a volume's fields. `field`: name of the edit's field, for errors. Operators of numbers are `+ - * / ^`,
    /// those of comparisons `&& || !`. Names that are not words are in quotation marks.
    ///
    /// # Errors
    /// The expected text, and the character at which it is missing.
    pub fn parse(text: &str, fields: &[&str], field: &'static str) -> Result<Self, EditError> {
        Self::parse_by(text, fields, field, &|_, _| None)
    }

    /// As [`Self::parse`], for fields some of which have ranks in place of the numbers in their file. `rank` returns the rank of a number
    /// that is compared with a field.
    ///
    /// # Errors
    /// As [`Self::parse`].
    pub fn parse_by(text: &str, fields: &[&str], field: &'static str, rank: RankOf<'_>) -> Result<Self, EditError> {
        Self::compile(text, fields, rank).map_err(|(offset, why)| {
            let character = text.get(..offset).unwrap_or(text).chars().count() + 1;
            EditError {
                field,
                why: format!("{text:?}, character {character}: {why}"),
            }
        })
    }

    /// Returns the unit of the values, if it follows from the fields' units and the operations on them. `units` are those of
    /// [`Self::fields`].
    ///
    /// Distances have the unit of lengths, which an expression does not know.
    pub fn unit<'a>(&self, units: &[Option<&'a str>]) -> Option<&'a str> {
        if self.is_distance || self.smoothing.is_some() {
            return None;
        }
        let mut dimensions: Vec<Dimension<'a>> = Vec::new();
        for op in self.expression.ops() {
            dimensions.push(Dimension::of(*op, units, &dimensions));
        }
        match dimensions.last() {
            Some(Dimension::Power(unit, 1)) => Some(unit),
            _ => None,
        }
    }

    /// Returns the names of the functions, those with one argument first.
    pub fn functions() -> Vec<&'static str> {
        let functions = Unary::ALL
            .iter()
            .map(|function| function.name())
            .chain(Binary::ALL.iter().map(|function| function.name()));
        functions
            .filter(|name| is_word(name))
            .chain(COMPOSED_FUNCTIONS)
            .collect()
    }

    /// Whether a text that is not a field's name may be an expression.
    pub fn may_be(text: &str) -> bool {
        text.contains(['(', ')', '+', '-', '*', '/', '^', '<', '>', '"'])
    }

    /// Parses the text, and compiles it to operations of the device.
    fn compile(text: &str, fields: &[&str], rank: RankOf<'_>) -> Result<Self, Fault> {
        if text.len() > MAX_BYTES {
            return Err((MAX_BYTES, format!("{} bytes, expected {MAX_BYTES} at most", text.len())));
        }
        let mut program = Program {
            field_names: fields,
            rank,
            fields: Vec::new(),
            ops: Vec::new(),
        };
        let smoothed = condition::parse_smooth(text)?;
        let distance = condition::parse_distance(text)?;
        match smoothed.map(|(_, condition)| condition).or(distance) {
            Some((offset, condition)) => program.indicator(offset, condition)?,
            None => {
                program.number(&syntax::parse(text)?)?;
            }
        }
        if program.fields.is_empty() {
            return Err((0, format!("no field in it, expected one of {}", quoted(fields))));
        }
        let expression = Expression::new(program.ops).map_err(|e| (0, e.to_string()))?;
        Ok(Self {
            fields: program.fields,
            expression,
            is_distance: distance.is_some(),
            smoothing: smoothed.map(|(sigma, _)| sigma),
        })
    }
}

/// Dimension of a value.
#[derive(Clone, Copy, PartialEq)]
enum Dimension<'a> {
    /// Plain numbers.
    Number,
    /// A power of a unit.
    Power(&'a str, i32),
    /// The dimension does not follow from the units of the fields.
    Unknown,
}

impl<'a> Dimension<'a> {
    /// Returns the dimension of an operation. `earlier`: the dimensions of the operations before it.
    fn of(op: Op, units: &[Option<&'a str>], earlier: &[Self]) -> Self {
        let dimension_of = |node: u8| earlier[usize::from(node)];
        match op {
            Op::Number(_) | Op::Compare(..) | Op::And(..) | Op::Or(..) | Op::Not(_) => Self::Number,
            Op::Field(index) => {
                let unit = units.get(usize::from(index)).copied().flatten();
                unit.map_or(Self::Unknown, |unit| Self::Power(unit, 1))
            }
            Op::Unary(Unary::Negate | Unary::Abs | Unary::Floor | Unary::Ceil, x) => dimension_of(x),
            Op::Unary(Unary::Sqrt, x) => match dimension_of(x) {
                Self::Power(unit, power) if power % 2 == 0 => Self::Power(unit, power / 2),
                Self::Number => Self::Number,
                _ => Self::Unknown,
            },
            Op::Unary(_, x) => dimension_of(x).number_or_unknown(),
            Op::Binary(Binary::Multiply, x, y) => dimension_of(x).times(dimension_of(y), 1),
            Op::Binary(Binary::Divide, x, y) => dimension_of(x).times(dimension_of(y), -1),
            Op::Binary(Binary::Power, x, y) => match (dimension_of(x), dimension_of(y)) {
                (Self::Number, Self::Number) => Self::Number,
                _ => Self::Unknown,
            },
            Op::Binary(_, x, y) | Op::Select(_, x, y) => dimension_of(x).or_other(dimension_of(y)),
        }
    }

    /// Returns the dimension of a function that is defined for plain numbers only.
    fn number_or_unknown(self) -> Self {
        if self == Self::Number { self } else { Self::Unknown }
    }

    /// Returns the dimension of a product with another value, or with its inverse if `sign` is -1.
    fn times(self, other: Self, sign: i32) -> Self {
        match (self, other) {
            (x, Self::Number) => x,
            (Self::Number, Self::Power(unit, power)) => Self::Power(unit, sign * power),
            (Self::Power(a, p), Self::Power(b, q)) if a == b => match p + sign * q {
                0 => Self::Number,
                power => Self::Power(a, power),
            },
            _ => Self::Unknown,
        }
    }

    /// Returns the dimension of a sum, or of a choice between two values. Plain numbers take the unit of the other value.
    fn or_other(self, other: Self) -> Self {
        match (self, other) {
            (x, Self::Number) | (Self::Number, x) => x,
            (x, y) if x == y => x,
            _ => Self::Unknown,
        }
    }
}

/// The operations that were compiled so far.
struct Program<'a> {
    /// Names of the volume's fields.
    field_names: &'a [&'a str],
    rank: RankOf<'a>,
    /// The fields that the operations use, in the order of their numbers.
    fields: Vec<String>,
    ops: Vec<Op>,
}

impl Program<'_> {
    /// Adds an operation, and returns its number. `offset`: byte of the text to which the operation belongs.
    fn add(&mut self, offset: usize, op: Op) -> Result<u8, Fault> {
        if let Some(number) = self.ops.iter().position(|other| *other == op) {
            // Reuses the earlier operation. Later operations refer to it, so the last one is still the value of the expression.
            return Ok(number as u8);
        }
        if self.ops.len() == MAX_NODES {
            return Err((offset, format!("more than {MAX_NODES} operations")));
        }
        self.ops.push(op);
        Ok(self.ops.len() as u8 - 1)
    }

    /// Adds the operations of a tree whose value must be of this kind.
    fn of_kind(&mut self, tree: &Tree, kind: Kind) -> Result<u8, Fault> {
        let node = self.node(tree)?;
        if self.ops[usize::from(node)].kind() == kind {
            return Ok(node);
        }
        let why = match kind {
            Kind::Number => "a condition, expected a number",
            Kind::Condition => "a number, expected a condition, such as u > 0",
        };
        Err((tree.offset, why.to_owned()))
    }

    /// Adds the operations of a tree whose value must be a number.
    fn number(&mut self, tree: &Tree) -> Result<u8, Fault> {
        self.of_kind(tree, Kind::Number)
    }

    /// Adds the operations of a tree.
    fn node(&mut self, tree: &Tree) -> Result<u8, Fault> {
        let offset = tree.offset;
        let op = match &tree.node_kind {
            NodeKind::Number { value, .. } => Op::Number(*value),
            NodeKind::Name(name) => return self.field(offset, name),
            NodeKind::Not(inner) => Op::Not(self.of_kind(inner, Kind::Condition)?),
            NodeKind::Negate(inner) => Op::Unary(Unary::Negate, self.number(inner)?),
            NodeKind::Infix(symbol, left, right) => return self.infix(offset, symbol, left, right),
            NodeKind::Call(name, arguments) => return self.call(offset, name, arguments),
        };
        self.add(offset, op)
    }

    /// Adds the operation that reads a field.
    fn field(&mut self, offset: usize, name: &str) -> Result<u8, Fault> {
        if !self.field_names.contains(&name) {
            return Err((
                offset,
                format!("no field {name:?}, expected one of {}", quoted(self.field_names)),
            ));
        }
        let index = match self.fields.iter().position(|field| field == name) {
            Some(index) => index,
            None if self.fields.len() == MAX_FIELDS => return Err((offset, format!("more than {MAX_FIELDS} fields"))),
            None => {
                self.fields.push(name.to_owned());
                self.fields.len() - 1
            }
        };
        self.add(offset, Op::Field(index as u8))
    }

    /// Adds the operations of an infix operator.
    fn infix(&mut self, offset: usize, symbol: &str, left: &Tree, right: &Tree) -> Result<u8, Fault> {
        if let "&&" | "||" = symbol {
            let [x, y] = [
                self.of_kind(left, Kind::Condition)?,
                self.of_kind(right, Kind::Condition)?,
            ];
            return self.add(offset, if symbol == "&&" { Op::And(x, y) } else { Op::Or(x, y) });
        }
        let comparison = Comparison::ALL.iter().find(|comparison| comparison.name() == symbol);
        if comparison.is_some()
            && let Some((left, right)) = self.ranked(left, right)
        {
            return self.infix(offset, symbol, &left, &right);
        }
        let [x, y] = [self.number(left)?, self.number(right)?];
        let op = match comparison {
            Some(&comparison) => Op::Compare(comparison, x, y),
            None => Op::Binary(binary(symbol).unwrap_or(Binary::Add), x, y),
        };
        self.add(offset, op)
    }

    /// If a number is compared with a field that has ranks, returns both operands with the number's rank in place of the number.
    fn ranked(&self, left: &Tree, right: &Tree) -> Option<(Tree, Tree)> {
        let ranked = |field: &Tree, number: &Tree| {
            let NodeKind::Name(name) = &field.node_kind else {
                return None;
            };
            let rank = (self.rank)(name, number.integer()?)?;
            let node_kind = NodeKind::Number {
                value: rank.abs(),
                integer: None,
            };
            let offset = number.offset;
            let node_kind = if rank < 0.0 {
                NodeKind::Negate(Box::new(Tree { offset, node_kind }))
            } else {
                node_kind
            };
            Some((field.clone(), Tree { offset, node_kind }))
        };
        ranked(left, right).or_else(|| ranked(right, left).map(|(field, number)| (number, field)))
    }

    /// Adds the operations of a function.
    fn call(&mut self, offset: usize, name: &str, arguments: &[Tree]) -> Result<u8, Fault> {
        let count = |expected: usize| match arguments.len() {
            n if n == expected => Ok(()),
            n => Err((offset, format!("{n} arguments of {name}, expected {expected}"))),
        };
        if let Some(&function) = Unary::ALL
            .iter()
            .find(|function| function.name() == name && is_word(name))
        {
            count(1)?;
            let x = self.number(&arguments[0])?;
            return self.add(offset, Op::Unary(function, x));
        }
        if let Some(function) = binary(if name == "pow" { "^" } else { name }) {
            count(2)?;
            let [x, y] = [self.number(&arguments[0])?, self.number(&arguments[1])?];
            return self.add(offset, Op::Binary(function, x, y));
        }
        match name {
            "clamp" => {
                count(3)?;
                let [x, low, high] = [0, 1, 2].map(|i| self.number(&arguments[i]));
                let above = self.add(offset, Op::Binary(Binary::Max, x?, low?))?;
                self.add(offset, Op::Binary(Binary::Min, above, high?))
            }
            "if" => {
                count(3)?;
                let condition = self.of_kind(&arguments[0], Kind::Condition)?;
                let [x, y] = [self.number(&arguments[1])?, self.number(&arguments[2])?];
                self.add(offset, Op::Select(condition, x, y))
            }
            "magnitude" => self.magnitude(offset, arguments),
            DISTANCE => Err((
                offset,
                "distance(CONDITION) inside another expression, expected it alone".to_owned(),
            )),
            SMOOTH => Err((
                offset,
                "smooth(SAMPLES, CONDITION) inside another expression, expected it alone".to_owned(),
            )),
            _ => {
                let known = quoted(&FieldExpression::functions());
                Err((offset, format!("no function {name:?}, expected one of {known}")))
            }
        }
    }

    /// Adds the square root of the sum of squares.
    fn magnitude(&mut self, offset: usize, arguments: &[Tree]) -> Result<u8, Fault> {
        let mut sum = None;
        for argument in arguments {
            let x = self.number(argument)?;
            let square = self.add(offset, Op::Binary(Binary::Multiply, x, x))?;
            sum = Some(match sum {
                None => square,
                Some(sum) => self.add(offset, Op::Binary(Binary::Add, sum, square))?,
            });
        }
        match sum {
            Some(sum) => self.add(offset, Op::Unary(Unary::Sqrt, sum)),
            None => Err((offset, "0 arguments of magnitude, expected 1 or more".to_owned())),
        }
    }
}

/// Whether an operation of the device is named like a function, not like an operator.
fn is_word(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_lowercase())
}

/// Returns the operation of two numbers with this name.
fn binary(name: &str) -> Option<Binary> {
    Binary::ALL.iter().copied().find(|function| function.name() == name)
}

#[cfg(test)]
mod tests;
