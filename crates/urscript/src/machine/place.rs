//! Changes inside a value: the element that a path leads to.

use crate::error::ErrorKind;
use crate::operators;
use crate::value::Value;

type Kind<T> = Result<T, ErrorKind>;

/// A step into a value with its index.
pub(super) enum Key<'a> {
    Index(&'a Value),
    Member(&'a str),
}

/// Changes the element that the keys lead to.
pub(super) fn change(
    base: &mut Value,
    keys: &[Key<'_>],
    edit: impl FnOnce(&mut Value) -> Kind<()>,
) -> Kind<()> {
    // Down the path, taking each value out of the one around it, and up again.
    let mut around = Vec::new();
    let mut here = std::mem::replace(base, Value::Nothing);
    for key in keys {
        let inner = take(&mut here, key)?;
        around.push(std::mem::replace(&mut here, inner));
    }
    edit(&mut here)?;
    for (key, mut outer) in keys.iter().zip(around).rev() {
        put(&mut outer, key, here)?;
        here = outer;
    }
    *base = here;
    Ok(())
}

fn take(base: &mut Value, key: &Key<'_>) -> Kind<Value> {
    match (base, key) {
        (Value::List(list), Key::Index(index)) => {
            let at = operators::position(index, list.items().len(), "list")?;
            Ok(list.take(at).unwrap_or(Value::Nothing))
        }
        (Value::Pose(pose), Key::Index(index)) => {
            Ok(Value::Float(pose[operators::position(index, 6, "pose")?]))
        }
        (Value::Struct(record), Key::Member(name)) => record
            .take(name)
            .ok_or_else(|| ErrorKind::Value(format!("the struct has no member '{name}'"))),
        (Value::Struct(record), Key::Index(index)) => {
            let at = operators::position(index, record.members().len(), "struct")?;
            let name = record.members()[at].0.clone();
            Ok(record.take(&name).unwrap_or(Value::Nothing))
        }
        (base, Key::Index(_)) => Err(ErrorKind::Type(format!("{} has no elements", base.kind()))),
        (base, Key::Member(name)) => {
            Err(ErrorKind::Type(format!("{} has no member '{name}'", base.kind())))
        }
    }
}

/// Puts a value back where [`take`] found it.
fn put(base: &mut Value, key: &Key<'_>, value: Value) -> Kind<()> {
    match (base, key) {
        (Value::List(list), Key::Index(index)) => {
            list.replace(operators::position(index, list.items().len(), "list")?, value)
        }
        (Value::Pose(pose), Key::Index(index)) => {
            let number = value
                .number()
                .ok_or_else(|| ErrorKind::of_type("an element of a pose is a number"))?;
            pose[operators::position(index, 6, "pose")?] = number;
            Ok(())
        }
        (Value::Struct(record), Key::Member(name)) => record.replace(name, value),
        (Value::Struct(record), Key::Index(index)) => {
            let at = operators::position(index, record.members().len(), "struct")?;
            let name = record.members()[at].0.clone();
            record.replace(&name, value)
        }
        _ => Ok(()),
    }
}
