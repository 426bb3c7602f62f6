//! The syntax tree.

use crate::value::Value;
use std::sync::Arc;

pub(crate) type Name = Arc<str>;

/// An expression with its line and the height of its tree.
#[derive(Debug, Clone)]
pub(crate) struct Expr {
    pub kind: ExprKind,
    pub line: u32,
    pub height: usize,
}

#[derive(Debug, Clone)]
pub(crate) enum ExprKind {
    Constant(Value),
    Name(Name),
    List(Vec<Expr>),
    Pose(Vec<Expr>),
    Struct(Vec<(Name, Expr)>),
    /// `a[i]`, `a[i, j]`.
    Index(Box<Expr>, Vec<Expr>),
    Member(Box<Expr>, Name),
    Unary(Unary, Box<Expr>),
    Binary(Binary, Box<Expr>, Box<Expr>),
    And(Box<Expr>, Box<Expr>),
    Or(Box<Expr>, Box<Expr>),
    Call(Call),
    /// `run f()`.
    Run(Name),
    /// `value.method(...)` that changes nothing.
    Ask(Box<Expr>, Method, Vec<Expr>),
    /// `variable.method(...)` that changes the list there.
    Change(Name, Vec<Step>, Method, Vec<Expr>),
}

#[derive(Debug, Clone)]
pub(crate) struct Call {
    pub function: Name,
    pub positional: Vec<Expr>,
    pub named: Vec<(Name, Expr)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unary {
    Minus,
    Plus,
    Not,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Modulo,
    Equal,
    Unequal,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Xor,
}

#[derive(Debug, Clone)]
pub(crate) struct Statement {
    pub kind: StatementKind,
    pub line: u32,
}

/// One step from a variable into its value: `[i]` or `.member`.
#[derive(Debug, Clone)]
pub(crate) enum Step {
    Index(Vec<Expr>),
    Member(Name),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Qualifier {
    Free,
    Local,
    Global,
}

#[derive(Debug, Clone)]
pub(crate) enum StatementKind {
    Assign {
        qualifier: Qualifier,
        name: Name,
        path: Vec<Step>,
        value: Expr,
    },
    /// `global x`, `local x`: the variable gets its value later.
    Declare {
        qualifier: Qualifier,
        name: Name,
    },
    Expression(Expr),
    If {
        branches: Vec<(Expr, Vec<Statement>)>,
        otherwise: Vec<Statement>,
    },
    While {
        condition: Expr,
        body: Vec<Statement>,
    },
    Break,
    Continue,
    Return(Option<Expr>),
    Halt,
    Kill(Expr),
    Join(Expr),
    EnterCritical,
    ExitCritical,
    Define(Function),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FunctionKind {
    Function,
    Thread,
    Secondary,
}

#[derive(Debug, Clone)]
pub(crate) struct Function {
    pub kind: FunctionKind,
    pub name: Name,
    pub parameters: Vec<(Name, Option<Expr>)>,
    pub body: Vec<Statement>,
    pub line: u32,
}

/// Functions of values ("Methods in URScript").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Method {
    Append,
    Clear,
    Extend,
    Insert,
    Pop,
    Remove,
    Capacity,
    ExcessCapacity,
    Length,
    Slice,
    ToString,
    GetColumn,
    GetRow,
    Shape,
}

impl Method {
    /// The method of this name, the number of its arguments and whether it changes its list.
    pub fn find(name: &str) -> Option<(Self, usize, bool)> {
        Some(match name {
            "append" => (Self::Append, 1, true),
            "clear" => (Self::Clear, 0, true),
            "extend" => (Self::Extend, 1, true),
            "insert" => (Self::Insert, 2, true),
            "pop" => (Self::Pop, 0, true),
            "remove" => (Self::Remove, 1, true),
            "capacity" => (Self::Capacity, 0, false),
            "excess_capacity" => (Self::ExcessCapacity, 0, false),
            "length" => (Self::Length, 0, false),
            "slice" => (Self::Slice, 2, false),
            "to_string" => (Self::ToString, 0, false),
            "get_column" => (Self::GetColumn, 1, false),
            "get_row" => (Self::GetRow, 1, false),
            "shape" => (Self::Shape, 0, false),
            _ => return None,
        })
    }
}
