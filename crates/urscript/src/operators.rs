//! Arithmetic and comparison.
//!
//! Ints stay ints under `+ - * %`; `/` always gives a float. Lists of numbers (and matrices) are
//! added, subtracted and scaled element by element; matrix times matrix or list is the product of
//! linear algebra ("Matrix and Array Expressions"). Poses have functions instead of operators.

use crate::error::ErrorKind;
use crate::syntax::{Binary, Unary};
use crate::value::{List, Value};

type Result<T> = std::result::Result<T, ErrorKind>;

/// `-a`, `+a`, `not a`.
pub(crate) fn unary(operator: Unary, value: &Value) -> Result<Value> {
    match (operator, value) {
        (Unary::Not, Value::Bool(b)) => Ok(Value::Bool(!b)),
        (Unary::Minus, Value::Int(i)) => Ok(Value::Int(i.wrapping_neg())),
        (Unary::Minus, Value::Float(x)) => Ok(Value::Float(-x)),
        (Unary::Minus, Value::List(l)) => {
            let items: Result<Vec<Value>> = l.items().iter().map(|v| unary(operator, v)).collect();
            Ok(Value::List(List::new(items?)?))
        }
        (Unary::Plus, Value::Int(_) | Value::Float(_) | Value::List(_)) => Ok(value.clone()),
        (Unary::Not, v) => Err(ErrorKind::of_type(format!("'not' needs a bool, not {}", v.kind()))),
        (_, v) => Err(ErrorKind::of_type(format!("a sign before {}", v.kind()))),
    }
}

/// Operators with two operands, `and` and `or` aside.
pub(crate) fn binary(operator: Binary, a: &Value, b: &Value) -> Result<Value> {
    match operator {
        Binary::Equal => Ok(Value::Bool(equal(a, b))),
        Binary::Unequal => Ok(Value::Bool(!equal(a, b))),
        Binary::Xor => match (a.truth(), b.truth()) {
            (Some(a), Some(b)) => Ok(Value::Bool(a != b)),
            _ => Err(misfit("xor", a, b)),
        },
        Binary::Less => compare("<", a, b, |o| o.is_lt()),
        Binary::LessEqual => compare("<=", a, b, |o| o.is_le()),
        Binary::Greater => compare(">", a, b, |o| o.is_gt()),
        Binary::GreaterEqual => compare(">=", a, b, |o| o.is_ge()),
        _ => arithmetic(operator, a, b),
    }
}

/// Equality: numbers by value, lists and structs by their elements; different types are unequal.
pub(crate) fn equal(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::List(a), Value::List(b)) => {
            a.items().len() == b.items().len()
                && a.items().iter().zip(b.items()).all(|(a, b)| equal(a, b))
        }
        (Value::Struct(a), Value::Struct(b)) => {
            let pairs = a.members().iter().zip(b.members());
            a.members().len() == b.members().len()
                && pairs.into_iter().all(|(a, b)| a.0 == b.0 && equal(&a.1, &b.1))
        }
        _ => match (a.number(), b.number()) {
            (Some(a), Some(b)) => a == b,
            _ => a == b,
        },
    }
}

fn misfit(sign: &str, a: &Value, b: &Value) -> ErrorKind {
    ErrorKind::of_type(format!("'{sign}' between {} and {}", a.kind(), b.kind()))
}

fn compare(sign: &str, a: &Value, b: &Value, is: fn(std::cmp::Ordering) -> bool) -> Result<Value> {
    match (a.number(), b.number()) {
        (Some(a), Some(b)) => Ok(Value::Bool(a.partial_cmp(&b).is_some_and(is))),
        _ => Err(misfit(sign, a, b)),
    }
}

fn sign(operator: Binary) -> &'static str {
    match operator {
        Binary::Add => "+",
        Binary::Subtract => "-",
        Binary::Multiply => "*",
        Binary::Divide => "/",
        _ => "%",
    }
}

fn arithmetic(operator: Binary, a: &Value, b: &Value) -> Result<Value> {
    match (a, b) {
        (Value::Int(x), Value::Int(y)) => integers(operator, *x, *y),
        (Value::List(x), Value::List(y)) => lists(operator, x, y),
        (Value::List(x), _) if b.number().is_some() => each(x, |v| arithmetic(operator, v, b)),
        (_, Value::List(y)) if a.number().is_some() => each(y, |v| arithmetic(operator, a, v)),
        (Value::Text(_), _) | (_, Value::Text(_)) => {
            let hint = "join strings by str_cat";
            Err(ErrorKind::of_type(format!(
                "'{}' between {} and {}: {hint}",
                sign(operator),
                a.kind(),
                b.kind()
            )))
        }
        _ => match (a.number(), b.number()) {
            (Some(x), Some(y)) => floats(operator, x, y),
            _ => Err(misfit(sign(operator), a, b)),
        },
    }
}

fn integers(operator: Binary, a: i32, b: i32) -> Result<Value> {
    Ok(Value::Int(match operator {
        Binary::Add => a.wrapping_add(b),
        Binary::Subtract => a.wrapping_sub(b),
        Binary::Multiply => a.wrapping_mul(b),
        Binary::Modulo if b != 0 => a.wrapping_rem(b),
        _ => return floats(operator, f64::from(a), f64::from(b)),
    }))
}

fn floats(operator: Binary, a: f64, b: f64) -> Result<Value> {
    Ok(Value::Float(match operator {
        Binary::Add => a + b,
        Binary::Subtract => a - b,
        Binary::Multiply => a * b,
        _ if b == 0.0 => return Err(ErrorKind::value("division by zero")),
        Binary::Divide => a / b,
        _ => a % b,
    }))
}

fn each(list: &List, f: impl Fn(&Value) -> Result<Value>) -> Result<Value> {
    let items: Result<Vec<Value>> = list.items().iter().map(f).collect();
    Ok(Value::List(List::new(items?)?))
}

fn lists(operator: Binary, a: &List, b: &List) -> Result<Value> {
    let matrix = |l: &List| l.items().first().is_some_and(|v| matches!(v, Value::List(_)));
    if operator == Binary::Multiply && (matrix(a) || matrix(b)) {
        return product(a, b, matrix(a), matrix(b));
    }
    if a.items().len() != b.items().len() {
        let (n, m) = (a.items().len(), b.items().len());
        return Err(ErrorKind::value(format!(
            "'{}' between lists of {n} and {m} elements",
            sign(operator)
        )));
    }
    let items: Result<Vec<Value>> =
        a.items().iter().zip(b.items()).map(|(a, b)| arithmetic(operator, a, b)).collect();
    Ok(Value::List(List::new(items?)?))
}

/// Rows of a matrix of numbers; every row has the same length.
pub(crate) fn rows(list: &List) -> Result<Vec<Vec<f64>>> {
    let rows: Option<Vec<Vec<f64>>> = list
        .items()
        .iter()
        .map(|r| match r {
            Value::List(_) => r.vector(),
            _ => None,
        })
        .collect();
    let rows = rows.ok_or_else(|| ErrorKind::of_type("a matrix is a list of lists of numbers"))?;
    if rows.iter().any(|r| r.len() != rows[0].len()) {
        return Err(ErrorKind::value("the rows of a matrix have different lengths"));
    }
    Ok(rows)
}

fn product(a: &List, b: &List, a_matrix: bool, b_matrix: bool) -> Result<Value> {
    let numbers = |l: &List| {
        Value::List(l.clone())
            .vector()
            .ok_or_else(|| ErrorKind::of_type("a list of numbers is needed in a product"))
    };
    let left = if a_matrix { rows(a)? } else { vec![numbers(a)?] };
    let right =
        if b_matrix { rows(b)? } else { numbers(b)?.into_iter().map(|x| vec![x]).collect() };
    let inner = left.first().map_or(0, Vec::len);
    if inner != right.len() {
        return Err(ErrorKind::value(format!(
            "a product of matrices with {inner} columns and {} rows",
            right.len()
        )));
    }
    let columns = right.first().map_or(0, Vec::len);
    let cell =
        |r: &Vec<f64>, c: usize| r.iter().zip(&right).map(|(x, row)| x * row[c]).sum::<f64>();
    let out: Vec<Vec<f64>> =
        left.iter().map(|r| (0..columns).map(|c| cell(r, c)).collect()).collect();
    Ok(match (a_matrix, b_matrix) {
        (true, true) => Value::List(List::new(out.iter().map(|r| Value::numbers(r)).collect())?),
        _ => Value::numbers(&out.concat()),
    })
}

/// The element of a value that these indices name.
pub(crate) fn element(value: &Value, indices: &[Value]) -> Result<Value> {
    let mut here = value.clone();
    for index in indices {
        here = match &here {
            Value::List(l) => l.items()[position(index, l.items().len(), "list")?].clone(),
            Value::Pose(p) => Value::Float(p[position(index, 6, "pose")?]),
            Value::Struct(r) => {
                r.members()[position(index, r.members().len(), "struct")?].1.clone()
            }
            other => return Err(ErrorKind::of_type(format!("{} has no elements", other.kind()))),
        };
    }
    Ok(here)
}

/// A checked index.
pub(crate) fn position(index: &Value, len: usize, what: &str) -> Result<usize> {
    let whole = index.integer();
    let whole = whole.ok_or_else(|| {
        ErrorKind::of_type(format!("an index is a whole number, not {}", index.kind()))
    })?;
    match usize::try_from(whole) {
        Ok(at) if at < len => Ok(at),
        _ => {
            Err(ErrorKind::value(format!("index {whole} is outside the {what} of {len} elements")))
        }
    }
}
