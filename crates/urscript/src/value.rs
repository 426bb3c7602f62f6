//! Values of the language.

use crate::error::ErrorKind;
use crate::limits::LIST_DEPTH;
use std::sync::Arc;

/// A value. Lists and texts are shared, so that a copy costs nothing.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// No value: result of a function without `return`, an optional argument that was not given.
    Nothing,
    /// `True`, `False`.
    Bool(bool),
    /// 32-bit integer; sums wrap as on the controller.
    Int(i32),
    /// Number.
    Float(f64),
    /// Text.
    Text(Arc<str>),
    /// `p[x, y, z, rx, ry, rz]`: m and rotation vector in rad.
    Pose([f64; 6]),
    /// `[a, b, ...]`; a matrix is a list of rows.
    List(List),
    /// `struct(a = 1, ...)`.
    Struct(Record),
}

/// A shared list that knows its size and how many elements it may hold.
#[derive(Debug, Clone)]
pub struct List(Arc<Measured<Vec<Value>>>, usize);

/// Lists are equal by their elements.
impl PartialEq for List {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

/// A shared struct value: members in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct Record(Arc<Measured<Members>>);

type Members = Vec<(Arc<str>, Value)>;

#[derive(Debug, Clone, PartialEq)]
struct Measured<T> {
    items: T,
    weight: usize,
    depth: usize,
}

fn measure<'a>(values: impl Iterator<Item = &'a Value>) -> (usize, usize) {
    values.fold((1, 0), |(w, d), v| (w.saturating_add(v.weight()), d.max(v.depth())))
}

fn check_depth(depth: usize) -> Result<(), ErrorKind> {
    if depth > LIST_DEPTH {
        return Err(ErrorKind::limit(format!("lists may be nested {LIST_DEPTH} deep")));
    }
    Ok(())
}

impl List {
    /// A list of these elements, which it keeps the number of; refused where lists are nested too
    /// deep.
    pub fn new(items: Vec<Value>) -> Result<Self, ErrorKind> {
        let (weight, depth) = measure(items.iter());
        check_depth(depth + 1)?;
        let capacity = items.len();
        Ok(Self(Arc::new(Measured { items, weight, depth: depth + 1 }), capacity))
    }
    /// How many elements the list may hold.
    pub fn capacity(&self) -> usize {
        self.1
    }
    /// The same list with another capacity, which must suffice.
    pub(crate) fn with_capacity(mut self, capacity: usize) -> Result<Self, ErrorKind> {
        let n = self.items().len();
        if n > capacity {
            return Err(ErrorKind::value(format!(
                "a list of {n} elements where {capacity} have room"
            )));
        }
        self.1 = capacity;
        Ok(self)
    }
    /// Changes the elements as a whole, within the capacity.
    pub(crate) fn edit(
        &mut self,
        change: impl FnOnce(&mut Vec<Value>) -> Result<(), ErrorKind>,
    ) -> Result<(), ErrorKind> {
        let mut items = self.items().to_vec();
        change(&mut items)?;
        *self = Self::new(items)?.with_capacity(self.1)?;
        Ok(())
    }
    /// The elements.
    pub fn items(&self) -> &[Value] {
        &self.0.items
    }
    /// Replaces an element; the index must be valid.
    pub(crate) fn replace(&mut self, index: usize, value: Value) -> Result<(), ErrorKind> {
        let inner = Arc::make_mut(&mut self.0);
        let Some(slot) = inner.items.get_mut(index) else {
            return Err(ErrorKind::value(format!("index {index} is outside the list")));
        };
        check_depth(value.depth() + 1)?;
        inner.weight = inner.weight.saturating_sub(slot.weight()).saturating_add(value.weight());
        inner.depth = inner.depth.max(value.depth() + 1);
        *slot = value;
        Ok(())
    }
    /// Takes an element out, to change it in place.
    pub(crate) fn take(&mut self, index: usize) -> Option<Value> {
        let inner = Arc::make_mut(&mut self.0);
        let taken = std::mem::replace(inner.items.get_mut(index)?, Value::Nothing);
        inner.weight = inner.weight.saturating_sub(taken.weight()).saturating_add(1);
        Some(taken)
    }
}

impl Record {
    /// A struct of these members.
    pub fn new(items: Vec<(Arc<str>, Value)>) -> Result<Self, ErrorKind> {
        let (weight, depth) = measure(items.iter().map(|(_, v)| v));
        check_depth(depth + 1)?;
        Ok(Self(Arc::new(Measured { items, weight, depth: depth + 1 })))
    }
    /// The members.
    pub fn members(&self) -> &[(Arc<str>, Value)] {
        &self.0.items
    }
    /// A member.
    pub fn get(&self, name: &str) -> Option<&Value> {
        self.0.items.iter().find(|(n, _)| **n == *name).map(|(_, v)| v)
    }
    pub(crate) fn take(&mut self, name: &str) -> Option<Value> {
        let inner = Arc::make_mut(&mut self.0);
        let (_, slot) = inner.items.iter_mut().find(|(n, _)| **n == *name)?;
        let taken = std::mem::replace(slot, Value::Nothing);
        inner.weight = inner.weight.saturating_sub(taken.weight()).saturating_add(1);
        Some(taken)
    }
    pub(crate) fn replace(&mut self, name: &str, value: Value) -> Result<(), ErrorKind> {
        check_depth(value.depth() + 1)?;
        let inner = Arc::make_mut(&mut self.0);
        let Some((_, slot)) = inner.items.iter_mut().find(|(n, _)| **n == *name) else {
            return Err(ErrorKind::value(format!("the struct has no member '{name}'")));
        };
        inner.weight = inner.weight.saturating_sub(slot.weight()).saturating_add(value.weight());
        inner.depth = inner.depth.max(value.depth() + 1);
        *slot = value;
        Ok(())
    }
}

impl Value {
    /// A text value.
    pub fn text(text: &str) -> Self {
        Self::Text(text.into())
    }
    /// A list of numbers, e.g. six joint angles.
    pub fn numbers(numbers: &[f64]) -> Self {
        let items: Vec<Value> = numbers.iter().map(|n| Value::Float(*n)).collect();
        let (weight, capacity) = (items.len() + 1, items.len());
        Self::List(List(Arc::new(Measured { items, weight, depth: 1 }), capacity))
    }
    /// The name of the type, for messages.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Bool(_) => "bool",
            Self::Int(_) => "int",
            Self::Float(_) => "float",
            Self::Text(_) => "string",
            Self::Pose(_) => "pose",
            Self::List(_) => "list",
            Self::Struct(_) => "struct",
        }
    }
    /// As number: int or float.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Int(i) => Some(f64::from(*i)),
            Self::Float(f) => Some(*f),
            _ => None,
        }
    }
    /// As integer; a float only if it is whole.
    pub fn integer(&self) -> Option<i32> {
        match self {
            Self::Int(i) => Some(*i),
            Self::Float(f) if f.fract() == 0.0 && f.abs() <= f64::from(i32::MAX) => Some(*f as i32),
            _ => None,
        }
    }
    /// As truth value.
    pub fn truth(&self) -> Option<bool> {
        match self {
            Self::Bool(b) => Some(*b),
            _ => None,
        }
    }
    /// As numbers: a list of numbers or a pose.
    pub fn vector(&self) -> Option<Vec<f64>> {
        match self {
            Self::Pose(p) => Some(p.to_vec()),
            Self::List(l) => l.items().iter().map(Value::number).collect(),
            _ => None,
        }
    }
    /// As six numbers: a pose or a list of six, e.g. joint angles.
    pub fn six(&self) -> Option<[f64; 6]> {
        self.vector()?.try_into().ok()
    }
    /// Size for the bounds: elements; 16 bytes of text count as one.
    pub fn weight(&self) -> usize {
        match self {
            Self::Text(t) => 1 + t.len() / 16,
            Self::Pose(_) => 3,
            Self::List(l) => l.0.weight,
            Self::Struct(r) => r.0.weight,
            _ => 1,
        }
    }
    fn depth(&self) -> usize {
        match self {
            Self::List(l) => l.0.depth,
            Self::Struct(r) => r.0.depth,
            _ => 0,
        }
    }
    /// Whether a variable that holds `self` may take `new`: its type must stay; ints and floats
    /// count as one type.
    pub(crate) fn may_become(&self, new: &Value) -> bool {
        use Value::*;
        matches!(
            (self, new),
            (Nothing, _)
                | (Bool(_), Bool(_))
                | (Int(_) | Float(_), Int(_) | Float(_))
                | (Text(_), Text(_))
                | (Pose(_), Pose(_))
                | (List(_), List(_))
                | (Struct(_), Struct(_))
        )
    }
}

/// Gives a variable or an element a new value: its type stays, and a list must have room there
/// ("Lists and Structs").
pub(crate) fn assign(
    place: &mut Value,
    new: Value,
    what: impl Fn() -> String,
) -> Result<(), ErrorKind> {
    if !place.may_become(&new) {
        let (from, to) = (place.kind(), new.kind());
        return Err(ErrorKind::Type(format!(
            "{} is of type {from} and cannot become {to}",
            what()
        )));
    }
    *place = match (&*place, new) {
        (Value::List(old), Value::List(new)) => Value::List(new.with_capacity(old.capacity())?),
        (_, new) => new,
    };
    Ok(())
}

/// The form that `to_str` and `textmsg` give.
impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let commas = |f: &mut std::fmt::Formatter<'_>, items: &[Value]| {
            for (i, v) in items.iter().enumerate() {
                write!(f, "{}{v}", if i > 0 { ", " } else { "" })?;
            }
            f.write_str("]")
        };
        match self {
            Self::Nothing => f.write_str("None"),
            Self::Bool(b) => f.write_str(if *b { "True" } else { "False" }),
            Self::Int(i) => write!(f, "{i}"),
            Self::Float(x) => f.write_str(&float_text(*x)),
            Self::Text(t) => f.write_str(t),
            Self::Pose(p) => {
                f.write_str("p[")?;
                commas(f, &p.map(Value::Float))
            }
            Self::List(l) => {
                f.write_str("[")?;
                commas(f, l.items())
            }
            Self::Struct(r) => {
                f.write_str("struct(")?;
                for (i, (n, v)) in r.members().iter().enumerate() {
                    write!(f, "{}{n} = {v}", if i > 0 { ", " } else { "" })?;
                }
                f.write_str(")")
            }
        }
    }
}

/// Six significant digits, no trailing zeros: the controller's way to print a number.
fn float_text(x: f64) -> String {
    if !x.is_finite() {
        return format!("{x}").to_lowercase();
    }
    if x == 0.0 {
        return "0".into();
    }
    let exponent = x.abs().log10().floor() as i32;
    if !(-5..6).contains(&exponent) {
        let text = format!("{x:.5e}");
        let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
        let digits = if digits.contains('.') {
            digits.trim_end_matches('0').trim_end_matches('.')
        } else {
            digits
        };
        let power: i32 = power.parse().unwrap_or(0);
        let sign = if power < 0 { '-' } else { '+' };
        return format!("{digits}e{sign}{:02}", power.abs());
    }
    let text = format!("{x:.*}", (5 - exponent).max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}
