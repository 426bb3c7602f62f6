//! What the controller around the machine provides: its functions.

use crate::error::{ErrorKind, ScriptError};
use crate::lexer::{self, Token};
use crate::value::{List, Value};
use std::any::Any;
use std::collections::HashMap;

/// Number of a thread, unique in the life of a machine; what `run` returns.
pub type ThreadId = i32;

/// The controller around the machine.
pub trait Host {
    /// Carries out a call of one of the announced functions. After [`Reply::Wait`] the same call
    /// comes again in the next cycle, with the same arguments and the same `state`.
    fn call(&mut self, call: Call<'_>) -> Reply;

    /// A call that waited will not come again: its thread was killed or its program ended.
    fn abandoned(&mut self, call: Call<'_>) {
        let _ = call;
    }
}

/// A host that has no functions.
impl Host for () {
    fn call(&mut self, call: Call<'_>) -> Reply {
        Reply::Error(format!("'{}' is not there", call.function))
    }
}

/// One call of a host function.
#[derive(Debug)]
pub struct Call<'a> {
    /// Name of the function.
    pub function: &'a str,
    /// The arguments in the order of the signature, one per parameter; [`Value::Nothing`] for an
    /// optional one that was not given.
    pub args: &'a [Value],
    /// The thread that calls.
    pub thread: ThreadId,
    /// Whether the thread belongs to a secondary program.
    pub secondary: bool,
    /// Line of the call.
    pub line: u32,
    /// How many times this very call has waited.
    pub waited: u64,
    /// The host's notes on this call; dropped when the call ends.
    pub state: &'a mut State,
}

/// The host's notes on a call; `None` at first.
pub type State = Option<Box<dyn Any + Send>>;

/// Answer to a [`Call`].
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// The call is done; the thread goes on in this cycle.
    Done(Value),
    /// The call takes the rest of this cycle and comes again in the next one.
    Wait,
    /// The call is done and takes the rest of this cycle.
    Spent(Value),
    /// The call fails and ends the program with this text.
    Error(String),
}

/// Parameter of a host function.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name, for named arguments.
    pub name: String,
    /// What is passed where it is not given; `None` if it must be given.
    pub default: Option<Value>,
}

/// A function with its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Signature {
    /// Name of the function.
    pub name: String,
    /// Its parameters in order.
    pub parameters: Vec<Parameter>,
}

/// The functions that a host announces.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Functions {
    list: Vec<Signature>,
    by_name: HashMap<String, usize>,
}

impl Functions {
    /// Reads one signature per line: `movej(q, a = 1.4, v = 1.05, t = 0, r = 0)`. A parameter with
    /// `=` has that default (number, `True`, `False`, string, list or pose of numbers); one with
    /// `= None` may be missing and is then passed as [`Value::Nothing`].
    pub fn parse(lines: &str) -> Result<Self, ScriptError> {
        let mut all = Self::default();
        for (line, text) in (1..).zip(lines.lines()) {
            let text = text.split('#').next().unwrap_or("").trim();
            if !text.is_empty() {
                let signature = signature(text).map_err(|kind| kind.at(line))?;
                all.add(signature);
            }
        }
        Ok(all)
    }
    /// Adds a function, in place of one of the same name.
    pub fn add(&mut self, signature: Signature) {
        match self.by_name.get(&signature.name) {
            Some(&at) => self.list[at] = signature,
            None => {
                self.by_name.insert(signature.name.clone(), self.list.len());
                self.list.push(signature);
            }
        }
    }
    /// All functions.
    pub fn list(&self) -> &[Signature] {
        &self.list
    }
    /// The function of this name.
    pub fn get(&self, name: &str) -> Option<&Signature> {
        self.by_name.get(name).map(|&at| &self.list[at])
    }
    pub(crate) fn position(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }
}

fn signature(text: &str) -> Result<Signature, ErrorKind> {
    let tokens: Vec<Token> =
        lexer::tokens(text).map_err(|e| e.kind)?.into_iter().map(|p| p.token).collect();
    let bad = || ErrorKind::syntax(format!("'{text}' is not a signature such as 'f(a, b = 1)'"));
    let mut at = tokens.iter();
    let Some(Token::Name(name)) = at.next() else { return Err(bad()) };
    if at.next() != Some(&Token::Sign("(")) {
        return Err(bad());
    }
    let mut parameters = Vec::new();
    let mut token = at.next().ok_or_else(bad)?;
    while *token != Token::Sign(")") {
        let Token::Name(parameter) = token else { return Err(bad()) };
        let mut default = None;
        token = at.next().ok_or_else(bad)?;
        if *token == Token::Sign("=") {
            default = Some(constant(&mut at).ok_or_else(bad)?);
            token = at.next().ok_or_else(bad)?;
        }
        parameters.push(Parameter { name: parameter.to_string(), default });
        if *token == Token::Sign(",") {
            token = at.next().ok_or_else(bad)?;
        } else if *token != Token::Sign(")") {
            return Err(bad());
        }
    }
    Ok(Signature { name: name.to_string(), parameters })
}

/// A constant: number, truth value, string, `None`, list or pose of numbers.
fn constant<'a>(at: &mut impl Iterator<Item = &'a Token>) -> Option<Value> {
    match at.next()? {
        Token::Int(i) => Some(Value::Int(*i)),
        Token::Float(x) => Some(Value::Float(*x)),
        Token::Text(t) => Some(Value::Text(t.clone())),
        Token::Sign("-") => match constant_number(at)? {
            Value::Int(i) => Some(Value::Int(i.wrapping_neg())),
            Value::Float(x) => Some(Value::Float(-x)),
            _ => None,
        },
        Token::Sign("[") => Some(Value::List(List::new(numbers(at)?).ok()?)),
        Token::Name(n) => match &**n {
            "True" => Some(Value::Bool(true)),
            "False" => Some(Value::Bool(false)),
            "None" => Some(Value::Nothing),
            "p" if at.next()? == &Token::Sign("[") => {
                let six: Option<Vec<f64>> = numbers(at)?.iter().map(Value::number).collect();
                Some(Value::Pose(six?.try_into().ok()?))
            }
            _ => None,
        },
        _ => None,
    }
}

fn constant_number<'a>(at: &mut impl Iterator<Item = &'a Token>) -> Option<Value> {
    match at.next()? {
        Token::Int(i) => Some(Value::Int(*i)),
        Token::Float(x) => Some(Value::Float(*x)),
        _ => None,
    }
}

/// Numbers up to the closing bracket.
fn numbers<'a>(at: &mut impl Iterator<Item = &'a Token>) -> Option<Vec<Value>> {
    let mut items = Vec::new();
    loop {
        match at.next()? {
            Token::Sign("]") => return Some(items),
            Token::Sign(",") => {}
            Token::Int(i) => items.push(Value::Int(*i)),
            Token::Float(x) => items.push(Value::Float(*x)),
            Token::Sign("-") => match constant_number(at)? {
                Value::Int(i) => items.push(Value::Int(i.wrapping_neg())),
                Value::Float(x) => items.push(Value::Float(-x)),
                _ => return None,
            },
            _ => return None,
        }
    }
}
