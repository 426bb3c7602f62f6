//! The compiled form of a program.

use crate::syntax::{Binary, Method, Name, Unary};
use crate::value::Value;
use std::sync::Arc;

/// Where a variable lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Slot {
    Local(usize),
    Global(usize),
}

/// One step of a path into a value; the indices of the path lie on the stack in order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum PathStep {
    /// So many indices.
    Index(usize),
    Member(Name),
}

/// An instruction of the stack machine.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Op {
    Constant(usize),
    Load(Slot),
    Store(Slot),
    /// Stores the top of the stack into an element of a variable; the indices lie below it.
    StoreElement(Slot, Arc<[PathStep]>),
    Index(usize),
    Member(Name),
    /// A method of the value below the arguments, which it leaves as it is.
    Ask(Method, usize),
    /// A method that changes an element of a variable; indices and then arguments on the stack.
    Change(Slot, Arc<[PathStep]>, Method, usize),
    List(usize),
    Pose,
    Struct(Arc<[Name]>),
    Unary(Unary),
    Binary(Binary),
    Jump(usize),
    /// Pops a truth value.
    JumpIfFalse(usize),
    /// `and`: leaves False and jumps, or pops True and goes on.
    JumpIfFalseKeep(usize),
    /// `or`.
    JumpIfTrueKeep(usize),
    /// Refuses what is no truth value.
    NeedTruth,
    /// Goes on if the parameter in the slot was not given, else jumps.
    JumpIfGiven(usize, usize),
    Pop,
    Call(usize),
    Builtin(usize),
    Host(usize),
    Run(usize),
    Kill,
    Join,
    EnterCritical,
    ExitCritical,
    Sync,
    Sleep,
    Return,
    Halt,
}

/// A compiled function.
#[derive(Debug, Clone)]
pub(crate) struct Routine {
    pub name: Name,
    pub parameters: Vec<(Name, bool)>,
    pub locals: Vec<Name>,
    pub ops: Vec<Op>,
    /// Line of each instruction.
    pub lines: Vec<u32>,
}

/// A compiled program; routine 0 is its body.
#[derive(Debug)]
pub(crate) struct Code {
    pub name: Name,
    pub secondary: bool,
    pub routines: Vec<Routine>,
    pub globals: Vec<Name>,
    pub constants: Vec<Value>,
    /// Names of the host's functions by the number in [`Op::Host`].
    pub hosts: Vec<String>,
    /// Number of parameters of each of them.
    pub host_arguments: Vec<usize>,
}
