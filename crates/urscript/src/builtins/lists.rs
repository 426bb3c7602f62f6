//! Lists, matrices, bits.

use super::{Result, integer_of, pose};
use crate::error::ErrorKind;
use crate::operators::rows;
use crate::value::{List, Value};
use nalgebra::DMatrix;

pub(super) fn call(name: &str, args: &[Value], limit: usize) -> Result<Value> {
    let first = args.first().unwrap_or(&Value::Nothing);
    match name {
        "length" | "get_list_length" => match first {
            Value::List(l) => count(l.items().len()),
            Value::Pose(_) => Ok(Value::Int(6)),
            Value::Text(t) if name == "length" => count(t.chars().count()),
            Value::Struct(r) if name == "length" => count(r.members().len()),
            other => Err(ErrorKind::of_type(format!("a list is needed, not {}", other.kind()))),
        },
        "size" => match first {
            Value::List(l) => match l.items().first() {
                Some(Value::List(row)) => {
                    let sizes = vec![count(l.items().len())?, count(row.items().len())?];
                    Ok(Value::List(List::new(sizes)?))
                }
                _ => count(l.items().len()),
            },
            Value::Pose(_) => Ok(Value::Int(6)),
            other => Err(ErrorKind::of_type(format!("a list is needed, not {}", other.kind()))),
        },
        "make_list" => {
            let wanted = integer_of(first)?;
            let value = args.get(1).unwrap_or(&Value::Nothing);
            let n = usize::try_from(wanted)
                .map_err(|_| ErrorKind::value(format!("a list of {wanted} elements")))?;
            if n.saturating_mul(value.weight()) >= limit {
                return Err(ErrorKind::limit(format!("a list of {n} elements")));
            }
            let capacity = match args.get(2) {
                None | Some(Value::Nothing) => n,
                Some(wanted) => usize::try_from(integer_of(wanted)?).unwrap_or(0),
            };
            Ok(Value::List(List::new(vec![value.clone(); n])?.with_capacity(capacity)?))
        }
        "binary_list_to_integer" => {
            let Value::List(l) = first else {
                return Err(ErrorKind::of_type(format!("a list is needed, not {}", first.kind())));
            };
            let mut bits = 0_u32;
            for (at, bit) in l.items().iter().take(32).enumerate() {
                let bit = bit
                    .truth()
                    .ok_or_else(|| ErrorKind::of_type(format!("bit {at} is no bool")))?;
                bits |= u32::from(bit) << at;
            }
            Ok(Value::Int(bits as i32))
        }
        "integer_to_binary_list" => {
            let bits = integer_of(first)? as u32;
            Ok(Value::List(List::new(
                (0..32).map(|at| Value::Bool(bits >> at & 1 == 1)).collect(),
            )?))
        }
        "transpose" => {
            // A list is a row; a matrix of one column becomes a list again.
            if let Some(row) = first.vector() {
                return build(&DMatrix::from_column_slice(row.len(), 1, &row));
            }
            let m = matrix(first)?;
            if m.ncols() == 1 {
                return Ok(Value::numbers(m.as_slice()));
            }
            build(&m.transpose())
        }
        _ => {
            if let Value::Pose(p) = first {
                return Ok(Value::Pose(pose::inverse(p)));
            }
            let m = matrix(first)?;
            if m.nrows() != m.ncols() || m.nrows() > 32 {
                return Err(ErrorKind::value(format!(
                    "no inverse of {} by {}",
                    m.nrows(),
                    m.ncols()
                )));
            }
            let inverse = m.try_inverse().filter(|m| m.iter().all(|x| x.is_finite()));
            build(&inverse.ok_or_else(|| ErrorKind::value("the matrix is singular"))?)
        }
    }
}

fn count(n: usize) -> Result<Value> {
    i32::try_from(n).map(Value::Int).map_err(|_| ErrorKind::value(format!("{n} elements")))
}

fn matrix(value: &Value) -> Result<DMatrix<f64>> {
    let Value::List(list) = value else {
        return Err(ErrorKind::of_type(format!("a matrix is needed, not {}", value.kind())));
    };
    let rows = rows(list)?;
    let columns = rows.first().map_or(0, Vec::len);
    if columns == 0 {
        return Err(ErrorKind::value("an empty matrix"));
    }
    Ok(DMatrix::from_row_iterator(rows.len(), columns, rows.into_iter().flatten()))
}

fn build(m: &DMatrix<f64>) -> Result<Value> {
    let rows =
        m.row_iter().map(|r| Value::numbers(&r.iter().copied().collect::<Vec<_>>())).collect();
    Ok(Value::List(List::new(rows)?))
}
