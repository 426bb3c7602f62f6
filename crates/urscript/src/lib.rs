//! URScript: parser and interpreter.
mod builtins;
mod catalogue;
mod code;
mod compiler;
mod error;
#[cfg(test)]
mod fuzz;
mod host;
mod lexer;
mod limits;
mod machine;
mod methods;
mod operators;
mod parser;
mod script;
mod syntax;
#[cfg(test)]
mod tests;
mod value;

pub use builtins::BUILTINS;
pub use catalogue::CONTROLLER;
pub use error::{ErrorKind, ScriptError};
pub use host::{Call, Functions, Host, Parameter, Reply, Signature, State, ThreadId};
pub use limits::Limits;
pub use machine::{Ended, Machine};
pub use script::{Program, UNNAMED};
pub use value::{List, Record, Value};
