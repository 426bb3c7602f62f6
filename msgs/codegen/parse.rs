//! Parser for one message definition.

/// Element type of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum Base {
    /// A number, bool or octet, by its Rust name; the flag marks octets (`uint8`, `byte`, `char`).
    Number { rust: &'static str, octet: bool },
    /// UTF-8 text with an optional upper bound in bytes.
    Text { bound: Option<usize> },
    /// Another message.
    Message { package: String, name: String },
}

/// How often the element occurs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Count {
    /// Once.
    One,
    /// Exactly n times, without a length on the wire.
    Fixed(usize),
    /// Any number of times.
    Many,
    /// At most n times.
    AtMost(usize),
}

/// Element type and count.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldType {
    /// Element type.
    pub base: Base,
    /// How often.
    pub count: Count,
}

/// One member of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Its type.
    pub ty: FieldType,
    /// Its name.
    pub name: String,
    /// Default value as Rust source, where the definition gives one.
    pub default: Option<String>,
    /// Trailing comment.
    pub doc: String,
}

/// One named value of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Rust type.
    pub rust: &'static str,
    /// Name in capitals.
    pub name: String,
    /// Value as Rust source.
    pub value: String,
    /// Trailing comment.
    pub doc: String,
}

/// One message, or one part of a service or action.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Definition {
    /// Leading comment.
    pub doc: String,
    /// In wire order.
    pub fields: Vec<Field>,
    /// In file order.
    pub constants: Vec<Constant>,
}

impl Definition {
    /// (package, name) of every message used directly, in field order, each once.
    pub fn dependencies(&self) -> Vec<(String, String)> {
        let mut out = Vec::new();
        for field in &self.fields {
            if let Base::Message { package, name } = &field.ty.base {
                let key = (package.clone(), name.clone());
                if !out.contains(&key) {
                    out.push(key);
                }
            }
        }
        out
    }
}

/// Parses the text of one part. `package` is the package of unqualified type names.
pub fn parse_definition(package: &str, text: &str) -> Result<Definition, String> {
    let mut out = Definition::default();
    for (number, line) in text.lines().enumerate() {
        let (code, comment) = split_comment(line);
        let code = code.trim();
        if code.is_empty() {
            if out.fields.is_empty() && out.constants.is_empty() && !comment.is_empty() {
                if !out.doc.is_empty() {
                    out.doc.push(' ');
                }
                out.doc.push_str(comment);
            }
            continue;
        }
        parse_line(package, code, comment, &mut out)
            .map_err(|e| format!("line {}: {e}: {line:?}", number + 1))?;
    }
    Ok(out)
}

/// A `#` starts a comment unless it stands inside quotes.
fn split_comment(line: &str) -> (&str, &str) {
    let mut quote = None;
    for (i, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') => return (&line[..i], line[i + 1..].trim()),
            (None, '"' | '\'') => quote = Some(c),
            (Some(q), c) if q == c => quote = None,
            _ => {}
        }
    }
    (line, "")
}

fn parse_line(
    package: &str,
    code: &str,
    comment: &str,
    out: &mut Definition,
) -> Result<(), String> {
    let (ty_text, rest) = code.split_once(char::is_whitespace).ok_or("expected `type name`")?;
    let rest = rest.trim();
    let ty = parse_type(package, ty_text)?;
    let name_end =
        rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
    let (name, tail) = rest.split_at(name_end);
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        return Err("names start with a letter".into());
    }
    let tail = tail.trim();
    if let Some(value) = tail.strip_prefix('=') {
        if ty.count != Count::One {
            return Err("constants cannot be arrays".into());
        }
        let (rust, value) = literal(&ty.base, value.trim(), true)?;
        out.constants.push(Constant {
            rust,
            name: name.to_string(),
            value,
            doc: comment.to_string(),
        });
        return Ok(());
    }
    let default = if tail.is_empty() {
        None
    } else if ty.count != Count::One {
        return Err("default values of arrays are not supported".into());
    } else {
        Some(literal(&ty.base, tail, false)?.1)
    };
    if out.fields.iter().any(|f| f.name == name) {
        return Err(format!("field {name} occurs twice"));
    }
    out.fields.push(Field { ty, name: name.to_string(), default, doc: comment.to_string() });
    Ok(())
}

fn parse_type(package: &str, text: &str) -> Result<FieldType, String> {
    let (base_text, count) = match text.split_once('[') {
        None => (text, Count::One),
        Some((base, rest)) => {
            let inner = rest.strip_suffix(']').ok_or("expected ]")?;
            let number = |s: &str| s.parse::<usize>().map_err(|_| format!("bad length {s:?}"));
            let count = match inner.strip_prefix("<=") {
                Some(n) => Count::AtMost(number(n)?),
                None if inner.is_empty() => Count::Many,
                None => Count::Fixed(number(inner)?),
            };
            (base, count)
        }
    };
    Ok(FieldType { base: parse_base(package, base_text)?, count })
}

fn parse_base(package: &str, text: &str) -> Result<Base, String> {
    let number = |rust, octet| Ok(Base::Number { rust, octet });
    match text {
        "bool" => return number("bool", false),
        "byte" | "char" | "uint8" => return number("u8", true),
        "int8" => return number("i8", false),
        "int16" => return number("i16", false),
        "uint16" => return number("u16", false),
        "int32" => return number("i32", false),
        "uint32" => return number("u32", false),
        "int64" => return number("i64", false),
        "uint64" => return number("u64", false),
        "float32" => return number("f32", false),
        "float64" => return number("f64", false),
        "string" => return Ok(Base::Text { bound: None }),
        "wstring" => return Err("wstring is not supported".into()),
        _ => {}
    }
    if let Some(bound) = text.strip_prefix("string<=") {
        let bound = bound.parse().map_err(|_| format!("bad string bound {bound:?}"))?;
        return Ok(Base::Text { bound: Some(bound) });
    }
    let (package, name) = text.split_once('/').unwrap_or((package, text));
    let good = |s: &str| {
        s.starts_with(|c: char| c.is_ascii_alphabetic())
            && s.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    if !good(package) || !good(name) || !name.starts_with(|c: char| c.is_ascii_uppercase()) {
        return Err(format!("unknown type {text:?}"));
    }
    Ok(Base::Message { package: package.to_string(), name: name.to_string() })
}

/// A literal as (Rust type, Rust source).
fn literal(base: &Base, text: &str, constant: bool) -> Result<(&'static str, String), String> {
    match base {
        Base::Number { rust: "bool", .. } => match text {
            "true" | "True" | "1" => Ok(("bool", "true".into())),
            "false" | "False" | "0" => Ok(("bool", "false".into())),
            _ => Err(format!("bad bool {text:?}")),
        },
        Base::Number { rust, .. } if rust.starts_with('f') => {
            let value: f64 = text.parse().map_err(|_| format!("bad number {text:?}"))?;
            Ok((rust, format!("{value:?}")))
        }
        Base::Number { rust, .. } => {
            let value: i128 = match text.strip_prefix("0x") {
                Some(hex) => i128::from_str_radix(hex, 16),
                None => text.parse(),
            }
            .map_err(|_| format!("bad integer {text:?}"))?;
            Ok((rust, value.to_string()))
        }
        Base::Text { .. } => {
            let inner = ['"', '\'']
                .iter()
                .find_map(|q| text.strip_prefix(*q).and_then(|t| t.strip_suffix(*q)))
                .unwrap_or(text);
            let source = if constant { format!("{inner:?}") } else { format!("{inner:?}.into()") };
            Ok(("&str", source))
        }
        Base::Message { .. } => Err("messages have no literals".into()),
    }
}
