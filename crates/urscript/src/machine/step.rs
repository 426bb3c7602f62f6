//! Runs one thread until it pauses or ends.

use super::thread::{Frame, Pending, Task, Thread, Wait};
use super::values::variable;
use super::{Machine, remove};
use crate::code::{Code, Op, Slot};
use crate::error::{ErrorKind, ScriptError};
use crate::host::{Call, Host, Reply, ThreadId};
use crate::limits::STACK;
use crate::value::Value;
use std::sync::Arc;

/// Why a thread stopped running for now.
pub(super) enum Next {
    /// It waits or its slice is used up.
    Paused(ThreadId),
    /// It came to its end or killed itself.
    Ended(ThreadId),
    /// The program is to end.
    Halt,
}

type Kind<T> = Result<T, ErrorKind>;

impl Machine {
    /// Runs thread `at` of the program until it pauses or ends.
    pub(super) fn step(
        &mut self,
        task: &mut Task,
        at: usize,
        host: &mut dyn Host,
    ) -> Result<Next, ScriptError> {
        let code = task.code.clone();
        let id = task.threads[at].id;
        if let Wait::Host(pending) = std::mem::replace(&mut task.threads[at].wait, Wait::No) {
            let line = pending.line;
            if let Some(next) = self.host(task, id, pending, host).map_err(|k| k.at(line))? {
                return Ok(next);
            }
        }
        loop {
            // Another thread's end may have moved this one.
            let Some(at) = task.position(id) else { return Ok(Next::Ended(id)) };
            let thread = &mut task.threads[at];
            if thread.budget == 0 {
                return self.overrun(&code, thread);
            }
            let Some(frame) = thread.frames.last_mut() else { return Ok(Next::Ended(id)) };
            let routine = &code.routines[frame.routine];
            let (op, line) = (&routine.ops[frame.at], routine.lines[frame.at]);
            frame.at += 1;
            match self.execute(&code, op, line, task, at, host) {
                Ok(None) => {}
                Ok(Some(next)) => return Ok(next),
                Err(kind) => return Err(kind.at(line)),
            }
        }
    }

    /// One instruction; `Some` if the thread does not go on.
    fn execute(
        &mut self,
        code: &Arc<Code>,
        op: &Op,
        line: u32,
        task: &mut Task,
        at: usize,
        host: &mut dyn Host,
    ) -> Kind<Option<Next>> {
        let id = task.threads[at].id;
        charge(&mut task.threads[at], 1);
        let running = task.threads.len();
        let thread = &mut task.threads[at];
        match op {
            Op::Jump(to) => jump(thread, *to),
            Op::JumpIfFalse(to) => {
                if !truth(&pop(thread))? {
                    jump(thread, *to);
                }
            }
            Op::JumpIfFalseKeep(to) | Op::JumpIfTrueKeep(to) => {
                let value = truth(&pop(thread))?;
                if value == matches!(op, Op::JumpIfTrueKeep(_)) {
                    thread.stack.push(Value::Bool(value));
                    jump(thread, *to);
                }
            }
            Op::NeedTruth => {
                let value = truth(&pop(thread))?;
                thread.stack.push(Value::Bool(value));
            }
            Op::JumpIfGiven(slot, to) => {
                if !matches!(
                    variable(thread, &mut task.globals, Slot::Local(*slot)),
                    Some(Value::Nothing) | None
                ) {
                    jump(thread, *to);
                }
            }
            Op::Pop => drop(pop(thread)),
            Op::Call(number) => self.call(code, *number, thread)?,
            Op::Host(number) => {
                let n = code.host_arguments[*number];
                let args = thread.stack.split_off(thread.stack.len().saturating_sub(n));
                let pending = Pending { host: *number, args, line, waited: 0, state: None };
                return self.host(task, id, pending, host);
            }
            Op::Run(number) => {
                if running >= self.limits.threads {
                    return Err(ErrorKind::Limit(format!("{running} threads run already")));
                }
                self.last_thread = self.last_thread.wrapping_add(1).max(1);
                thread.stack.push(Value::Int(self.last_thread));
                let mut new =
                    Thread::new(self.last_thread, *number, code.routines[*number].locals.len());
                // Threads that start each other without end share one stock of instructions.
                new.budget = self.limits.instructions.min(task.stock);
                task.stock -= new.budget;
                task.threads.push(new);
            }
            Op::Kill => {
                let Value::Int(other) = pop(thread) else {
                    return Err(ErrorKind::of_type("'kill' needs what 'run' returned"));
                };
                if other == id {
                    return Ok(Some(Next::Ended(id)));
                }
                if let Some(p) = task.position(other) {
                    remove(task, p, host);
                }
            }
            Op::Join => {
                let Value::Int(other) = pop(thread) else {
                    return Err(ErrorKind::of_type("'join' needs what 'run' returned"));
                };
                if task.position(other).is_some() {
                    task.threads[at].wait = Wait::Join(other);
                    return Ok(Some(Next::Paused(id)));
                }
            }
            Op::EnterCritical => {
                let depth = task.critical.map_or(0, |(_, n)| n);
                task.critical = Some((id, depth.saturating_add(1)));
            }
            Op::ExitCritical => {
                task.critical = match task.critical {
                    Some((holder, n)) if n > 1 => Some((holder, n - 1)),
                    _ => None,
                };
            }
            Op::Sync => {
                thread.stack.push(Value::Nothing);
                return Ok(Some(self.pause(thread, 1)));
            }
            Op::Sleep => {
                let value = pop(thread);
                let seconds = value.number().filter(|s| !s.is_nan());
                let seconds = seconds.ok_or_else(|| {
                    ErrorKind::of_type(format!("sleep needs a number, not {}", value.kind()))
                })?;
                thread.stack.push(Value::Nothing);
                let cycles = (seconds / self.period - 1e-6).ceil().clamp(1.0, 1e15);
                return Ok(Some(self.pause(thread, cycles as u64)));
            }
            Op::Return => {
                let value = pop(thread);
                if let Some(frame) = thread.frames.pop() {
                    thread.stack.truncate(frame.base);
                }
                if thread.frames.is_empty() {
                    return Ok(Some(Next::Ended(id)));
                }
                thread.stack.push(value);
            }
            Op::Halt => return Ok(Some(Next::Halt)),
            other => self.value(code, other, task, at)?,
        }
        Ok(None)
    }

    /// The thread computed through its whole slice. It goes on in the next cycle, but not for ever.
    fn overrun(&self, code: &Code, thread: &mut Thread) -> Result<Next, ScriptError> {
        thread.overruns += 1;
        if thread.overruns > self.limits.overruns {
            let line = thread.frames.last().map_or(0, |f| code.routines[f.routine].lines[f.at]);
            return Err(ErrorKind::Endless.at(line));
        }
        thread.spent = true;
        Ok(Next::Paused(thread.id))
    }

    /// The slice is used up; the thread goes on so many cycles later.
    fn pause(&self, thread: &mut Thread, cycles: u64) -> Next {
        thread.overruns = 0;
        thread.spent = true;
        thread.wait = Wait::Cycle(self.cycle.saturating_add(cycles));
        Next::Paused(thread.id)
    }

    fn call(&self, code: &Code, number: usize, thread: &mut Thread) -> Kind<()> {
        let routine = &code.routines[number];
        if thread.frames.len() >= self.limits.frames || thread.stack.len() > STACK {
            let depth = self.limits.frames;
            return Err(ErrorKind::Limit(format!(
                "call of '{}': functions call each other {depth} deep",
                routine.name
            )));
        }
        let n = routine.parameters.len();
        charge(thread, routine.locals.len() as u64 / 8);
        let args = thread.stack.split_off(thread.stack.len().saturating_sub(n));
        let mut locals: Vec<Option<Value>> = args.into_iter().map(Some).collect();
        locals.resize(routine.locals.len(), None);
        thread.frames.push(Frame { routine: number, at: 0, locals, base: thread.stack.len() });
        Ok(())
    }

    /// Asks the host; `None` if the thread goes on.
    fn host(
        &mut self,
        task: &mut Task,
        id: ThreadId,
        mut pending: Pending,
        host: &mut dyn Host,
    ) -> Kind<Option<Next>> {
        let code = task.code.clone();
        let function = &code.hosts[pending.host];
        let reply = host.call(Call {
            function,
            args: &pending.args,
            thread: id,
            secondary: code.secondary,
            line: pending.line,
            waited: pending.waited,
            state: &mut pending.state,
        });
        let Some(at) = task.position(id) else { return Ok(Some(Next::Ended(id))) };
        let (value, spent) = match reply {
            Reply::Done(value) => (value, false),
            Reply::Spent(value) => (value, true),
            Reply::Error(reason) => {
                return Err(ErrorKind::Host { function: function.clone(), reason });
            }
            Reply::Wait => {
                pending.waited += 1;
                task.threads[at].overruns = 0;
                task.threads[at].wait = Wait::Host(pending);
                task.threads[at].spent = true;
                return Ok(Some(Next::Paused(id)));
            }
        };
        self.made(task, at, value)?;
        Ok(spent.then(|| self.pause(&mut task.threads[at], 1)))
    }
}

/// Takes instructions from the slice.
pub(super) fn charge(thread: &mut Thread, cost: u64) {
    thread.budget = thread.budget.saturating_sub(cost);
}

pub(super) fn pop(thread: &mut Thread) -> Value {
    thread.stack.pop().unwrap_or(Value::Nothing)
}

fn jump(thread: &mut Thread, to: usize) {
    if let Some(frame) = thread.frames.last_mut() {
        frame.at = to;
    }
}

fn truth(value: &Value) -> Kind<bool> {
    value
        .truth()
        .ok_or_else(|| ErrorKind::of_type(format!("a condition is a bool, not {}", value.kind())))
}
