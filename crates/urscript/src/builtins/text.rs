//! Strings; positions count characters.

use super::{Result, integer_of};
use crate::error::ErrorKind;
use crate::value::Value;

pub(super) fn call(name: &str, args: &[Value], limit: usize) -> Result<Value> {
    let first = args.first().unwrap_or(&Value::Nothing);
    let second = args.get(1).unwrap_or(&Value::Nothing);
    match name {
        "to_str" => Ok(Value::text(&bounded(first.to_string(), limit)?)),
        "str_cat" => Ok(Value::text(&bounded(format!("{first}{second}"), limit)?)),
        "str_empty" => Ok(Value::Bool(text(first)?.is_empty())),
        "str_len" => Ok(Value::Int(text(first)?.chars().count() as i32)),
        "str_at" => {
            let (source, at) = (text(first)?, index(second)?);
            let found = source.chars().nth(at).ok_or_else(|| outside(at))?;
            Ok(Value::text(found.encode_utf8(&mut [0; 4])))
        }
        "str_sub" => {
            let (source, at) = (text(first)?, index(second)?);
            let len = match args.get(2) {
                None | Some(Value::Nothing) => usize::MAX,
                Some(len) => index(len)?,
            };
            if at > source.chars().count() {
                return Err(outside(at));
            }
            Ok(Value::text(&source.chars().skip(at).take(len).collect::<String>()))
        }
        "str_find" => {
            let (source, target) = (text(first)?, text(second)?);
            let from = index(args.get(2).unwrap_or(&Value::Int(0)))?;
            let start = source.char_indices().nth(from).map_or(source.len(), |(at, _)| at);
            let found = source[start..].find(target);
            Ok(Value::Int(found.map_or(-1, |at| source[..start + at].chars().count() as i32)))
        }
        _ => {
            let source = text(first)?.trim();
            if let Ok(whole) = source.parse::<i32>() {
                return Ok(Value::Int(whole));
            }
            let plain = source.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
            let number = source.parse::<f64>().ok().filter(|_| plain);
            number
                .map(Value::Float)
                .ok_or_else(|| ErrorKind::value(format!("'{source:.40}' is not a number")))
        }
    }
}

fn bounded(text: String, limit: usize) -> Result<String> {
    if 1 + text.len() / 16 > limit {
        return Err(ErrorKind::limit(format!("a string of {} bytes", text.len())));
    }
    Ok(text)
}

fn outside(at: usize) -> ErrorKind {
    ErrorKind::value(format!("position {at} is outside the string"))
}

fn text(value: &Value) -> Result<&str> {
    match value {
        Value::Text(t) => Ok(t),
        other => Err(ErrorKind::of_type(format!("a string is needed, not {}", other.kind()))),
    }
}

fn index(value: &Value) -> Result<usize> {
    let whole = integer_of(value)?;
    usize::try_from(whole).map_err(|_| ErrorKind::value(format!("position {whole} is negative")))
}
