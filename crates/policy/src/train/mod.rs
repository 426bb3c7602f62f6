//! Training of the trajectory policy.

mod draw;
mod run;
mod state;

use crate::network::Architecture;
use crate::planner::{Planner, PlannerConfig};
use crate::rollout::{RolloutConfig, RolloutReport, RolloutTrial, errors};
use crate::tasks::{LearnedTask, together};
use crate::{PolicyConfig, PolicyError, TrainConfig, TrainedPolicy, TrainingSet};
use draw::Drawer;
use run::Run;
use serde::{Deserialize, Serialize};
use state::Fingerprint;
use std::time::Instant;

/// Said after every step.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrainProgress {
    /// Steps done, from 1.
    pub step: usize,
    /// Steps to do.
    pub steps: usize,
    /// Denoising loss of this step's batch.
    pub loss: f64,
    /// Learning rate of this step.
    pub learning_rate: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Mean wall time of a step so far, rollouts included (ms).
    pub step_ms: f64,
    /// Expected time to the end (s).
    pub eta: f64,
    /// Closed-loop result on unseen starts, when this step was one to evaluate.
    pub rollout: Option<RolloutReport>,
}

fn learning_rate(t: &TrainConfig, step: usize) -> f64 {
    if step <= t.warm_up {
        return t.learning_rate * step as f64 / t.warm_up.max(1) as f64;
    }
    let x = (step - t.warm_up) as f64 / (t.steps.saturating_sub(t.warm_up)).max(1) as f64;
    t.learning_rate * (0.02 + 0.98 * 0.5 * (1.0 + (std::f64::consts::PI * x.min(1.0)).cos()))
}

/// Moves every tenth trajectory (at most 10 of a procedure) out of the set, for rollouts.
fn hold_out(set: &TrainingSet) -> (TrainingSet, Vec<RolloutTrial>) {
    let mut kept = set.clone();
    let mut trials = Vec::new();
    for (procedure, p) in kept.procedures.iter_mut().enumerate() {
        let n = (p.trajectories.len() / 10).min(10);
        for t in p.trajectories.drain(..n) {
            trials.push(RolloutTrial::of(procedure, &t));
        }
    }
    (kept, trials)
}

/// Trains a policy. The same set, configurations and processor give the same bytes, whatever the
/// number of threads; `progress` is called after every step.
///
/// # Errors
/// [`PolicyError::Config`], [`PolicyError::Data`], [`PolicyError::NotFinite`],
/// [`PolicyError::Diverged`].
pub fn train(
    set: &TrainingSet,
    policy: &PolicyConfig,
    t: &TrainConfig,
    progress: &mut dyn FnMut(&TrainProgress),
) -> Result<TrainedPolicy, PolicyError> {
    train_tasks(std::slice::from_ref(set), policy, t, progress)
}

/// As [`train()`], one policy for several tasks. They are drawn equally often, each with its own
/// normalisers, and the network tells them apart by their text embeddings alone. The policy that comes
/// back has the first task chosen.
///
/// # Errors
/// As [`train()`]; [`PolicyError::Data`] for tasks that cannot be told apart.
pub fn train_tasks(
    sets: &[TrainingSet],
    policy: &PolicyConfig,
    t: &TrainConfig,
    progress: &mut dyn FnMut(&TrainProgress),
) -> Result<TrainedPolicy, PolicyError> {
    let mut training = Training::new(sets, policy, t)?;
    while !training.is_done() {
        progress(&training.step()?);
    }
    training.policy()
}

/// A training that goes step by step and can be kept on the disk in between.
pub struct Training {
    t: TrainConfig,
    fingerprint: Fingerprint,
    tasks: Vec<LearnedTask>,
    /// Kept starts of each task.
    trials: Vec<Vec<RolloutTrial>>,
    architecture: Architecture,
    drawer: Drawer,
    run: Run,
    /// Running mean of the loss.
    loss: f64,
    step: usize,
    /// Good rollout evaluations in a row.
    good: usize,
    rollout: Option<RolloutReport>,
    began: Instant,
    steps_here: usize,
}

impl Training {
    /// At step 0.
    ///
    /// # Errors
    /// [`PolicyError::Config`], [`PolicyError::Data`], [`PolicyError::NotFinite`].
    pub fn new(
        sets: &[TrainingSet],
        policy: &PolicyConfig,
        t: &TrainConfig,
    ) -> Result<Self, PolicyError> {
        t.validate()?;
        let dimensions = together(sets, policy)?;
        let architecture = Architecture::new(policy, dimensions)?;
        let tasks = sets.iter().map(LearnedTask::of).collect::<Result<Vec<_>, _>>()?;
        let (kept, trials) = sets
            .iter()
            .map(|set| if t.evaluate_every > 0 { hold_out(set) } else { (set.clone(), Vec::new()) })
            .unzip();
        Ok(Self {
            fingerprint: Fingerprint::of(sets, policy, t),
            trials,
            drawer: Drawer::new(kept, &tasks, policy, t),
            run: Run::new(&architecture, &tasks, t),
            architecture,
            tasks,
            t: t.clone(),
            loss: 0.0,
            step: 0,
            good: 0,
            rollout: None,
            began: Instant::now(),
            steps_here: 0,
        })
    }

    /// Steps done.
    pub fn steps_done(&self) -> usize {
        self.step
    }

    /// All steps are done, or the rollouts were good enough to stop.
    pub fn is_done(&self) -> bool {
        self.step >= self.t.steps || (self.t.early_stop && self.good >= 2)
    }

    /// One step.
    ///
    /// # Errors
    /// [`PolicyError::Diverged`]; what [`Planner::plan`] says in rollouts.
    pub fn step(&mut self) -> Result<TrainProgress, PolicyError> {
        let t = &self.t;
        let step = self.step + 1;
        self.drawer.draw(&mut self.run.samples);
        let lr = learning_rate(t, step);
        let (loss, gradient_norm) = self.run.step(&self.architecture, t, step, lr)?;
        self.step = step;
        self.loss = if step == 1 { loss } else { 0.98 * self.loss + 0.02 * loss };
        let mut rollout = None;
        let due = t.evaluate_every > 0 && step.is_multiple_of(t.evaluate_every);
        if due && self.trials.iter().any(|trials| !trials.is_empty()) {
            let report = self.roll_out()?;
            let fine = report.success_rate() >= 0.99 && report.median_position < 0.0025;
            self.good = if fine { self.good + 1 } else { 0 };
            self.rollout = Some(report.clone());
            rollout = Some(report);
        }
        self.steps_here += 1;
        let step_ms = self.began.elapsed().as_secs_f64() * 1e3 / self.steps_here as f64;
        let (steps, learning_rate) = (self.t.steps, lr);
        let eta = step_ms * 1e-3 * (steps - step) as f64;
        Ok(TrainProgress { step, steps, loss, learning_rate, gradient_norm, step_ms, eta, rollout })
    }

    /// Rollouts of the averaged weights on the kept starts of all tasks.
    fn roll_out(&self) -> Result<RolloutReport, PolicyError> {
        let config = RolloutConfig::default();
        let mut all = Vec::new();
        let candidate = self.policy()?;
        for (task, trials) in self.tasks.iter().zip(&self.trials) {
            let chosen = candidate.clone().choose(&task.task)?;
            let mut planner = Planner::new(&chosen, PlannerConfig::default())?;
            all.extend(errors(&mut planner, trials, &config, self.t.seed)?);
        }
        RolloutReport::of(&all, &config)
    }

    /// The policy as it is now: the averaged weights, the first task chosen.
    ///
    /// # Errors
    /// None after a successful construction.
    pub fn policy(&self) -> Result<TrainedPolicy, PolicyError> {
        let mut metrics: std::collections::BTreeMap<_, _> =
            [("loss".to_string(), self.loss)].into();
        if let Some(r) = &self.rollout {
            metrics.insert("rollout_success".into(), r.success_rate());
            metrics.insert("rollout_median_position_m".into(), r.median_position);
        }
        TrainedPolicy::of(
            self.architecture.clone(),
            self.run.ema.clone(),
            &self.tasks,
            self.t.seed,
            self.step,
            metrics,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::evaluate;
    use crate::{Prediction, synthetic};

    fn tiny() -> (PolicyConfig, TrainConfig) {
        let policy = PolicyConfig {
            d_model: 16,
            heads: 1,
            decoder_layers: 1,
            encoder_layers: 1,
            dt: 0.1,
            ..PolicyConfig::small()
        };
        let train = TrainConfig { steps: 6, batch: 21, warm_up: 2, seed: 9, ..Default::default() };
        (policy, train)
    }

    #[test]
    fn a_seed_decides_every_byte_and_threads_none() {
        let set = synthetic::reach_and_place_set(4, 1);
        let (policy, t) = tiny();
        let mut losses = Vec::new();
        let one = train(&set, &policy, &t, &mut |p| losses.push(p.loss)).unwrap();
        assert_eq!(losses.len(), 6);
        let single = TrainConfig { threads: 1, ..t.clone() };
        let same = train(&set, &policy, &single, &mut |_| {}).unwrap();
        assert_eq!(one.to_bytes().unwrap(), same.to_bytes().unwrap());
        let other = TrainConfig { seed: 10, ..t };
        let other = train(&set, &policy, &other, &mut |_| {}).unwrap();
        assert_ne!(one.weights, other.weights);
    }

    /// From the zero-initialised gates on, every tensor starts to move within a few steps.
    #[test]
    fn every_tensor_is_trained() {
        let mut set = synthetic::reach_and_place_set(3, 1);
        set.text_embedding = Some((0..12).map(|i| (i as f32).sin()).collect());
        let (policy, t) = tiny();
        for prediction in [Prediction::Sample, Prediction::Epsilon, Prediction::V] {
            let policy = PolicyConfig { prediction, ..policy.clone() };
            let trained = train(&set, &policy, &t, &mut |_| {}).unwrap();
            let start = trained.architecture.initial(t.seed);
            for p in trained.architecture.parameters() {
                let (a, b) = (p.slot.of(&trained.weights), p.slot.of(&start));
                // Attention does not see an offset that all keys share: the keys' biases (the middle
                // third) stay put up to rounding, the others move.
                assert_ne!(a, b, "{} did not move with {prediction:?}", p.name);
                assert!(a.iter().all(|v| v.is_finite()));
            }
        }
    }

    #[test]
    fn numbers_that_run_away_are_an_error() {
        let mut set = synthetic::reach_and_place_set(3, 1);
        set.text_embedding = Some(vec![f32::MAX; 12]);
        let (policy, t) = tiny();
        let error = train(&set, &policy, &t, &mut |_| {}).unwrap_err();
        assert!(matches!(error, PolicyError::Diverged { step: 1, .. }), "{error}");
        let idle = TrainConfig { early_stop: true, ..t };
        let error = train(&set, &policy, &idle, &mut |_| {}).unwrap_err().to_string();
        assert!(error.contains("evaluate_every"), "{error}");
    }

    #[test]
    fn schedule_of_the_learning_rate() {
        let t = TrainConfig { steps: 100, warm_up: 10, learning_rate: 1.0, ..Default::default() };
        assert!((learning_rate(&t, 5) - 0.5).abs() < 1e-12);
        assert!((learning_rate(&t, 10) - 1.0).abs() < 1e-12);
        assert!((learning_rate(&t, 100) - 0.02).abs() < 1e-12);
        let w = run::loss_weights(&t, 4);
        assert!((w.iter().sum::<f32>() * 4.0 - 1.0).abs() < 1e-6);
    }

    /// One network, one scene, two goals 40 cm apart: the text decides which one is reached, also with
    /// the other task's normalisers.
    #[test]
    fn the_text_decides_between_two_tasks() {
        let sets = synthetic::two_goal_sets(40, 5);
        let policy = PolicyConfig { d_model: 32, dt: 0.1, ..PolicyConfig::small() };
        let t = TrainConfig {
            steps: 300,
            batch: 96,
            learning_rate: 2e-3,
            warm_up: 30,
            ..Default::default()
        };
        let both = train_tasks(&sets, &policy, &t, &mut |_| {}).unwrap();
        let unseen = synthetic::two_goal_sets(6, 77);
        let trials = |i: usize| -> Vec<RolloutTrial> {
            let trajectories = &unseen[i].procedures[0].trajectories;
            trajectories.iter().map(|t| RolloutTrial::of(0, t)).collect()
        };
        let config = RolloutConfig { position_tolerance: 0.02, ..Default::default() };
        for (mine, other) in [(0, 1), (1, 0)] {
            let chosen = both.clone().choose(&sets[mine].task).unwrap();
            let mut planner = Planner::new(&chosen, PlannerConfig::default()).unwrap();
            let own = evaluate(&mut planner, &trials(mine), &config, 1).unwrap();
            println!("{}: {own:?}", chosen.task);
            assert!(own.successes >= 5, "{own:?}");
            // The same network and scene with the other's words goes to the other's goal.
            let mut swapped = chosen;
            swapped.text_embedding = sets[other].text_embedding.clone();
            let mut planner = Planner::new(&swapped, PlannerConfig::default()).unwrap();
            let own = evaluate(&mut planner, &trials(mine), &config, 1).unwrap();
            let theirs = evaluate(&mut planner, &trials(other), &config, 1).unwrap();
            assert!(own.successes == 0 && theirs.median_position < 0.05, "{own:?} {theirs:?}");
        }
    }

    /// The whole way: a small set, a short training, unseen starts reached in closed loop.
    #[test]
    fn a_short_training_reaches_unseen_starts() {
        let set = synthetic::reach_and_place_set(40, 5);
        let policy = PolicyConfig { d_model: 32, dt: 0.1, ..PolicyConfig::small() };
        let t = TrainConfig {
            steps: 240,
            batch: 96,
            learning_rate: 2e-3,
            warm_up: 30,
            evaluate_every: 240,
            ..Default::default()
        };
        let mut report = None;
        let trained = train(&set, &policy, &t, &mut |p| report = p.rollout.clone()).unwrap();
        let report: RolloutReport = report.unwrap();
        println!("{report:?}");
        assert_eq!(report.trials, 8);
        assert!(report.successes >= 7, "{report:?}");
        assert_eq!(trained.metrics["rollout_success"], report.success_rate());
        // An untrained network of the same shape fails all of them.
        let fresh = TrainedPolicy::untrained(&set, &policy, 1).unwrap();
        let (_, trials) = hold_out(&set);
        let mut planner = Planner::new(&fresh, PlannerConfig::default()).unwrap();
        let control = evaluate(&mut planner, &trials, &RolloutConfig::default(), 1).unwrap();
        assert_eq!(control.successes, 0, "{control:?}");
        // A plan from the plan before stays close to it.
        let mut planner = Planner::new(&trained, PlannerConfig::default()).unwrap();
        let history = vec![trials[0].start; 8];
        let cold = planner.plan(0, &history, 3).unwrap();
        assert_eq!(cold, planner.plan(0, &history, 3).unwrap());
        let warm = planner.plan_from(0, &history, &cold, 0.0, 3).unwrap();
        for (a, b) in cold.iter().zip(&warm) {
            assert!(tdv_geometry::pose_distance(a, b).0 < 0.02);
        }
    }
}
