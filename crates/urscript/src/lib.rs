//! URScript: parser, compiler and machine for the programs that a Universal Robots controller runs,
//! free of clocks, sockets and files. The controller around it calls [`Machine::cycle`] once per
//! control cycle and carries out motion, inputs, outputs and registers as a [`Host`].
//!
//! ```
//! use tdv_urscript::{Call, Functions, Host, Limits, Machine, Program, Reply, Value};
//!
//! struct Robot;
//! impl Host for Robot {
//!     fn call(&mut self, call: Call<'_>) -> Reply {
//!         match call.function {
//!             // Takes 10 cycles: the same call comes again in each.
//!             "movej" if call.waited < 10 => Reply::Wait,
//!             "movej" => Reply::Done(Value::Nothing),
//!             other => Reply::Error(format!("'{other}' is not there")),
//!         }
//!     }
//! }
//!
//! let functions = Functions::parse("movej(q, a = 1.4, v = 1.05, t = 0, r = 0)")?;
//! let limits = Limits::default();
//! let text = "def home():\n  movej([0, -1.57, 0, -1.57, 0, 0], v = 0.5)\nend\n";
//! let mut machine = Machine::new(0.008, limits.clone(), 1);
//! for program in Program::load(text, &functions, &limits)? {
//!     machine.start(&program, &mut Robot)?;
//! }
//! let cycles = (1..).find(|_| !machine.cycle(&mut Robot).is_empty());
//! assert_eq!(cycles, Some(11));
//! # Ok::<(), tdv_urscript::ScriptError>(())
//! ```
//!
//! # What is covered
//! - `def` programs with nested functions (default and named arguments), `sec` programs, threads
//!   (`thread`, `run`, `join`, `kill`, critical sections), loose statements; `if`, `while`, `break`,
//!   `continue`, `return`, `halt`, `pass`; `global`, `local`; labels (`$ 1 "text"`), which have no
//!   effect; newlines as blanks, so that several statements may stand on a line and one on several.
//! - Bools, 32-bit ints, floats, strings, poses, lists with capacity, matrices, structs; their
//!   operators and methods.
//! - The functions in [`BUILTINS`]; [`CONTROLLER`] lists those that a host usually has.
//! - Names, calls and their arguments are checked when a text is loaded; every error names its line.
//! - Every cost is bounded by [`Limits`]: no text can hang the cycle or fill the memory.
//!
//! # What differs from the robot
//! - Not there: RPC (`rpc_factory`), interpreter mode, ROS messages, functions that only newer
//!   releases have.
//! - A global is one for the whole text, also above its first assignment; reading it before is an
//!   error of the run.
//! - Loose statements of one text form one program, called [`UNNAMED`]; it also sees the functions
//!   of the text. A secondary program has its own globals.
//! - A thread that computes through its slice goes on in the next cycle; after [`Limits::overruns`]
//!   such cycles in a row the program ends. The robot's bound depends on its computer.
//! - Conditions are bools; values of different types are unequal; ints wrap around; a whole float
//!   serves as an index; `and` and `or` stop at the first answer. The manual is silent on these.
//!
//! # Sources
//! "The URScript Programming Language" (Universal Robots; CB3 3.15, e-Series 5.x): "Numbers,
//! Variables, and Types", "Matrix and Array Expressions", "Lists and Structs", "Methods in URScript",
//! "Flow of Control", "Function", "Scoping rules", "Threads", "Thread scheduling", "Program Label",
//! "Secondary Programs", "Module urmath", "Module interfaces". That `/` of two ints gives a float
//! and that newlines are blanks was read off programs that run on robots.

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
