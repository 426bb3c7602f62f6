//! From a moving target to a checked trajectory that ends at rest.

use super::law::{self, Gains, MotionState};
use super::params::ControllerParams;
use super::types::{JointPath, PathPoint};
use crate::collision::{ClearanceError, CollisionError, CollisionWorld, check_clearance};
use crate::kinematics::{IkError, JOINT_NAMES, Joints, Kinematics};
use tdv_geometry::{Pose, Stamp};
use thiserror::Error;

/// Samples of the target before and after each step from which its velocity is taken.
const HALF_WINDOW: usize = 3;
/// A target moving a joint faster than this (rad/s) from tick to tick has changed branch.
const BRANCH_RATE: f64 = 20.0;
/// No stop is quicker (s), however slow the arm: a jerk is no stop.
const QUICKEST_STOP: f64 = 0.06;
/// Points of the deceleration that are sent.
const STOP_POINTS: usize = 8;

/// Where to go, as a function of seconds from now (slightly negative too).
pub(super) enum Target<'a> {
    /// `T_base_link_tcp`.
    Tool(&'a dyn Fn(f64) -> Pose),
    /// Joint angles (rad).
    Joints(&'a dyn Fn(f64) -> Joints),
}

/// Why a target is not followed.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum Refusal {
    /// No joint solution.
    #[error("{0}")]
    Ik(#[from] IkError),
    /// Something would be hit or left.
    #[error("{0}")]
    Clearance(#[from] ClearanceError),
    /// The arm would run into a fixture or into itself.
    #[error("{0}")]
    Collision(#[from] CollisionError),
    /// A commanded joint would leave its range.
    #[error("{joint} would be at {value:.3} rad, its range is {lower:.3}..{upper:.3}")]
    JointRange {
        /// The joint's name.
        joint: &'static str,
        /// Rad.
        value: f64,
        /// Rad.
        lower: f64,
        /// Rad.
        upper: f64,
    },
    /// The path goes too far into a singularity.
    #[error(
        "the arm would come to a condition number of {condition:.0}, {limit:.0} is allowed: too near a singularity"
    )]
    Singular {
        /// Of the Jacobian, see [`crate::kinematics::Dexterity`].
        condition: f64,
        /// The limit.
        limit: f64,
    },
    /// The law itself broke a speed limit.
    #[error("{what} would be {value:.3}, {limit:.3} is the limit")]
    Speed {
        /// Which speed, with its unit.
        what: &'static str,
        /// The value.
        value: f64,
        /// The limit.
        limit: f64,
    },
}

/// A projected motion: the law's states one tick apart, then the stop from the last of them.
#[derive(Debug, Clone)]
pub(super) struct Projection {
    states: Vec<MotionState>,
    tick: f64,
    stop_time: f64,
}

impl Projection {
    /// Staying where the joints are.
    pub fn rest(q: Joints, p: &ControllerParams) -> Self {
        Self { states: vec![MotionState::at_rest(q)], tick: p.tick, stop_time: p.stop_time() }
    }

    /// To rest from `start`, from now on, in less time than a trajectory has for it where the speed
    /// allows that.
    pub fn stop(start: MotionState, p: &ControllerParams) -> Self {
        // The peak deceleration of `law::stop`.
        let needed = 1.5 * law::max_abs(&start.qd) / p.limits.stop_acceleration;
        let stop_time = needed.max(QUICKEST_STOP).min(p.stop_time());
        Self { states: vec![start], tick: p.tick, stop_time }
    }

    /// Seconds before the deceleration begins.
    pub fn law_time(&self) -> f64 {
        self.tick * (self.states.len() - 1) as f64
    }

    /// Seconds until rest.
    pub fn duration(&self) -> f64 {
        self.law_time() + self.stop_time
    }

    /// Commanded state `t` seconds after the start.
    pub fn sample(&self, t: f64) -> MotionState {
        let last = self.states[self.states.len() - 1];
        if t >= self.law_time() {
            return law::stop(&last, t - self.law_time(), self.stop_time);
        }
        let i = ((t / self.tick).max(0.0) as usize).min(self.states.len() - 2);
        let (s, a) = (self.states[i], self.states[i + 1].qdd);
        let dt = t.max(0.0) - self.tick * i as f64;
        MotionState {
            q: std::array::from_fn(|j| s.q[j] + s.qd[j] * dt + 0.5 * a[j] * dt * dt),
            qd: std::array::from_fn(|j| s.qd[j] + a[j] * dt),
            qdd: a,
        }
    }

    /// What goes out: the law's points from `first` seconds on, then the stop.
    pub fn path(&self, stamp: Stamp, first: f64) -> JointPath {
        let law = (0..self.states.len()).map(|i| self.tick * i as f64);
        let stop = (1..=STOP_POINTS)
            .map(|i| self.law_time() + self.stop_time * i as f64 / STOP_POINTS as f64);
        let mut points: Vec<PathPoint> = law
            .filter(|t| *t >= first - 1e-9)
            .chain(stop)
            .map(|time| {
                let s = self.sample(time);
                PathPoint { time, q: s.q, qd: s.qd }
            })
            .collect();
        if let Some(last) = points.last_mut() {
            last.qd = [0.0; 6];
        }
        JointPath { stamp, points }
    }
}

/// What is about the arm.
pub(super) struct Around<'a> {
    /// Fixtures and the arm itself; none: the table only.
    pub world: Option<&'a CollisionWorld>,
    /// Knuckle angle (rad).
    pub knuckle: f64,
}

/// Projects the law of motion from `start` toward `target` and checks what comes out.
///
/// # Errors
/// [`Refusal`]; nothing may then be sent.
pub(super) fn project(
    k: &Kinematics,
    p: &ControllerParams,
    around: &Around,
    start: &MotionState,
    target: &Target,
) -> Result<Projection, Refusal> {
    let steps = p.law_steps();
    let wanted = joint_targets(k, p, start, target, steps + 2 * HALF_WINDOW + 1)?;
    let gains = Gains { position: p.position_gain, velocity: p.velocity_gain };
    let mut states = vec![*start];
    let mut s = *start;
    for n in 1..=steps {
        // `wanted[HALF_WINDOW]` is for now.
        let (before, after) = (&wanted[n], &wanted[n + 2 * HALF_WINDOW]);
        let window = 2.0 * HALF_WINDOW as f64 * p.tick;
        let rate = std::array::from_fn(|i| (after[i] - before[i]) / window);
        s = law::step(k, &p.limits, gains, &s, &wanted[n + HALF_WINDOW], &rate, p.tick);
        states.push(s);
    }
    let out = Projection { states, tick: p.tick, stop_time: p.stop_time() };
    check(k, p, around, &out)?;
    Ok(out)
}

/// Joint targets one tick apart, the first [`HALF_WINDOW`] ticks before now.
fn joint_targets(
    k: &Kinematics,
    p: &ControllerParams,
    start: &MotionState,
    target: &Target,
    count: usize,
) -> Result<Vec<Joints>, Refusal> {
    let time = |n: usize| (n as f64 - HALF_WINDOW as f64) * p.tick;
    match target {
        Target::Joints(f) => Ok((0..count).map(|n| f(time(n))).collect()),
        Target::Tool(f) => {
            let mut out = Vec::with_capacity(count);
            let mut seed = start.q;
            let mut selection = p.limits.selection(p.max_ik_jump);
            for n in 0..count {
                seed = k.nearest_tcp(&f(time(n)), &seed, &selection)?;
                selection.max_step = BRANCH_RATE * p.tick;
                out.push(seed);
            }
            Ok(out)
        }
    }
}

fn check(
    k: &Kinematics,
    p: &ControllerParams,
    around: &Around,
    path: &Projection,
) -> Result<(), Refusal> {
    let l = &p.limits;
    let stop = |x: f64| path.sample(path.law_time() + x * path.stop_time);
    let law = path.states.iter().skip(1).copied();
    for (n, s) in law.chain([stop(0.25), stop(0.5), stop(1.0)]).enumerate() {
        for i in 0..6 {
            let (value, lower, upper) = (s.q[i], l.joint_lower[i], l.joint_upper[i]);
            if !(value >= lower && value <= upper) {
                return Err(Refusal::JointRange { joint: JOINT_NAMES[i], value, lower, upper });
            }
        }
        let fastest = law::max_abs(&s.qd);
        if !(fastest <= l.joint_velocity) {
            let what = "joint speed (rad/s)";
            return Err(Refusal::Speed { what, value: fastest, limit: l.joint_velocity });
        }
        let (linear, _) = k.tcp_speed(&s.q, &s.qd);
        if !(linear <= l.tcp_speed) {
            return Err(Refusal::Speed {
                what: "tcp speed (m/s)",
                value: linear,
                limit: l.tcp_speed,
            });
        }
        // Neighbouring points are 2 mm apart at most: every second one is enough.
        if n % 2 == 1 || n >= path.states.len() - 1 {
            check_clearance(k, &s.q, l)?;
        }
    }
    let end = path.sample(path.duration()).q;
    if let Some(world) = around.world {
        // The stop from anywhere on the way lies near this one.
        for q in [&path.sample(path.law_time()).q, &end] {
            world.check(q, around.knuckle, None)?;
        }
    }
    let condition = k.dexterity(&end).condition;
    let limit = l.singular_stop;
    if condition > limit && condition > k.dexterity(&path.states[0].q).condition {
        return Err(Refusal::Singular { condition, limit });
    }
    Ok(())
}
