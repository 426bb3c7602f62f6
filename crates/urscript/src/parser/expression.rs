//! Tokens to syntax tree: expressions.

use super::{KEYWORDS, Parser, Result, describe};
use crate::error::ErrorKind;
use crate::lexer::Token;
use crate::limits::{EXPRESSION_HEIGHT, LITERAL, LOCALS};
use crate::syntax::{Binary, Call, Expr, ExprKind, Method, Name, Unary};
use crate::value::Value;

/// An operator between two operands.
enum Infix {
    Or,
    And,
    Plain(Binary),
}

/// Operator with its rank: the higher, the tighter it binds.
fn infix(token: &Token) -> Option<(u8, Infix)> {
    use Binary::*;
    let plain = |rank, b| Some((rank, Infix::Plain(b)));
    match token {
        Token::Name(n) => match &**n {
            "or" => Some((1, Infix::Or)),
            "xor" => plain(2, Xor),
            "and" => Some((3, Infix::And)),
            _ => None,
        },
        Token::Sign(s) => match *s {
            "==" => plain(5, Equal),
            "!=" => plain(5, Unequal),
            "<" => plain(5, Less),
            "<=" => plain(5, LessEqual),
            ">" => plain(5, Greater),
            ">=" => plain(5, GreaterEqual),
            "+" => plain(6, Add),
            "-" => plain(6, Subtract),
            "*" => plain(7, Multiply),
            "/" => plain(7, Divide),
            "%" => plain(7, Modulo),
            _ => None,
        },
        _ => None,
    }
}

/// Rank of `not`, between the logical operators and the comparisons.
const NOT: u8 = 4;
/// Rank of the signs before a factor.
const SIGN: u8 = 8;

impl Parser<'_> {
    /// An expression; newlines inside it mean nothing.
    pub(super) fn expression(&mut self) -> Result<Expr> {
        self.deeper(|p| p.operators(0))
    }

    fn expr(&self, kind: ExprKind, line: u32, height: usize) -> Result<Expr> {
        if height >= EXPRESSION_HEIGHT {
            return Err(ErrorKind::limit(format!(
                "an expression of more than {EXPRESSION_HEIGHT} levels"
            ))
            .at(line));
        }
        Ok(Expr { kind, line, height: height + 1 })
    }

    fn operators(&mut self, least: u8) -> Result<Expr> {
        let mut left = self.prefixed()?;
        while let Some((rank, operator)) = infix(self.token())
            && rank >= least
        {
            let line = self.line();
            self.at += 1;
            let right = self.deeper(|p| p.operators(rank + 1))?;
            let height = left.height.max(right.height);
            let (l, r) = (Box::new(left), Box::new(right));
            let kind = match operator {
                Infix::Or => ExprKind::Or(l, r),
                Infix::And => ExprKind::And(l, r),
                Infix::Plain(b) => ExprKind::Binary(b, l, r),
            };
            left = self.expr(kind, line, height)?;
        }
        Ok(left)
    }

    fn prefixed(&mut self) -> Result<Expr> {
        let line = self.line();
        let (operator, rank) = match self.token() {
            Token::Name(n) if **n == *"not" => (Unary::Not, NOT),
            Token::Sign("-") => (Unary::Minus, SIGN),
            Token::Sign("+") => (Unary::Plus, SIGN),
            _ => return self.postfix(),
        };
        self.at += 1;
        let operand = self.deeper(|p| p.operators(rank))?;
        let constant = match (&operator, &operand.kind) {
            (Unary::Minus, ExprKind::Constant(Value::Int(i))) => Some(Value::Int(i.wrapping_neg())),
            (Unary::Minus, ExprKind::Constant(Value::Float(f))) => Some(Value::Float(-f)),
            _ => None,
        };
        let height = operand.height;
        match constant {
            Some(value) => self.expr(ExprKind::Constant(value), line, 0),
            None => self.expr(ExprKind::Unary(operator, Box::new(operand)), line, height),
        }
    }

    fn postfix(&mut self) -> Result<Expr> {
        let mut base = self.primary()?;
        loop {
            let line = self.line();
            // A bracket on a new line begins a statement.
            if self.placed().first {
                return Ok(base);
            }
            if self.take_sign("[") {
                let indices = self.list("]")?;
                if !(1..=2).contains(&indices.len()) {
                    let reason = format!("one or two indices expected, not {}", indices.len());
                    return Err(ErrorKind::Syntax(reason).at(line));
                }
                let height = highest(&indices).max(base.height);
                base = self.expr(ExprKind::Index(Box::new(base), indices), line, height)?;
            } else if self.take_sign(".") {
                let name = self.need_name()?;
                if !self.placed().first && self.take_sign("(") {
                    base = self.method(base, &name, line)?;
                    continue;
                }
                let height = base.height;
                base = self.expr(ExprKind::Member(Box::new(base), name), line, height)?;
            } else {
                return Ok(base);
            }
        }
    }

    /// `.name(` has been read.
    fn method(&mut self, base: Expr, name: &Name, line: u32) -> Result<Expr> {
        let missing = || ErrorKind::NotDefined(format!(".{name}")).at(line);
        let (method, arity, changes) = Method::find(name).ok_or_else(missing)?;
        let args = self.list(")")?;
        if args.len() != arity {
            let reason = format!("{arity} arguments, {} given", args.len());
            return Err(ErrorKind::Call { function: format!(".{name}"), reason }.at(line));
        }
        let height = highest(&args).max(base.height);
        if changes {
            let (variable, path) = self.target(base)?;
            return self.expr(ExprKind::Change(variable, path, method, args), line, height);
        }
        self.expr(ExprKind::Ask(Box::new(base), method, args), line, height)
    }

    fn primary(&mut self) -> Result<Expr> {
        let line = self.line();
        let token = self.token().clone();
        let constant = |p: &mut Self, value| {
            p.at += 1;
            p.expr(ExprKind::Constant(value), line, 0)
        };
        match token {
            Token::Int(i) => constant(self, Value::Int(i)),
            Token::Float(x) => constant(self, Value::Float(x)),
            Token::Text(t) => constant(self, Value::Text(t)),
            Token::Sign("(") => {
                self.at += 1;
                let inner = self.expression()?;
                self.need_sign(")")?;
                Ok(inner)
            }
            Token::Sign("[") => {
                self.at += 1;
                let items = self.list("]")?;
                let height = highest(&items);
                self.expr(ExprKind::List(items), line, height)
            }
            Token::Name(name) => match &*name {
                "True" => constant(self, Value::Bool(true)),
                "False" => constant(self, Value::Bool(false)),
                "None" => constant(self, Value::Nothing),
                "run" => {
                    self.at += 1;
                    let thread = self.need_name()?;
                    self.need_sign("(")?;
                    self.need_sign(")")?;
                    self.expr(ExprKind::Run(thread), line, 0)
                }
                word if KEYWORDS.contains(&word) => {
                    Err(self.error(format!("an expression expected before '{word}'")))
                }
                _ => {
                    self.at += 1;
                    self.named(name, line)
                }
            },
            other => Err(self.error(format!("an expression expected before {}", describe(&other)))),
        }
    }

    /// What begins with a name: variable, call, pose, struct.
    fn named(&mut self, name: Name, line: u32) -> Result<Expr> {
        let attached = !self.placed().first;
        if attached && *name == *"p" && self.is_sign("[") {
            // `p[0]` is an element of a variable called p; a pose has six.
            self.at += 1;
            let items = self.list("]")?;
            let height = highest(&items);
            if let 1 | 2 = items.len() {
                let variable = self.expr(ExprKind::Name(name), line, 0)?;
                return self.expr(ExprKind::Index(Box::new(variable), items), line, height);
            }
            if items.len() != 6 {
                let reason = format!("a pose has 6 elements, not {}", items.len());
                return Err(ErrorKind::Syntax(reason).at(line));
            }
            return self.expr(ExprKind::Pose(items), line, height);
        }
        if !(attached && self.take_sign("(")) {
            return self.expr(ExprKind::Name(name), line, 0);
        }
        let (mut positional, mut named) = (Vec::new(), Vec::<(Name, Expr)>::new());
        let mut height = 0;
        while !self.is_sign(")") {
            let value = self.expression()?;
            height = height.max(value.height);
            match value.kind {
                ExprKind::Name(key) if self.take_sign("=") => {
                    if named.iter().any(|(n, _)| *n == key) {
                        return Err(self.error(format!("argument '{key}' stands twice")));
                    }
                    let value = self.expression()?;
                    height = height.max(value.height);
                    named.push((key, value));
                }
                _ if !named.is_empty() => {
                    return Err(self.error("an argument without name after one with a name".into()));
                }
                _ => positional.push(value),
            }
            if positional.len() + named.len() > LOCALS {
                return Err(ErrorKind::limit(format!("more than {LOCALS} arguments")).at(line));
            }
            if !self.take_sign(",") {
                break;
            }
        }
        self.need_sign(")")?;
        let kind = if *name == *"struct" {
            if !positional.is_empty() {
                return Err(ErrorKind::syntax("every member of a struct needs a name").at(line));
            }
            ExprKind::Struct(named)
        } else {
            ExprKind::Call(Call { function: name, positional, named })
        };
        self.expr(kind, line, height)
    }

    /// Expressions with commas up to the closing sign, which is consumed.
    fn list(&mut self, close: &str) -> Result<Vec<Expr>> {
        let mut items = Vec::new();
        while !self.is_sign(close) {
            items.push(self.expression()?);
            if items.len() > LITERAL {
                return Err(ErrorKind::limit(format!("a list of more than {LITERAL} elements"))
                    .at(self.line()));
            }
            if !self.take_sign(",") {
                break;
            }
        }
        self.need_sign(close)?;
        Ok(items)
    }
}

fn highest(items: &[Expr]) -> usize {
    items.iter().map(|e| e.height).max().unwrap_or(0)
}
