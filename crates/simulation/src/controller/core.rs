//! All of the controller except the program that runs on it: what a script's calls act on.

use super::generation::Generation;
use super::motion::{Motion, Mover, Six, Violation};
use super::power::{Power, SafetyMode};
use super::registers::{Inputs, Lines, Registers, Watchdog, WatchdogAction};
use super::sockets::ScriptSockets;
use super::{STOP_DECELERATION, StopReason};
use std::collections::VecDeque;

/// Texts that wait to be fetched; older ones are dropped.
const MAX_MESSAGES: usize = 64;
/// How fast the speed slider's effect follows the slider, 1/s.
const SCALE_RATE: f64 = 2.0;

/// What kind of text the controller has to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageKind {
    /// `textmsg` of a script.
    Log,
    /// `popup` of a script or of the dashboard.
    Popup,
    /// A program that ended by an error.
    Error,
}

/// A text of the controller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Its kind.
    pub kind: MessageKind,
    /// Its words.
    pub text: String,
}

/// What happens to the program because of something that the core saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Demand {
    Pause,
    Stop,
}

/// The controller without its program.
#[derive(Debug)]
pub(crate) struct Core {
    pub generation: Generation,
    pub time: f64,
    pub mover: Mover,
    pub power: Power,
    pub safety: SafetyMode,
    pub stop: Option<(StopReason, f64)>,
    pub slider: f64,
    /// The slider's effect now.
    pub scale: f64,
    pub inputs: Inputs,
    pub outputs: Registers,
    pub lines: Lines,
    pub payload: f64,
    pub payload_cog: [f64; 3],
    pub payload_inertia: [f64; 6],
    /// Force (N) and torque (N m) at the tool in base axes, as measured and as zeroed.
    pub force_raw: Six,
    pub force_zero: Six,
    pub watchdogs: Vec<Watchdog>,
    pub messages: VecDeque<Message>,
    pub popup: Option<String>,
    pub sockets: ScriptSockets,
    /// Whether a script waits for the motion; one that nobody waits for any more is ended.
    pub polled: bool,
    pub demand: Option<Demand>,
    /// The last joint angles, newest first, one each cycle.
    pub history: VecDeque<Six>,
}

impl Core {
    pub(crate) fn new(generation: Generation, q: Six, running: bool) -> Self {
        Self {
            generation,
            time: 0.0,
            mover: Mover::new(q, generation.arm(), generation.cycle()),
            power: Power::new(running),
            safety: SafetyMode::Normal,
            stop: None,
            slider: 1.0,
            scale: 1.0,
            inputs: Inputs::default(),
            outputs: Registers::default(),
            lines: Lines::default(),
            payload: 0.0,
            payload_cog: [0.0; 3],
            payload_inertia: [0.0; 6],
            force_raw: [0.0; 6],
            force_zero: [0.0; 6],
            watchdogs: Vec::new(),
            messages: VecDeque::new(),
            popup: None,
            sockets: ScriptSockets::default(),
            polled: false,
            demand: None,
            history: VecDeque::new(),
        }
    }

    /// Whether the arm may be moved by a program.
    pub(crate) fn can_move(&self) -> bool {
        self.power.mode() == super::RobotMode::Running && self.safety.moves()
    }

    pub(crate) fn force(&self) -> Six {
        std::array::from_fn(|i| self.force_raw[i] - self.force_zero[i])
    }

    pub(crate) fn say(&mut self, kind: MessageKind, text: String) {
        if self.messages.len() >= MAX_MESSAGES {
            self.messages.pop_front();
        }
        self.messages.push_back(Message { kind, text });
    }

    /// A stop by the controller itself; the program pauses.
    pub(crate) fn protect(&mut self, reason: StopReason) {
        if self.safety.moves() {
            self.safety = SafetyMode::ProtectiveStop;
            self.stop = Some((reason, self.time));
            self.demand = self.demand.or(Some(Demand::Pause));
        }
    }

    /// The joints' and the slider's part of a tick.
    pub(crate) fn step(&mut self, dt: f64) {
        self.time += dt;
        self.power.step(dt);
        let step = SCALE_RATE * dt;
        self.scale += (self.slider - self.scale).clamp(-step, step);
        for w in &mut self.watchdogs {
            let seen = self.inputs.arrivals(w.slot);
            w.silent = if seen == w.seen { w.silent + dt } else { 0.0 };
            w.seen = seen;
            if w.silent > w.period {
                w.silent = 0.0;
                let demand = match w.action {
                    WatchdogAction::Ignore => continue,
                    WatchdogAction::Pause => Demand::Pause,
                    WatchdogAction::Stop => Demand::Stop,
                };
                self.demand = Some(demand);
            }
        }
        if let Err(violation) = self.mover.step(dt, self.scale) {
            if !matches!(self.mover.motion, Motion::Brake(_)) {
                self.mover.brake(STOP_DECELERATION);
            }
            self.protect(match violation {
                Violation::Position => StopReason::JointPosition,
                Violation::Speed => StopReason::JointSpeed,
                Violation::Reach => StopReason::Reach,
            });
        }
    }

    /// The end of a control cycle: what no script waits for any more is braked.
    pub(crate) fn end_cycle(&mut self) {
        let waited = matches!(self.mover.motion, Motion::Joint { .. } | Motion::Line { .. });
        if waited && !self.polled {
            self.mover.brake(STOP_DECELERATION);
        }
        self.polled = false;
        self.history.push_front(self.mover.q);
        self.history.truncate(500);
    }
}
