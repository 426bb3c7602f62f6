//! Syntax tree to instructions: resolves names, arranges arguments.

mod expression;
mod scope;

use crate::code::{Code, Op, PathStep, Routine, Slot};
use crate::error::{ErrorKind, ScriptError};
use crate::host::Functions;
use crate::limits::LOCALS;
use crate::syntax::{Expr, Function, FunctionKind, Name, Statement, StatementKind, Step};
use crate::value::Value;
use std::collections::HashMap;

type Result<T> = std::result::Result<T, ScriptError>;

/// Compiles one program.
pub(crate) fn compile(program: &Function, host: &Functions) -> Result<Code> {
    let names = scope::globals(&program.body);
    let globals = names.iter().cloned().zip(0..).collect();
    let mut compiler = Compiler {
        host,
        globals,
        constants: Vec::new(),
        routines: Vec::new(),
        signatures: Vec::new(),
        visible: Vec::new(),
        secondary: program.kind == FunctionKind::Secondary,
    };
    if let Some((name, _)) = program.parameters.first() {
        let reason = format!("the program '{}' cannot have the parameter '{name}'", program.name);
        return Err(ErrorKind::Syntax(reason).at(program.line));
    }
    compiler.routine(program, 0)?;
    let mut routines: Vec<(usize, Routine)> = compiler.routines;
    routines.sort_by_key(|(number, _)| *number);
    Ok(Code {
        name: program.name.clone(),
        secondary: compiler.secondary,
        routines: routines.into_iter().map(|(_, r)| r).collect(),
        globals: names,
        constants: compiler.constants,
        hosts: host.list().iter().map(|s| s.name.clone()).collect(),
        host_arguments: host.list().iter().map(|s| s.parameters.len()).collect(),
    })
}

/// What a call of a function of the program needs to know.
#[derive(Clone)]
struct Known {
    kind: FunctionKind,
    /// Names of the parameters and whether they have a default.
    parameters: Vec<(Name, bool)>,
}

struct Compiler<'a> {
    host: &'a Functions,
    globals: HashMap<Name, usize>,
    constants: Vec<Value>,
    routines: Vec<(usize, Routine)>,
    /// By number of the routine.
    signatures: Vec<Known>,
    /// Functions of the enclosing bodies, inner ones last.
    visible: Vec<HashMap<Name, usize>>,
    secondary: bool,
}

/// The function under construction.
struct Body {
    locals: HashMap<Name, usize>,
    ops: Vec<Op>,
    lines: Vec<u32>,
    loops: Vec<Loop>,
}

/// Addresses of a loop: where `continue` goes, and the jumps that `break` left to be set.
struct Loop {
    start: usize,
    breaks: Vec<usize>,
}

impl Body {
    fn emit(&mut self, op: Op, line: u32) -> usize {
        self.ops.push(op);
        self.lines.push(line);
        self.ops.len() - 1
    }
    /// Lets a jump go to here.
    fn land(&mut self, jump: usize) {
        let here = self.ops.len();
        match &mut self.ops[jump] {
            Op::Jump(to)
            | Op::JumpIfFalse(to)
            | Op::JumpIfFalseKeep(to)
            | Op::JumpIfTrueKeep(to)
            | Op::JumpIfGiven(_, to) => *to = here,
            _ => {}
        }
    }
}

impl Compiler<'_> {
    fn known(&mut self, function: &Function) -> usize {
        let parameters =
            function.parameters.iter().map(|(n, d)| (n.clone(), d.is_some())).collect();
        self.signatures.push(Known { kind: function.kind, parameters });
        self.signatures.len() - 1
    }

    /// Compiles a function; `number` 0 is the program itself.
    fn routine(&mut self, function: &Function, number: usize) -> Result<()> {
        if number == 0 {
            self.known(function);
        }
        let locals = if number == 0 { Vec::new() } else { scope::locals(function, &self.globals) };
        if locals.len() > LOCALS {
            let reason = format!("'{}' has more than {LOCALS} local variables", function.name);
            return Err(ErrorKind::Limit(reason).at(function.line));
        }
        let inner = scope::definitions(&function.body);
        let mut names = HashMap::new();
        for f in &inner {
            if f.kind == FunctionKind::Secondary {
                return Err(ErrorKind::syntax("'sec' stands only outside of programs").at(f.line));
            }
            if f.kind == FunctionKind::Thread && self.secondary {
                return Err(ErrorKind::syntax("a secondary program has no threads").at(f.line));
            }
            let at = self.known(f);
            if names.insert(f.name.clone(), at).is_some() {
                let reason = format!("'{}' is defined twice", f.name);
                return Err(ErrorKind::Syntax(reason).at(f.line));
            }
        }
        let numbers: Vec<usize> = inner.iter().map(|f| names[&f.name]).collect();
        self.visible.push(names);
        let mut body = Body {
            locals: locals.iter().cloned().zip(0..).collect(),
            ops: Vec::new(),
            lines: Vec::new(),
            loops: Vec::new(),
        };
        for (slot, (_, default)) in function.parameters.iter().enumerate() {
            if let Some(default) = default {
                let jump = body.emit(Op::JumpIfGiven(slot, 0), function.line);
                self.expression(default, &mut body)?;
                body.emit(Op::Store(Slot::Local(slot)), function.line);
                body.land(jump);
            }
        }
        self.block(&function.body, &mut body)?;
        let nothing = self.constant(Value::Nothing);
        body.emit(Op::Constant(nothing), function.line);
        body.emit(Op::Return, function.line);
        for (f, number) in inner.into_iter().zip(numbers) {
            self.routine(f, number)?;
        }
        self.visible.pop();
        let parameters = self.signatures[number].parameters.clone();
        let routine = Routine {
            name: function.name.clone(),
            parameters,
            locals,
            ops: body.ops,
            lines: body.lines,
        };
        self.routines.push((number, routine));
        Ok(())
    }

    fn constant(&mut self, value: Value) -> usize {
        if value == Value::Nothing
            && let Some(at) = self.constants.iter().position(|c| *c == value)
        {
            return at;
        }
        self.constants.push(value);
        self.constants.len() - 1
    }

    fn block(&mut self, statements: &[Statement], body: &mut Body) -> Result<()> {
        statements.iter().try_for_each(|s| self.statement(s, body))
    }

    /// The place of a variable.
    pub(super) fn slot(&self, name: &Name, body: &Body) -> Option<Slot> {
        match body.locals.get(name) {
            Some(&at) => Some(Slot::Local(at)),
            None => self.globals.get(name).map(|&at| Slot::Global(at)),
        }
    }

    fn statement(&mut self, statement: &Statement, body: &mut Body) -> Result<()> {
        let line = statement.line;
        match &statement.kind {
            StatementKind::Assign { name, path, value, .. } => {
                self.assign(name, path, value, line, body)?
            }
            StatementKind::Declare { .. } | StatementKind::Define(_) => {}
            StatementKind::Expression(e) => {
                self.expression(e, body)?;
                body.emit(Op::Pop, line);
            }
            StatementKind::If { branches, otherwise } => {
                let mut ends = Vec::new();
                for (condition, block) in branches {
                    self.expression(condition, body)?;
                    let next = body.emit(Op::JumpIfFalse(0), condition.line);
                    self.block(block, body)?;
                    ends.push(body.emit(Op::Jump(0), line));
                    body.land(next);
                }
                self.block(otherwise, body)?;
                ends.into_iter().for_each(|jump| body.land(jump));
            }
            StatementKind::While { condition, body: block } => {
                let start = body.ops.len();
                self.expression(condition, body)?;
                let end = body.emit(Op::JumpIfFalse(0), condition.line);
                body.loops.push(Loop { start, breaks: vec![end] });
                self.block(block, body)?;
                body.emit(Op::Jump(start), line);
                for jump in body.loops.pop().map(|l| l.breaks).unwrap_or_default() {
                    body.land(jump);
                }
            }
            StatementKind::Break => {
                let jump = body.emit(Op::Jump(0), line);
                let outside = || ErrorKind::syntax("'break' outside of a loop").at(line);
                body.loops.last_mut().ok_or_else(outside)?.breaks.push(jump);
            }
            StatementKind::Continue => {
                let outside = || ErrorKind::syntax("'continue' outside of a loop").at(line);
                let start = body.loops.last().ok_or_else(outside)?.start;
                body.emit(Op::Jump(start), line);
            }
            StatementKind::Return(value) => {
                match value {
                    Some(e) => self.expression(e, body)?,
                    None => {
                        let nothing = self.constant(Value::Nothing);
                        body.emit(Op::Constant(nothing), line);
                    }
                }
                body.emit(Op::Return, line);
            }
            StatementKind::Halt => {
                body.emit(Op::Halt, line);
            }
            StatementKind::Kill(e) => {
                self.expression(e, body)?;
                body.emit(Op::Kill, line);
            }
            StatementKind::Join(e) => {
                self.expression(e, body)?;
                body.emit(Op::Join, line);
            }
            StatementKind::EnterCritical => {
                body.emit(Op::EnterCritical, line);
            }
            StatementKind::ExitCritical => {
                body.emit(Op::ExitCritical, line);
            }
        }
        Ok(())
    }

    fn assign(
        &mut self,
        name: &Name,
        path: &[Step],
        value: &Expr,
        line: u32,
        body: &mut Body,
    ) -> Result<()> {
        let steps = self.path(path, body)?;
        self.expression(value, body)?;
        let slot = self
            .slot(name, body)
            .ok_or_else(|| ErrorKind::NotDefined(name.to_string()).at(line))?;
        body.emit(
            if steps.is_empty() { Op::Store(slot) } else { Op::StoreElement(slot, steps.into()) },
            line,
        );
        Ok(())
    }

    /// Pushes the indices of a path.
    pub(super) fn path(&mut self, path: &[Step], body: &mut Body) -> Result<Vec<PathStep>> {
        let mut steps = Vec::new();
        for step in path {
            steps.push(match step {
                Step::Index(indices) => {
                    for index in indices {
                        self.expression(index, body)?;
                    }
                    PathStep::Index(indices.len())
                }
                Step::Member(name) => PathStep::Member(name.clone()),
            });
        }
        Ok(steps)
    }
}
