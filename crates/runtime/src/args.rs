//! The command line of a node: `--ros-args ... --` sections and what is left.

use std::fmt;
use std::path::PathBuf;

/// One `-r` rule. Node name and namespace rules are kept apart in [`Arguments`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// Only for the node of this name, if given.
    pub node: Option<String>,
    /// Name to replace, as written.
    pub from: String,
    /// Replacement, as written.
    pub to: String,
}

/// One `-p` assignment; the value is YAML text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// Only for the node of this name, if given.
    pub node: Option<String>,
    /// Dotted parameter name.
    pub name: String,
    /// YAML text.
    pub value: String,
}

/// What the command line says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Arguments {
    /// Topic and service remaps in order.
    pub remaps: Vec<Remap>,
    /// `__node` / `__name` rule.
    pub node_name: Option<String>,
    /// `__ns` rule.
    pub namespace: Option<String>,
    /// `-p` assignments in order.
    pub parameters: Vec<Assignment>,
    /// `--params-file` in order.
    pub params_files: Vec<PathBuf>,
    /// `--log-level`: (logger, level); the logger is empty for the default.
    pub log_levels: Vec<(String, String)>,
    /// Everything outside the `--ros-args` sections, without the program name.
    pub rest: Vec<String>,
    /// `-h` or `--help` outside the sections.
    pub help: bool,
}

/// A command line that cannot be understood. Programs exit with code 2.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ArgumentError {
    /// A flag at the end of its section.
    #[error("{0} wants a value after it")]
    MissingValue(String),
    /// A flag that no ROS program has.
    #[error(
        "unknown ROS argument {0:?} after --ros-args (program arguments go before it or after --)"
    )]
    Unknown(String),
    /// A rule without `:=` or with an empty side.
    #[error("{flag} {text:?} is not of the form {form}")]
    Malformed {
        /// The flag.
        flag: String,
        /// What stood after it.
        text: String,
        /// What should stand there.
        form: &'static str,
    },
    /// Not one of the level names.
    #[error("log level {0:?} is unknown: use debug, info, warn, error or fatal")]
    LogLevel(String),
    /// Arguments for a program that takes none.
    #[error("unexpected argument {0:?}: this node takes only --ros-args (try --help)")]
    Unexpected(String),
}

/// Text for `--help` of a node.
pub struct Usage<'a>(pub &'a str);

impl fmt::Display for Usage<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "usage: {} [--ros-args [-r FROM:=TO] [-r __node:=NAME] [-r __ns:=/NS] \
             [-p NAME:=VALUE] [--params-file FILE] [--log-level LEVEL] [--]]",
            self.0
        )
    }
}

impl Arguments {
    /// Parses `std::env::args()` or the like; the first item is the program name.
    ///
    /// # Errors
    /// [`ArgumentError`] naming the argument.
    pub fn parse(args: impl IntoIterator<Item = String>) -> Result<Self, ArgumentError> {
        let mut out = Self::default();
        let mut args = args.into_iter().skip(1);
        let mut in_ros = false;
        while let Some(arg) = args.next() {
            if !in_ros {
                match arg.as_str() {
                    "--ros-args" => in_ros = true,
                    "-h" | "--help" => out.help = true,
                    _ => out.rest.push(arg),
                }
                continue;
            }
            let mut value = || args.next().ok_or_else(|| ArgumentError::MissingValue(arg.clone()));
            match arg.as_str() {
                "--" => in_ros = false,
                "--ros-args" => {}
                "-r" | "--remap" => out.remap(&arg, &value()?)?,
                "-p" | "--param" => out.assignment(&arg, &value()?)?,
                "--params-file" => out.params_files.push(value()?.into()),
                "--log-level" => out.log_level(&value()?)?,
                "-e" | "--enclave" | "--log-config-file" | "--log-file-name" => {
                    value()?; // accepted for compatibility, without effect
                }
                "--enable-rosout-logs"
                | "--disable-rosout-logs"
                | "--enable-stdout-logs"
                | "--disable-stdout-logs"
                | "--enable-external-lib-logs"
                | "--disable-external-lib-logs" => {}
                _ => return Err(ArgumentError::Unknown(arg)),
            }
        }
        Ok(out)
    }

    /// Refuses leftover arguments.
    ///
    /// # Errors
    /// [`ArgumentError::Unexpected`] naming the first one.
    pub fn expect_no_rest(&self) -> Result<(), ArgumentError> {
        match self.rest.first() {
            None => Ok(()),
            Some(arg) => Err(ArgumentError::Unexpected(arg.clone())),
        }
    }

    fn remap(&mut self, flag: &str, text: &str) -> Result<(), ArgumentError> {
        let (node, from, to) = rule(flag, text, "FROM:=TO")?;
        let from =
            from.trim_start_matches("rostopic://").trim_start_matches("rosservice://").to_string();
        match from.as_str() {
            "__node" | "__name" => self.node_name = Some(to),
            "__ns" => self.namespace = Some(to),
            _ => self.remaps.push(Remap { node, from, to }),
        }
        Ok(())
    }

    fn assignment(&mut self, flag: &str, text: &str) -> Result<(), ArgumentError> {
        let form = "NAME:=VALUE";
        let malformed = || ArgumentError::Malformed { flag: flag.into(), text: text.into(), form };
        let (left, value) = text.split_once(":=").ok_or_else(malformed)?;
        let (node, name) = match left.rsplit_once(':') {
            Some((node, name)) => (Some(node.to_string()), name),
            None => (None, left),
        };
        if name.is_empty() {
            return Err(malformed());
        }
        self.parameters.push(Assignment { node, name: name.into(), value: value.into() });
        Ok(())
    }

    fn log_level(&mut self, text: &str) -> Result<(), ArgumentError> {
        let (logger, level) = text.split_once(":=").unwrap_or(("", text));
        let level = level.to_ascii_lowercase();
        let level = match level.as_str() {
            "debug" | "info" | "warn" | "error" => level.as_str(),
            "warning" => "warn",
            "fatal" => "error",
            _ => return Err(ArgumentError::LogLevel(text.into())),
        };
        self.log_levels.push((logger.into(), level.into()));
        Ok(())
    }
}

/// Splits `[node:]from:=to`. A colon inside `rostopic://` is not a node prefix.
fn rule(
    flag: &str,
    text: &str,
    form: &'static str,
) -> Result<(Option<String>, String, String), ArgumentError> {
    let malformed = || ArgumentError::Malformed { flag: flag.into(), text: text.into(), form };
    let (left, to) = text.split_once(":=").ok_or_else(malformed)?;
    let (node, from) = match left.split_once(':') {
        Some((_, rest)) if rest.starts_with("//") => (None, left),
        Some((node, from)) => (Some(node.to_string()), from),
        None => (None, left),
    };
    if from.is_empty() || to.is_empty() || to.contains(":=") {
        return Err(malformed());
    }
    Ok((node, from.into(), to.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Arguments, ArgumentError> {
        Arguments::parse(
            std::iter::once("node".to_string()).chain(line.split_whitespace().map(str::to_string)),
        )
    }

    #[test]
    fn everything_together() {
        let a = parse(
            "one --ros-args -r a:=b -r __node:=n -r __ns:=/x -p k.l:=1 -p n:m:=[1,2] \
             --params-file F.yaml --log-level DEBUG --log-level rustdds:=error -- two --ros-args \
             --remap other:rostopic://c:=/d -r n:e:=f",
        )
        .expect("parses");
        assert_eq!(a.rest, ["one", "two"]);
        assert_eq!(a.node_name.as_deref(), Some("n"));
        assert_eq!(a.namespace.as_deref(), Some("/x"));
        let remap = |node: Option<&str>, from: &str, to: &str| Remap {
            node: node.map(str::to_string),
            from: from.into(),
            to: to.into(),
        };
        assert_eq!(
            a.remaps,
            [remap(None, "a", "b"), remap(Some("other"), "c", "/d"), remap(Some("n"), "e", "f")]
        );
        assert_eq!(a.parameters[0].name, "k.l");
        assert_eq!(a.parameters[1].node.as_deref(), Some("n"));
        assert_eq!(a.params_files, [PathBuf::from("F.yaml")]);
        assert_eq!(
            a.log_levels,
            [("".to_string(), "debug".to_string()), ("rustdds".to_string(), "error".to_string())]
        );
    }

    #[test]
    fn topic_url_without_node() {
        assert_eq!(parse("--ros-args -r rostopic://a:=b").expect("parses").remaps[0].from, "a");
    }

    #[test]
    fn values_may_hold_anything() {
        let a = parse("--ros-args -p url:=http://h:1/x -p empty:=").expect("parses");
        assert_eq!(a.parameters[0].value, "http://h:1/x");
        assert_eq!(a.parameters[1].value, "");
    }

    #[test]
    fn errors_name_the_argument() {
        for (line, part) in [
            ("--ros-args -r", "-r wants a value"),
            ("--ros-args -p k=v", "\"k=v\" is not of the form NAME:=VALUE"),
            ("--ros-args -r a:=", "\"a:=\" is not of the form FROM:=TO"),
            ("--ros-args --frobnicate", "--frobnicate"),
            ("--ros-args --log-level loud", "\"loud\" is unknown"),
        ] {
            let text = parse(line).expect_err(line).to_string();
            assert!(text.contains(part), "{text}");
        }
        let rest = parse("x").expect("parses").expect_no_rest().expect_err("x").to_string();
        assert!(rest.contains("\"x\""), "{rest}");
    }
}
