//! From any robot and safety mode to a wanted robot mode: which dashboard command comes next.
//!
//! The order is Universal Robots' own for the return from a protective stop: wait, close the safety
//! popup, stop the program (going on would repeat the motion that led to the stop), unlock, power,
//! brakes. Emergency stops and open safeguards are people's to end, never a program's.

use super::client::{Answer, Request, robot_mode_name, safety_mode_name};

/// A protective stop cannot be unlocked earlier (s).
pub const UNLOCK_AFTER: f64 = 5.5;
/// Time for all of it (s).
const PATIENCE: f64 = 90.0;
/// Time for one command to show its effect before it is sent again (s).
const AGAIN: f64 = 8.0;
/// Between two attempts to unlock (s).
const UNLOCK_AGAIN: f64 = 1.0;
/// Attempts for each command.
const ATTEMPTS: u32 = 4;

/// What is known about the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotStatus {
    /// `robot_mode` of RTDE.
    pub robot_mode: i32,
    /// `safety_mode` of RTDE.
    pub safety_mode: i32,
    /// Whether a program runs or is paused.
    pub program: bool,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// Look again a little later; why.
    Wait(String),
    /// Send this and hand the answer to [`Recovery::answered`].
    Send(Request),
    /// The mode is reached.
    Done,
    /// It cannot be reached; what somebody has to do.
    Failed(String),
}

/// The way to a robot mode.
#[derive(Debug, Clone)]
pub struct Recovery {
    target: i32,
    stop_program: bool,
    begun: Option<f64>,
    stopped_since: Option<f64>,
    program_stopped: bool,
    popup_closed: bool,
    last: Option<(Request, f64)>,
    attempts: u32,
    refusal: String,
}

impl Recovery {
    /// To `target`: 3 POWER_OFF, 5 IDLE or 7 RUNNING.
    ///
    /// # Errors
    /// A sentence for any other mode.
    pub fn new(target: i32, stop_program: bool) -> Result<Self, String> {
        if ![3, 5, 7].contains(&target) {
            return Err(format!(
                "robot mode {target} ({}) cannot be asked for: 3 POWER_OFF, 5 IDLE and 7 RUNNING can",
                robot_mode_name(target)
            ));
        }
        Ok(Self {
            target,
            stop_program,
            begun: None,
            stopped_since: None,
            program_stopped: false,
            popup_closed: false,
            last: None,
            attempts: 0,
            refusal: String::new(),
        })
    }

    /// The next step at time `now` (s, of any clock that only goes forward).
    pub fn step(&mut self, now: f64, s: &RobotStatus) -> Step {
        let begun = *self.begun.get_or_insert(now);
        if now - begun > PATIENCE {
            return Step::Failed(format!(
                "not reached within {PATIENCE:.0} s: robot mode {}, safety mode {}{}",
                robot_mode_name(s.robot_mode),
                safety_mode_name(s.safety_mode),
                self.last_refusal()
            ));
        }
        match s.safety_mode {
            1 | 2 => self.stopped_since = None,
            3 => return self.protective_stop(now, s),
            4 => return failed("joints are outside their limits: move them back by hand"),
            5 | 12 => return failed("the safeguard stop is open: close it, then reset it"),
            6 | 7 => return failed("the emergency stop is pressed: release it"),
            8 | 9 => {
                if !self.popup_closed {
                    return self.send(now, Request::CloseSafetyPopup);
                }
                return self.send(now, Request::RestartSafety);
            }
            _ => return Step::Wait(format!("safety mode is {}", safety_mode_name(s.safety_mode))),
        }
        if self.stop_program && s.program && !self.program_stopped {
            return self.send(now, Request::Stop);
        }
        if s.robot_mode == self.target {
            return Step::Done;
        }
        match (s.robot_mode, self.target) {
            (4 | 5 | 7, 3) | (7, 5) => self.send(now, Request::PowerOff),
            (3, 5 | 7) => self.send(now, Request::PowerOn),
            (5, 7) => self.send(now, Request::BrakeRelease),
            (1, _) => failed("the safety configuration has to be confirmed on the pendant"),
            (mode, _) => Step::Wait(format!("robot mode is {}", robot_mode_name(mode))),
        }
    }

    fn protective_stop(&mut self, now: f64, s: &RobotStatus) -> Step {
        let since = *self.stopped_since.get_or_insert(now);
        // Always, whatever was asked for: the stopped motion must not go on.
        if s.program && !self.program_stopped {
            return self.send(now, Request::Stop);
        }
        let left = UNLOCK_AFTER - (now - since);
        if left > 0.0 {
            return Step::Wait(format!("protective stop: can be unlocked in {left:.1} s"));
        }
        if !self.popup_closed {
            return self.send(now, Request::CloseSafetyPopup);
        }
        self.send(now, Request::UnlockProtectiveStop)
    }

    fn send(&mut self, now: f64, request: Request) -> Step {
        match &self.last {
            Some((last, at)) if *last == request => {
                let unlock = *last == Request::UnlockProtectiveStop && !self.refusal.is_empty();
                if now - at < if unlock { UNLOCK_AGAIN } else { AGAIN } {
                    return Step::Wait(format!("waiting for {:?}", last));
                }
                self.attempts += 1;
                if self.attempts > ATTEMPTS {
                    let why = self.last_refusal();
                    return Step::Failed(format!("{request:?} has no effect{why}"));
                }
            }
            _ => self.attempts = 1,
        }
        self.refusal.clear();
        self.last = Some((request.clone(), now));
        Step::Send(request)
    }

    /// The server's answer to the last request, in its own words.
    pub fn answered(&mut self, answer: &Answer, words: &str) {
        let Some((request, _)) = &self.last else { return };
        match request {
            // A popup that was not there is closed too.
            Request::CloseSafetyPopup => self.popup_closed = true,
            Request::Stop if *answer == Answer::Done => self.program_stopped = true,
            _ => {}
        }
        if *answer == Answer::Refused {
            self.refusal = words.trim().to_owned();
        }
    }

    fn last_refusal(&self) -> String {
        if self.refusal.is_empty() { String::new() } else { format!(" ({})", self.refusal) }
    }
}

fn failed(why: &str) -> Step {
    Step::Failed(why.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that does what it is told, a little later.
    struct Robot {
        status: RobotStatus,
        stopped_at: f64,
        heard: Vec<Request>,
    }

    impl Robot {
        fn take(&mut self, now: f64, r: &Request) -> Answer {
            self.heard.push(r.clone());
            let s = &mut self.status;
            match r {
                Request::PowerOn if s.safety_mode == 1 && s.robot_mode == 3 => s.robot_mode = 5,
                Request::BrakeRelease if s.safety_mode == 1 && s.robot_mode == 5 => {
                    s.robot_mode = 7
                }
                Request::PowerOff => s.robot_mode = 3,
                Request::Stop => s.program = false,
                Request::UnlockProtectiveStop if now - self.stopped_at >= 5.0 => s.safety_mode = 1,
                Request::RestartSafety => (s.safety_mode, s.robot_mode) = (1, 3),
                Request::CloseSafetyPopup => {}
                _ => return Answer::Refused,
            }
            Answer::Done
        }
    }

    fn run(status: RobotStatus, target: i32) -> (Result<f64, String>, Vec<Request>) {
        let mut robot = Robot { status, stopped_at: 0.0, heard: Vec::new() };
        let mut recovery = Recovery::new(target, true).unwrap();
        let mut now = 0.0;
        loop {
            match recovery.step(now, &robot.status) {
                Step::Send(r) => {
                    let answer = robot.take(now, &r);
                    recovery.answered(&answer, "words");
                }
                Step::Done => return (Ok(now), robot.heard),
                Step::Failed(why) => return (Err(why), robot.heard),
                Step::Wait(_) => {}
            }
            now += 0.25;
            assert!(now < 200.0, "it never ends");
        }
    }

    #[test]
    fn every_mode_either_comes_to_running_or_says_what_to_do() {
        for safety_mode in 1..=13 {
            for robot_mode in -1..=8 {
                for program in [false, true] {
                    let s = RobotStatus { robot_mode, safety_mode, program };
                    let (end, heard) = run(s, 7);
                    let able = matches!(safety_mode, 8 | 9)
                        || (matches!(safety_mode, 1..=3) && matches!(robot_mode, 3 | 5 | 7));
                    // Reduced mode is accepted by the plan, not by the robot of this test.
                    if safety_mode != 2 || robot_mode == 7 {
                        assert_eq!(end.is_ok(), able, "{s:?}: {end:?} {heard:?}");
                    }
                    if matches!(safety_mode, 4..=7) {
                        assert!(heard.is_empty(), "{s:?}: {heard:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_protective_stop_waits_closes_stops_and_unlocks_in_this_order() {
        let s = RobotStatus { robot_mode: 7, safety_mode: 3, program: true };
        let (end, heard) = run(s, 7);
        assert!(end.unwrap() >= UNLOCK_AFTER);
        use Request::*;
        assert_eq!(heard, [Stop, CloseSafetyPopup, UnlockProtectiveStop]);
    }

    #[test]
    fn power_off_and_idle_and_modes_that_cannot_be_asked_for() {
        let s = RobotStatus { robot_mode: 7, safety_mode: 1, program: false };
        assert_eq!(run(s, 3).1, [Request::PowerOff]);
        assert_eq!(run(s, 5).1, [Request::PowerOff, Request::PowerOn]);
        for mode in [-1, 0, 4, 6, 8, 99] {
            assert!(Recovery::new(mode, false).is_err());
        }
    }
}
