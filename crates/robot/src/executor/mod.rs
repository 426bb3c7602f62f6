//! The driver's side of a joint trajectory: acceptance by the rules of ros2_control's joint
//! trajectory controller, sampling, preemption, and a last guard before the robot. Pure.

mod clocks;
mod goal;
mod guard;
mod motion;
mod scale;
mod spline;
mod stream;
mod validate;

pub use goal::{GoalCode, GoalEndReport, GoalTolerances, JointTolerance, ToleranceError};
pub use guard::{GuardError, TargetGuard};
pub use motion::{
    Follow, Motion, MotionController, MotionParams, MotionRefusal, RobotInput, StepOutput,
};
pub use scale::SpeedScale;
pub use validate::TrajectoryRejection;

use crate::kinematics::{JOINT_NAMES, Joints};
use spline::Knot;
use tdv_geometry::Stamp;

/// One point as the message carries it; empty vectors mean "not given".
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrajectoryPoint {
    /// Rad, in the order of the trajectory's names.
    pub positions: Vec<f64>,
    /// Rad/s.
    pub velocities: Vec<f64>,
    /// Rad/s^2.
    pub accelerations: Vec<f64>,
    /// Must be empty: there is no effort interface.
    pub effort: Vec<f64>,
    /// Seconds.
    pub time_from_start: f64,
}

/// A `trajectory_msgs/JointTrajectory`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointTrajectory {
    /// All six joints, in any order.
    pub names: Vec<String>,
    /// The header's stamp; `None` (a zero stamp) starts on acceptance.
    pub stamp: Option<Stamp>,
    /// At least one.
    pub points: Vec<TrajectoryPoint>,
}

/// Desired joints at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Desired {
    /// Rad, UR order.
    pub q: Joints,
    /// Rad/s.
    pub qd: Joints,
}

/// What the executor checks a trajectory against.
#[derive(Debug, Clone, PartialEq)]
pub struct ExecutorParams {
    /// The joints' names in UR order (a `tf_prefix` changes them).
    pub names: [String; 6],
    /// Least positions (rad).
    pub lower: Joints,
    /// Greatest positions (rad).
    pub upper: Joints,
}

impl Default for ExecutorParams {
    fn default() -> Self {
        let limits = crate::limits::Limits::default();
        Self {
            names: JOINT_NAMES.map(String::from),
            lower: limits.joint_lower,
            upper: limits.joint_upper,
        }
    }
}

/// Executes one trajectory at a time; a new one preempts it from the present desired state.
#[derive(Debug, Clone)]
pub struct JointTrajectoryExecutor {
    params: ExecutorParams,
    knots: Vec<Knot>,
    /// When the trajectory was accepted; knot times are seconds from here, and negative for what is left
    /// of the one before.
    start: Stamp,
}

/// A trajectory that replaces a running one is merged into within this time (s).
const MERGE: f64 = 0.02;
/// What has to be caught up with may take until this time (s).
const JOIN: f64 = 0.1;
/// Points of the replaced trajectory that are kept, over the longest step: it may be asked for what was
/// due before, when the states of the robot are late.
const KEPT: u32 = 5;

impl JointTrajectoryExecutor {
    /// Without a trajectory; [`Self::sample`] gives nothing until the first one or a [`Self::hold`].
    pub fn new(params: ExecutorParams) -> Self {
        Self { params, knots: Vec::new(), start: Stamp::default() }
    }

    /// Checks a trajectory and, if it is good, makes it the active one at once. `current` is the state
    /// to start from when nothing is active: the last target sent to the robot, or the measured state
    /// at rest.
    ///
    /// # Errors
    /// [`TrajectoryRejection`]; what was active stays active.
    pub fn accept(
        &mut self,
        trajectory: &JointTrajectory,
        now: Stamp,
        current: &Desired,
    ) -> Result<(), TrajectoryRejection> {
        self.accept_at(trajectory, now, now, current)
    }

    /// As [`Self::accept`] for an executor whose time `at` is not the clock `now` of the stamps: time that
    /// is stretched, or a clock of the graph that may jump.
    ///
    /// # Errors
    /// [`TrajectoryRejection`]; what was active stays active.
    pub fn accept_at(
        &mut self,
        trajectory: &JointTrajectory,
        now: Stamp,
        at: Stamp,
        current: &Desired,
    ) -> Result<(), TrajectoryRejection> {
        let order = validate::validate(trajectory, now, &self.params)?;
        let from = self.sample(at).unwrap_or(*current);
        let begin = trajectory.stamp.map_or(0.0, |s| s.since(now));
        let mut knots = vec![Knot { time: 0.0, q: from.q, qd: Some(from.qd), qdd: None }];
        let moving = self.is_moving(at);
        for (i, p) in trajectory.points.iter().enumerate() {
            let time = begin + p.time_from_start;
            // Points that lie in the past are skipped: the path goes from here to the next one. So are
            // those of the next moment while another trajectory runs: a message that came some
            // milliseconds early or late must not make the arm hurry or wait.
            let first = if moving && i + 1 < trajectory.points.len() { MERGE } else { 1e-9 };
            if time > first {
                let pick = |v: &[f64]| -> Option<Joints> {
                    (v.len() == 6).then(|| std::array::from_fn(|i| v[order[i]]))
                };
                if let Some(q) = pick(&p.positions) {
                    let (qd, qdd) = (pick(&p.velocities), pick(&p.accelerations));
                    knots.push(Knot { time, q, qd, qdd });
                }
            }
        }
        if knots.len() == 1 {
            // A single point at time zero: the target itself, as a controller would hold it.
            if let Some(p) = trajectory.points.last() {
                let q = std::array::from_fn(|i| p.positions[order[i]]);
                knots[0] = Knot { time: 0.0, q, qd: None, qdd: None };
            }
        }
        let before = (1..=KEPT).rev().filter_map(|i| {
            let time = -SpeedScale::LONGEST_STEP * f64::from(i) / f64::from(KEPT);
            let Desired { q, qd } = self.sample(at.plus(time))?;
            Some(Knot { time, q, qd: Some(qd), qdd: None })
        });
        self.knots = before.chain(knots).collect();
        self.start = at;
        Ok(())
    }

    /// The present state and the first point after it.
    fn entry(&self) -> Option<(usize, &Knot, &Knot)> {
        let i = self.knots.partition_point(|k| k.time < 0.0) + 1;
        Some((i, self.knots.get(i - 1)?, self.knots.get(i)?))
    }

    /// Greatest mean speed (rad/s) of a joint on the way from the present state to the first point.
    pub fn entry_speed(&self) -> f64 {
        let Some((_, a, b)) = self.entry() else { return 0.0 };
        let far = (0..6).map(|i| (b.q[i] - a.q[i]).abs()).fold(0.0, f64::max);
        far / (b.time - a.time).max(1e-9)
    }

    /// Leaves the first points out as long as a joint would be faster than `limit` (rad/s) on the way to
    /// them: what a late trajectory is ahead by is caught up with over a tenth of a second.
    pub fn join(&mut self, limit: f64) {
        const LOOKS: usize = 8;
        while let Some((i, a, b)) = self.entry() {
            let fast = (0..=LOOKS).any(|k| {
                let t = a.time + (b.time - a.time) * k as f64 / LOOKS as f64;
                spline::sample(a, b, t).1.iter().any(|v| v.abs() > limit)
            });
            if !fast || self.knots.get(i + 1).is_none_or(|next| next.time > JOIN) {
                return;
            }
            self.knots.remove(i);
        }
    }

    /// Comes to rest from state `from`: all joints together with constant deceleration, the fastest one
    /// with `deceleration` (rad/s^2), so that the tool stays near its path.
    pub fn stop(&mut self, now: Stamp, from: &Desired, deceleration: f64) {
        let fastest = from.qd.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let time = fastest / deceleration.max(1e-3);
        self.start = now;
        self.knots = vec![Knot { time: 0.0, q: from.q, qd: Some(from.qd), qdd: None }];
        if time > 1e-6 {
            let q = std::array::from_fn(|i| {
                let end = from.q[i] + 0.5 * from.qd[i] * time;
                end.clamp(self.params.lower[i], self.params.upper[i])
            });
            self.knots.push(Knot { time, q, qd: Some([0.0; 6]), qdd: None });
        }
    }

    /// Stays at joints `q` from now on.
    pub fn hold(&mut self, now: Stamp, q: Joints) {
        self.start = now;
        self.knots = vec![Knot { time: 0.0, q, qd: Some([0.0; 6]), qdd: None }];
    }

    /// Forgets everything, for a robot that was moved by others.
    pub fn clear(&mut self) {
        self.knots.clear();
    }

    /// Desired state at a time: along the trajectory (cubic where both ends have velocities, quintic
    /// where they have accelerations too, else linear), then its last position at rest.
    pub fn sample(&self, now: Stamp) -> Option<Desired> {
        let t = now.since(self.start);
        let (first, last) = (self.knots.first()?, self.knots.last()?);
        if t >= last.time {
            return Some(Desired { q: last.q, qd: [0.0; 6] });
        }
        if t <= first.time {
            return Some(Desired { q: first.q, qd: first.qd.unwrap_or([0.0; 6]) });
        }
        let i = self.knots.partition_point(|k| k.time <= t).clamp(1, self.knots.len() - 1);
        let (q, qd) = spline::sample(&self.knots[i - 1], &self.knots[i], t);
        Some(Desired { q, qd })
    }

    /// As [`Self::sample`]; none before what is still known of the trajectory that was replaced.
    pub fn known(&self, at: Stamp) -> Option<Desired> {
        let first = self.knots.first()?;
        (at.since(self.start) >= first.time).then(|| self.sample(at))?
    }

    /// True until the last point's time.
    pub fn is_moving(&self, now: Stamp) -> bool {
        self.knots.last().is_some_and(|k| now.since(self.start) < k.time)
    }

    /// Last position of the active trajectory (rad) and when it is due.
    pub fn goal(&self) -> Option<(Joints, Stamp)> {
        self.knots.last().map(|k| (k.q, self.start.plus(k.time)))
    }
}

#[cfg(test)]
mod motion_tests;
#[cfg(test)]
mod tests;
