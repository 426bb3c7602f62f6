//! Parameter values as a tree of JSON values: merging, flattening, conversion to and from ROS.

use serde_json::{Map, Value};
use tdv_msgs::rcl_interfaces::msg::{ParameterType, ParameterValue};

/// Leaves with dotted names, in order. Objects with entries are branches, everything else a leaf.
pub fn flatten(tree: &Value) -> Vec<(String, &Value)> {
    fn walk<'a>(prefix: &str, value: &'a Value, out: &mut Vec<(String, &'a Value)>) {
        match value {
            Value::Object(map) if !map.is_empty() || prefix.is_empty() => {
                for (key, child) in map {
                    let name =
                        if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                    walk(&name, child, out);
                }
            }
            _ => out.push((prefix.to_string(), value)),
        }
    }
    let mut out = Vec::new();
    walk("", tree, &mut out);
    out
}

/// Turns `a.b: 1` into `a: {b: 1}`; a whole branch may be assigned at once.
pub fn nested(name: &str, value: Value) -> Value {
    name.rsplit('.').fold(value, |inner, key| {
        let mut map = Map::new();
        map.insert(key.to_string(), inner);
        Value::Object(map)
    })
}

/// Writes `overlay` over `base`. Names that `base` does not have, and values of another type, are
/// reported as sentences; `source` says where the overlay comes from.
pub fn merge(base: &mut Value, overlay: Value, source: &str, problems: &mut Vec<String>) {
    let names: Vec<String> = flatten(base).into_iter().map(|(n, _)| n).collect();
    merge_at("", base, overlay, source, &names, problems);
}

fn merge_at(
    name: &str,
    base: &mut Value,
    overlay: Value,
    source: &str,
    names: &[String],
    problems: &mut Vec<String>,
) {
    match (base, overlay) {
        // A map that is empty by default, or unset, takes any content.
        (Value::Object(base), Value::Object(overlay)) if !base.is_empty() || name.is_empty() => {
            for (key, value) in overlay {
                // Dotted keys are allowed anywhere in a file.
                if let Some((first, rest)) = key.split_once('.') {
                    let inner = nested(rest, value);
                    let mut map = Map::new();
                    map.insert(first.to_string(), inner);
                    let mut whole = Value::Object(std::mem::take(base));
                    merge_at(name, &mut whole, Value::Object(map), source, names, problems);
                    if let Value::Object(map) = whole {
                        *base = map;
                    }
                    continue;
                }
                let full = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                match base.get_mut(&key) {
                    Some(child) => merge_at(&full, child, value, source, names, problems),
                    None => problems.push(unknown(&full, source, names)),
                }
            }
        }
        (base, value) => match coerce(base, value) {
            Ok(value) => *base = value,
            Err(value) => problems.push(format!(
                "parameter '{name}' wants {}, but {source} gives {}",
                kind(base),
                kind_and_value(&value)
            )),
        },
    }
}

fn unknown(name: &str, source: &str, names: &[String]) -> String {
    let nearest = names.iter().min_by_key(|n| distance(n, name));
    match nearest {
        Some(n) if distance(n, name) <= 3 => {
            format!("unknown parameter '{name}' ({source}): did you mean '{n}'?")
        }
        _ => format!("unknown parameter '{name}' ({source}): known are {}", names.join(", ")),
    }
}

/// `value` in the type of the default `base`, or `value` back when it does not fit.
pub fn coerce(base: &Value, value: Value) -> Result<Value, Value> {
    match (base, &value) {
        (Value::Null, _) | (Value::Bool(_), Value::Bool(_)) => Ok(value),
        (Value::String(_), Value::String(_)) => Ok(value),
        (Value::Number(b), Value::Number(v)) => {
            if b.is_f64() == v.is_f64() {
                Ok(value)
            } else if b.is_f64() {
                v.as_f64().and_then(serde_json::Number::from_f64).map(Value::Number).ok_or(value)
            } else {
                Err(value)
            }
        }
        (Value::Array(b), Value::Array(v)) => {
            let Some(first) = b.first() else { return Ok(value) };
            let items: Result<Vec<Value>, Value> =
                v.iter().map(|item| coerce(first, item.clone())).collect();
            items.map(Value::Array).map_err(|_| value)
        }
        (Value::Object(b), Value::Object(_)) if b.is_empty() => Ok(value),
        _ => Err(value),
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Bool(_) => "true or false",
        Value::Number(n) if n.is_f64() => "a number",
        Value::Number(_) => "a whole number",
        Value::String(_) => "text",
        Value::Array(items) => match items.first() {
            Some(Value::Number(n)) if n.is_f64() => "a list of numbers",
            Some(Value::Number(_)) => "a list of whole numbers",
            Some(Value::String(_)) => "a list of texts",
            _ => "a list",
        },
        Value::Object(_) => "a group of parameters",
    }
}

fn kind_and_value(value: &Value) -> String {
    match value {
        Value::Null => "nothing".into(),
        Value::String(text) => format!("the text {text:?}"),
        Value::Object(_) => kind(value).into(),
        _ => format!("{value}"),
    }
}

/// Edit distance, for suggestions.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let next = (diagonal + usize::from(ca != *cb)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

/// The ROS form of a leaf. Lists of lists and the like, which ROS does not have, appear as JSON text.
pub fn to_ros(value: &Value) -> ParameterValue {
    let mut out = ParameterValue::default();
    match value {
        Value::Null => out.r#type = ParameterType::PARAMETER_NOT_SET,
        Value::Bool(b) => {
            out.r#type = ParameterType::PARAMETER_BOOL;
            out.bool_value = *b;
        }
        Value::Number(n) => match n.as_i64() {
            Some(i) => {
                out.r#type = ParameterType::PARAMETER_INTEGER;
                out.integer_value = i;
            }
            None => {
                out.r#type = ParameterType::PARAMETER_DOUBLE;
                out.double_value = n.as_f64().unwrap_or(f64::NAN);
            }
        },
        Value::String(s) => {
            out.r#type = ParameterType::PARAMETER_STRING;
            out.string_value = s.clone();
        }
        Value::Array(items) => list_to_ros(items, value, &mut out),
        Value::Object(_) => text_to_ros(value, &mut out),
    }
    out
}

fn text_to_ros(value: &Value, out: &mut ParameterValue) {
    out.r#type = ParameterType::PARAMETER_STRING;
    out.string_value = value.to_string();
}

fn list_to_ros(items: &[Value], whole: &Value, out: &mut ParameterValue) {
    if let Some(list) = items.iter().map(Value::as_bool).collect::<Option<Vec<_>>>()
        && !list.is_empty()
    {
        out.r#type = ParameterType::PARAMETER_BOOL_ARRAY;
        out.bool_array_value = list;
    } else if let Some(list) = items.iter().map(Value::as_i64).collect::<Option<Vec<_>>>()
        && !list.is_empty()
    {
        out.r#type = ParameterType::PARAMETER_INTEGER_ARRAY;
        out.integer_array_value = list;
    } else if let Some(list) = items.iter().map(Value::as_f64).collect::<Option<Vec<_>>>()
        && !list.is_empty()
    {
        out.r#type = ParameterType::PARAMETER_DOUBLE_ARRAY;
        out.double_array_value = list;
    } else if let Some(list) =
        items.iter().map(|v| v.as_str().map(str::to_string)).collect::<Option<Vec<_>>>()
    {
        out.r#type = ParameterType::PARAMETER_STRING_ARRAY;
        out.string_array_value = list;
    } else {
        text_to_ros(whole, out);
    }
}

/// The JSON form of a ROS value; `None` for a type number that ROS does not have.
pub fn from_ros(value: &ParameterValue) -> Option<Value> {
    Some(match value.r#type {
        ParameterType::PARAMETER_NOT_SET => Value::Null,
        ParameterType::PARAMETER_BOOL => value.bool_value.into(),
        ParameterType::PARAMETER_INTEGER => value.integer_value.into(),
        ParameterType::PARAMETER_DOUBLE => value.double_value.into(),
        ParameterType::PARAMETER_STRING => value.string_value.clone().into(),
        ParameterType::PARAMETER_BYTE_ARRAY => value.byte_array_value.clone().into(),
        ParameterType::PARAMETER_BOOL_ARRAY => value.bool_array_value.clone().into(),
        ParameterType::PARAMETER_INTEGER_ARRAY => value.integer_array_value.clone().into(),
        ParameterType::PARAMETER_DOUBLE_ARRAY => value.double_array_value.clone().into(),
        ParameterType::PARAMETER_STRING_ARRAY => value.string_array_value.clone().into(),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn ros_round_trip() {
        for value in [
            json!(null),
            json!(true),
            json!(-3),
            json!(2.0),
            json!("x"),
            json!([true, false]),
            json!([1, 2]),
            json!([1.0, 2.5]),
            json!(["a", "b"]),
        ] {
            assert_eq!(from_ros(&to_ros(&value)), Some(value));
        }
        assert_eq!(to_ros(&json!([[1]])).string_value, "[[1]]");
        assert_eq!(to_ros(&json!([])).r#type, ParameterType::PARAMETER_STRING_ARRAY);
        assert_eq!(from_ros(&ParameterValue { r#type: 77, ..Default::default() }), None);
    }

    #[test]
    fn merging() {
        let mut base =
            json!({"a": 1, "b": {"c": 0.5, "d": "x"}, "free": {}, "maybe": null, "l": [0.0]});
        let mut problems = Vec::new();
        merge(
            &mut base,
            json!({"b.c": 2, "b": {"d": "y"}, "free": {"k": 1}, "maybe": 3, "l": [1, 2.5]}),
            "f.yaml",
            &mut problems,
        );
        assert!(problems.is_empty(), "{problems:?}");
        assert_eq!(
            base,
            json!({"a": 1, "b": {"c": 2.0, "d": "y"}, "free": {"k": 1}, "maybe": 3, "l": [1.0, 2.5]})
        );
        merge(&mut base, json!({"a": 1.5, "b": {"e": 1}, "zzzzzzzz": 1}), "-p", &mut problems);
        assert_eq!(problems[0], "parameter 'a' wants a whole number, but -p gives 1.5");
        assert_eq!(problems[1], "unknown parameter 'b.e' (-p): did you mean 'b.c'?");
        assert!(problems[2].contains("known are a, b.c, b.d, free"), "{}", problems[2]);
    }

    #[test]
    fn flat_names() {
        let tree = json!({"a": {"b": {"c": 1}}, "d": {}});
        let names: Vec<_> = flatten(&tree).into_iter().map(|(n, _)| n).collect();
        assert_eq!(names, ["a.b.c", "d"]);
        assert_eq!(nested("a.b", json!(1)), json!({"a": {"b": 1}}));
    }
}
