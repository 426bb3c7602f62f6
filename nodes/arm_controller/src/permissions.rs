//! What has to agree before the arm may move.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Why the arm may not move yet, or any more.
#[derive(Debug, Default)]
struct State {
    /// What the robot's safety system says against it.
    safety: Option<String>,
    /// Whether the robot's program runs; none when that is not asked for.
    program: Option<bool>,
    /// The dead-man switch and when it last spoke; none when there is no such switch.
    switch: Option<(bool, Instant)>,
    /// What stands against it on the controller manager's side.
    controllers: Option<String>,
}

/// All permissions. Cloning is cheap.
#[derive(Debug, Clone)]
pub struct Permissions {
    state: Arc<Mutex<State>>,
    /// A dead-man switch that is silent for longer counts as released.
    patience: Duration,
}

impl Permissions {
    /// With what is asked for not given yet.
    pub fn new(program: bool, switch: bool, controllers: bool, patience: Duration) -> Self {
        let state = State {
            safety: None,
            program: program.then_some(false),
            switch: switch.then(|| (false, Instant::now())),
            controllers: controllers.then(|| "the controller manager has not answered yet".into()),
        };
        Self { state: Arc::new(Mutex::new(state)), patience }
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        // Every change is one assignment.
        f(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether the robot's program runs.
    pub fn program(&self, runs: bool) {
        self.with(|s| s.program = s.program.map(|_| runs));
    }

    /// What the robot's safety system says against motion; none when nothing.
    pub fn safety(&self, problem: Option<String>) {
        self.with(|s| s.safety = problem);
    }

    /// A word of the dead-man switch.
    pub fn switch(&self, pressed: bool) {
        self.with(|s| s.switch = Some((pressed, Instant::now())));
    }

    /// What stands against motion on the controller manager's side; none when nothing does.
    pub fn controllers(&self, problem: Option<String>) {
        self.with(|s| s.controllers = problem);
    }

    /// Why the arm may not move; none when it may.
    pub fn refusal(&self) -> Option<String> {
        self.with(|s| {
            // First: it is the reason why the program does not run.
            if let Some(safety) = &s.safety {
                return Some(safety.clone());
            }
            if s.program == Some(false) {
                return Some("the robot's program does not run".into());
            }
            match s.switch {
                Some((false, _)) => return Some("the dead-man switch is not pressed".into()),
                Some((true, at)) if at.elapsed() > self.patience => {
                    return Some("the dead-man switch is silent".into());
                }
                _ => {}
            }
            s.controllers.clone()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_asked_for_has_to_agree() {
        let p = Permissions::new(true, true, true, Duration::from_millis(20));
        assert!(p.refusal().unwrap().contains("program"));
        p.safety(Some("protective stop".into()));
        assert!(p.refusal().unwrap().contains("protective"));
        p.safety(None);
        p.program(true);
        assert!(p.refusal().unwrap().contains("not pressed"));
        p.switch(true);
        assert!(p.refusal().unwrap().contains("controller manager"));
        p.controllers(None);
        assert_eq!(p.refusal(), None);
        std::thread::sleep(Duration::from_millis(30));
        assert!(p.refusal().unwrap().contains("silent"));
        let p = Permissions::new(false, false, false, Duration::ZERO);
        p.program(false);
        assert_eq!(p.refusal(), None);
    }
}
