//! Expressions and calls to instructions.

use super::{Body, Compiler, Result};
use crate::builtins;
use crate::code::Op;
use crate::error::ErrorKind;
use crate::syntax::{Call, Expr, ExprKind, FunctionKind, Name};
use crate::value::Value;

impl Compiler<'_> {
    pub(super) fn expression(&mut self, expr: &Expr, body: &mut Body) -> Result<()> {
        let line = expr.line;
        match &expr.kind {
            ExprKind::Constant(value) => {
                let at = self.constant(value.clone());
                body.emit(Op::Constant(at), line);
            }
            ExprKind::Name(name) => {
                let missing = || ErrorKind::NotDefined(name.to_string()).at(line);
                let slot = self.slot(name, body).ok_or_else(missing)?;
                body.emit(Op::Load(slot), line);
            }
            ExprKind::List(items) => {
                self.all(items, body)?;
                body.emit(Op::List(items.len()), line);
            }
            ExprKind::Pose(items) => {
                self.all(items, body)?;
                body.emit(Op::Pose, line);
            }
            ExprKind::Struct(members) => {
                for (_, value) in members {
                    self.expression(value, body)?;
                }
                body.emit(Op::Struct(members.iter().map(|(n, _)| n.clone()).collect()), line);
            }
            ExprKind::Index(base, indices) => {
                self.expression(base, body)?;
                self.all(indices, body)?;
                body.emit(Op::Index(indices.len()), line);
            }
            ExprKind::Member(base, name) => {
                self.expression(base, body)?;
                body.emit(Op::Member(name.clone()), line);
            }
            ExprKind::Ask(base, method, args) => {
                self.expression(base, body)?;
                self.all(args, body)?;
                body.emit(Op::Ask(*method, args.len()), line);
            }
            ExprKind::Change(name, path, method, args) => {
                let steps = self.path(path, body)?;
                self.all(args, body)?;
                let missing = || ErrorKind::NotDefined(name.to_string()).at(line);
                let slot = self.slot(name, body).ok_or_else(missing)?;
                body.emit(Op::Change(slot, steps.into(), *method, args.len()), line);
            }
            ExprKind::Unary(operator, operand) => {
                self.expression(operand, body)?;
                body.emit(Op::Unary(*operator), line);
            }
            ExprKind::Binary(operator, left, right) => {
                self.expression(left, body)?;
                self.expression(right, body)?;
                body.emit(Op::Binary(*operator), line);
            }
            ExprKind::And(left, right) => {
                self.logical(left, right, Op::JumpIfFalseKeep(0), body)?
            }
            ExprKind::Or(left, right) => self.logical(left, right, Op::JumpIfTrueKeep(0), body)?,
            ExprKind::Call(call) => self.call(call, line, body)?,
            ExprKind::Run(name) => {
                let (number, kind) = self
                    .function(name)
                    .ok_or_else(|| ErrorKind::NotDefined(name.to_string()).at(line))?;
                if kind != FunctionKind::Thread {
                    return Err(ErrorKind::Type(format!(
                        "'{name}' is a function; 'run' needs a thread"
                    ))
                    .at(line));
                }
                body.emit(Op::Run(number), line);
            }
        }
        Ok(())
    }

    fn all(&mut self, items: &[Expr], body: &mut Body) -> Result<()> {
        items.iter().try_for_each(|e| self.expression(e, body))
    }

    fn logical(&mut self, left: &Expr, right: &Expr, jump: Op, body: &mut Body) -> Result<()> {
        self.expression(left, body)?;
        let jump = body.emit(jump, left.line);
        self.expression(right, body)?;
        body.emit(Op::NeedTruth, right.line);
        body.land(jump);
        Ok(())
    }

    /// The innermost visible function of this name.
    fn function(&self, name: &Name) -> Option<(usize, FunctionKind)> {
        let number = *self.visible.iter().rev().find_map(|names| names.get(name))?;
        Some((number, self.signatures[number].kind))
    }

    /// A function of the program, else one of the host, else a built-in.
    fn call(&mut self, call: &Call, line: u32, body: &mut Body) -> Result<()> {
        let name = &call.function;
        if let Some((number, kind)) = self.function(name) {
            if kind == FunctionKind::Thread {
                return Err(ErrorKind::Type(format!(
                    "'{name}' is a thread: start it by 'run {name}()'"
                ))
                .at(line));
            }
            let parameters = self.signatures[number].parameters.clone();
            // A missing argument is filled in by the function itself.
            let parameters: Vec<_> =
                parameters.iter().map(|(n, has)| (&**n, has.then_some(Value::Nothing))).collect();
            self.arguments(call, &parameters, line, body)?;
            body.emit(Op::Call(number), line);
            return Ok(());
        }
        let (signature, op) = if let Some(at) = self.host.position(name) {
            (&self.host.list()[at], Op::Host(at))
        } else if let Some(at) = builtins::signatures().position(name) {
            let op = match &**name {
                "sync" => Op::Sync,
                "sleep" => Op::Sleep,
                _ => Op::Builtin(at),
            };
            (&builtins::signatures().list()[at], op)
        } else {
            return Err(ErrorKind::NotDefined(name.to_string()).at(line));
        };
        let parameters: Vec<_> =
            signature.parameters.iter().map(|p| (&*p.name, p.default.clone())).collect();
        self.arguments(call, &parameters, line, body)?;
        body.emit(op, line);
        Ok(())
    }

    /// Pushes one value per parameter.
    fn arguments(
        &mut self,
        call: &Call,
        parameters: &[(&str, Option<Value>)],
        line: u32,
        body: &mut Body,
    ) -> Result<()> {
        let wrong = |reason: String| {
            ErrorKind::Call { function: call.function.to_string(), reason }.at(line)
        };
        if call.positional.len() > parameters.len() {
            let (most, given) = (parameters.len(), call.positional.len());
            return Err(wrong(format!("at most {most} arguments, {given} given")));
        }
        for (name, _) in &call.named {
            match parameters.iter().position(|(n, _)| **n == **name) {
                None => return Err(wrong(format!("there is no parameter '{name}'"))),
                Some(at) if at < call.positional.len() => {
                    return Err(wrong(format!("argument '{name}' is given twice")));
                }
                Some(_) => {}
            }
        }
        for (at, (name, default)) in parameters.iter().enumerate() {
            let named = call.named.iter().find(|(n, _)| **n == **name).map(|(_, e)| e);
            match (call.positional.get(at).or(named), default) {
                (Some(given), _) => self.expression(given, body)?,
                (None, Some(default)) => {
                    let at = self.constant(default.clone());
                    body.emit(Op::Constant(at), line);
                }
                (None, None) => return Err(wrong(format!("argument '{name}' is missing"))),
            }
        }
        Ok(())
    }
}
