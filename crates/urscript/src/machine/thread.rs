//! State of one thread and of one running program.

use crate::code::Code;
use crate::host::{State, ThreadId};
use crate::value::Value;
use std::sync::Arc;

/// A call of a host function that goes on.
#[derive(Debug)]
pub(super) struct Pending {
    pub host: usize,
    pub args: Vec<Value>,
    pub line: u32,
    pub waited: u64,
    pub state: State,
}

/// Why a thread does not run.
#[derive(Debug)]
pub(super) enum Wait {
    /// It does run.
    No,
    /// Until the cycle of this number.
    Cycle(u64),
    Host(Pending),
    Join(ThreadId),
}

/// A call inside a thread.
#[derive(Debug)]
pub(super) struct Frame {
    pub routine: usize,
    pub at: usize,
    pub locals: Vec<Option<Value>>,
    /// Height of the stack below this call.
    pub base: usize,
}

#[derive(Debug)]
pub(super) struct Thread {
    pub id: ThreadId,
    pub frames: Vec<Frame>,
    pub stack: Vec<Value>,
    pub wait: Wait,
    /// The slice of this cycle is used up.
    pub spent: bool,
    /// Instructions left in this cycle.
    pub budget: u64,
    /// Cycles in a row that it computed through.
    pub overruns: u32,
}

/// A running program.
#[derive(Debug)]
pub(super) struct Task {
    pub code: Arc<Code>,
    pub globals: Vec<Option<Value>>,
    /// In the order of their start; the first is the main one.
    pub threads: Vec<Thread>,
    /// Holder of the critical section and how often it entered.
    pub critical: Option<(ThreadId, u32)>,
    /// Size of what was made since the memory was last counted.
    pub made: usize,
    /// Instructions for threads that start in this cycle.
    pub stock: u64,
}

impl Thread {
    pub fn new(id: ThreadId, routine: usize, locals: usize) -> Self {
        let frame = Frame { routine, at: 0, locals: vec![None; locals], base: 0 };
        Self {
            id,
            frames: vec![frame],
            stack: Vec::new(),
            wait: Wait::No,
            spent: false,
            budget: 0,
            overruns: 0,
        }
    }
    fn memory(&self) -> usize {
        let locals = self.frames.iter().flat_map(|f| f.locals.iter().flatten());
        let args: &[Value] = match &self.wait {
            Wait::Host(p) => &p.args,
            _ => &[],
        };
        locals.chain(&self.stack).chain(args).map(Value::weight).sum()
    }
}

impl Task {
    pub fn new(code: Arc<Code>, main: ThreadId) -> Self {
        let globals = vec![None; code.globals.len()];
        let locals = code.routines.first().map_or(0, |r| r.locals.len());
        Self {
            code,
            globals,
            threads: vec![Thread::new(main, 0, locals)],
            critical: None,
            made: 0,
            stock: 0,
        }
    }
    /// Size of all values held.
    pub fn memory(&self) -> usize {
        let globals: usize = self.globals.iter().flatten().map(Value::weight).sum();
        globals + self.threads.iter().map(Thread::memory).sum::<usize>()
    }
    pub fn position(&self, id: ThreadId) -> Option<usize> {
        self.threads.iter().position(|t| t.id == id)
    }
}

#[cfg(test)]
impl Task {
    /// Elements that really exist: what is shared counts once.
    pub fn elements(&self) -> usize {
        let mut seen = std::collections::HashSet::new();
        let threads = self.threads.iter();
        let held = threads
            .flat_map(|t| t.frames.iter().flat_map(|f| f.locals.iter().flatten()).chain(&t.stack));
        self.globals.iter().flatten().chain(held).map(|v| elements(v, &mut seen)).sum()
    }
}

#[cfg(test)]
fn elements(value: &Value, seen: &mut std::collections::HashSet<usize>) -> usize {
    match value {
        Value::List(l) if seen.insert(l.items().as_ptr() as usize) => {
            1 + l.items().iter().map(|v| elements(v, seen)).sum::<usize>()
        }
        Value::Text(t) if seen.insert(t.as_ptr() as usize) => 1 + t.len() / 16,
        _ => 1,
    }
}
