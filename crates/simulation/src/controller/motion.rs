//! What moves the joints: one motion at a time, stepped in time.

use super::profile::Trapezoid;
use super::servo;
use super::{MAX_ACCELERATION, MAX_SPEED, POSITION_LIMIT, STOP_DECELERATION};
use crate::arm::ArmModel;
use tdv_geometry::nalgebra::{Vector3, Vector6};
use tdv_geometry::{Pose, interpolate};
use tdv_robot::{IkSelection, Kinematics, base_link_to_base};

/// Joint angles or speeds.
pub(crate) type Six = [f64; 6];

/// Why the controller cannot go on with a motion; each is a protective stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Violation {
    /// A joint at the end of its range.
    Position,
    /// A joint that would have to be faster than it can.
    Speed,
    /// A tool path that leaves the arm's reach.
    Reach,
}

/// A way from rest to rest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    /// Greatest speed: rad/s of the fastest joint, or m/s (rad/s for a pure turn) of the tool.
    pub v: f64,
    /// Greatest acceleration, the same per s.
    pub a: f64,
    /// Duration instead of both, s.
    pub t: Option<f64>,
}

impl Pace {
    fn profile(&self, length: f64) -> Trapezoid {
        match self.t {
            Some(t) => Trapezoid::timed(length, t),
            None => Trapezoid::new(length, self.v, self.a),
        }
    }
}

/// What the arm does now.
#[derive(Debug, Clone)]
pub(crate) enum Motion {
    /// Nothing.
    Rest,
    /// All joints slow down together at this rate (rad/s^2 of the fastest).
    Brake(f64),
    /// To joint angles; `plan` is made as soon as the arm rests.
    Joint { to: Six, pace: Pace, plan: Option<(Six, Trapezoid, f64)> },
    /// The tool (`T_base_tcp`) on a straight line.
    Line { to: Pose, pace: Pace, plan: Option<(Pose, Trapezoid, f64)> },
    /// After a stream of targets.
    Servo { target: Six, aim: Six, aim_left: f64, lag: f64, left: f64 },
    /// At joint speeds; `left` seconds, for ever if `None`.
    SpeedJ { qd: Six, a: f64, left: Option<f64> },
    /// At a tool speed in base axes (m/s, rad/s); accelerations linear and angular.
    SpeedL { now: Vector6<f64>, xd: Vector6<f64>, a: [f64; 2], left: Option<f64> },
}

/// The arm and its motion.
#[derive(Debug, Clone)]
pub(crate) struct Mover {
    pub q: Six,
    pub qd: Six,
    pub qdd: Six,
    pub motion: Motion,
    kinematics: Kinematics,
    cycle: f64,
    scale: f64,
}

fn fastest(qd: &Six) -> f64 {
    qd.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// A tool speed given in `base` axes in `base_link` axes, and the other way round.
fn half_turn(x: &Vector6<f64>) -> Vector6<f64> {
    Vector6::new(-x[0], -x[1], x[2], -x[3], -x[4], x[5])
}

impl Mover {
    pub(crate) fn new(q: Six, arm: ArmModel, cycle: f64) -> Self {
        let kinematics = arm.kinematics().with_tool(Pose::identity());
        Self { q, qd: [0.0; 6], qdd: [0.0; 6], motion: Motion::Rest, kinematics, cycle, scale: 1.0 }
    }

    /// `T_tool0_tcp`.
    pub(crate) fn tool(&self) -> &Pose {
        self.kinematics.tool()
    }

    pub(crate) fn set_tool(&mut self, tool: Pose) {
        self.kinematics = self.kinematics.clone().with_tool(tool);
    }

    /// `T_base_tool0` at other joint angles.
    pub(crate) fn flange(&self, q: &Six) -> Pose {
        base_link_to_base().inverse() * self.kinematics.frames(q)[6]
    }

    /// `T_base_tcp` at other joint angles.
    pub(crate) fn fk(&self, q: &Six) -> Pose {
        base_link_to_base().inverse() * self.kinematics.fk_tcp(q)
    }

    /// The solution for `T_base_tcp` nearest to `near`.
    pub(crate) fn ik(&self, pose: &Pose, near: &Six) -> Option<Six> {
        let selection = IkSelection {
            lower: [-POSITION_LIMIT; 6],
            upper: [POSITION_LIMIT; 6],
            ..IkSelection::default()
        };
        self.kinematics.nearest_tcp(&(base_link_to_base() * pose), near, &selection).ok()
    }

    /// Tool speed in base axes: m/s, rad/s.
    pub(crate) fn tcp_speed(&self) -> Vector6<f64> {
        half_turn(&(self.kinematics.jacobian_tcp(&self.q) * Vector6::from(self.qd)))
    }

    pub(crate) fn at_rest(&self) -> bool {
        self.qd.iter().all(|v| v.abs() < 1e-9)
    }

    /// Whether a script's call that started the motion still waits for it.
    pub(crate) fn busy(&self) -> bool {
        let half = 0.5 * self.cycle;
        match &self.motion {
            Motion::Rest => false,
            Motion::Brake(_) | Motion::Joint { .. } | Motion::Line { .. } => true,
            Motion::Servo { left, .. } => *left > half,
            Motion::SpeedJ { left: Some(left), .. } | Motion::SpeedL { left: Some(left), .. } => {
                *left > half
            }
            Motion::SpeedJ { qd, .. } => {
                (0..6).any(|i| (self.qd[i] - qd[i] * self.scale).abs() > 1e-6)
            }
            Motion::SpeedL { now, xd, .. } => (now - xd * self.scale).norm() > 1e-6,
        }
    }

    /// A target of `servoj` that is followed for `t` seconds.
    pub(crate) fn servo(&mut self, to: Six, t: f64, lookahead: f64, gain: f64) {
        let aim = match &self.motion {
            Motion::Servo { aim, .. } => *aim,
            _ => self.q,
        };
        let (aim_left, left) = (self.cycle, t.max(self.cycle));
        let lag = servo::lag(lookahead, gain);
        self.motion = Motion::Servo { target: to, aim, aim_left, lag, left };
    }

    pub(crate) fn speed_l(&mut self, xd: Vector6<f64>, a: [f64; 2], left: Option<f64>) {
        self.motion = Motion::SpeedL { now: self.tcp_speed(), xd, a, left };
    }

    /// Slows down at `rate` rad/s^2 of the fastest joint.
    pub(crate) fn brake(&mut self, rate: f64) {
        self.motion = if self.at_rest() { Motion::Rest } else { Motion::Brake(rate) };
    }

    /// Slows down so that the tool's speed falls by `a` m/s^2.
    pub(crate) fn brake_tool(&mut self, a: f64) {
        let x = self.tcp_speed();
        let speed = x.fixed_rows::<3>(0).norm().max(x.fixed_rows::<3>(3).norm());
        let rate = if speed > 1e-6 { fastest(&self.qd) * a / speed } else { STOP_DECELERATION };
        self.brake(rate.max(1e-3));
    }

    /// Slows down and returns what to take up again afterwards.
    pub(crate) fn suspend(&mut self) -> Option<Motion> {
        let motion = std::mem::replace(&mut self.motion, Motion::Rest);
        self.brake(STOP_DECELERATION);
        match motion {
            Motion::Joint { to, pace, .. } => Some(Motion::Joint { to, pace, plan: None }),
            Motion::Line { to, pace, .. } => Some(Motion::Line { to, pace, plan: None }),
            _ => None,
        }
    }

    /// One tick of `dt` seconds; `scale` is the speed slider's effect, 0..=1.
    pub(crate) fn step(&mut self, dt: f64, scale: f64) -> Result<(), Violation> {
        self.scale = scale;
        let before = (self.q, self.qd);
        let mut motion = std::mem::replace(&mut self.motion, Motion::Rest);
        let outcome = self.advance(&mut motion, dt, scale);
        self.motion = motion;
        let outcome = outcome.and_then(|done| self.check(&before.0).map(|()| done));
        match outcome {
            Ok(true) => self.motion = Motion::Rest,
            Ok(false) => {}
            Err(violation) => {
                // The step that would break a limit is not taken.
                for i in 0..6 {
                    let at_end = self.q[i].abs() > POSITION_LIMIT;
                    self.qd[i] = if at_end { 0.0 } else { before.1[i] };
                }
                self.q = before.0;
                self.qdd = [0.0; 6];
                return Err(violation);
            }
        }
        self.qdd = std::array::from_fn(|i| (self.qd[i] - before.1[i]) / dt);
        Ok(())
    }

    fn check(&self, before: &Six) -> Result<(), Violation> {
        let outward = |i: usize| self.q[i].abs() > before[i].abs() + 1e-12;
        if (0..6).any(|i| self.q[i].abs() > POSITION_LIMIT && outward(i)) {
            return Err(Violation::Position);
        }
        if !self.qd.iter().all(|v| v.abs() <= MAX_SPEED + 1e-6) {
            return Err(Violation::Speed);
        }
        Ok(())
    }

    fn set(&mut self, q: Six, dt: f64) {
        self.qd = std::array::from_fn(|i| (q[i] - self.q[i]) / dt);
        self.q = q;
    }

    fn slow(&mut self, rate: f64, dt: f64) {
        let speed = fastest(&self.qd);
        let keep = if speed > 0.0 { ((speed - rate * dt) / speed).max(0.0) } else { 0.0 };
        for (q, qd) in self.q.iter_mut().zip(&mut self.qd) {
            *qd *= keep;
            *q += *qd * dt;
        }
    }

    /// True when the motion is over.
    fn advance(&mut self, motion: &mut Motion, dt: f64, scale: f64) -> Result<bool, Violation> {
        match motion {
            Motion::Rest => {
                self.qd = [0.0; 6];
                Ok(false)
            }
            Motion::Brake(rate) => {
                self.slow(*rate, dt);
                Ok(self.at_rest())
            }
            Motion::Joint { to, pace, plan } => {
                let Some((from, profile, t)) = plan else {
                    if !self.at_rest() {
                        self.slow(pace.a.max(STOP_DECELERATION), dt);
                        return Ok(false);
                    }
                    let q = self.q;
                    let length = (0..6).fold(0.0_f64, |m, i| m.max((to[i] - q[i]).abs()));
                    *plan = Some((q, pace.profile(length), 0.0));
                    return Ok(length < 1e-12);
                };
                *t += dt * scale;
                let whole = profile.at(f64::INFINITY);
                let share = if whole > 0.0 { profile.at(*t) / whole } else { 1.0 };
                let q = std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
                let over = *t >= profile.duration();
                self.set(q, dt);
                if over {
                    self.qd = [0.0; 6];
                }
                Ok(over)
            }
            Motion::Line { to, pace, plan } => {
                let Some((from, profile, t)) = plan else {
                    if !self.at_rest() {
                        self.slow(STOP_DECELERATION, dt);
                        return Ok(false);
                    }
                    let here = self.fk(&self.q);
                    let way = (to.translation.vector - here.translation.vector).norm();
                    let length = way.max(here.rotation.angle_to(&to.rotation));
                    *plan = Some((here, pace.profile(length), 0.0));
                    return Ok(length < 1e-9);
                };
                *t += dt * scale;
                let whole = profile.at(f64::INFINITY);
                let share = if whole > 0.0 { profile.at(*t) / whole } else { 1.0 };
                let pose = interpolate(from, to, share);
                let q = self.ik(&pose, &self.q).ok_or(Violation::Reach)?;
                let over = *t >= profile.duration();
                self.set(q, dt);
                if over && fastest(&self.qd) < MAX_SPEED {
                    self.qd = [0.0; 6];
                }
                Ok(over)
            }
            Motion::Servo { target, aim, aim_left, lag, left } => {
                *left -= dt;
                if *left < -1.5 * self.cycle {
                    // Nobody asked for more: the arm is not left in motion.
                    *motion = Motion::Brake(STOP_DECELERATION);
                    return Ok(false);
                }
                // A new target is reached in the course of one cycle, not in a jump.
                let share = if *aim_left > dt { dt / *aim_left } else { 1.0 };
                *aim_left -= dt;
                for i in 0..6 {
                    aim[i] += (target[i] - aim[i]) * share;
                    let (q, qd) = servo::track(self.q[i], self.qd[i], aim[i], *lag, dt);
                    (self.q[i], self.qd[i]) = (q, qd);
                }
                Ok(false)
            }
            Motion::SpeedJ { qd, a, left } => {
                if let Some(left) = left {
                    *left -= dt;
                    if *left < -1.5 * self.cycle {
                        *motion = Motion::Brake(*a);
                        return Ok(false);
                    }
                }
                let gap: Six = std::array::from_fn(|i| qd[i] * scale - self.qd[i]);
                let share = (a.min(MAX_ACCELERATION) * dt / fastest(&gap).max(1e-12)).min(1.0);
                for ((q, qd), gap) in self.q.iter_mut().zip(&mut self.qd).zip(gap) {
                    *qd += share * gap;
                    *q += *qd * dt;
                }
                Ok(false)
            }
            Motion::SpeedL { now, xd, a, left } => {
                if let Some(left) = left {
                    *left -= dt;
                    if *left < -1.5 * self.cycle {
                        *motion = Motion::Brake(STOP_DECELERATION);
                        return Ok(false);
                    }
                }
                let gap = *xd * scale - *now;
                for (rows, a) in [(0..3, a[0]), (3..6, a[1])] {
                    let part = Vector3::from_fn(|i, _| gap[rows.start + i]);
                    let share = (a * dt / part.norm().max(1e-12)).min(1.0);
                    for i in rows {
                        now[i] += share * gap[i];
                    }
                }
                let jacobian = self.kinematics.jacobian_tcp(&self.q);
                let qd = jacobian.lu().solve(&half_turn(now)).ok_or(Violation::Reach)?;
                self.qd = std::array::from_fn(|i| qd[i]);
                for i in 0..6 {
                    self.q[i] += self.qd[i] * dt;
                }
                Ok(false)
            }
        }
    }
}
