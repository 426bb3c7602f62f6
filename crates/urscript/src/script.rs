//! Script texts: from text to programs.

use crate::code::Code;
use crate::compiler;
use crate::error::{ErrorKind, ScriptError};
use crate::host::Functions;
use crate::lexer;
use crate::limits::Limits;
use crate::parser;
use crate::syntax::{Function, FunctionKind, Statement, StatementKind};
use std::sync::Arc;

/// A program, parsed, with all its names resolved.
#[derive(Debug, Clone)]
pub struct Program {
    pub(crate) code: Arc<Code>,
}

/// Name of a program made of statements without `def`.
pub const UNNAMED: &str = "unnamed";

impl Program {
    /// Loads a text as the controller receives it: `def` and `sec` programs, in their order. Other
    /// statements outside of programs form a program of their own, called [`UNNAMED`], which also
    /// sees the functions that the text defines.
    pub fn load(text: &str, host: &Functions, limits: &Limits) -> Result<Vec<Self>, ScriptError> {
        if text.len() > limits.source {
            let reason = format!("a text of {} bytes; {} at most", text.len(), limits.source);
            return Err(ErrorKind::Limit(reason).at(0));
        }
        let statements = parser::parse(&lexer::tokens(text)?)?;
        programs(statements)
            .iter()
            .map(|f| Ok(Self { code: Arc::new(compiler::compile(f, host)?) }))
            .collect()
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.code.name
    }

    /// Whether it is a `sec` program, which runs beside the main one.
    pub fn is_secondary(&self) -> bool {
        self.code.secondary
    }
}

fn is_program(statement: &Statement) -> bool {
    matches!(&statement.kind, StatementKind::Define(f) if f.kind != FunctionKind::Thread)
}

fn is_secondary(statement: &Statement) -> bool {
    matches!(&statement.kind, StatementKind::Define(f) if f.kind == FunctionKind::Secondary)
}

/// Groups the statements of a text into programs.
fn programs(statements: Vec<Statement>) -> Vec<Function> {
    let mut found = Vec::new();
    let mut loose = Vec::new();
    let only_programs = statements.iter().all(is_program);
    for statement in statements {
        let apart = only_programs || is_secondary(&statement);
        match statement.kind {
            StatementKind::Define(f) if apart => found.push(f),
            kind => loose.push(Statement { kind, line: statement.line }),
        }
    }
    if let Some(first) = loose.first() {
        let line = first.line;
        let (kind, name) = (FunctionKind::Function, UNNAMED.into());
        found.push(Function { kind, name, parameters: Vec::new(), body: loose, line });
    }
    found
}
