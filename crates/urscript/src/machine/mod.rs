//! The machine that runs programs in controller cycles.
//!
//! Each cycle gives every thread one slice of time ("Thread scheduling" of the script manual). A
//! thread runs until it uses its slice up: by `sync`, `sleep` or a host function that waits.

mod place;
mod step;
mod thread;
mod values;

use crate::error::{ErrorKind, ScriptError};
use crate::host::{Call, Host, ThreadId};
use crate::limits::Limits;
use crate::script::Program;
use crate::value::Value;
use step::Next;
use thread::{Task, Wait};

/// How a program ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Ended {
    /// Name of the program.
    pub program: String,
    /// Whether it was a secondary one.
    pub secondary: bool,
    /// The error that ended it, if one did.
    pub error: Option<ScriptError>,
}

/// Runs one main program and secondary ones beside it.
#[derive(Debug)]
pub struct Machine {
    limits: Limits,
    /// Length of a cycle, s.
    period: f64,
    random: u64,
    cycle: u64,
    last_thread: ThreadId,
    main: Option<Task>,
    secondary: Vec<Task>,
}

impl Machine {
    /// A machine without program. `period` is the length of a cycle in s (0.008 on CB3, 0.002 on
    /// e-Series); `seed` is that of `random()`.
    pub fn new(period: f64, limits: Limits, seed: u64) -> Self {
        let period = if period.is_finite() && period > 0.0 { period } else { 0.008 };
        Self {
            limits,
            period,
            random: seed,
            cycle: 0,
            last_thread: 0,
            main: None,
            secondary: Vec::new(),
        }
    }

    /// Starts a program from the next cycle on. A main program takes the place of the one that
    /// runs, as on the controller; a secondary one runs beside it and is refused where too many do.
    pub fn start(&mut self, program: &Program, host: &mut dyn Host) -> Result<(), ScriptError> {
        if program.is_secondary() && self.secondary.len() >= self.limits.secondary {
            let reason = format!("{} secondary programs run already", self.secondary.len());
            return Err(ErrorKind::Limit(reason).at(0));
        }
        self.last_thread = self.last_thread.wrapping_add(1).max(1);
        let task = Task::new(program.code.clone(), self.last_thread);
        if program.is_secondary() {
            self.secondary.push(task);
        } else {
            self.stop(host);
            self.main = Some(task);
        }
        Ok(())
    }

    /// Ends the main program; tells the host of calls that waited. Secondary programs go on.
    pub fn stop(&mut self, host: &mut dyn Host) {
        if let Some(mut task) = self.main.take() {
            abandon_all(&mut task, host);
        }
    }

    /// Whether a main program runs.
    pub fn running(&self) -> bool {
        self.main.is_some()
    }

    /// Name of the main program that runs.
    pub fn program(&self) -> Option<&str> {
        self.main.as_ref().map(|t| &*t.code.name)
    }

    /// Number of threads that run, those of secondary programs included.
    pub fn threads(&self) -> usize {
        self.main.iter().chain(&self.secondary).map(|t| t.threads.len()).sum()
    }

    /// The value of a global variable of the main program, e.g. to show it.
    pub fn global(&self, name: &str) -> Option<&Value> {
        let task = self.main.as_ref()?;
        let at = task.code.globals.iter().position(|g| **g == *name)?;
        task.globals[at].as_ref()
    }

    /// Elements that the programs hold.
    #[cfg(test)]
    pub(crate) fn elements(&self) -> usize {
        self.main.iter().chain(&self.secondary).map(Task::elements).sum()
    }

    /// One controller cycle: every thread gets its slice. Returns the programs that ended in it.
    pub fn cycle(&mut self, host: &mut dyn Host) -> Vec<Ended> {
        self.cycle += 1;
        let mut ended = Vec::new();
        if let Some(mut task) = self.main.take() {
            match self.run(&mut task, host) {
                None => self.main = Some(task),
                Some(end) => ended.push(end),
            }
        }
        for mut task in std::mem::take(&mut self.secondary) {
            match self.run(&mut task, host) {
                None => self.secondary.push(task),
                Some(end) => ended.push(end),
            }
        }
        ended
    }

    /// One cycle of one program; how it ended, if it did.
    fn run(&mut self, task: &mut Task, host: &mut dyn Host) -> Option<Ended> {
        let outcome = self.slices(task, host);
        if let Ok(false) = outcome {
            return None;
        }
        abandon_all(task, host);
        Some(Ended {
            program: task.code.name.to_string(),
            secondary: task.code.secondary,
            error: outcome.err(),
        })
    }

    /// Gives every thread its slice; true if the program is over.
    fn slices(&mut self, task: &mut Task, host: &mut dyn Host) -> Result<bool, ScriptError> {
        let main = task.threads.first().map(|t| t.id);
        task.stock = self.limits.instructions.saturating_mul(self.limits.threads as u64);
        for thread in &mut task.threads {
            thread.spent = false;
            thread.budget = self.limits.instructions;
        }
        // Again and again, because one thread's end may let another one run that waits for it. A
        // thread that ran and did not end is spent or waits, so this comes to an end.
        loop {
            let mut progress = false;
            let mut at = 0;
            while at < task.threads.len() {
                if !self.ready(task, at) {
                    at += 1;
                    continue;
                }
                progress = true;
                match self.step(task, at, host)? {
                    Next::Halt => return Ok(true),
                    // A kill may have moved the threads: go on behind this one.
                    Next::Paused(id) => at = task.position(id).map_or(at, |p| p + 1),
                    Next::Ended(id) => {
                        if main == Some(id) {
                            return Ok(true);
                        }
                        if let Some(p) = task.position(id) {
                            remove(task, p, host);
                            at = p;
                        }
                    }
                }
                if main.is_none_or(|id| task.position(id).is_none()) {
                    return Ok(true);
                }
            }
            if !progress {
                return Ok(false);
            }
        }
    }

    /// Whether a thread can run now.
    fn ready(&self, task: &mut Task, at: usize) -> bool {
        let id = task.threads[at].id;
        if task.threads[at].spent || task.critical.is_some_and(|(holder, _)| holder != id) {
            return false;
        }
        let free = match &task.threads[at].wait {
            Wait::No | Wait::Host(_) => true,
            Wait::Cycle(until) => self.cycle >= *until,
            Wait::Join(other) => task.position(*other).is_none(),
        };
        if free && !matches!(task.threads[at].wait, Wait::Host(_)) {
            task.threads[at].wait = Wait::No;
        }
        free
    }
}

/// Tells the host of the call that a thread waits for, and forgets it.
fn abandon(task: &mut Task, at: usize, host: &mut dyn Host) {
    let thread = &mut task.threads[at];
    if let Wait::Host(mut pending) = std::mem::replace(&mut thread.wait, Wait::No) {
        host.abandoned(Call {
            function: &task.code.hosts[pending.host],
            args: &pending.args,
            thread: thread.id,
            secondary: task.code.secondary,
            line: pending.line,
            waited: pending.waited,
            state: &mut pending.state,
        });
    }
}

/// Removes a thread that ended or is killed.
fn remove(task: &mut Task, at: usize, host: &mut dyn Host) {
    abandon(task, at, host);
    let gone = task.threads.remove(at);
    if task.critical.is_some_and(|(holder, _)| holder == gone.id) {
        task.critical = None;
    }
}

fn abandon_all(task: &mut Task, host: &mut dyn Host) {
    for at in 0..task.threads.len() {
        abandon(task, at, host);
    }
    task.threads.clear();
}
