//! Reads ROS interface text (`.msg`, `.srv`, `.action`) and writes the Rust types for it.
//!
//! Used by the build script, and by the crate's own tests.

pub mod emit;
pub mod parse;

use parse::{Definition, parse_definition};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// What an interface file describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// One message.
    Message,
    /// Request and response.
    Service,
    /// Goal, result and feedback.
    Action,
}

impl Kind {
    /// The file extension, which is also the folder and the middle part of the type name.
    pub fn folder(self) -> &'static str {
        match self {
            Kind::Message => "msg",
            Kind::Service => "srv",
            Kind::Action => "action",
        }
    }

    fn parts(self) -> usize {
        match self {
            Kind::Message => 1,
            Kind::Service => 2,
            Kind::Action => 3,
        }
    }
}

/// One interface file.
#[derive(Clone, Debug)]
pub struct Interface {
    /// Package, e.g. `std_msgs`.
    pub package: String,
    /// Type name without package, e.g. `Header`.
    pub name: String,
    /// Message, service or action.
    pub kind: Kind,
    /// The file's text, trimmed.
    pub text: String,
    /// 1, 2 or 3 parts.
    pub parts: Vec<Definition>,
}

/// Every interface under the given package folders, keyed by (package, kind, name).
pub type Interfaces = BTreeMap<(String, Kind, String), Interface>;

/// Parses one file's text.
pub fn parse_interface(
    package: &str,
    name: &str,
    kind: Kind,
    text: &str,
) -> Result<Interface, String> {
    let mut sections = vec![String::new()];
    for line in text.lines() {
        if line.trim() == "---" {
            sections.push(String::new());
        } else if let Some(last) = sections.last_mut() {
            last.push_str(line);
            last.push('\n');
        }
    }
    if sections.len() != kind.parts() {
        return Err(format!(
            "{package}/{}/{name}: expected {} part(s) separated by ---, found {}",
            kind.folder(),
            kind.parts(),
            sections.len()
        ));
    }
    let parts = sections
        .iter()
        .map(|s| parse_definition(package, s))
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| format!("{package}/{}/{name}: {e}", kind.folder()))?;
    Ok(Interface {
        package: package.to_string(),
        name: name.to_string(),
        kind,
        text: text.trim().to_string(),
        parts,
    })
}

/// Reads `<dir>/{msg,srv,action}/*` of one package into `out`.
pub fn read_package(package: &str, dir: &Path, out: &mut Interfaces) -> Result<(), String> {
    for kind in [Kind::Message, Kind::Service, Kind::Action] {
        let folder = dir.join(kind.folder());
        if !folder.is_dir() {
            continue;
        }
        let entries = fs::read_dir(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        for entry in entries {
            let path = entry.map_err(|e| format!("{}: {e}", folder.display()))?.path();
            if path.extension().and_then(|e| e.to_str()) != Some(kind.folder()) {
                continue;
            }
            let name = path.file_stem().and_then(|s| s.to_str()).unwrap_or_default().to_string();
            let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
            let interface = parse_interface(package, &name, kind, &text)?;
            out.insert((package.to_string(), kind, name), interface);
        }
    }
    Ok(())
}

/// Reads every package folder inside `dir`.
pub fn read_packages(dir: &Path, out: &mut Interfaces) -> Result<(), String> {
    let entries = fs::read_dir(dir).map_err(|e| format!("{}: {e}", dir.display()))?;
    for entry in entries {
        let path = entry.map_err(|e| format!("{}: {e}", dir.display()))?.path();
        if path.is_dir() {
            let package = path.file_name().and_then(|s| s.to_str()).unwrap_or_default().to_string();
            read_package(&package, &path, out)?;
        }
    }
    Ok(())
}

/// The `ros2msg` schema text of a message: its own text, then every type that it needs, each once,
/// headed by a line of 80 `=` and `MSG: package/Type`.
pub fn schema(interfaces: &Interfaces, package: &str, name: &str) -> Result<String, String> {
    let find = |p: &str, n: &str| {
        interfaces
            .get(&(p.to_string(), Kind::Message, n.to_string()))
            .ok_or_else(|| format!("message {p}/{n} is used but not defined"))
    };
    let root = find(package, name)?;
    let mut text = root.text.clone();
    let mut order: Vec<(String, String)> = vec![(package.to_string(), name.to_string())];
    let mut next = 0;
    while next < order.len() {
        let (p, n) = order[next].clone();
        for dependency in find(&p, &n)?.parts[0].dependencies() {
            if !order.contains(&dependency) {
                order.push(dependency);
            }
        }
        if next > 0 {
            text.push('\n');
            text.push_str(&"=".repeat(80));
            text.push_str(&format!("\nMSG: {p}/{n}\n{}", find(&p, &n)?.text));
        }
        next += 1;
    }
    text.push('\n');
    Ok(text)
}
