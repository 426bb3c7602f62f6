//! Tokens to syntax tree: statements.
//!
//! The language has no end of statement: a statement ends where the next token cannot continue it.
//! Only opening brackets need care: on a new line they begin a statement of their own.

mod expression;

use crate::error::{ErrorKind, ScriptError};
use crate::lexer::{Placed, Token};
use crate::limits::NESTING;
use crate::syntax::{
    Expr, ExprKind, Function, FunctionKind, Name, Qualifier, Statement, StatementKind, Step,
};

const KEYWORDS: [&str; 27] = [
    "and",
    "break",
    "continue",
    "def",
    "elif",
    "else",
    "end",
    "enter_critical",
    "exit_critical",
    "global",
    "halt",
    "if",
    "join",
    "kill",
    "local",
    "not",
    "or",
    "pass",
    "return",
    "run",
    "sec",
    "thread",
    "while",
    "xor",
    "True",
    "False",
    "None",
];

type Result<T> = std::result::Result<T, ScriptError>;

/// Parses a whole text.
pub(crate) fn parse(tokens: &[Placed]) -> Result<Vec<Statement>> {
    let mut parser = Parser { tokens, at: 0, nesting: 0 };
    let body = parser.block(&[])?;
    match parser.token() {
        Token::End => Ok(body),
        other => {
            Err(parser.error(format!("{} without a block that it belongs to", describe(other))))
        }
    }
}

struct Parser<'a> {
    tokens: &'a [Placed],
    at: usize,
    nesting: usize,
}

fn describe(token: &Token) -> String {
    match token {
        Token::Name(n) => format!("'{n}'"),
        Token::Int(i) => format!("'{i}'"),
        Token::Float(x) => format!("'{x}'"),
        Token::Text(_) => "a string".into(),
        Token::Sign(s) => format!("'{s}'"),
        Token::End => "the end of the text".into(),
    }
}

impl Parser<'_> {
    fn placed(&self) -> &Placed {
        // The last token is `End`, which nothing consumes.
        &self.tokens[self.at.min(self.tokens.len() - 1)]
    }
    fn token(&self) -> &Token {
        &self.placed().token
    }
    fn line(&self) -> u32 {
        self.placed().line
    }
    fn error(&self, text: String) -> ScriptError {
        ErrorKind::Syntax(text).at(self.line())
    }
    fn is_sign(&self, sign: &str) -> bool {
        matches!(self.token(), Token::Sign(s) if *s == sign)
    }
    fn is_word(&self, word: &str) -> bool {
        matches!(self.token(), Token::Name(n) if **n == *word)
    }
    fn take_sign(&mut self, sign: &str) -> bool {
        let found = self.is_sign(sign);
        self.at += usize::from(found);
        found
    }
    fn take_word(&mut self, word: &str) -> bool {
        let found = self.is_word(word);
        self.at += usize::from(found);
        found
    }
    fn need_sign(&mut self, sign: &str) -> Result<()> {
        if self.take_sign(sign) {
            return Ok(());
        }
        Err(self.error(format!("'{sign}' expected before {}", describe(self.token()))))
    }
    fn need_name(&mut self) -> Result<Name> {
        match self.token() {
            Token::Name(n) if !KEYWORDS.contains(&&**n) => {
                let name = n.clone();
                self.at += 1;
                Ok(name)
            }
            other => Err(self.error(format!("a name expected before {}", describe(other)))),
        }
    }
    /// Runs `inner` one level deeper; the levels are bounded because each takes stack.
    fn deeper<T>(&mut self, inner: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        if self.nesting >= NESTING {
            return Err(ErrorKind::limit(format!("nested deeper than {NESTING}")).at(self.line()));
        }
        self.nesting += 1;
        let result = inner(self);
        self.nesting -= 1;
        result
    }

    /// Statements up to one of the words, which stays, or to the end of the text.
    fn block(&mut self, until: &[&str]) -> Result<Vec<Statement>> {
        self.deeper(|p| {
            let mut body = Vec::new();
            loop {
                while p.take_sign(";") {}
                match p.token() {
                    Token::End => return Ok(body),
                    Token::Name(n) if until.contains(&&**n) => return Ok(body),
                    Token::Name(n) if matches!(&**n, "end" | "elif" | "else") => return Ok(body),
                    _ => {}
                }
                if let Some(statement) = p.statement()? {
                    body.push(statement);
                }
            }
        })
    }
    fn need_end(&mut self, what: &str, line: u32) -> Result<()> {
        if self.take_word("end") {
            return Ok(());
        }
        Err(self.error(format!(
            "'end' expected for the {what} of line {line} before {}",
            describe(self.token())
        )))
    }

    fn statement(&mut self) -> Result<Option<Statement>> {
        let line = self.line();
        let word = match self.token() {
            Token::Name(n) => n.clone(),
            Token::Sign("$") => {
                self.label()?;
                return Ok(None);
            }
            Token::Sign(s) if !matches!(*s, "(" | "[" | "-" | "+") => {
                return Err(self.error(format!("a statement cannot begin with '{s}'")));
            }
            _ => "".into(),
        };
        let simple = |p: &mut Self, kind| {
            p.at += 1;
            // Some texts call these like functions.
            if p.is_sign("(") && !p.placed().first {
                p.at += 1;
                p.need_sign(")")?;
            }
            Ok(kind)
        };
        let kind = match &*word {
            "def" => self.definition(FunctionKind::Function)?,
            "thread" => self.definition(FunctionKind::Thread)?,
            "sec" => self.definition(FunctionKind::Secondary)?,
            "if" => self.conditional(line)?,
            "while" => {
                self.at += 1;
                let condition = self.expression()?;
                self.need_sign(":")?;
                let body = self.block(&[])?;
                self.need_end("while", line)?;
                StatementKind::While { condition, body }
            }
            "pass" => {
                self.at += 1;
                return Ok(None);
            }
            "break" => simple(self, StatementKind::Break)?,
            "continue" => simple(self, StatementKind::Continue)?,
            "halt" => simple(self, StatementKind::Halt)?,
            "enter_critical" => simple(self, StatementKind::EnterCritical)?,
            "exit_critical" => simple(self, StatementKind::ExitCritical)?,
            "return" => {
                self.at += 1;
                let bare = self.placed().first || self.is_sign(";") || self.is_word("end");
                StatementKind::Return(if bare { None } else { Some(self.expression()?) })
            }
            "kill" => {
                self.at += 1;
                StatementKind::Kill(self.expression()?)
            }
            "join" => {
                self.at += 1;
                StatementKind::Join(self.expression()?)
            }
            "global" => self.declaration(Qualifier::Global)?,
            "local" => self.declaration(Qualifier::Local)?,
            _ => {
                let target = self.expression()?;
                if self.take_sign("=") {
                    let (name, path) = self.target(target)?;
                    let value = self.expression()?;
                    StatementKind::Assign { qualifier: Qualifier::Free, name, path, value }
                } else {
                    StatementKind::Expression(target)
                }
            }
        };
        Ok(Some(Statement { kind, line }))
    }

    /// `$ 3 "text" "option"`: marks the node of the program tree that runs; has no effect here.
    fn label(&mut self) -> Result<()> {
        self.need_sign("$")?;
        match self.token() {
            Token::Int(_) => self.at += 1,
            other => {
                return Err(
                    self.error(format!("a number expected after '$' before {}", describe(other)))
                );
            }
        }
        while matches!(self.token(), Token::Text(_)) && !self.placed().first {
            self.at += 1;
        }
        Ok(())
    }

    fn declaration(&mut self, qualifier: Qualifier) -> Result<StatementKind> {
        self.at += 1;
        let name = self.need_name()?;
        if !self.take_sign("=") {
            return Ok(StatementKind::Declare { qualifier, name });
        }
        Ok(StatementKind::Assign { qualifier, name, path: Vec::new(), value: self.expression()? })
    }

    /// The variable and the path into it that the left side of an assignment names.
    fn target(&self, expr: Expr) -> Result<(Name, Vec<Step>)> {
        let mut path = Vec::new();
        let (mut kind, line) = (expr.kind, expr.line);
        loop {
            kind = match kind {
                ExprKind::Name(name) => {
                    path.reverse();
                    return Ok((name, path));
                }
                ExprKind::Index(base, indices) => {
                    path.push(Step::Index(indices));
                    base.kind
                }
                ExprKind::Member(base, name) => {
                    path.push(Step::Member(name));
                    base.kind
                }
                _ => {
                    return Err(ErrorKind::syntax(
                        "only variables and their elements can be changed",
                    )
                    .at(line));
                }
            };
        }
    }

    fn conditional(&mut self, line: u32) -> Result<StatementKind> {
        let mut branches = Vec::new();
        let mut otherwise = Vec::new();
        while branches.is_empty() || self.is_word("elif") {
            self.at += 1;
            let condition = self.expression()?;
            self.need_sign(":")?;
            branches.push((condition, self.block(&[])?));
        }
        if self.take_word("else") {
            self.need_sign(":")?;
            otherwise = self.block(&[])?;
        }
        self.need_end("if", line)?;
        Ok(StatementKind::If { branches, otherwise })
    }

    fn definition(&mut self, kind: FunctionKind) -> Result<StatementKind> {
        let line = self.line();
        self.at += 1;
        let name = self.need_name()?;
        let mut parameters: Vec<(Name, Option<Expr>)> = Vec::new();
        self.need_sign("(")?;
        while !self.is_sign(")") {
            let name = self.need_name()?;
            if parameters.iter().any(|(n, _)| *n == name) {
                return Err(self.error(format!("parameter '{name}' stands twice")));
            }
            let default = if self.take_sign("=") { Some(self.expression()?) } else { None };
            parameters.push((name, default));
            if !self.take_sign(",") {
                break;
            }
        }
        self.need_sign(")")?;
        self.need_sign(":")?;
        if kind != FunctionKind::Function && !parameters.is_empty() {
            return Err(ErrorKind::syntax(format!("'{name}' can have no parameters")).at(line));
        }
        let body = self.block(&[])?;
        self.need_end("definition", line)?;
        Ok(StatementKind::Define(Function { kind, name, parameters, body, line }))
    }
}
