//! JSON values in messages. They are a list of tokens, as formats that do not describe themselves cannot read JSON, and as its text would
//! round numbers. For `serde(with)`.

use serde::de::{Deserializer, Error};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Map, Number, Value};

/// Maximum depth of nested values, as serde_json has it for texts.
const MAX_DEPTH: u32 = 128;

#[derive(Serialize, Deserialize)]
enum Token {
    Null,
    Bool(bool),
    Unsigned(u64),
    Signed(i64),
    Float(f64),
    Text(String),
    /// The number of values that follow.
    Array(u64),
    /// The number of pairs that follow: a text and a value each.
    Object(u64),
}

pub(super) fn serialize<S: Serializer>(value: &Option<Value>, serializer: S) -> Result<S::Ok, S::Error> {
    let mut tokens = Vec::new();
    value.iter().for_each(|value| write(value, &mut tokens));
    tokens.serialize(serializer)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Value>, D::Error> {
    let mut tokens = Vec::<Token>::deserialize(deserializer)?.into_iter().peekable();
    if tokens.peek().is_none() {
        return Ok(None);
    }
    let value = read(&mut tokens, 0).filter(|_| tokens.peek().is_none());
    value
        .map(Some)
        .ok_or_else(|| D::Error::custom("tokens of no JSON value"))
}

fn write(value: &Value, tokens: &mut Vec<Token>) {
    match value {
        Value::Null => tokens.push(Token::Null),
        Value::Bool(value) => tokens.push(Token::Bool(*value)),
        Value::Number(number) => tokens.push(match (number.as_u64(), number.as_i64()) {
            (Some(n), _) => Token::Unsigned(n),
            (None, Some(n)) => Token::Signed(n),
            (None, None) => Token::Float(number.as_f64().unwrap_or(f64::NAN)),
        }),
        Value::String(text) => tokens.push(Token::Text(text.clone())),
        Value::Array(values) => {
            tokens.push(Token::Array(values.len() as u64));
            values.iter().for_each(|value| write(value, tokens));
        }
        Value::Object(pairs) => {
            tokens.push(Token::Object(pairs.len() as u64));
            for (name, value) in pairs {
                tokens.push(Token::Text(name.clone()));
                write(value, tokens);
            }
        }
    }
}

fn read(tokens: &mut impl Iterator<Item = Token>, depth: u32) -> Option<Value> {
    if depth > MAX_DEPTH {
        return None;
    }
    Some(match tokens.next()? {
        Token::Null => Value::Null,
        Token::Bool(value) => Value::Bool(value),
        Token::Unsigned(n) => n.into(),
        Token::Signed(n) => n.into(),
        Token::Float(x) => Number::from_f64(x)?.into(),
        Token::Text(text) => text.into(),
        Token::Array(count) => Value::Array((0..count).map(|_| read(tokens, depth + 1)).collect::<Option<_>>()?),
        Token::Object(count) => {
            let pair = |_| match tokens.next()? {
                Token::Text(name) => Some((name, read(tokens, depth + 1)?)),
                _ => None,
            };
            Value::Object((0..count).map(pair).collect::<Option<Map<_, _>>>()?)
        }
    })
}
