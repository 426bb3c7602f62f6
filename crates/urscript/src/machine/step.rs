//! Runs one thread until it pauses or ends.

use super::place::{self, Key};
use super::thread::{Frame, Pending, Task, Thread, Wait};
use super::{Machine, remove};
use crate::builtins;
use crate::code::{Code, Op, PathStep, Slot};
use crate::error::{ErrorKind, ScriptError};
use crate::host::{Call, Host, Reply, ThreadId};
use crate::limits::STACK;
use crate::methods;
use crate::operators;
use crate::value::{self, List, Record, Value};
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
            Op::Constant(c) => thread.stack.push(code.constants[*c].clone()),
            Op::Load(slot) => {
                let value = variable(thread, &mut task.globals, *slot).clone();
                let value = value.ok_or_else(|| unset(code, thread, *slot))?;
                thread.stack.push(value);
            }
            Op::Store(slot) => {
                let value = pop(thread);
                let routine = thread.frames.last().map_or(0, |f| f.routine);
                let place = variable(thread, &mut task.globals, *slot);
                match place {
                    Some(old) => value::assign(old, value, || {
                        format!("the variable '{}'", slot_name(code, routine, *slot))
                    })?,
                    None => *place = Some(value),
                }
            }
            Op::StoreElement(slot, path) => {
                let value = pop(thread);
                self.change(code, *slot, path, task, at, |place| {
                    value::assign(place, value.clone(), || "the element".into())
                })?;
            }
            Op::Index(n) => {
                let indices = thread.stack.split_off(thread.stack.len().saturating_sub(*n));
                let base = pop(thread);
                thread.stack.push(operators::element(&base, &indices)?);
            }
            Op::Member(name) => {
                let base = pop(thread);
                let Value::Struct(record) = &base else {
                    return Err(ErrorKind::Type(format!("{} has no member '{name}'", base.kind())));
                };
                let missing = || ErrorKind::Value(format!("the struct has no member '{name}'"));
                thread.stack.push(record.get(name).cloned().ok_or_else(missing)?);
            }
            Op::Ask(method, n) => {
                let args = thread.stack.split_off(thread.stack.len().saturating_sub(*n));
                let base = pop(thread);
                let value = methods::ask(*method, &base, &args)?;
                self.made(task, at, value)?;
            }
            Op::Change(slot, path, method, n) => {
                let args = thread.stack.split_off(thread.stack.len().saturating_sub(*n));
                self.change(code, *slot, path, task, at, |place| {
                    methods::change(*method, place, &args)
                })?;
                task.threads[at].stack.push(Value::Nothing);
            }
            Op::List(n) => {
                let items = thread.stack.split_off(thread.stack.len().saturating_sub(*n));
                let list = Value::List(List::new(items)?);
                self.made(task, at, list)?;
            }
            Op::Pose => {
                let items = thread.stack.split_off(thread.stack.len().saturating_sub(6));
                let numbers: Option<Vec<f64>> = items.iter().map(Value::number).collect();
                let six = numbers.and_then(|n| n.try_into().ok());
                let six = six.ok_or_else(|| ErrorKind::of_type("a pose is made of six numbers"))?;
                thread.stack.push(Value::Pose(six));
            }
            Op::Struct(names) => {
                let items = thread.stack.split_off(thread.stack.len().saturating_sub(names.len()));
                let record = Record::new(names.iter().cloned().zip(items).collect())?;
                self.made(task, at, Value::Struct(record))?;
            }
            Op::Unary(operator) => {
                let value = operators::unary(*operator, &pop(thread))?;
                self.made(task, at, value)?;
            }
            Op::Binary(operator) => {
                let (b, a) = (pop(thread), pop(thread));
                // A product of matrices costs more than its operands are big.
                charge(thread, product_cost(a.weight(), b.weight()));
                let value = operators::binary(*operator, &a, &b)?;
                self.made(task, at, value)?;
            }
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
            Op::Builtin(number) => {
                let signature = &builtins::signatures().list()[*number];
                let args = thread
                    .stack
                    .split_off(thread.stack.len().saturating_sub(signature.parameters.len()));
                let cost = args.iter().map(Value::weight).sum::<usize>();
                charge(thread, cost as u64 / 4);
                let value = builtins::call(*number, &args, &mut self.random, self.limits.value)
                    .map_err(|kind| kind.inside(&signature.name))?;
                self.made(task, at, value)?;
            }
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

    /// Pushes a new value and accounts for its size.
    fn made(&self, task: &mut Task, at: usize, value: Value) -> Kind<()> {
        let weight = value.weight();
        if weight > 1 {
            if weight > self.limits.value {
                return Err(ErrorKind::Limit(format!(
                    "a value of {weight} elements; {} at most",
                    self.limits.value
                )));
            }
            charge(&mut task.threads[at], weight as u64 / 4);
            self.account(task, weight)?;
        }
        task.threads[at].stack.push(value);
        Ok(())
    }

    /// Counts the memory now and then: at the latest when as much was made as may be held.
    fn account(&self, task: &mut Task, weight: usize) -> Kind<()> {
        task.made = task.made.saturating_add(weight);
        if task.made > self.limits.memory / 4 {
            task.made = 0;
            if task.memory() > self.limits.memory {
                return Err(ErrorKind::Limit(format!(
                    "the program holds more than {} elements",
                    self.limits.memory
                )));
            }
        }
        Ok(())
    }

    /// Changes an element of a variable in place; the indices of the path lie on the stack.
    fn change(
        &self,
        code: &Code,
        slot: Slot,
        path: &[PathStep],
        task: &mut Task,
        at: usize,
        edit: impl FnOnce(&mut Value) -> Kind<()>,
    ) -> Kind<()> {
        let thread = &mut task.threads[at];
        let n: usize = path.iter().map(|s| if let PathStep::Index(n) = s { *n } else { 0 }).sum();
        let indices = thread.stack.split_off(thread.stack.len().saturating_sub(n));
        let base = variable(thread, &mut task.globals, slot).take();
        let mut base = base.ok_or_else(|| unset(code, thread, slot))?;
        let mut keys = Vec::new();
        let mut left = indices.iter();
        for step in path {
            match step {
                PathStep::Index(n) => keys.extend(left.by_ref().take(*n).map(Key::Index)),
                PathStep::Member(name) => keys.push(Key::Member(name)),
            }
        }
        place::change(&mut base, &keys, edit)?;
        let weight = base.weight();
        if weight > self.limits.value {
            return Err(ErrorKind::Limit(format!(
                "a value of {weight} elements; {} at most",
                self.limits.value
            )));
        }
        // The whole list may have been copied for the change.
        charge(thread, weight as u64 / 8);
        *variable(thread, &mut task.globals, slot) = Some(base);
        self.account(task, weight)
    }
}

/// Takes instructions from the slice.
fn charge(thread: &mut Thread, cost: u64) {
    thread.budget = thread.budget.saturating_sub(cost);
}

/// Instructions that an operation on values of these sizes counts for.
fn product_cost(a: usize, b: usize) -> u64 {
    if a <= 16 && b <= 16 { 0 } else { (a as u64).saturating_mul(b as u64) / 64 }
}

fn pop(thread: &mut Thread) -> Value {
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

/// The place of a variable. Slots come from the compiler, which made the places.
fn variable<'a>(
    thread: &'a mut Thread,
    globals: &'a mut [Option<Value>],
    slot: Slot,
) -> &'a mut Option<Value> {
    match slot {
        Slot::Global(at) => &mut globals[at],
        Slot::Local(at) => {
            let last = thread.frames.len() - 1;
            &mut thread.frames[last].locals[at]
        }
    }
}

fn slot_name(code: &Code, routine: usize, slot: Slot) -> String {
    match slot {
        Slot::Global(at) => code.globals[at].to_string(),
        Slot::Local(at) => code.routines[routine].locals[at].to_string(),
    }
}

fn unset(code: &Code, thread: &Thread, slot: Slot) -> ErrorKind {
    let routine = thread.frames.last().map_or(0, |f| f.routine);
    ErrorKind::NotDefined(slot_name(code, routine, slot))
}
