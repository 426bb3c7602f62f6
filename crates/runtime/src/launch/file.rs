use super::substitution::Scope;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A launch file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// It cannot be read.
    #[error("launch file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// It is not a launch file, or one with things that are not supported.
    #[error("launch file {path}: {reason}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A `name:=value` that is not an argument of the file.
    #[error("launch argument {name:?} is unknown; {path} has: {known}")]
    Argument {
        /// The file.
        path: PathBuf,
        /// As given.
        name: String,
        /// What there is.
        known: String,
    },
    /// A program that cannot be started.
    #[error("cannot start {program}: {source}; `cargo build` makes it")]
    Start {
        /// The program.
        program: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
}

/// A scalar or a list of scalars of a parameter.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
enum Value {
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(String),
    List(Vec<Value>),
}

impl Value {
    fn text(&self, scope: &Scope) -> Result<String, String> {
        Ok(match self {
            Self::Bool(v) => v.to_string(),
            Self::Integer(v) => v.to_string(),
            Self::Float(v) => format!("{v:?}"),
            Self::Text(v) => scope.apply(v)?,
            Self::List(v) => {
                let items =
                    v.iter().map(|v| v.text(scope)).collect::<Result<Vec<_>, _>>()?.join(", ");
                format!("[{items}]")
            }
        })
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Entry {
    Arg(Arg),
    Node(NodeEntry),
    SetEnv(SetEnv),
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arg {
    name: String,
    default: Option<Value>,
    description: Option<String>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct SetEnv {
    name: String,
    value: Value,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct NodeEntry {
    pkg: String,
    exec: String,
    name: Option<String>,
    namespace: Option<String>,
    #[serde(default)]
    param: Vec<ParamEntry>,
    #[serde(default)]
    remap: Vec<RemapEntry>,
    args: Option<String>,
    #[serde(rename = "if")]
    condition: Option<Value>,
    unless: Option<Value>,
    #[allow(dead_code)]
    output: Option<String>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ParamEntry {
    from: Option<String>,
    name: Option<String>,
    value: Option<Value>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RemapEntry {
    from: String,
    to: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    launch: Vec<Entry>,
}

/// A parsed launch file.
#[derive(Debug, Clone)]
pub struct LaunchFile {
    path: PathBuf,
    entries: Vec<Entry>,
}

/// One program with its arguments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeCommand {
    /// Node name, unique within the launch.
    pub name: String,
    /// Name of the executable.
    pub executable: String,
    /// Arguments.
    pub arguments: Vec<String>,
    /// Environment to add.
    pub environment: Vec<(String, String)>,
}

impl NodeCommand {
    /// A program that is no node of ours, given by a shell command.
    pub fn shell(name: &str, command: &str) -> Self {
        Self {
            name: name.into(),
            executable: "/bin/sh".into(),
            arguments: vec!["-c".into(), format!("exec {command}")],
            environment: Vec::new(),
        }
    }
}

impl LaunchFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`LaunchError::Read`], [`LaunchError::Content`].
    pub fn load(path: &Path) -> Result<Self, LaunchError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| LaunchError::Read { path: path.to_owned(), source })?;
        Self::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, LaunchError> {
        let document: Document = serde_saphyr::from_str(text)
            .map_err(|e| LaunchError::Content { path: path.to_owned(), reason: e.to_string() })?;
        Ok(Self { path: path.to_owned(), entries: document.launch })
    }

    /// Name, default and description of every argument.
    pub fn arguments(&self) -> Vec<(String, Option<String>, String)> {
        self.entries
            .iter()
            .filter_map(|e| match e {
                Entry::Arg(a) => Some((
                    a.name.clone(),
                    a.default.as_ref().map(|d| match d {
                        Value::Text(t) => t.clone(),
                        other => other
                            .text(&Scope {
                                variables: &BTreeMap::new(),
                                folder: Path::new("."),
                                share: Path::new("."),
                            })
                            .unwrap_or_default(),
                    }),
                    a.description.clone().unwrap_or_default(),
                )),
                _ => None,
            })
            .collect()
    }

    /// The programs to start, given `name:=value` settings of the file's arguments. `share` is the folder
    /// that `$(find-pkg-share tdv)` stands for.
    ///
    /// # Errors
    /// [`LaunchError::Argument`], [`LaunchError::Content`].
    pub fn commands(
        &self,
        settings: &BTreeMap<String, String>,
        share: &Path,
    ) -> Result<Vec<NodeCommand>, LaunchError> {
        let names: Vec<String> = self.arguments().into_iter().map(|a| a.0).collect();
        if let Some(name) = settings.keys().find(|k| !names.contains(k)) {
            return Err(LaunchError::Argument {
                path: self.path.clone(),
                name: name.clone(),
                known: names.join(", "),
            });
        }
        let content = |reason| LaunchError::Content { path: self.path.clone(), reason };
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let mut variables = BTreeMap::new();
        let mut environment = Vec::new();
        let mut commands: Vec<NodeCommand> = Vec::new();
        for entry in &self.entries {
            let scope = Scope { variables: &variables, folder, share };
            match entry {
                Entry::Arg(a) => {
                    let value = match (settings.get(&a.name), &a.default) {
                        (Some(v), _) => v.clone(),
                        (None, Some(d)) => d.text(&scope).map_err(content)?,
                        (None, None) => {
                            return Err(content(format!(
                                "argument {0:?} has no default: give {0}:=VALUE",
                                a.name
                            )));
                        }
                    };
                    variables.insert(a.name.clone(), value);
                }
                Entry::SetEnv(e) => {
                    environment.push((e.name.clone(), e.value.text(&scope).map_err(content)?));
                }
                Entry::Node(n) => {
                    if let Some(mut command) = n.command(&scope).map_err(content)? {
                        command.environment = environment.clone();
                        if commands.iter().any(|c| c.name == command.name) {
                            return Err(content(format!("two nodes are called {}", command.name)));
                        }
                        commands.push(command);
                    }
                }
            }
        }
        Ok(commands)
    }
}

fn truth(value: &Value, scope: &Scope) -> Result<bool, String> {
    match value.text(scope)?.to_lowercase().as_str() {
        "true" | "1" => Ok(true),
        "false" | "0" => Ok(false),
        other => Err(format!("{other:?} is neither true nor false")),
    }
}

impl NodeEntry {
    /// None when its condition does not hold.
    fn command(&self, scope: &Scope) -> Result<Option<NodeCommand>, String> {
        if self.pkg != "tdv" {
            return Err(format!(
                "node {} is of package {}; only tdv's own can be started without ROS",
                self.exec, self.pkg
            ));
        }
        if let Some(c) = &self.condition
            && !truth(c, scope)?
        {
            return Ok(None);
        }
        if let Some(c) = &self.unless
            && truth(c, scope)?
        {
            return Ok(None);
        }
        let executable = scope.apply(&self.exec)?;
        let name = scope.apply(self.name.as_deref().unwrap_or(&self.exec))?;
        let mut arguments = Vec::new();
        if let Some(a) = &self.args {
            arguments.extend(scope.apply(a)?.split_whitespace().map(str::to_owned));
        }
        arguments.push("--ros-args".into());
        arguments.extend(["-r".into(), format!("__node:={name}")]);
        if let Some(ns) = &self.namespace {
            arguments.extend(["-r".into(), format!("__ns:={}", scope.apply(ns)?)]);
        }
        for p in &self.param {
            match (&p.from, &p.name, &p.value) {
                (Some(f), None, None) => {
                    arguments.extend(["--params-file".into(), scope.apply(f)?]);
                }
                (None, Some(n), Some(v)) => {
                    arguments.extend(["-p".into(), format!("{n}:={}", v.text(scope)?)]);
                }
                _ => {
                    return Err(format!(
                        "a param of node {name} needs either from, or name and value"
                    ));
                }
            }
        }
        for r in &self.remap {
            arguments.extend([
                "-r".into(),
                format!("{}:={}", scope.apply(&r.from)?, scope.apply(&r.to)?),
            ]);
        }
        Ok(Some(NodeCommand { name, executable, arguments, environment: Vec::new() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "
launch:
- arg: {name: seed, default: 1, description: of the lab}
- arg: {name: lab, default: true}
- set_env: {name: ROS_DOMAIN_ID, value: '17'}
- node:
    pkg: tdv
    exec: virtual_lab
    if: $(var lab)
    param:
    - from: $(find-pkg-share tdv)/config/virtual_lab.yaml
    - {name: seed, value: $(var seed)}
    - {name: offsets, value: [0.5, 1]}
- node:
    pkg: tdv
    exec: ur5_driver
    name: driver
    remap:
    - {from: /a, to: /b}
";

    fn commands(settings: &[(&str, &str)]) -> Result<Vec<NodeCommand>, LaunchError> {
        let settings = settings.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        LaunchFile::parse(Path::new("/l/x.launch.yaml"), TEXT)?.commands(&settings, Path::new("/s"))
    }

    #[test]
    fn nodes_with_parameters_remaps_and_conditions() {
        let all = commands(&[("seed", "9")]).unwrap();
        assert_eq!(all.len(), 2);
        let text = all[0].arguments.join(" ");
        assert_eq!(
            text,
            "--ros-args -r __node:=virtual_lab --params-file /s/config/virtual_lab.yaml \
             -p seed:=9 -p offsets:=[0.5, 1]"
        );
        assert_eq!(all[1].name, "driver");
        assert!(all[1].arguments.contains(&"/a:=/b".to_owned()));
        assert_eq!(all[1].environment, [("ROS_DOMAIN_ID".to_owned(), "17".to_owned())]);
        assert_eq!(commands(&[("lab", "false")]).unwrap().len(), 1);
    }

    #[test]
    fn mistakes_are_named() {
        let e = commands(&[("sead", "9")]).unwrap_err().to_string();
        assert!(e.contains("sead") && e.contains("seed"));
        assert!(commands(&[("lab", "maybe")]).is_err());
        let parse = |t: &str| LaunchFile::parse(Path::new("x"), t);
        assert!(parse("launch:\n- include: {file: x}\n").is_err());
        assert!(parse("nodes: []").is_err());
        let other = "launch:\n- node: {pkg: rviz2, exec: rviz2}\n";
        let e = parse(other).unwrap().commands(&BTreeMap::new(), Path::new("/s")).unwrap_err();
        assert!(e.to_string().contains("rviz2"));
    }
}
