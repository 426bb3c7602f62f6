//! Collision-free joint motions: the straight joint line if it is free, else RRT-Connect with shortcuts,
//! then a jerk-limited trajectory that ends at rest.
//!
//! Pure: random numbers come from a seed, time from the caller's `expired`. Every edge is certified
//! along its whole length by the bodies' motion bounds, not by samples: see [`CollisionWorld`].

mod edge;
mod scurve;
mod timing;
mod tree;

pub use scurve::SCurve;
pub use timing::parametrise;

use crate::collision::{CollisionError, CollisionWorld, HeldObject};
use crate::executor::JointTrajectory;
use crate::kinematics::{JOINT_NAMES, Joints, Kinematics, unwrap_near};
use crate::limits::Limits;
use edge::Edges;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tdv_geometry::Pose;
use thiserror::Error;

/// A straight line to another goal is taken at once if it is at most this much longer than the one to
/// the nearest goal.
const DETOUR: f64 = 1.5;
/// Iterations spent on a way to the near goals while others are left, and on each further candidate.
const BETTER: usize = 600;

/// Where to go.
#[derive(Debug, Clone, PartialEq)]
pub enum Goal {
    /// Any of these configurations (rad), as they are.
    Joints(Vec<Joints>),
    /// `T_base_link_tcp`: any solution of the inverse kinematics, each joint unwrapped to the start.
    Tcp(Pose),
}

/// A motion to find.
#[derive(Debug, Clone)]
pub struct PlanRequest<'a> {
    /// Where the arm is (rad).
    pub start: Joints,
    /// Where it should be.
    pub goal: Goal,
    /// Knuckle angle during the motion (rad).
    pub knuckle: f64,
    /// What is carried.
    pub held: Option<&'a HeldObject>,
}

/// How hard to look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannerParams {
    /// Same seed, same path.
    pub seed: u64,
    /// Random samples before giving up.
    pub max_iterations: usize,
    /// Random shortcuts tried on a path with corners.
    pub shortcuts: usize,
    /// Paths found for choice, when no straight line is free; the one that takes least time is kept.
    pub candidates: usize,
    /// How far shapes may intrude into their margins between two looks at an edge (m); below every
    /// margin of the collision world, or an edge may touch.
    pub slip: f64,
}

impl Default for PlannerParams {
    fn default() -> Self {
        Self { seed: 1, max_iterations: 4000, shortcuts: 25, candidates: 1, slip: 1e-3 }
    }
}

/// Why there is no path.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum PlanError {
    /// The arm is already too near to something.
    #[error("start: {0}; move away from it by hand or in freedrive first")]
    Start(CollisionError),
    /// The start is outside the joint limits.
    #[error("start: {joint} at {value:.3} rad is outside {lower:.3}..{upper:.3}")]
    StartLimits {
        /// The joint's name.
        joint: &'static str,
        /// Rad.
        value: f64,
        /// Rad.
        lower: f64,
        /// Rad.
        upper: f64,
    },
    /// Every goal configuration collides; the pair is that of the one nearest to the start.
    #[error("goal, {tried} configurations tried: {nearest}")]
    Goal {
        /// How many there are.
        tried: usize,
        /// Why the nearest is not free.
        nearest: CollisionError,
    },
    /// No joint solution within the limits.
    #[error("goal tcp ({x:.3}, {y:.3}, {z:.3}) m has no joint solution within the limits")]
    NoIk {
        /// Metres in base_link.
        x: f64,
        /// Metres in base_link.
        y: f64,
        /// Metres in base_link.
        z: f64,
    },
    /// No goal configuration was given, or none within the joint limits.
    #[error("none of {given} goal configurations is within the joint limits")]
    NoGoal {
        /// How many were given.
        given: usize,
    },
    /// The search ended without a path.
    #[error("no path found in {iterations} iterations; there may be none")]
    NoPath {
        /// Random samples used.
        iterations: usize,
    },
    /// The caller's time ran out.
    #[error("no path found in the time given, {iterations} iterations")]
    TimedOut {
        /// Random samples used.
        iterations: usize,
    },
}

/// A free path and its timing.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedMotion {
    /// Corners of the path (rad), start and goal included; straight lines in joint space between.
    pub path: Vec<Joints>,
    /// The path in time, points every 8 ms, at rest at every corner and at the end; the first point is
    /// 8 ms after the start.
    pub trajectory: JointTrajectory,
    /// Random samples used; zero when a straight line was free.
    pub iterations: usize,
}

impl PlannedMotion {
    /// Seconds.
    pub fn duration(&self) -> f64 {
        self.trajectory.points.last().map_or(0.0, |p| p.time_from_start)
    }
}

/// Plans for one arm in one world.
#[derive(Debug, Clone)]
pub struct Planner<'a> {
    /// The arm.
    pub kinematics: &'a Kinematics,
    /// What it may not touch.
    pub world: &'a CollisionWorld,
    /// Joint ranges, speeds, accelerations, jerk, tcp speed.
    pub limits: &'a Limits,
    /// How hard to look.
    pub params: PlannerParams,
}

impl Planner<'_> {
    /// Finds a motion. `expired` is asked often and ends the search by returning true.
    ///
    /// # Errors
    /// [`PlanError`].
    pub fn plan(
        &self,
        request: &PlanRequest,
        expired: &mut dyn FnMut() -> bool,
    ) -> Result<PlannedMotion, PlanError> {
        let edges = Edges { world: self.world, request, slip: self.params.slip };
        let start = request.start;
        edges.check(&start).map_err(PlanError::Start)?;
        if let Some(i) = self.outside(&start) {
            return Err(PlanError::StartLimits {
                joint: JOINT_NAMES[i],
                value: start[i],
                lower: self.limits.joint_lower[i],
                upper: self.limits.joint_upper[i],
            });
        }
        let goals = self.goals(request, &edges)?;
        let (paths, iterations) = match self.straight(&edges, &start, &goals) {
            (Some(g), true) => (vec![vec![start, g]], 0),
            (fallback, _) => self.around(&edges, &start, &goals, fallback, expired)?,
        };
        let timed = paths.into_iter().map(|path| {
            let trajectory = parametrise(&path, self.kinematics, self.limits);
            PlannedMotion { path, trajectory, iterations }
        });
        let quickest = timed.min_by(|a, b| a.duration().total_cmp(&b.duration()));
        quickest.ok_or(PlanError::NoPath { iterations })
    }

    /// The nearest goal with a free straight line, and whether it is as near as any goal: the line to
    /// another branch of the inverse kinematics may be free but a long way round.
    fn straight(&self, edges: &Edges, start: &Joints, goals: &[Joints]) -> (Option<Joints>, bool) {
        let least = goals.first().map_or(0.0, |g| edge::length(start, g));
        let found = goals.iter().find(|g| edges.free(start, g)).copied();
        (found, found.is_some_and(|g| edge::length(start, &g) <= DETOUR * least))
    }

    /// Candidates: paths to the near goals, a few for choice; the straight line that is there to fall
    /// back on; only if there is neither, a path to any goal.
    fn around(
        &self,
        edges: &Edges,
        start: &Joints,
        goals: &[Joints],
        fallback: Option<Joints>,
        expired: &mut dyn FnMut() -> bool,
    ) -> Result<(Vec<Vec<Joints>>, usize), PlanError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.params.seed);
        let least = goals.first().map_or(0.0, |g| edge::length(start, g));
        let near = goals.partition_point(|g| edge::length(start, g) <= DETOUR * least);
        let elsewhere = near < goals.len();
        let (mut paths, mut used) = (Vec::new(), 0);
        for _ in 0..self.params.candidates.max(1) {
            let left = self.params.max_iterations.saturating_sub(used);
            let most = if elsewhere || !paths.is_empty() { left.min(BETTER) } else { left };
            let mut search = tree::Search::new(self.limits, edges, start, &goals[..near]);
            let found = search.run(most, &mut rng, expired);
            used += search.iterations;
            match found {
                Ok(p) => {
                    let tries = self.params.shortcuts;
                    paths.push(tree::shorten(p, edges, tries, &mut rng, expired));
                }
                Err(e) if !elsewhere && paths.is_empty() => return Err(e),
                Err(_) => break,
            }
        }
        paths.extend(fallback.map(|g| vec![*start, g]));
        if paths.is_empty() {
            let left = self.params.max_iterations.saturating_sub(used);
            let mut search = tree::Search::new(self.limits, edges, start, goals);
            let found = search.run(left, &mut rng, expired);
            used += search.iterations;
            // The count is of the whole query.
            let p = found.map_err(|e| match e {
                PlanError::TimedOut { .. } => PlanError::TimedOut { iterations: used },
                _ => PlanError::NoPath { iterations: used },
            })?;
            paths.push(tree::shorten(p, edges, self.params.shortcuts, &mut rng, expired));
        }
        Ok((paths, used))
    }

    fn outside(&self, q: &Joints) -> Option<usize> {
        (0..6)
            .find(|&i| !(q[i] >= self.limits.joint_lower[i] && q[i] <= self.limits.joint_upper[i]))
    }

    /// Free goal configurations, the nearest to the start first.
    fn goals(&self, request: &PlanRequest, edges: &Edges) -> Result<Vec<Joints>, PlanError> {
        let (l, start) = (self.limits, &request.start);
        let mut all: Vec<Joints> = match &request.goal {
            Goal::Joints(q) => q.clone(),
            Goal::Tcp(pose) => {
                let near = |q: &Joints| -> Joints {
                    std::array::from_fn(|i| {
                        unwrap_near(q[i], start[i], l.joint_lower[i], l.joint_upper[i])
                    })
                };
                self.kinematics.ik_tcp(pose).iter().map(near).collect()
            }
        };
        let given = all.len();
        all.retain(|q| self.outside(q).is_none());
        all.sort_by(|a, b| edge::length(start, a).total_cmp(&edge::length(start, b)));
        if all.is_empty() {
            return Err(match &request.goal {
                Goal::Joints(_) => PlanError::NoGoal { given },
                Goal::Tcp(p) => {
                    let t = p.translation;
                    PlanError::NoIk { x: t.x, y: t.y, z: t.z }
                }
            });
        }
        let (tried, mut nearest) = (all.len(), None);
        let mut free = Vec::new();
        for q in all {
            match edges.check(&q) {
                Ok(()) => free.push(q),
                Err(e) => nearest = nearest.or(Some(e)),
            }
        }
        match nearest {
            Some(nearest) if free.is_empty() => Err(PlanError::Goal { tried, nearest }),
            _ => Ok(free),
        }
    }
}

#[cfg(test)]
mod tests;
