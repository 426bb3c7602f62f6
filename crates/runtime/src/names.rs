//! Topic and service names: `~` and relative names, namespaces, remaps.

use crate::args::{Arguments, Remap};

/// A name that ROS does not allow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} {name:?} is not a valid ROS name: {reason}")]
pub struct NameError {
    /// What it names.
    pub what: &'static str,
    /// The name.
    pub name: String,
    /// What is wrong.
    pub reason: &'static str,
}

/// Turns names as written in a node into names in the graph.
#[derive(Clone, Debug)]
pub struct Resolver {
    node: String,
    namespace: String,
    remaps: Vec<(String, String)>,
}

impl Resolver {
    /// For the node `default_name` under the rules of the command line.
    ///
    /// # Errors
    /// [`NameError`] for node name, namespace or a remap that ROS does not allow.
    pub fn new(default_name: &str, arguments: &Arguments) -> Result<Self, NameError> {
        let node = arguments.node_name.as_deref().unwrap_or(default_name).to_string();
        check_token("node name", &node, &node)?;
        let mut namespace = arguments.namespace.clone().unwrap_or_else(|| "/".into());
        if !namespace.starts_with('/') {
            namespace.insert(0, '/');
        }
        if namespace.len() > 1 {
            check_absolute("namespace", &namespace)?;
        }
        let mut resolver = Self { node, namespace, remaps: Vec::new() };
        for Remap { node, from, to } in &arguments.remaps {
            if node.as_deref().is_none_or(|n| n == default_name || n == resolver.node) {
                let rule = (resolver.expand(from)?, resolver.expand(to)?);
                resolver.remaps.push(rule);
            }
        }
        Ok(resolver)
    }

    /// Node name without namespace.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// Namespace, starting with `/`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// Node name with namespace, e.g. `/robot/arm_controller`.
    pub fn fully_qualified(&self) -> String {
        join(&self.namespace, &self.node)
    }

    /// Absolute name of a topic, service or action after the remaps (the first match counts).
    ///
    /// # Errors
    /// [`NameError`].
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        let absolute = self.expand(name)?;
        let remapped = self.remaps.iter().find(|(from, _)| *from == absolute);
        Ok(remapped.map_or(absolute, |(_, to)| to.clone()))
    }

    fn expand(&self, name: &str) -> Result<String, NameError> {
        let absolute = if let Some(private) = name.strip_prefix("~/") {
            join(&self.fully_qualified(), private)
        } else if name.starts_with('/') {
            name.to_string()
        } else {
            join(&self.namespace, name)
        };
        check_absolute("name", &absolute)?;
        Ok(absolute)
    }
}

fn join(namespace: &str, name: &str) -> String {
    if namespace == "/" { format!("/{name}") } else { format!("{namespace}/{name}") }
}

fn check_absolute(what: &'static str, name: &str) -> Result<(), NameError> {
    name[1..].split('/').try_for_each(|token| check_token(what, token, name))
}

fn check_token(what: &'static str, token: &str, name: &str) -> Result<(), NameError> {
    let reason = if token.is_empty() {
        "a part is empty"
    } else if token.starts_with(|c: char| c.is_ascii_digit()) {
        "a part starts with a digit"
    } else if !token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
        "only letters, digits and _ are allowed"
    } else if token.contains("__") {
        "__ is not allowed"
    } else {
        return Ok(());
    };
    Err(NameError { what, name: name.into(), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolver(line: &str) -> Result<Resolver, NameError> {
        let words = std::iter::once("program").chain(line.split_whitespace()).map(str::to_string);
        Resolver::new("talker", &Arguments::parse(words).expect("arguments"))
    }

    #[test]
    fn expansion() {
        let r = resolver("--ros-args -r __ns:=/robot").expect("valid");
        assert_eq!(r.fully_qualified(), "/robot/talker");
        assert_eq!(r.resolve("image").as_deref(), Ok("/robot/image"));
        assert_eq!(r.resolve("/image").as_deref(), Ok("/image"));
        assert_eq!(r.resolve("~/reset").as_deref(), Ok("/robot/talker/reset"));
        let r = resolver("--ros-args -r __node:=other").expect("valid");
        assert_eq!(r.resolve("~/a/b").as_deref(), Ok("/other/a/b"));
    }

    #[test]
    fn remaps_compare_absolute_names() {
        let r = resolver(
            "--ros-args -r image:=/camera/image -r ~/reset:=restart -r nobody:x:=y -r talker:z:=w \
             -r __ns:=/n",
        )
        .expect("valid");
        assert_eq!(r.resolve("/n/image").as_deref(), Ok("/camera/image"));
        assert_eq!(r.resolve("~/reset").as_deref(), Ok("/n/restart"));
        assert_eq!(r.resolve("x").as_deref(), Ok("/n/x"));
        assert_eq!(r.resolve("z").as_deref(), Ok("/n/w"));
    }

    #[test]
    fn bad_names() {
        for line in ["-r __node:=a-b", "-r __ns:=/a//b", "-r a:=/b/", "-r a:=1x"] {
            assert!(resolver(&format!("--ros-args {line}")).is_err(), "{line}");
        }
        let r = resolver("").expect("valid");
        for name in ["", "a b", "/a__b", "~", "a/~/b"] {
            assert!(r.resolve(name).is_err(), "{name}");
        }
    }
}
