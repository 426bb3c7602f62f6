//! Training of the switch classifier and its figures on trajectories kept aside.

use super::policy::{SwitchBuffers, SwitchLayout, SwitchPolicy, Texts};
use super::{SwitchConfig, SwitchCore};
use crate::kernels::{AdamW, adamw};
use crate::network::initial;
use crate::normaliser::POSE_DIM;
use crate::rng::{Stream, stream};
use crate::samples::{disturb, pose_at, write_history};
use crate::tasks::{LearnedTask, together};
use crate::{PolicyConfig, PolicyError, ProcedureData, TrainConfig, TrainingSet};
use rand::Rng;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use tdv_geometry::{Pose, Stamp, pose_distance};

/// Part of the samples that show another task's trajectory, when there are several.
const FOREIGN: f64 = 0.2;
/// A pose of another task that is farther than this (m) from a procedure's end does not end it.
const APART: f64 = 0.05;

/// How the classifier is trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwitchTrainConfig {
    /// Optimiser steps.
    pub steps: usize,
    /// Windows per step.
    pub batch: usize,
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Weight of a positive sample against a negative one in the loss.
    pub positive_weight: f64,
    /// How many samples before and including the arrival (from which on the pose stays within 1 mm
    /// and 0.5 degrees of its end) count as done, as all later ones do.
    pub window: usize,
    /// Samples of rest after the end, done as well.
    pub hold_samples: usize,
    /// Every so many-th trajectory is kept aside for the report.
    pub hold_out: usize,
    /// Everything random follows from it.
    pub seed: u64,
}

impl Default for SwitchTrainConfig {
    fn default() -> Self {
        Self {
            steps: 1500,
            batch: 256,
            learning_rate: 2e-3,
            positive_weight: 100.0,
            window: 3,
            hold_samples: 8,
            hold_out: 5,
            seed: 0,
        }
    }
}

impl SwitchTrainConfig {
    pub(super) fn validate(&self) -> Result<(), PolicyError> {
        let mut problems = Vec::new();
        for (name, v, low) in [
            ("steps", self.steps, 1),
            ("batch", self.batch, 1),
            ("window", self.window, 1),
            ("hold_out", self.hold_out, 2),
        ] {
            if v < low {
                problems.push(format!("{name} is {v}, must be at least {low}"));
            }
        }
        for (name, v) in
            [("learning_rate", self.learning_rate), ("positive_weight", self.positive_weight)]
        {
            if !(v.is_finite() && v > 0.0) {
                problems.push(format!("{name} is {v}, must be positive"));
            }
        }
        if problems.is_empty() { Ok(()) } else { Err(PolicyError::Config { problems }) }
    }
}

/// Figures on trajectories that were not trained on, with tracker noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwitchReport {
    /// Trajectories.
    pub trajectories: usize,
    /// Of the samples above 0.5, the part that is done.
    pub precision: f64,
    /// Of the samples that are done, the part above 0.5.
    pub recall: f64,
    /// Trajectories on which the machine never fired, up to 2 s of rest after the end.
    pub missed: usize,
    /// Trajectories on which it fired farther than 15 mm or 10 degrees from the end.
    pub premature: usize,
    /// Median time from the arrival to the firing (s); negative is early.
    pub median_delay: f64,
    /// Delay that nine of ten firings do not exceed (s).
    pub delay_90: f64,
    /// Largest distance from the end when it fired (m).
    pub max_distance: f64,
    /// Largest rotation from the end when it fired (rad).
    pub max_rotation: f64,
}

/// Trains the classifier. `noise` gives the disturbances of the histories. The weights with which
/// every procedure's trajectories are drawn are equal.
///
/// # Errors
/// [`PolicyError::Config`], [`PolicyError::Data`], [`PolicyError::Diverged`].
pub fn train_switch(
    set: &TrainingSet,
    policy: &PolicyConfig,
    noise: &TrainConfig,
    t: &SwitchTrainConfig,
) -> Result<(SwitchPolicy, SwitchReport), PolicyError> {
    let (trained, mut reports) = train_switch_tasks(std::slice::from_ref(set), policy, noise, t)?;
    let report =
        reports.pop().ok_or_else(|| PolicyError::Data { reason: "there is no task".into() })?;
    Ok((trained, report))
}

/// As [`train_switch`], one classifier for several tasks, which it tells apart by their text
/// embeddings alone; one report per task. The first task is chosen.
///
/// # Errors
/// As [`train_switch`]; [`PolicyError::Data`] for tasks that cannot be told apart.
pub fn train_switch_tasks(
    sets: &[TrainingSet],
    policy: &PolicyConfig,
    noise: &TrainConfig,
    t: &SwitchTrainConfig,
) -> Result<(SwitchPolicy, Vec<SwitchReport>), PolicyError> {
    t.validate()?;
    noise.validate()?;
    policy.validate()?;
    let dimensions = together(sets, policy)?;
    let mut procedures = sets.iter().flat_map(|s| &s.procedures);
    if let Some(p) = procedures.find(|p| p.trajectories.len() < t.hold_out) {
        let (n, need) = (p.trajectories.len(), t.hold_out);
        let reason = format!(
            "procedure `{}` has {n} trajectories; keeping every {need}th aside needs {need}",
            p.name
        );
        return Err(PolicyError::Data { reason });
    }
    let tasks = sets.iter().map(LearnedTask::of).collect::<Result<Vec<_>, _>>()?;
    let arrivals = |p: &ProcedureData| p.trajectories.iter().map(|t| arrival(t)).collect();
    let ends: Vec<Vec<Vec<usize>>> =
        sets.iter().map(|s| s.procedures.iter().map(arrivals).collect()).collect();
    let table: Vec<f32> =
        sets.iter().flat_map(|s| s.text_embedding.iter().flatten()).copied().collect();
    let layout = SwitchLayout::new(policy.history, dimensions.text, dimensions.procedures);
    let mut rng = stream(t.seed, Stream::Switch);
    let mut theta = initial(&layout.parameters, layout.len, rng.clone());
    let (mut m, mut v) = (vec![0.0; layout.len], vec![0.0; layout.len]);
    let mut grads = vec![0.0; layout.len];
    let mut buffers = SwitchBuffers::new(&layout, t.batch);
    let width = policy.history * POSE_DIM;
    let mut histories = vec![0.0; t.batch * width];
    let (mut ids, mut done) = (vec![0; t.batch], vec![false; t.batch]);
    let mut task = vec![0; t.batch];
    // Off-path offsets would blur the very boundary that is to be learned.
    let noise = TrainConfig { drift_position: 0.0, drift_rotation: 0.0, ..noise.clone() };
    for step in 1..=t.steps {
        for i in 0..t.batch {
            let (k, s, from, r, j, position) = loop {
                let k = if sets.len() > 1 { rng.random_range(0..sets.len()) } else { 0 };
                let s = rng.random_range(0..sets[k].procedures.len());
                // Some windows come from another task: what ends that one is no end of this one.
                let foreign = sets.len() > 1 && rng.random_bool(FOREIGN);
                let from =
                    if foreign { (k + rng.random_range(1..sets.len())) % sets.len() } else { k };
                let r = s.min(sets[from].procedures.len() - 1);
                let trajectories = &sets[from].procedures[r].trajectories;
                let j = rng.random_range(0..trajectories.len());
                if j % t.hold_out == 0 {
                    continue;
                }
                let position = rng.random_range(0..trajectories[j].len() + t.hold_samples);
                let end = &tasks[k].end_poses[s];
                let here = pose_at(&trajectories[j], position as f64);
                // Both tasks may end in the same place.
                if !foreign || pose_distance(&here, end).0 > APART {
                    break (k, s, from, r, j, position);
                }
            };
            let poses = &sets[from].procedures[r].trajectories[j];
            (task[i], ids[i]) = (k, s);
            done[i] = from == k && position + t.window > ends[k][s][j];
            let jitter = if noise.time_jitter > 0.0 {
                1.0 + rng.random_range(-noise.time_jitter..noise.time_jitter)
            } else {
                1.0
            };
            let out = &mut histories[i * width..][..width];
            let normaliser = &tasks[k].normalisers[s];
            write_history(poses, normaliser, position as f64, jitter, &noise, &mut rng, out);
            // A stall on the way is not the end, and an end reached suddenly is one.
            if rng.random_bool(noise.padding) {
                let valid = rng.random_range(1..=policy.history);
                let (old, young) = out.split_at_mut((policy.history - valid) * POSE_DIM);
                old.chunks_exact_mut(POSE_DIM).for_each(|o| o.copy_from_slice(&young[..POSE_DIM]));
            }
        }
        let text = Texts { table: &table, task: &task };
        buffers.forward(&layout, &theta, &histories, &ids, text);
        let mut loss = 0.0f64;
        for (z, done) in buffers.logits.iter_mut().zip(&done) {
            let weight = if *done { t.positive_weight } else { 1.0 } / t.batch as f64;
            let (x, y) = (f64::from(*z), f64::from(u8::from(*done)));
            loss += weight * (x.max(0.0) - x * y + (-x.abs()).exp().ln_1p());
            *z = (weight * (1.0 / (1.0 + (-x).exp()) - y)) as f32;
        }
        if !loss.is_finite() {
            return Err(PolicyError::Diverged { step, what: "loss" });
        }
        grads.fill(0.0);
        buffers.backward(&layout, &theta, &ids, &mut grads);
        let x = step as f64 / t.steps as f64;
        let cosine = 0.02 + 0.98 * 0.5 * (1.0 + (std::f64::consts::PI * x).cos());
        let a = AdamW {
            lr: (t.learning_rate * cosine * (step as f64 / 20.0).min(1.0)) as f32,
            beta1: 0.9,
            beta2: 0.98,
            weight_decay: 1e-4,
            gradient_scale: 1.0,
            step: step as u32,
        };
        adamw(a, &mut theta, &grads, &mut m, &mut v);
    }
    let dt = sets.first().map_or(policy.dt, |s| s.dt);
    let mut trained = SwitchPolicy::of(layout, theta, &tasks, dt, Default::default())?;
    let mut reports = Vec::new();
    for set in sets {
        trained = trained.choose(&set.task)?;
        let report = evaluate(&mut trained, set, &noise, t)?;
        // The figures of a single task have plain names.
        let name = |what: &str| {
            if sets.len() == 1 { what.to_owned() } else { format!("{}/{what}", set.task) }
        };
        trained.metrics.insert(name("precision"), report.precision);
        trained.metrics.insert(name("recall"), report.recall);
        trained.metrics.insert(name("median_delay_s"), report.median_delay);
        trained.metrics.insert(name("max_distance_m"), report.max_distance);
        reports.push(report);
    }
    if let Some(first) = sets.first() {
        trained = trained.choose(&first.task)?;
    }
    Ok((trained, reports))
}

/// The sample from which on a trajectory stays within 1 mm and 0.5 degrees of its end; what comes
/// after it may be rest.
fn arrival(poses: &[Pose]) -> usize {
    let Some(end) = poses.last() else { return 0 };
    let away = poses.iter().rposition(|p| {
        let (d, a) = pose_distance(p, end);
        d > 0.001 || a > 0.5f64.to_radians()
    });
    away.map_or(0, |i| i + 1)
}

/// Runs the machine along the trajectories that were kept aside.
fn evaluate(
    policy: &mut SwitchPolicy,
    set: &TrainingSet,
    noise: &TrainConfig,
    t: &SwitchTrainConfig,
) -> Result<SwitchReport, PolicyError> {
    let mut rng = stream(t.seed ^ 0x7e57, Stream::Switch);
    let (mut hit, mut false_alarm, mut overlooked) = (0usize, 0usize, 0usize);
    let mut report = SwitchReport {
        trajectories: 0,
        precision: 0.0,
        recall: 0.0,
        missed: 0,
        premature: 0,
        median_delay: 0.0,
        delay_90: 0.0,
        max_distance: 0.0,
        max_rotation: 0.0,
    };
    let mut delays = Vec::new();
    let rest = (2.0 / set.dt).round() as usize;
    for (s, data) in set.procedures.iter().enumerate() {
        for poses in data.trajectories.iter().step_by(t.hold_out) {
            report.trajectories += 1;
            let end = arrival(poses);
            let mut core = SwitchCore::new(set.procedures.len(), SwitchConfig::default())?;
            core.start_at(s, Stamp(0));
            let mut history: VecDeque<_> = VecDeque::new();
            let mut fired = false;
            for i in 0..poses.len() + rest {
                let clean = pose_at(poses, i as f64);
                let seen = disturb(&clean, noise.noise_position, noise.noise_rotation, &mut rng);
                while history.len() < policy.history_len() {
                    history.push_back(seen);
                }
                history.pop_front();
                history.push_back(seen);
                let p = policy.probability(s, history.make_contiguous())?;
                let done = i + t.window > end;
                hit += usize::from(done && p > 0.5);
                false_alarm += usize::from(!done && p > 0.5);
                overlooked += usize::from(done && p <= 0.5);
                let state = core.step(Stamp::from_secs((i + 1) as f64 * set.dt), p, &seen);
                if state.switched && !fired {
                    fired = true;
                    delays.push((i as f64 - end as f64) * set.dt);
                    let (d, a) = pose_distance(&clean, &poses[poses.len() - 1]);
                    report.premature += usize::from(d > 0.015 || a > 10f64.to_radians());
                    report.max_distance = report.max_distance.max(d);
                    report.max_rotation = report.max_rotation.max(a);
                }
            }
            report.missed += usize::from(!fired);
        }
    }
    delays.sort_by(f64::total_cmp);
    report.median_delay = delays.get(delays.len() / 2).copied().unwrap_or(0.0);
    let ninth = (delays.len() * 9).div_ceil(10).saturating_sub(1);
    report.delay_90 = delays.get(ninth).copied().unwrap_or(0.0);
    report.precision = hit as f64 / (hit + false_alarm).max(1) as f64;
    report.recall = hit as f64 / (hit + overlooked).max(1) as f64;
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    /// Two goals 40 cm apart in one scene: what ends one task is no end of the other, and only the
    /// text says which one is on.
    #[test]
    fn one_classifier_for_two_tasks_goes_by_the_text() {
        let sets = synthetic::two_goal_sets(25, 3);
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let t = SwitchTrainConfig { steps: 300, ..SwitchTrainConfig::default() };
        let (policy, reports) =
            train_switch_tasks(&sets, &config, &TrainConfig::default(), &t).unwrap();
        println!("{reports:?}");
        assert!(reports.iter().all(|r| r.missed == 0 && r.recall > 0.9), "{reports:?}");
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("both.safetensors");
        policy.save(&path).unwrap();
        for (mine, other) in [(0, 1), (1, 0)] {
            let mut policy = SwitchPolicy::load_for(&path, &sets[mine].task, &["place"]).unwrap();
            let mut at_end = |set: &TrainingSet| {
                let end = set.procedures[0].trajectories[0].last().copied().unwrap();
                policy.probability(0, &vec![end; 8]).unwrap()
            };
            let (own, foreign) = (at_end(&sets[mine]), at_end(&sets[other]));
            assert!(own > 0.9 && foreign < 0.1, "{own} {foreign}");
        }
    }

    /// On two procedures with tracker noise: it fires on every unseen trajectory and near its end.
    #[test]
    fn learns_the_ends_of_two_procedures() {
        let set = synthetic::reach_and_place_set(25, 3);
        let config = PolicyConfig { dt: set.dt, ..PolicyConfig::small() };
        let t = SwitchTrainConfig { steps: 400, ..SwitchTrainConfig::default() };
        let (mut policy, report) =
            train_switch(&set, &config, &TrainConfig::default(), &t).unwrap();
        println!("{report:?}");
        assert_eq!(report.trajectories, 10);
        assert_eq!(report.missed, 0, "{report:?}");
        assert!(report.recall > 0.95, "{report:?}");
        assert!(report.max_distance < 0.03, "{report:?}");
        let start = vec![set.procedures[0].trajectories[0][0]; 8];
        assert!(policy.probability(0, &start).unwrap() < 0.1);
        assert!(matches!(
            policy.probability(2, &start),
            Err(PolicyError::UnknownProcedure { procedure: 2, count: 2 })
        ));
        assert!(report.median_delay <= report.delay_90 && report.delay_90 < 1.0, "{report:?}");
        let (again, _) = train_switch(&set, &config, &TrainConfig::default(), &t).unwrap();
        assert_eq!(again.weights, policy.weights);
    }
}
