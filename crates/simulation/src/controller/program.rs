//! Scripts on this controller: reading them, and why one is refused.

use super::{host, host_sockets};
use std::sync::OnceLock;
use tdv_urscript::{CONTROLLER, Functions, Limits, Program, ScriptError};
use thiserror::Error;

/// Why the controller does not run a program.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ProgramError {
    /// Not URScript, or it calls what no controller has.
    #[error("the script is refused: {0}")]
    Script(#[from] ScriptError),
    /// A text without a program.
    #[error("the script has no program in it")]
    Empty,
    /// The arm has no power, its brakes are on, or it is stopped.
    #[error(
        "robot mode {robot}, safety mode {safety}: bring the robot to RUNNING and NORMAL first"
    )]
    NotReady {
        /// The robot mode.
        robot: &'static str,
        /// The safety mode.
        safety: &'static str,
    },
    /// Nothing was loaded.
    #[error("no program is loaded: `load` one or send a script")]
    NothingLoaded,
}

/// A script text, read and checked, whatever came out of that.
#[derive(Debug, Clone)]
pub struct Script(pub(super) Result<Vec<Program>, ProgramError>);

impl Script {
    /// Reads a text: `def` and `sec` programs, or single statements.
    pub fn parse(text: &str) -> Self {
        Self(read(text))
    }
}

fn read(text: &str) -> Result<Vec<Program>, ProgramError> {
    let programs = Program::load(text, functions(), &Limits::default())?;
    if programs.is_empty() { Err(ProgramError::Empty) } else { Ok(programs) }
}

/// The usual functions of a controller, then what is different here.
fn table() -> String {
    [CONTROLLER, host::NOT_SIMULATED, host::SIGNATURES, host_sockets::SIGNATURES].concat()
}

/// All functions of the controller; those that it does not simulate are known too.
fn functions() -> &'static Functions {
    static TABLE: OnceLock<Functions> = OnceLock::new();
    TABLE.get_or_init(|| {
        // The table is a constant that a test parses; an empty one would make every name unknown.
        Functions::parse(&table()).unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_urscript::Value;

    #[test]
    fn the_table_of_functions_is_read() {
        let all = Functions::parse(&table()).unwrap();
        assert!(all.get("movej").is_some() && all.get("set_speed").is_some());
        assert_eq!(all.get("servoj").unwrap().parameters[3].default, Some(Value::Float(0.002)));
    }
}
