//! A UR controller as its RTDE interface shows it, free of sockets and clocks, with the servo program
//! of `tdv_ur_protocol::servo` built in.
//!
//! The joints follow their targets through a first-order tracker (time constant [`Controller::LOOKAHEAD`],
//! critically damped in speed) under a limit on speed and acceleration, which stands in for `servoj`:
//! a ramp is followed with that lag and one control cycle, a step without overshoot.

use crate::arm;
use tdv_geometry::Pose;
use tdv_ur_protocol::servo::{Command, ProgramState, START_WINDOW, WATCHDOG};

/// Which controller generation is imitated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Generation {
    /// CB3: 125 Hz.
    #[default]
    Cb3,
    /// e-Series: 500 Hz.
    ESeries,
}

impl Generation {
    /// Control cycle, s.
    pub fn cycle(self) -> f64 {
        match self {
            Self::Cb3 => 0.008,
            Self::ESeries => 0.002,
        }
    }

    /// Software version: major, minor, bug-fix, build.
    pub fn version(self) -> [u32; 4] {
        match self {
            Self::Cb3 => [3, 15, 8, 106_339],
            Self::ESeries => [5, 12, 4, 1_101_661],
        }
    }
}

/// Registers that the program reads, as the outside wrote them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ServoInputs {
    /// [`Command`] as a number.
    pub command: i32,
    /// Changes with every fresh command.
    pub heartbeat: i32,
    /// Joint targets, rad.
    pub targets: [f64; 6],
}

/// Why the arm was stopped for protection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The arm pushed against something harder than allowed.
    Force,
    /// A part of the arm or gripper went into the table.
    Table,
}

/// `runtime_state`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum RuntimeState {
    /// No program runs.
    Stopped = 1,
    /// The program runs.
    Playing = 2,
    /// The program waits.
    Paused = 4,
}

/// The controller. One [`step`](Self::step) per tick of the lab.
#[derive(Debug, Clone)]
pub struct Controller {
    generation: Generation,
    time: f64,
    cycle_left: f64,
    q: [f64; 6],
    qd: [f64; 6],
    target: [f64; 6],
    /// Where between the last target and this one the tracker aims now.
    aim: [f64; 6],
    aim_left: f64,
    speed_fraction: f64,
    runtime: RuntimeState,
    program: ProgramState,
    seen_heartbeat: i32,
    accepted_heartbeat: i32,
    since_heartbeat: f64,
    stop: Option<(StopReason, f64)>,
}

impl Controller {
    /// Time constant of the tracker, s: UR's default `lookahead_time` of the official driver.
    pub const LOOKAHEAD: f64 = 0.03;
    /// Largest joint speed, rad/s (UR5 data sheet: 180 deg/s).
    pub const MAX_SPEED: f64 = std::f64::consts::PI;
    /// Largest joint acceleration while servoing, rad/s^2.
    pub const MAX_ACCELERATION: f64 = 20.0;
    /// Deceleration of every stop, rad/s^2: from 1 rad/s to rest in 0.1 s.
    pub const STOP_DECELERATION: f64 = 10.0;
    /// A target farther than this (rad, any joint) from the last one is refused while servoing.
    pub const MAX_STEP: f64 = 0.1;
    /// A protective stop cannot be unlocked for this long, s.
    pub const UNLOCK_AFTER: f64 = 5.0;

    /// A controller whose arm rests at `q` (rad), powered, its servo program running.
    pub fn new(generation: Generation, q: [f64; 6]) -> Self {
        Self {
            generation,
            time: 0.0,
            cycle_left: 0.0,
            q,
            qd: [0.0; 6],
            target: q,
            aim: q,
            aim_left: 0.0,
            speed_fraction: 1.0,
            runtime: RuntimeState::Playing,
            program: ProgramState::Ready,
            seen_heartbeat: 0,
            accepted_heartbeat: 0,
            since_heartbeat: 0.0,
            stop: None,
        }
    }

    /// Which controller this is.
    pub fn generation(&self) -> Generation {
        self.generation
    }

    /// Seconds since it was switched on.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Joint angles, rad.
    pub fn q(&self) -> &[f64; 6] {
        &self.q
    }

    /// Joint speeds, rad/s.
    pub fn qd(&self) -> &[f64; 6] {
        &self.qd
    }

    /// The joint target that the program follows, rad.
    pub fn target(&self) -> &[f64; 6] {
        &self.target
    }

    /// `T_base_tool0`: the flange in the controller's own frame `base`.
    pub fn tool_pose(&self) -> Pose {
        Self::tool_pose_at(&self.q)
    }

    /// `T_base_tool0` at other joint angles.
    pub fn tool_pose_at(q: &[f64; 6]) -> Pose {
        arm::base_link_to_base().inverse() * arm::link_frames(q)[6]
    }

    /// State of the servo program.
    pub fn program_state(&self) -> ProgramState {
        self.program
    }

    /// The last heartbeat whose target was taken.
    pub fn heartbeat_echo(&self) -> i32 {
        self.accepted_heartbeat
    }

    /// `runtime_state`.
    pub fn runtime_state(&self) -> RuntimeState {
        self.runtime
    }

    /// Why it stands in a protective stop, if it does.
    pub fn protective_stop(&self) -> Option<StopReason> {
        self.stop.map(|s| s.0)
    }

    /// `robot_mode`: RUNNING, or BACKDRIVE never; power is always on here.
    pub fn robot_mode(&self) -> i32 {
        7
    }

    /// `safety_mode`: 1 normal, 3 protective stop.
    pub fn safety_mode(&self) -> i32 {
        if self.stop.is_some() { 3 } else { 1 }
    }

    /// `robot_status_bits`: power, program running.
    pub fn robot_status_bits(&self) -> u32 {
        1 | if self.runtime == RuntimeState::Playing { 2 } else { 0 }
    }

    /// `safety_status_bits`.
    pub fn safety_status_bits(&self) -> u32 {
        // Bit 0 normal; bit 2 protective stop, bit 10 stopped due to safety.
        if self.stop.is_some() { 1 << 2 | 1 << 10 } else { 1 }
    }

    /// The speed slider, 0..=1.
    pub fn speed_fraction(&self) -> f64 {
        self.speed_fraction
    }

    /// Moves the speed slider. Like `servoj` on the robot, the servo program does not scale its
    /// targets by it: a driver reads `target_speed_fraction` and slows down itself.
    pub fn set_speed_fraction(&mut self, fraction: f64) {
        if fraction.is_finite() {
            self.speed_fraction = fraction.clamp(0.0, 1.0);
        }
    }

    /// Stops the arm for protection; it stays so until unlocked and played again.
    pub fn protect(&mut self, reason: StopReason) {
        if self.stop.is_none() {
            self.stop = Some((reason, self.time));
            self.runtime = RuntimeState::Paused;
            self.program = ProgramState::NotRunning;
        }
    }

    /// Unlocks a protective stop.
    ///
    /// # Errors
    /// A sentence as the dashboard says it: too early.
    pub fn unlock(&mut self) -> Result<(), &'static str> {
        match self.stop {
            Some((_, since)) if self.time - since < Self::UNLOCK_AFTER => {
                Err("Cannot unlock protective stop until 5s after occurrence. \
                     Always inspect cause of protective stop before unlocking")
            }
            _ => {
                self.stop = None;
                Ok(())
            }
        }
    }

    /// Starts the servo program, or goes on with it.
    ///
    /// # Errors
    /// When a protective stop is not unlocked.
    pub fn play(&mut self) -> Result<(), &'static str> {
        if self.stop.is_some() {
            return Err("protective stop");
        }
        if self.runtime != RuntimeState::Playing {
            self.runtime = RuntimeState::Playing;
            self.program = ProgramState::Ready;
            self.target = self.q;
        }
        Ok(())
    }

    /// Stops the program.
    pub fn stop_program(&mut self) {
        self.runtime = RuntimeState::Stopped;
        self.program = ProgramState::NotRunning;
    }

    /// Pauses the program.
    pub fn pause(&mut self) {
        if self.runtime == RuntimeState::Playing {
            self.runtime = RuntimeState::Paused;
            self.program = ProgramState::NotRunning;
        }
    }

    /// One tick of `dt` seconds. The program looks at its registers once in a control cycle; the
    /// joints move in every tick.
    pub fn step(&mut self, dt: f64, inputs: &ServoInputs) {
        self.time += dt;
        self.since_heartbeat += dt;
        self.cycle_left -= dt;
        if self.cycle_left <= 0.5 * dt {
            self.cycle_left += self.generation.cycle();
            self.cycle(inputs);
        }
        if self.program == ProgramState::Servoing {
            // A new target is reached in the course of one cycle, not in a jump.
            let share = if self.aim_left > dt { dt / self.aim_left } else { 1.0 };
            self.aim_left -= dt;
            for i in 0..6 {
                self.aim[i] += (self.target[i] - self.aim[i]) * share;
                let (q, qd) = track(self.q[i], self.qd[i], self.aim[i], dt);
                (self.q[i], self.qd[i]) = (q, qd);
            }
        } else {
            self.brake(dt);
        }
    }

    fn cycle(&mut self, inputs: &ServoInputs) {
        if self.runtime != RuntimeState::Playing {
            self.seen_heartbeat = inputs.heartbeat;
            return;
        }
        let fresh = inputs.heartbeat != self.seen_heartbeat;
        self.seen_heartbeat = inputs.heartbeat;
        let sane = inputs.targets.iter().all(|t| t.is_finite() && t.abs() <= std::f64::consts::TAU);
        let within = |from: &[f64; 6], most: f64| {
            from.iter().zip(&inputs.targets).all(|(a, b)| (a - b).abs() <= most)
        };
        if inputs.command != Command::Servo as i32 {
            if fresh {
                self.accepted_heartbeat = inputs.heartbeat;
            }
            if self.program != ProgramState::WatchdogStop || fresh {
                self.program = ProgramState::Ready;
            }
            return;
        }
        let acceptable = match self.program {
            ProgramState::Servoing => within(&self.target, Self::MAX_STEP),
            _ => within(&self.q, START_WINDOW),
        };
        if fresh && sane && acceptable {
            if self.program != ProgramState::Servoing {
                self.aim = self.q;
            }
            self.target = inputs.targets;
            self.aim_left = self.generation.cycle();
            self.accepted_heartbeat = inputs.heartbeat;
            self.since_heartbeat = 0.0;
            self.program = ProgramState::Servoing;
        } else if self.program == ProgramState::Servoing && self.since_heartbeat > WATCHDOG {
            self.program = ProgramState::WatchdogStop;
        }
    }

    /// All joints slow down together, so that the tool stays on its path.
    fn brake(&mut self, dt: f64) {
        let fastest = self.qd.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        if fastest <= 0.0 {
            return;
        }
        let keep = ((fastest - Self::STOP_DECELERATION * dt) / fastest).max(0.0);
        for (q, qd) in self.q.iter_mut().zip(&mut self.qd) {
            *qd *= keep;
            *q += *qd * dt;
        }
    }
}

/// One tick of one joint towards `target`.
fn track(q: f64, qd: f64, target: f64, dt: f64) -> (f64, f64) {
    let error = target - q;
    let gain = 1.0 / Controller::LOOKAHEAD;
    // Never faster than what still stops in time within the acceleration limit.
    let stoppable = (2.0 * 0.8 * Controller::MAX_ACCELERATION * error.abs()).sqrt();
    let wanted = (gain * error).clamp(-stoppable, stoppable);
    let wanted = wanted.clamp(-Controller::MAX_SPEED, Controller::MAX_SPEED);
    let acceleration = ((wanted - qd) * 4.0 * gain)
        .clamp(-Controller::MAX_ACCELERATION, Controller::MAX_ACCELERATION);
    let qd = qd + acceleration * dt;
    (q + qd * dt, qd)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.002;
    const HOME: [f64; 6] = [0.0, -1.5, 1.8, -1.8, -1.57, 0.0];

    fn servo(heartbeat: i32, targets: [f64; 6]) -> ServoInputs {
        ServoInputs { command: 1, heartbeat, targets }
    }

    #[test]
    fn follows_a_ramp_with_the_stated_lag_and_limits() {
        let mut c = Controller::new(Generation::Cb3, HOME);
        let mut t = HOME;
        let mut last = 0.0;
        for k in 0..1000 {
            if k % 4 == 0 {
                t[0] = HOME[0] + 0.8 * k as f64 * DT;
            }
            c.step(DT, &servo(1 + k / 4, t));
            assert!((c.qd()[0] - last).abs() <= Controller::MAX_ACCELERATION * DT + 1e-9);
            last = c.qd()[0];
        }
        assert_eq!(c.program_state(), ProgramState::Servoing);
        assert!((c.qd()[0] - 0.8).abs() < 0.03, "{}", c.qd()[0]);
        let lag = (t[0] - c.q()[0]) / 0.8;
        assert!((lag - Controller::LOOKAHEAD - 0.008).abs() < 0.006, "{lag}");
        // The ramp ends: no overshoot worth the name.
        for k in 0..500 {
            c.step(DT, &servo(1000 + k / 4, t));
            assert!(c.q()[0] < t[0] + 1e-3);
        }
        assert!((t[0] - c.q()[0]).abs() < 1e-5);
    }

    #[test]
    fn watchdog_brings_it_to_rest_and_a_fresh_command_resumes() {
        let mut c = Controller::new(Generation::Cb3, HOME);
        let mut t = HOME;
        for k in 0..250 {
            t[1] = HOME[1] + 1.0 * k as f64 * DT;
            c.step(DT, &servo(k / 4 + 1, t));
        }
        assert!((c.qd()[1] - 1.0).abs() < 0.05);
        let mut rest = 0.0;
        while c.qd().iter().any(|v| v.abs() > 1e-9) {
            c.step(DT, &servo(250 / 4 + 1, t));
            rest += DT;
            assert!(rest < 0.4);
        }
        assert!(rest < 0.25, "{rest}");
        for _ in 0..100 {
            c.step(DT, &servo(250 / 4 + 1, t));
        }
        assert_eq!(c.program_state(), ProgramState::WatchdogStop);
        // Too far away: refused and not echoed. Near: taken.
        let mut far = *c.q();
        far[3] += 0.2;
        for _ in 0..8 {
            c.step(DT, &servo(900, far));
        }
        assert_eq!((c.program_state(), c.heartbeat_echo()), (ProgramState::WatchdogStop, 63));
        let near = *c.q();
        for _ in 0..8 {
            c.step(DT, &servo(901, near));
        }
        assert_eq!((c.program_state(), c.heartbeat_echo()), (ProgramState::Servoing, 901));
    }

    #[test]
    fn jumps_and_nonsense_are_refused_while_servoing() {
        let mut c = Controller::new(Generation::ESeries, HOME);
        c.step(DT, &servo(1, HOME));
        let mut jump = HOME;
        jump[2] += 0.3;
        c.step(DT, &servo(2, jump));
        assert_eq!(c.heartbeat_echo(), 1);
        c.step(DT, &servo(3, [f64::NAN; 6]));
        assert_eq!(c.heartbeat_echo(), 1);
        assert_eq!(c.target(), &HOME);
    }

    #[test]
    fn protective_stop_needs_unlock_and_play() {
        let mut c = Controller::new(Generation::Cb3, HOME);
        c.protect(StopReason::Table);
        assert_eq!((c.safety_mode(), c.robot_status_bits()), (3, 1));
        assert!(c.play().is_err() && c.unlock().is_err());
        for k in 0..2600 {
            c.step(DT, &servo(k, HOME));
        }
        assert!(c.unlock().is_ok() && c.play().is_ok());
        assert_eq!((c.safety_mode(), c.program_state()), (1, ProgramState::Ready));
    }

    #[test]
    fn tool_pose_is_in_the_controllers_base() {
        let p = Controller::new(Generation::Cb3, [0.0; 6]).tool_pose();
        assert!((p.translation.x + 0.81725).abs() < 1e-9);
    }
}
