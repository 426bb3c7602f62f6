//! Default < file < `-p`.

use super::Parameters;
use super::tree::{merge, nested};
use crate::args::Arguments;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Parameters that cannot be used. Programs exit with code 2.
#[derive(Debug, thiserror::Error)]
pub enum ParameterError {
    /// A `--params-file` that cannot be read.
    #[error("parameter file {path}: {reason}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// Every problem found with names, types and values.
    #[error("node {node}: {} problem(s) with its parameters:\n  {}", problems.len(), problems.join("\n  "))]
    Invalid {
        /// The node.
        node: String,
        /// One sentence each.
        problems: Vec<String>,
    },
}

/// Parameters and what the runtime itself takes out of them.
pub(crate) struct Loaded<P> {
    pub values: P,
    pub use_sim_time: bool,
}

/// Loads the parameters of the node `node_name` (without namespace): defaults, then the files in
/// order, then `-p`. Unknown names are refused. `use_sim_time` is always allowed.
///
/// # Errors
/// [`ParameterError`] with every problem.
pub fn load_params<P: Parameters>(
    node_name: &str,
    arguments: &Arguments,
) -> Result<P, ParameterError> {
    let namespace = arguments.namespace.as_deref().unwrap_or("/");
    load(node_name, namespace, arguments).map(|loaded| loaded.values)
}

pub(crate) fn load<P: Parameters>(
    node: &str,
    namespace: &str,
    arguments: &Arguments,
) -> Result<Loaded<P>, ParameterError> {
    let invalid = |problems| ParameterError::Invalid { node: node.into(), problems };
    let mut tree = serde_json::to_value(P::default())
        .map_err(|e| invalid(vec![format!("the defaults cannot be written: {e}")]))?;
    let own_sim_time = tree.get("use_sim_time").is_some();
    let mut use_sim_time = Value::Bool(false);
    let mut problems = Vec::new();
    let mut apply = |mut overlay: Value, source: &str| {
        if let Value::Object(map) = &mut overlay {
            if !own_sim_time && let Some(value) = map.remove("use_sim_time") {
                let mut base = serde_json::json!({ "use_sim_time": use_sim_time.clone() });
                let overlay = serde_json::json!({ "use_sim_time": value });
                merge(&mut base, overlay, source, &mut problems);
                use_sim_time = base["use_sim_time"].clone();
            }
            // Written by launch tools for publishers and subscriptions; has no meaning here.
            map.retain(|key, _| !key.starts_with("qos_overrides"));
        }
        merge(&mut tree, overlay, source, &mut problems);
    };

    let mut unreadable = Vec::new();
    for path in &arguments.params_files {
        for section in read_file(path, node, namespace)? {
            apply(section, &path.display().to_string());
        }
    }
    for assignment in &arguments.parameters {
        if assignment.node.as_deref().is_some_and(|n| n != node) {
            continue;
        }
        let source = format!("-p {}:={}", assignment.name, assignment.value);
        match parse_value(&assignment.value) {
            Ok(value) => apply(nested(&assignment.name, value), &source),
            Err(e) => unreadable.push(format!("{source}: {e}")),
        }
    }
    problems.extend(unreadable);
    if !problems.is_empty() {
        return Err(invalid(problems));
    }
    let use_sim_time = use_sim_time == Value::Bool(true);
    let values: P = serde_json::from_value(tree).map_err(|e| invalid(vec![e.to_string()]))?;
    let problems = values.validate();
    if problems.is_empty() { Ok(Loaded { values, use_sim_time }) } else { Err(invalid(problems)) }
}

/// YAML of one value. An empty text is an empty string, not null.
fn parse_value(text: &str) -> Result<Value, String> {
    if text.trim().is_empty() {
        return Ok(Value::String(String::new()));
    }
    serde_saphyr::from_str::<Value>(text).map_err(|e| first_line(&e.to_string()))
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_string()
}

/// The `ros__parameters` maps that apply to the node, general ones first.
fn read_file(path: &Path, node: &str, namespace: &str) -> Result<Vec<Value>, ParameterError> {
    let error = |reason: String| ParameterError::File { path: path.into(), reason };
    let text = fs::read_to_string(path).map_err(|e| error(e.to_string()))?;
    let file: Value = serde_saphyr::from_str(&text).map_err(|e| error(e.to_string()))?;
    let Value::Object(file) = file else {
        return Err(error("expected `NODE: ros__parameters: ...` at the top".into()));
    };
    let qualified =
        if namespace == "/" { format!("/{node}") } else { format!("{namespace}/{node}") };
    let mut general = Vec::new();
    let mut own = Vec::new();
    for (key, value) in sections("", Value::Object(file)).map_err(error)? {
        let key = if key.starts_with('/') { key } else { format!("/{key}") };
        match key.as_str() {
            "/**" | "/*" => general.push(value),
            k if k == qualified || k == format!("/{node}") => own.push(value),
            k if k == format!("/**/{node}") => own.push(value),
            _ => {}
        }
    }
    general.extend(own);
    Ok(general)
}

/// (node key, parameters) of every section; namespaces may nest.
fn sections(prefix: &str, value: Value) -> Result<Vec<(String, Value)>, String> {
    let mut out = Vec::new();
    let Value::Object(map) = value else {
        return Err(format!("section '{prefix}' has no ros__parameters"));
    };
    for (key, value) in map {
        if key == "ros__parameters" {
            let value = if value.is_null() { Value::Object(Default::default()) } else { value };
            if !value.is_object() {
                return Err(format!("ros__parameters of '{prefix}' is not a map"));
            }
            out.push((prefix.to_string(), value));
        } else {
            let name = if prefix.is_empty() {
                key
            } else {
                format!("{}/{}", prefix.trim_end_matches('/'), key.trim_start_matches('/'))
            };
            out.extend(sections(&name, value)?);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use std::io::Write;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Demo {
        rate: f64,
        names: Vec<String>,
        inner: Inner,
        file: Option<String>,
    }
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct Inner {
        count: u32,
    }
    impl Default for Inner {
        fn default() -> Self {
            Self { count: 3 }
        }
    }
    impl Default for Demo {
        fn default() -> Self {
            Self { rate: 30.0, names: vec!["a".into()], inner: Inner::default(), file: None }
        }
    }
    impl Parameters for Demo {
        fn validate(&self) -> Vec<String> {
            let mut out = Vec::new();
            if self.rate <= 0.0 {
                out.push(format!("'rate' must be positive, is {}", self.rate));
            }
            if self.inner.count == 0 {
                out.push("'inner.count' must be positive".into());
            }
            out
        }
    }

    fn arguments(words: &[&str]) -> Arguments {
        let all = ["program", "--ros-args"].iter().chain(words).map(|s| s.to_string());
        Arguments::parse(all).expect("arguments")
    }

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().expect("temporary file");
        file.write_all(text.as_bytes()).expect("written");
        file
    }

    #[test]
    fn precedence() {
        let f = file(
            "/**:\n  ros__parameters:\n    rate: 5\n    names: [x, z]\n\
             demo:\n  ros__parameters:\n    use_sim_time: true\n    rate: 10\n    inner:\n      count: 7\n\
             other:\n  ros__parameters:\n    unknown: 1\n",
        );
        let path = f.path().to_str().expect("utf-8");
        let loaded = load::<Demo>("demo", "/", &arguments(&["--params-file", path]))
            .unwrap_or_else(|e| panic!("{e}"));
        assert!(loaded.use_sim_time);
        assert_eq!(loaded.values.rate, 10.0);
        assert_eq!(loaded.values.names, ["x", "z"]);
        assert_eq!(loaded.values.inner.count, 7);
        let loaded = load::<Demo>(
            "demo",
            "/",
            &arguments(&["--params-file", path, "-p", "inner.count:=9", "-p", "file:=a.b"]),
        )
        .unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(loaded.values.inner.count, 9);
        assert_eq!(loaded.values.file.as_deref(), Some("a.b"));
    }

    #[test]
    fn namespaces_in_files() {
        let f = file("/robot:\n  demo:\n    ros__parameters: {rate: 1.5}\n");
        let path = f.path().to_str().expect("utf-8");
        let args = arguments(&["--params-file", path, "-r", "__ns:=/robot"]);
        assert_eq!(load_params::<Demo>("demo", &args).unwrap_or_else(|e| panic!("{e}")).rate, 1.5);
    }

    #[test]
    fn every_problem_is_listed() {
        let args =
            arguments(&["-p", "rates:=1", "-p", "inner.count:=many", "-p", "use_sim_time:=3"]);
        let text = load_params::<Demo>("demo", &args).expect_err("bad").to_string();
        assert!(text.contains("did you mean 'rate'?"), "{text}");
        assert!(text.contains("'inner.count' wants a whole number"), "{text}");
        assert!(text.contains("'use_sim_time' wants true or false"), "{text}");
        let args = arguments(&["-p", "rate:=-1", "-p", "inner.count:=0"]);
        let text = load_params::<Demo>("demo", &args).expect_err("bad").to_string();
        assert!(text.contains("2 problem(s)"), "{text}");
        let args = arguments(&["-p", "inner.count:=-1"]);
        let text = load_params::<Demo>("demo", &args).expect_err("bad").to_string();
        assert!(text.contains("-1"), "{text}");
    }

    #[test]
    fn bad_files_are_named() {
        let args = arguments(&["--params-file", "/nowhere/x.yaml"]);
        let text = load_params::<Demo>("demo", &args).expect_err("bad").to_string();
        assert!(text.contains("/nowhere/x.yaml"), "{text}");
        let f = file("demo: 5\n");
        let args = arguments(&["--params-file", f.path().to_str().expect("utf-8")]);
        let text = load_params::<Demo>("demo", &args).expect_err("bad").to_string();
        assert!(text.contains("no ros__parameters"), "{text}");
        let f = file("demo: [unclosed\n");
        let args = arguments(&["--params-file", f.path().to_str().expect("utf-8")]);
        assert!(load_params::<Demo>("demo", &args).is_err());
    }
}
