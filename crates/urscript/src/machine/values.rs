//! Instructions that make and change values.

use super::Machine;
use super::place::{self, Key};
use super::step::{charge, pop};
use super::thread::{Task, Thread};
use crate::builtins;
use crate::code::{Code, Op, PathStep, Slot};
use crate::error::ErrorKind;
use crate::methods;
use crate::operators;
use crate::value::{self, List, Record, Value};

type Kind<T> = Result<T, ErrorKind>;

impl Machine {
    /// One instruction on values; those of the flow of control are elsewhere.
    pub(super) fn value(&mut self, code: &Code, op: &Op, task: &mut Task, at: usize) -> Kind<()> {
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
            // The instructions of the flow of control do not come here.
            _ => {}
        }
        Ok(())
    }

    /// Pushes a new value and accounts for its size.
    pub(super) fn made(&self, task: &mut Task, at: usize, value: Value) -> Kind<()> {
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

/// Instructions that an operation on values of these sizes counts for.
fn product_cost(a: usize, b: usize) -> u64 {
    if a <= 16 && b <= 16 { 0 } else { (a as u64).saturating_mul(b as u64) / 64 }
}

/// The place of a variable. Slots come from the compiler, which made the places.
pub(super) fn variable<'a>(
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
