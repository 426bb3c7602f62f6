//! URScript: parser and interpreter.
mod builtins;
mod code;
mod compiler;
mod error;
mod host;
mod lexer;
mod limits;
mod machine;
mod operators;
mod parser;
mod script;
mod syntax;
mod value;

pub use builtins::BUILTINS;
pub use error::{ErrorKind, ScriptError};
pub use host::{Call, Functions, Host, Parameter, Reply, Signature, State, ThreadId};
pub use limits::Limits;
pub use machine::{Ended, Machine};
pub use script::{Program, UNNAMED};
pub use value::{List, Record, Value};
