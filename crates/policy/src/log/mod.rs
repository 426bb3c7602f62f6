//! The course of a training for those who watch it: lines of JSON and TensorBoard's event files. The
//! writers take any [`std::io::Write`] and the time as an argument.

mod events;
mod jsonl;

pub use events::{EventWriter, scalars};
pub use jsonl::{append_line, keep_until};
