//! Functions of values: `list.append(1)` ("Methods in URScript").

use crate::error::ErrorKind;
use crate::operators::{position, rows};
use crate::syntax::Method;
use crate::value::{List, Value};

type Result<T> = std::result::Result<T, ErrorKind>;

fn list_of(value: &Value) -> Result<&List> {
    match value {
        Value::List(list) => Ok(list),
        other => Err(ErrorKind::of_type(format!("a list is needed, not {}", other.kind()))),
    }
}

fn count(n: usize) -> Result<Value> {
    i32::try_from(n).map(Value::Int).map_err(|_| ErrorKind::value(format!("{n} elements")))
}

/// Methods that leave their value as it is.
pub(crate) fn ask(method: Method, base: &Value, args: &[Value]) -> Result<Value> {
    let arg = |at: usize| args.get(at).unwrap_or(&Value::Nothing);
    match method {
        Method::ToString => Ok(Value::text(&base.to_string())),
        Method::Length => match base {
            Value::Struct(record) => count(record.members().len()),
            other => count(list_of(other)?.items().len()),
        },
        Method::Capacity => count(list_of(base)?.capacity()),
        Method::ExcessCapacity => {
            let list = list_of(base)?;
            count(list.capacity() - list.items().len())
        }
        Method::Slice => {
            let items = list_of(base)?.items();
            let from = position(arg(0), items.len() + 1, "list")?;
            let to = position(arg(1), items.len() + 1, "list")?;
            Ok(Value::List(List::new(items.get(from..to).unwrap_or_default().to_vec())?))
        }
        _ => {
            let rows = rows(list_of(base)?)?;
            let columns = rows.first().map_or(0, Vec::len);
            match method {
                Method::GetRow => {
                    Ok(Value::numbers(&rows[position(arg(0), rows.len(), "matrix")?]))
                }
                Method::GetColumn => {
                    let at = position(arg(0), columns, "matrix")?;
                    Ok(Value::numbers(&rows.iter().map(|r| r[at]).collect::<Vec<_>>()))
                }
                _ => Ok(Value::List(List::new(vec![count(rows.len())?, count(columns)?])?)),
            }
        }
    }
}

/// Methods that change their list.
pub(crate) fn change(method: Method, base: &mut Value, args: &[Value]) -> Result<()> {
    let Value::List(list) = base else {
        return Err(ErrorKind::of_type(format!("a list is needed, not {}", base.kind())));
    };
    let arg = |at: usize| args.get(at).unwrap_or(&Value::Nothing);
    list.edit(|items| {
        let fits = |items: &[Value], new: &Value| match items.first() {
            Some(old) if !old.may_become(new) => {
                Err(ErrorKind::of_type(format!("{} in a list of {}", new.kind(), old.kind())))
            }
            _ => Ok(()),
        };
        match method {
            Method::Append => {
                fits(items, arg(0))?;
                items.push(arg(0).clone());
            }
            Method::Extend => {
                for new in list_of(arg(0))?.items() {
                    fits(items, new)?;
                    items.push(new.clone());
                }
            }
            Method::Insert => {
                fits(items, arg(1))?;
                items.insert(position(arg(0), items.len() + 1, "list")?, arg(1).clone());
            }
            Method::Remove => {
                items.remove(position(arg(0), items.len(), "list")?);
            }
            Method::Pop => {
                items.pop().ok_or_else(|| ErrorKind::value("the list is empty"))?;
            }
            _ => items.clear(),
        }
        Ok(())
    })
}
