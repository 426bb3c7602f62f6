//! Numbers.

use super::Result;
use crate::error::ErrorKind;
use crate::value::Value;

/// A number in [0, 1) from a counter that every call moves on (splitmix64).
pub(super) fn random(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    (z >> 11) as f64 / (1_u64 << 53) as f64
}

fn whole(x: f64) -> Result<Value> {
    if x.abs() <= f64::from(i32::MAX) {
        return Ok(Value::Int(x as i32));
    }
    Err(ErrorKind::value(format!("{x} does not fit an integer")))
}

pub(super) fn one(name: &str, x: f64) -> Result<Value> {
    let y = match name {
        "acos" | "asin" if !(-1.0..=1.0).contains(&x) => {
            return Err(ErrorKind::value(format!("{x} is outside -1 to 1")));
        }
        "sqrt" if x < 0.0 => return Err(ErrorKind::value(format!("root of {x}"))),
        "acos" => x.acos(),
        "asin" => x.asin(),
        "atan" => x.atan(),
        "cos" => x.cos(),
        "sin" => x.sin(),
        "tan" => x.tan(),
        "sqrt" => x.sqrt(),
        "d2r" => x.to_radians(),
        "r2d" => x.to_degrees(),
        "ceil" => return whole(x.ceil()),
        _ => return whole(x.floor()),
    };
    Ok(Value::Float(y))
}

pub(super) fn two(name: &str, a: f64, b: f64) -> Result<Value> {
    match name {
        "atan2" => Ok(Value::Float(a.atan2(b))),
        "pow" if (a < 0.0 && b.fract() != 0.0) || (a == 0.0 && b < 0.0) => {
            Err(ErrorKind::value(format!("{a} to the power of {b}")))
        }
        "pow" => Ok(Value::Float(a.powf(b))),
        // Base first.
        _ if a > 0.0 && a != 1.0 && b > 0.0 => Ok(Value::Float(b.ln() / a.ln())),
        _ => Err(ErrorKind::value(format!("logarithm of {b} to the base {a}"))),
    }
}

/// A list of numbers scaled to length 1.
pub(super) fn normalize(value: &Value) -> Result<Value> {
    let all = value.vector().filter(|_| !matches!(value, Value::Pose(_)));
    let all = all.ok_or_else(|| ErrorKind::of_type("a list of numbers is needed"))?;
    let length = all.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length == 0.0 {
        return Err(ErrorKind::value("a list of zeros has no direction"));
    }
    Ok(Value::numbers(&all.iter().map(|x| x / length).collect::<Vec<_>>()))
}

/// Length of a list of numbers or of all six numbers of a pose; amount of a number.
pub(super) fn norm(value: &Value) -> Result<Value> {
    if let Some(x) = value.number() {
        return Ok(Value::Float(x.abs()));
    }
    let all = value.vector();
    let all = all.ok_or_else(|| {
        ErrorKind::of_type(format!("a list, pose or number is needed, not {}", value.kind()))
    })?;
    Ok(Value::Float(all.iter().map(|x| x * x).sum::<f64>().sqrt()))
}
