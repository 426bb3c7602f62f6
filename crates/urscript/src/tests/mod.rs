//! Programs run against a host that notes its calls.

mod errors;
mod language;
mod scheduling;
mod values;

use crate::{Call, Ended, Functions, Host, Limits, Machine, Program, Reply, ScriptError, Value};

/// What the host of these tests has: `note` writes down, `move` takes `n` cycles, `take` uses up
/// the cycle, `fail` fails.
const FUNCTIONS: &str = "note(a, b = None)\nmove(n, speed = 0.5, name = 'x')\ntake(v)\nfail()\n";

#[derive(Default)]
pub(crate) struct Notes {
    pub notes: Vec<String>,
    pub moves: Vec<(i32, f64)>,
    pub abandoned: Vec<(String, u64)>,
}

impl Host for Notes {
    fn call(&mut self, call: Call<'_>) -> Reply {
        match (call.function, call.args) {
            ("note", [a, Value::Nothing]) => self.notes.push(a.to_string()),
            ("note", [a, b]) => self.notes.push(format!("{a}{b}")),
            ("move", [n, speed, _]) => {
                let n = n.integer().unwrap_or(0);
                if call.waited == 0 {
                    *call.state = Some(Box::new(n));
                    self.moves.push((call.thread, speed.number().unwrap_or(f64::NAN)));
                }
                // The notes of the call must come back unchanged.
                let noted = call.state.as_ref().and_then(|s| s.downcast_ref::<i32>().copied());
                if noted != Some(n) {
                    return Reply::Error("the notes of the call were lost".into());
                }
                if call.waited < n as u64 {
                    return Reply::Wait;
                }
                return Reply::Done(Value::Int(n));
            }
            ("take", [v]) => return Reply::Spent(v.clone()),
            _ => return Reply::Error("it failed".into()),
        }
        Reply::Done(Value::Nothing)
    }
    fn abandoned(&mut self, call: Call<'_>) {
        self.abandoned.push((call.function.into(), call.waited));
    }
}

pub(crate) fn load(text: &str) -> Result<Vec<Program>, ScriptError> {
    Program::load(text, &Functions::parse(FUNCTIONS).unwrap(), &Limits::default())
}

pub(super) fn error(text: &str) -> String {
    load(text).unwrap_err().to_string()
}

/// Runs a text for at most `cycles`; its notes and its end.
pub(super) fn run_for(text: &str, cycles: usize) -> (Notes, Vec<Ended>) {
    let mut host = Notes::default();
    let mut machine = Machine::new(0.008, Limits::default(), 7);
    for program in &load(text).unwrap() {
        machine.start(program, &mut host).unwrap();
    }
    let mut ended = Vec::new();
    for _ in 0..cycles {
        ended.extend(machine.cycle(&mut host));
    }
    (host, ended)
}

/// The notes of statements that end without error.
pub(super) fn notes(text: &str) -> Vec<String> {
    let (host, ended) = run_for(text, 100);
    assert_eq!(ended.iter().map(|e| e.error.clone()).collect::<Vec<_>>(), [None], "{text}");
    host.notes
}

/// The value of an expression as text.
pub(super) fn eval(expression: &str) -> String {
    notes(&format!("note(to_str({expression}))")).concat()
}

/// The error that ends statements.
pub(super) fn failure(text: &str) -> ScriptError {
    let (_, ended) = run_for(text, 100);
    ended.into_iter().find_map(|e| e.error).unwrap()
}
