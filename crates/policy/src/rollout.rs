//! Closed-loop rollouts without a robot: the plan's poses are reached exactly, the history is noisy.

use crate::rng::{Stream, stream};
use crate::samples::disturb;
use crate::{Planner, PolicyError};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use tdv_geometry::{Pose, pose_distance};

/// How a rollout is run and judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RolloutConfig {
    /// Steps after which the final pose is judged.
    pub steps: usize,
    /// Poses of a plan that are executed before the next one.
    pub execute: usize,
    /// Noise of the observed poses (m, per axis).
    pub noise_position: f64,
    /// The same for rotation (rad, per axis).
    pub noise_rotation: f64,
    /// Largest final error (m) of a success.
    pub position_tolerance: f64,
    /// Largest final error (rad) of a success.
    pub rotation_tolerance: f64,
}

impl Default for RolloutConfig {
    fn default() -> Self {
        Self {
            steps: 160,
            execute: 4,
            noise_position: 0.001,
            noise_rotation: 0.005,
            position_tolerance: 0.010,
            rotation_tolerance: 5.0_f64.to_radians(),
        }
    }
}

/// A start that was not trained on, and where it shall end.
#[derive(Debug, Clone, PartialEq)]
pub struct RolloutTrial {
    /// Procedure.
    pub procedure: usize,
    /// First pose `T_reference_moving`.
    pub start: Pose,
    /// Wanted last pose.
    pub goal: Pose,
}

impl RolloutTrial {
    /// Start and goal of a trajectory that is kept from training.
    ///
    /// # Panics
    /// For an empty trajectory; a validated set has none.
    pub fn of(procedure: usize, trajectory: &[Pose]) -> Self {
        Self { procedure, start: trajectory[0], goal: trajectory[trajectory.len() - 1] }
    }
}

/// Result over all trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RolloutReport {
    /// Trials.
    pub trials: usize,
    /// Those within both tolerances at the end.
    pub successes: usize,
    /// Median final error (m).
    pub median_position: f64,
    /// Largest final error (m).
    pub max_position: f64,
    /// Median final error (rad).
    pub median_rotation: f64,
    /// Largest final error (rad).
    pub max_rotation: f64,
}

impl RolloutReport {
    /// Of the trials' final errors (m, rad).
    ///
    /// # Errors
    /// [`PolicyError::Data`] without trials.
    pub fn of(errors: &[(f64, f64)], c: &RolloutConfig) -> Result<Self, PolicyError> {
        if errors.is_empty() {
            return Err(PolicyError::Data { reason: "no trials to roll out".into() });
        }
        let (mut d, mut a): (Vec<f64>, Vec<f64>) = errors.iter().copied().unzip();
        d.sort_by(f64::total_cmp);
        a.sort_by(f64::total_cmp);
        let within =
            |(d, a): &&(f64, f64)| *d <= c.position_tolerance && *a <= c.rotation_tolerance;
        let n = errors.len();
        Ok(Self {
            trials: n,
            successes: errors.iter().filter(within).count(),
            median_position: d[n / 2],
            max_position: d[n - 1],
            median_rotation: a[n / 2],
            max_rotation: a[n - 1],
        })
    }

    /// Part of the trials that succeeded.
    pub fn success_rate(&self) -> f64 {
        self.successes as f64 / self.trials.max(1) as f64
    }
}

/// Runs one trial; every pose that was reached, the start first.
///
/// # Errors
/// As [`Planner::plan`].
pub fn rollout(
    planner: &mut Planner,
    trial: &RolloutTrial,
    c: &RolloutConfig,
    seed: u64,
) -> Result<Vec<Pose>, PolicyError> {
    let mut rng = stream(seed, Stream::Rollout);
    let mut observe = |p: &Pose| disturb(p, c.noise_position, c.noise_rotation, &mut rng);
    let first = observe(&trial.start);
    let mut history: VecDeque<Pose> = vec![first; planner.history_len()].into();
    let mut path = vec![trial.start];
    while path.len() <= c.steps {
        let plan = planner.plan(trial.procedure, history.make_contiguous(), seed)?;
        for pose in plan.iter().take(c.execute.max(1)).take(c.steps + 1 - path.len()) {
            history.pop_front();
            history.push_back(observe(pose));
            path.push(*pose);
        }
    }
    Ok(path)
}

/// Final errors (m, rad) of all trials.
///
/// # Errors
/// As [`Planner::plan`].
pub fn errors(
    planner: &mut Planner,
    trials: &[RolloutTrial],
    c: &RolloutConfig,
    seed: u64,
) -> Result<Vec<(f64, f64)>, PolicyError> {
    let run = |(i, trial): (usize, &RolloutTrial)| {
        let path = rollout(planner, trial, c, seed.wrapping_add(i as u64))?;
        Ok(pose_distance(&path[path.len() - 1], &trial.goal))
    };
    trials.iter().enumerate().map(run).collect()
}

/// Runs all trials.
///
/// # Errors
/// As [`Planner::plan`]; [`PolicyError::Data`] without trials.
pub fn evaluate(
    planner: &mut Planner,
    trials: &[RolloutTrial],
    c: &RolloutConfig,
    seed: u64,
) -> Result<RolloutReport, PolicyError> {
    RolloutReport::of(&errors(planner, trials, c, seed)?, c)
}
