//! What can be wrong with a script, before it runs and while it runs.

use thiserror::Error;

/// A script error with the line it belongs to.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("line {line}: {kind}")]
pub struct ScriptError {
    /// Line of the script text, from 1; 0 where no text is concerned.
    pub line: u32,
    /// What is wrong.
    pub kind: ErrorKind,
}

/// The kinds of script errors.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ErrorKind {
    /// The text is not URScript.
    #[error("syntax error: {0}")]
    Syntax(String),
    /// A name that no function, variable or built-in bears.
    #[error("name '{0}' is not defined")]
    NotDefined(String),
    /// A function called with arguments that it does not take.
    #[error("call of '{function}': {reason}")]
    Call {
        /// The function.
        function: String,
        /// What does not fit.
        reason: String,
    },
    /// A value of a type that does not fit its use.
    #[error("type error: {0}")]
    Type(String),
    /// A value outside its range: an index, a length, a division by zero.
    #[error("value error: {0}")]
    Value(String),
    /// A bound of [`crate::Limits`] is exceeded.
    #[error("limit exceeded: {0}")]
    Limit(String),
    /// A thread computed through too many cycles in a row without consuming time.
    #[error("runtime too much behind: a loop without motion, sleep or sync does not end")]
    Endless,
    /// The host refused or failed a call.
    #[error("{function}: {reason}")]
    Host {
        /// The function.
        function: String,
        /// The host's words.
        reason: String,
    },
}

impl ErrorKind {
    /// Attaches the line.
    pub(crate) fn at(self, line: u32) -> ScriptError {
        ScriptError { line, kind: self }
    }
    /// Names the built-in function in which it happened.
    pub(crate) fn inside(self, function: &str) -> Self {
        match self {
            Self::Type(reason) => Self::Type(format!("{function}: {reason}")),
            Self::Value(reason) => Self::Value(format!("{function}: {reason}")),
            Self::Limit(reason) => Self::Limit(format!("{function}: {reason}")),
            other => other,
        }
    }
    pub(crate) fn syntax(text: impl Into<String>) -> Self {
        Self::Syntax(text.into())
    }
    pub(crate) fn of_type(text: impl Into<String>) -> Self {
        Self::Type(text.into())
    }
    pub(crate) fn value(text: impl Into<String>) -> Self {
        Self::Value(text.into())
    }
    pub(crate) fn limit(text: impl Into<String>) -> Self {
        Self::Limit(text.into())
    }
}
