//! A UR controller as its interfaces show it: robot and safety modes, programs in URScript, motions,
//! registers, lines. Pure and stepped in time, except for the sockets that a script opens.
//!
//! The physical arm is a UR5; both generations move it, at their own cycle. Until a program is
//! loaded nothing runs and the arm stands.

mod core;
mod generation;
mod host;
mod host_sockets;
mod motion;
mod power;
mod profile;
mod program;
mod registers;
mod servo;
mod shown;
mod sockets;
#[cfg(test)]
mod tests;

pub use self::core::{Message, MessageKind};
pub use generation::Generation;
pub use power::{RobotMode, SafetyMode};
pub use program::{ProgramError, Script};
pub use registers::{Inputs, Lines, Registers, Slot, WatchdogAction};

use self::core::{Core, Demand};
use motion::Motion;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_urscript::{Limits, Machine, Program};

/// Largest joint speed, rad/s (UR5 data sheet: 180 deg/s).
pub const MAX_SPEED: f64 = std::f64::consts::PI;
/// Largest joint acceleration while servoing, rad/s^2.
pub const MAX_ACCELERATION: f64 = 20.0;
/// Deceleration of every stop that no script asked for, rad/s^2: from 1 rad/s to rest in 0.1 s.
pub const STOP_DECELERATION: f64 = 10.0;
/// A joint is stopped here, rad (363 deg).
pub const POSITION_LIMIT: f64 = 363.0 * std::f64::consts::PI / 180.0;
/// A protective stop cannot be unlocked for this long, s.
pub const UNLOCK_AFTER: f64 = 5.0;
/// A resumed program is RESUMING for this long, s.
const RESUME: f64 = 0.1;

/// Why the arm was stopped for protection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The arm pushed against something harder than allowed.
    Force,
    /// A part of the arm or gripper went into the table.
    Table,
    /// A joint reached the end of its range.
    JointPosition,
    /// A joint would have been too fast.
    JointSpeed,
    /// A tool path led out of reach or through a singularity.
    Reach,
    /// A script or an operator asked for it.
    Asked,
}

/// `runtime_state`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum RuntimeState {
    /// The program ends; the arm slows down.
    Stopping = 0,
    /// No program runs.
    Stopped = 1,
    /// The program runs.
    Playing = 2,
    /// The program is to wait; the arm slows down.
    Pausing = 3,
    /// The program waits.
    Paused = 4,
    /// The program goes on soon.
    Resuming = 5,
}

/// The controller. One [`step`](Self::step) per tick of the lab.
#[derive(Debug)]
pub struct Controller {
    core: Core,
    cycle_left: f64,
    runtime: RuntimeState,
    resume_left: f64,
    /// A motion that a pause interrupted.
    suspended: Option<Motion>,
    machine: Machine,
    /// What `play` starts.
    loaded: Option<Program>,
}

impl Controller {
    /// A controller whose arm rests at `q` (rad), powered, brakes released, no program.
    pub fn new(generation: Generation, q: [f64; 6]) -> Self {
        Self::with_power(generation, q, true)
    }

    /// The same, `running` or without power.
    pub fn with_power(generation: Generation, q: [f64; 6], running: bool) -> Self {
        Self {
            core: Core::new(generation, q, running),
            cycle_left: 0.0,
            runtime: RuntimeState::Stopped,
            resume_left: 0.0,
            suspended: None,
            machine: Machine::new(generation.cycle(), Limits::default(), 0),
            loaded: None,
        }
    }

    /// Moves the speed slider. It slows down `movej`, `movel`, `speedj` and `speedl`; `servoj` is not
    /// scaled: a driver reads `target_speed_fraction` and slows down itself.
    pub fn set_speed_fraction(&mut self, fraction: f64) {
        if fraction.is_finite() {
            self.core.slider = fraction.clamp(0.0, 1.0);
        }
    }

    /// Stops the arm for protection; it stays so until unlocked.
    pub fn protect(&mut self, reason: StopReason) {
        self.core.protect(reason);
        self.obey();
    }

    /// Unlocks a protective stop.
    ///
    /// # Errors
    /// A sentence as the dashboard says it: too early.
    pub fn unlock(&mut self) -> Result<(), &'static str> {
        match self.core.stop {
            Some((_, since)) if self.core.time - since < UNLOCK_AFTER => {
                Err("Cannot unlock protective stop until 5s after occurrence. \
                     Always inspect cause of protective stop before unlocking")
            }
            Some(_) => {
                self.core.stop = None;
                if self.core.safety == SafetyMode::ProtectiveStop {
                    self.core.safety = SafetyMode::Normal;
                }
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Presses an emergency stop, trips a safeguard, or breaks the safety system; `Normal` releases
    /// an emergency stop or a safeguard. A violation and a fault end by [`restart_safety`].
    ///
    /// [`restart_safety`]: Self::restart_safety
    pub fn set_safety(&mut self, mode: SafetyMode) {
        match mode {
            SafetyMode::ProtectiveStop => self.protect(StopReason::Asked),
            SafetyMode::Normal => {
                let was = self.core.safety;
                if matches!(was, SafetyMode::Violation | SafetyMode::Fault) {
                    return;
                }
                if was != SafetyMode::ProtectiveStop {
                    self.core.safety = SafetyMode::Normal;
                }
                if was == SafetyMode::SafeguardStop {
                    // Without a reset input the program goes on by itself.
                    let _ = self.play();
                }
            }
            _ => {
                self.core.safety = mode;
                self.core.stop = None;
                if mode.cuts_power() {
                    self.core.power.off();
                    self.stop_program();
                } else if !mode.moves() {
                    self.pause();
                }
            }
        }
    }

    /// Restarts the safety system after a violation or a fault; the arm is without power then.
    pub fn restart_safety(&mut self) {
        if matches!(self.core.safety, SafetyMode::Violation | SafetyMode::Fault) {
            self.core.safety = SafetyMode::Normal;
        }
        self.power_off();
    }

    /// Switches the arm's power on; with `release` its brakes follow.
    ///
    /// # Errors
    /// The safety mode that does not allow it.
    pub fn power_on(&mut self, release: bool) -> Result<(), SafetyMode> {
        if self.core.safety.cuts_power() {
            return Err(self.core.safety);
        }
        self.core.power.on(release);
        Ok(())
    }

    /// Switches the arm's power off.
    pub fn power_off(&mut self) {
        self.stop_program();
        self.core.power.off();
    }

    /// Loads a program for [`play`](Self::play).
    ///
    /// # Errors
    /// [`ProgramError`] naming the line.
    pub fn load(&mut self, text: &str) -> Result<(), ProgramError> {
        let programs = Script::parse(text).0?;
        self.loaded = programs.into_iter().find(|p| !p.is_secondary());
        self.loaded.as_ref().map(|_| ()).ok_or(ProgramError::Empty)
    }

    /// Whether [`play`](Self::play) has something to play.
    pub fn has_program(&self) -> bool {
        self.loaded.is_some()
    }

    /// Runs a script that came over the network: a `def` replaces the running program, a `sec` runs
    /// beside it.
    ///
    /// # Errors
    /// [`ProgramError`]: not URScript, or the robot is not ready to run it.
    pub fn run_script(&mut self, text: &str) -> Result<(), ProgramError> {
        self.run(Script::parse(text))
    }

    /// The same with a script that was read before.
    ///
    /// # Errors
    /// As [`run_script`](Self::run_script); the controller also says it in a message.
    pub fn run(&mut self, script: Script) -> Result<(), ProgramError> {
        let outcome = script.0.and_then(|programs| {
            for program in programs {
                if program.is_secondary() {
                    self.machine.start(&program, &mut self.core)?;
                } else {
                    self.ready()?;
                    self.start(program)?;
                }
            }
            Ok(())
        });
        if let Err(e) = &outcome {
            tracing::warn!("{e}");
            self.core.say(MessageKind::Error, e.to_string());
        }
        outcome
    }

    /// Name of the program that runs or was loaded last.
    pub fn program_name(&self) -> Option<&str> {
        self.machine.program().or(self.loaded.as_ref().map(Program::name))
    }

    fn ready(&self) -> Result<(), ProgramError> {
        if self.core.can_move() {
            return Ok(());
        }
        let (robot, safety) = (self.robot_mode().name(), self.core.safety.name());
        Err(ProgramError::NotReady { robot, safety })
    }

    fn start(&mut self, program: Program) -> Result<(), ProgramError> {
        self.end_program();
        self.machine.start(&program, &mut self.core)?;
        self.loaded = Some(program);
        self.runtime = RuntimeState::Playing;
        Ok(())
    }

    /// Starts the loaded program anew, or goes on with a paused one.
    ///
    /// # Errors
    /// When the robot is not ready or nothing is loaded.
    pub fn play(&mut self) -> Result<(), ProgramError> {
        self.ready()?;
        match self.runtime {
            RuntimeState::Playing | RuntimeState::Resuming => {}
            RuntimeState::Pausing | RuntimeState::Paused => {
                self.runtime = RuntimeState::Resuming;
                self.resume_left = RESUME;
            }
            RuntimeState::Stopping | RuntimeState::Stopped => {
                let program = self.loaded.clone().ok_or(ProgramError::NothingLoaded)?;
                self.start(program)?;
            }
        }
        Ok(())
    }

    /// Stops the program and the arm.
    pub fn stop_program(&mut self) {
        let had = self.runtime != RuntimeState::Stopped;
        self.end_program();
        if had {
            self.runtime = RuntimeState::Stopping;
        }
    }

    fn end_program(&mut self) {
        self.machine.stop(&mut self.core);
        self.suspended = None;
        self.core.watchdogs.clear();
        self.core.sockets.close_all();
        if !matches!(self.core.mover.motion, Motion::Brake(_)) {
            self.core.mover.brake(STOP_DECELERATION);
        }
    }

    /// Pauses the program; the arm slows down.
    pub fn pause(&mut self) {
        if self.program_running() {
            self.runtime = RuntimeState::Pausing;
            self.suspended = self.core.mover.suspend().or(self.suspended.take());
        } else if !matches!(self.core.mover.motion, Motion::Rest | Motion::Brake(_)) {
            self.core.mover.brake(STOP_DECELERATION);
        }
    }

    /// Does what the core demands.
    fn obey(&mut self) {
        match self.core.demand.take() {
            Some(Demand::Pause) => self.pause(),
            Some(Demand::Stop) => self.stop_program(),
            None => {}
        }
    }

    /// One tick of `dt` seconds. The program runs once in a control cycle; the joints move in every
    /// tick.
    pub fn step(&mut self, dt: f64) {
        self.cycle_left -= dt;
        if self.cycle_left <= 0.5 * dt {
            self.cycle_left += self.core.generation.cycle();
            self.cycle();
        }
        self.core.step(dt);
        self.obey();
        let rests = self.core.mover.at_rest();
        match self.runtime {
            RuntimeState::Stopping if rests => self.runtime = RuntimeState::Stopped,
            RuntimeState::Pausing if rests => self.runtime = RuntimeState::Paused,
            RuntimeState::Resuming => {
                self.resume_left -= dt;
                if self.resume_left <= 0.0 {
                    self.runtime = RuntimeState::Playing;
                    if let Some(motion) = self.suspended.take() {
                        self.core.mover.motion = motion;
                    }
                }
            }
            _ => {}
        }
    }

    fn cycle(&mut self) {
        let waits = matches!(
            self.runtime,
            RuntimeState::Pausing | RuntimeState::Paused | RuntimeState::Resuming
        );
        if waits {
            return;
        }
        for end in self.machine.cycle(&mut self.core) {
            if let Some(e) = &end.error {
                tracing::warn!("program '{}' ends: {e}", end.program);
                self.core.say(MessageKind::Error, format!("{}: {e}", end.program));
            }
            if !end.secondary {
                self.end_program();
                self.runtime = RuntimeState::Stopping;
            }
        }
        self.core.end_cycle();
        self.obey();
    }
}

/// Position (m) and rotation vector (rad) of a pose.
pub fn six(pose: &Pose) -> [f64; 6] {
    let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// The pose of a position (m) and a rotation vector (rad).
pub fn pose_of(p: &[f64; 6]) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], p[5]));
    Pose::from_parts(Translation3::new(p[0], p[1], p[2]), rotation)
}
