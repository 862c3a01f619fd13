//! Parses the text of an expression into a tree whose nodes know their positions in the text.

use winnow::LocatingSlice;
use winnow::ascii::multispace0;
use winnow::combinator::{alt, cut_err, delimited, fail, opt, peek, preceded, repeat, terminated};
use winnow::error::{ContextError, ErrMode, StrContext, StrContextValue};
use winnow::prelude::*;
use winnow::stream::Location;
use winnow::token::{any, none_of, one_of, take_while};

use super::Fault;

/// Maximum nesting depth of parentheses and signs, because each level takes a part of the stack.
const MAX_DEPTH: usize = 48;

/// A node of the tree of an expression, with the nodes below it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tree {
    /// Byte of the text at which the node begins; for an infix operation, the byte of its symbol.
    pub(super) offset: usize,
    pub(super) node_kind: NodeKind,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum NodeKind {
    /// A number. `integer` is its exact value if it is written as a whole number, because a float may round it.
    Number {
        value: f32,
        integer: Option<i128>,
    },
    Name(String),
    Negate(Box<Tree>),
    Not(Box<Tree>),
    Infix(&'static str, Box<Tree>, Box<Tree>),
    Call(String, Vec<Tree>),
}

impl Tree {
    /// Returns the exact value of a number that is written as a whole number; `None` for any other node.
    pub(super) fn integer(&self) -> Option<i128> {
        match &self.node_kind {
            NodeKind::Number { integer, .. } => *integer,
            NodeKind::Negate(inner) => inner.integer().map(|number| -number),
            _ => None,
        }
    }
}

type Input<'a> = LocatingSlice<&'a str>;

/// Parses a whole text.
pub(super) fn parse(text: &str) -> Result<Tree, Fault> {
    check_depth(text)?;
    terminated(disjunction, multispace0)
        .parse(LocatingSlice::new(text))
        .map_err(|error| {
            let expected: Vec<String> = error
                .inner()
                .context()
                .filter_map(|context| match context {
                    StrContext::Expected(value) => Some(value.to_string()),
                    _ => None,
                })
                .collect();
            let why = if expected.is_empty() {
                "expected an operator, or the end".to_owned()
            } else {
                format!("expected {}", expected.join(" or "))
            };
            (error.offset(), why)
        })
}

/// Refuses texts that nest too deeply. Counts text in quotation marks too, because names hardly contain parentheses or signs.
fn check_depth(text: &str) -> Result<(), Fault> {
    let (mut open, mut signs) = (0usize, 0usize);
    for (offset, c) in text.char_indices() {
        match c {
            '(' => open += 1,
            ')' => open = open.saturating_sub(1),
            _ => {}
        }
        match c {
            '-' | '!' | '^' => signs += 1,
            _ if c.is_whitespace() || c == '(' => {}
            // Powers nest to the right, so signs before them add up over the whole text.
            _ if !text.contains('^') => signs = 0,
            _ => {}
        }
        if open + signs > MAX_DEPTH {
            return Err((offset, format!("more than {MAX_DEPTH} parts within each other")));
        }
    }
    Ok(())
}

fn expected(what: &'static str) -> StrContext {
    StrContext::Expected(StrContextValue::Description(what))
}

/// Parses one of several symbols behind optional spaces. Symbols are tried in order, so longer ones must come first. Returns the position
/// and the symbol.
fn symbol<'a>(
    symbols: &'static [&'static str],
) -> impl FnMut(&mut Input<'a>) -> Result<(usize, &'static str), ErrMode<ContextError>> {
    move |input| {
        multispace0(input)?;
        let offset = input.current_token_start();
        for &symbol in symbols {
            if input.starts_with(symbol) {
                let mut rest = symbol.chars();
                while rest.next().is_some() {
                    any(input)?;
                }
                return Ok((offset, symbol));
            }
        }
        Err(ErrMode::Backtrack(ContextError::new()))
    }
}

/// Parses operands that are joined by symbols, left-associative. `part` parses an operand, which binds more strongly.
fn chain<'a>(
    symbols: &'static [&'static str],
    part: fn(&mut Input<'a>) -> ModalResult<Tree>,
) -> impl FnMut(&mut Input<'a>) -> ModalResult<Tree> {
    move |input| {
        let first = part(input)?;
        let rest: Vec<((usize, &'static str), Tree)> =
            repeat(0.., (symbol(symbols), cut_err(part))).parse_next(input)?;
        Ok(rest.into_iter().fold(first, |left, ((offset, symbol), right)| Tree {
            offset,
            node_kind: NodeKind::Infix(symbol, Box::new(left), Box::new(right)),
        }))
    }
}

/// Parses operands of `||`: a whole expression.
fn disjunction(input: &mut Input<'_>) -> ModalResult<Tree> {
    chain(&["||"], conjunction)(input)
}

/// Parses operands of `&&`.
fn conjunction(input: &mut Input<'_>) -> ModalResult<Tree> {
    chain(&["&&"], comparison)(input)
}

/// Parses a sum, or a comparison of two sums.
fn comparison(input: &mut Input<'_>) -> ModalResult<Tree> {
    let left = sum(input)?;
    let right = opt((symbol(&["<=", ">=", "==", "!=", "<", ">"]), cut_err(sum))).parse_next(input)?;
    Ok(match right {
        None => left,
        Some(((offset, symbol), right)) => Tree {
            offset,
            node_kind: NodeKind::Infix(symbol, Box::new(left), Box::new(right)),
        },
    })
}

fn sum(input: &mut Input<'_>) -> ModalResult<Tree> {
    chain(&["+", "-"], product)(input)
}

fn product(input: &mut Input<'_>) -> ModalResult<Tree> {
    chain(&["*", "/"], sign)(input)
}

/// Parses a power, with signs before it.
fn sign(input: &mut Input<'_>) -> ModalResult<Tree> {
    let Some((offset, symbol)) = opt(symbol(&["-", "!"])).parse_next(input)? else {
        return power(input);
    };
    let inner = Box::new(cut_err(sign).parse_next(input)?);
    let node_kind = if symbol == "-" {
        NodeKind::Negate(inner)
    } else {
        NodeKind::Not(inner)
    };
    Ok(Tree { offset, node_kind })
}

/// Parses a power. Powers are right-associative, and bind more strongly than a sign before them.
fn power(input: &mut Input<'_>) -> ModalResult<Tree> {
    let base = atom(input)?;
    let exponent = opt((symbol(&["^"]), cut_err(sign))).parse_next(input)?;
    Ok(match exponent {
        None => base,
        Some(((offset, symbol), exponent)) => Tree {
            offset,
            node_kind: NodeKind::Infix(symbol, Box::new(base), Box::new(exponent)),
        },
    })
}

/// Parses a number, a name, a call, or an expression in parentheses.
fn atom(input: &mut Input<'_>) -> ModalResult<Tree> {
    multispace0(input)?;
    let offset = input.current_token_start();
    let parenthesised = delimited('(', cut_err(disjunction), close).map(|tree| tree.node_kind);
    let nothing = fail.context(expected("a number, a field, a function or ("));
    alt((parenthesised, number, quoted.map(NodeKind::Name), name_or_call, nothing))
        .map(|node_kind| Tree { offset, node_kind })
        .parse_next(input)
}

/// Parses a closing parenthesis.
fn close(input: &mut Input<'_>) -> ModalResult<char> {
    cut_err(preceded(multispace0, ')'))
        .context(expected("an operator"))
        .context(expected(")"))
        .parse_next(input)
}

fn number(input: &mut Input<'_>) -> ModalResult<NodeKind> {
    let digits = |c: char| c.is_ascii_digit();
    let exponent = (one_of(['e', 'E']), opt(one_of(['+', '-'])), take_while(1.., digits));
    let text = (
        peek(one_of(|c: char| c.is_ascii_digit() || c == '.')),
        take_while(0.., digits),
        opt(('.', take_while(0.., digits))),
        opt(exponent),
    )
        .take()
        .parse_next(input)?;
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(NodeKind::Number {
            value,
            integer: text.parse().ok(),
        }),
        _ => Err(ErrMode::Backtrack(ContextError::new())),
    }
}

/// Parses a name in quotation marks.
fn quoted(input: &mut Input<'_>) -> ModalResult<String> {
    let name = |mark: char| delimited(mark, take_while(1.., move |c| c != mark), cut_err(mark));
    let checked = alt((name('"'), name('`'))).map(str::to_owned);
    preceded(peek(none_of(|c: char| c.is_whitespace())), checked)
        .context(expected("a name in quotation marks"))
        .parse_next(input)
}

/// Parses a word: a field, or a function with its arguments.
fn name_or_call(input: &mut Input<'_>) -> ModalResult<NodeKind> {
    let is_first = |c: char| c.is_alphabetic() || c == '_';
    let word = (
        one_of(is_first),
        take_while(0.., |c: char| c.is_alphanumeric() || c == '_'),
    );
    let name: &str = word.take().parse_next(input)?;
    if opt(symbol(&["("])).parse_next(input)?.is_none() {
        return Ok(NodeKind::Name(name.to_owned()));
    }
    let mut arguments = Vec::from_iter(opt(disjunction).parse_next(input)?);
    if !arguments.is_empty() {
        let others: Vec<Tree> = repeat(0.., preceded((multispace0, ','), cut_err(disjunction))).parse_next(input)?;
        arguments.extend(others);
    }
    cut_err(preceded(multispace0, ')'))
        .context(expected("an operator"))
        .context(expected(", or )"))
        .parse_next(input)?;
    Ok(NodeKind::Call(name.to_owned(), arguments))
}
