//! Writes Rust source for parsed interfaces.

use super::parse::{Base, Count, Definition, Field};
use super::{Interface, Interfaces, Kind, schema};
use std::collections::BTreeMap;
use std::fmt::Write;

const KEYWORDS: [&str; 12] =
    ["type", "fn", "match", "move", "ref", "use", "mod", "loop", "impl", "where", "final", "yield"];

/// Member of an empty message: the DDS mapping of ROS does not allow empty structures.
const DUMMY: &str = "structure_needs_at_least_one_member";

/// The whole source: one module per package with modules `msg`, `srv`, `action`, and the function
/// that finds a schema by type name.
pub fn emit(interfaces: &Interfaces) -> Result<String, String> {
    let mut packages: BTreeMap<&str, BTreeMap<Kind, Vec<&Interface>>> = BTreeMap::new();
    for interface in interfaces.values() {
        packages
            .entry(&interface.package)
            .or_default()
            .entry(interface.kind)
            .or_default()
            .push(interface);
    }
    let mut out = String::from("// Made by build.rs from the interface text. Do not edit.\n");
    let mut table = String::new();
    for (package, kinds) in &packages {
        line(&mut out, format!("/// Interfaces of the ROS package `{package}`."));
        line(&mut out, format!("pub mod {package} {{"));
        for (kind, list) in kinds {
            line(&mut out, format!("/// `{package}/{}/...`", kind.folder()));
            line(&mut out, format!("pub mod {} {{", kind.folder()));
            for interface in list {
                match kind {
                    Kind::Message => {
                        let text = schema(interfaces, package, &interface.name)?;
                        message(&mut out, interface, &text);
                        line(
                            &mut table,
                            format!(
                                "    (\"{package}/msg/{0}\", <crate::{package}::msg::{0} as \
                                 crate::RosMessage>::SCHEMA),",
                                interface.name
                            ),
                        );
                    }
                    Kind::Service => service(&mut out, interface),
                    Kind::Action => action(&mut out, interface),
                }
            }
            line(&mut out, "}");
        }
        line(&mut out, "}");
    }
    line(&mut out, "/// (type name, schema text) of every message, sorted by name.");
    line(&mut out, "pub(crate) const SCHEMAS: &[(&str, &str)] = &[");
    out.push_str(&table);
    line(&mut out, "];");
    Ok(out)
}

fn line(out: &mut String, text: impl AsRef<str>) {
    out.push_str(text.as_ref());
    out.push('\n');
}

fn doc(out: &mut String, text: &str, otherwise: &str) {
    let text = if text.is_empty() { otherwise } else { text };
    // Brackets would be read as links to Rust items.
    line(out, format!("/// {}", text.replace('[', "\\[").replace(']', "\\]")));
}

fn message(out: &mut String, interface: &Interface, schema: &str) {
    let Interface { package, name, .. } = interface;
    structure(out, name, &format!("`{package}/msg/{name}`"), &interface.parts[0]);
    let _ = write!(
        out,
        "impl crate::RosMessage for {name} {{\n\
         const PACKAGE: &'static str = \"{package}\";\n\
         const NAME: &'static str = \"{name}\";\n\
         const FULL_NAME: &'static str = \"{package}/msg/{name}\";\n\
         const SCHEMA: &'static str = {schema:?};\n}}\n"
    );
}

fn service(out: &mut String, interface: &Interface) {
    let Interface { package, name, .. } = interface;
    structure(out, &format!("{name}Request"), "Request.", &interface.parts[0]);
    structure(out, &format!("{name}Response"), "Response.", &interface.parts[1]);
    let _ = write!(
        out,
        "/// Names the service type `{package}/srv/{name}`.\n\
         #[derive(Clone, Copy, Debug)]\npub struct {name};\n\
         impl crate::RosService for {name} {{\n\
         type Request = {name}Request;\ntype Response = {name}Response;\n\
         const PACKAGE: &'static str = \"{package}\";\n\
         const NAME: &'static str = \"{name}\";\n}}\n"
    );
}

fn action(out: &mut String, interface: &Interface) {
    let Interface { package, name, .. } = interface;
    for (part, suffix) in interface.parts.iter().zip(["Goal", "Result", "Feedback"]) {
        structure(out, &format!("{name}{suffix}"), &format!("{suffix}."), part);
    }
    let _ = write!(
        out,
        "/// Names the action type `{package}/action/{name}`.\n\
         #[derive(Clone, Copy, Debug)]\npub struct {name};\n\
         impl crate::RosAction for {name} {{\n\
         type Goal = {name}Goal;\ntype Result = {name}Result;\ntype Feedback = {name}Feedback;\n\
         const PACKAGE: &'static str = \"{package}\";\n\
         const NAME: &'static str = \"{name}\";\n}}\n"
    );
}

fn structure(out: &mut String, name: &str, otherwise: &str, definition: &Definition) {
    doc(out, &definition.doc, otherwise);
    line(out, "#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]");
    line(out, format!("pub struct {name} {{"));
    for field in &definition.fields {
        doc(out, &field.doc, &format!("`{}`.", field.name));
        if let Some(attribute) = wire_attribute(field) {
            line(out, attribute);
        }
        line(out, format!("pub {}: {},", identifier(&field.name), rust_type(field)));
    }
    if definition.fields.is_empty() {
        line(out, "/// Filler of the DDS mapping of empty messages.");
        line(out, format!("#[doc(hidden)]\npub {DUMMY}: u8,"));
    }
    line(out, "}");

    line(out, format!("impl Default for {name} {{\nfn default() -> Self {{\nSelf {{"));
    for field in &definition.fields {
        let value = match (&field.default, field.ty.count) {
            (Some(value), _) => value.clone(),
            (None, Count::Fixed(_)) => "std::array::from_fn(|_| Default::default())".into(),
            (None, _) => "Default::default()".into(),
        };
        line(out, format!("{}: {value},", identifier(&field.name)));
    }
    if definition.fields.is_empty() {
        line(out, format!("{DUMMY}: 0,"));
    }
    line(out, "}\n}\n}");

    line(out, format!("impl ros2_client::Message for {name} {{}}"));
    if !definition.constants.is_empty() {
        line(out, format!("impl {name} {{"));
        for constant in &definition.constants {
            doc(out, &constant.doc, &format!("`{}`.", constant.name));
            let rust = if constant.rust == "&str" { "&'static str" } else { constant.rust };
            line(out, format!("pub const {}: {rust} = {};", constant.name, constant.value));
        }
        line(out, "}");
    }
}

fn identifier(name: &str) -> String {
    if KEYWORDS.contains(&name) { format!("r#{name}") } else { name.to_string() }
}

fn element(base: &Base) -> String {
    match base {
        Base::Number { rust, .. } => (*rust).to_string(),
        // A message may itself be called String.
        Base::Text { .. } => "::std::string::String".into(),
        Base::Message { package, name } => format!("crate::{package}::msg::{name}"),
    }
}

fn rust_type(field: &Field) -> String {
    let element = element(&field.ty.base);
    match field.ty.count {
        Count::One => element,
        Count::Fixed(n) => format!("[{element}; {n}]"),
        Count::Many | Count::AtMost(_) => format!("Vec<{element}>"),
    }
}

/// The serde attribute of fields whose wire form is not serde's own: octet sequences move as bytes,
/// long arrays as tuples, bounds are checked on the way out.
fn wire_attribute(field: &Field) -> Option<String> {
    let octet = matches!(field.ty.base, Base::Number { octet: true, .. });
    match (&field.ty.base, field.ty.count) {
        (_, Count::Many) if octet => Some("#[serde(with = \"serde_bytes\")]".into()),
        (_, Count::AtMost(n)) => {
            let function = if octet { "bounded_bytes" } else { "bounded" };
            let read = if octet { ", deserialize_with = \"serde_bytes::deserialize\"" } else { "" };
            let generics = if octet { format!("_, {n}") } else { format!("_, _, {n}") };
            Some(format!(
                "#[serde(serialize_with = \"crate::wire::{function}::<{generics}>\"{read})]"
            ))
        }
        (_, Count::Fixed(n)) if n > 32 => Some(format!(
            "#[serde(serialize_with = \"crate::wire::write_array::<_, _, {n}>\", \
             deserialize_with = \"crate::wire::read_array::<_, _, {n}>\")]"
        )),
        (Base::Text { bound: Some(n) }, Count::One) => {
            Some(format!("#[serde(serialize_with = \"crate::wire::bounded_text::<_, {n}>\")]"))
        }
        _ => None,
    }
}
