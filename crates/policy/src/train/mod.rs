//! Training of the trajectory policy.

use crate::kernels::{AdamW, adamw, add, squared_norm};
use crate::network::{Architecture, Batch, Dimensions, Workspace};
use crate::normaliser::POSE_DIM;
use crate::planner::{Planner, PlannerConfig};
use crate::rng::{Stream, stream};
use crate::rollout::{RolloutConfig, RolloutReport, RolloutTrial, evaluate};
use crate::samples::Windows;
use crate::{
    Normaliser, PolicyConfig, PolicyError, Prediction, Schedule, TrainConfig, TrainedPolicy,
    TrainingSet,
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::time::Instant;

/// Samples that go through the network at once: few, so that they stay in the cache.
const MICRO_BATCH: usize = 16;
/// The batch is always split into this many parts, whatever the number of threads, so that the
/// gradient's sum has one order.
const LANES: usize = 2;

/// Said after every step.
#[derive(Debug, Clone)]
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
    /// Mean wall time of a step so far (ms).
    pub step_ms: f64,
    /// Expected time to the end (s).
    pub eta: f64,
    /// Closed-loop result on unseen starts, when this step was one to evaluate.
    pub rollout: Option<RolloutReport>,
}

/// One of the batch's parts: own buffers, own gradient.
struct Lane {
    workspace: Workspace,
    grads: Vec<f32>,
    loss: f64,
}

struct Samples {
    history: Vec<f32>,
    clean: Vec<f32>,
    noise: Vec<f32>,
    noisy: Vec<f32>,
    target: Vec<f32>,
    procedure: Vec<usize>,
    step: Vec<usize>,
}

/// Draws a step's samples; every random number comes from here, on one thread.
struct Drawer<'a> {
    windows: Windows<'a>,
    schedule: &'a Schedule,
    prediction: Prediction,
    batch_rng: ChaCha8Rng,
    augmentation_rng: ChaCha8Rng,
    noise_rng: ChaCha8Rng,
}

impl Drawer<'_> {
    fn draw(&mut self, s: &mut Samples) {
        let count = s.procedure.len();
        let (h, f) = (s.history.len() / count, s.clean.len() / count);
        for v in &mut s.noise {
            *v = self.noise_rng.sample(StandardNormal);
        }
        for i in 0..count {
            let at = self.windows.draw(&mut self.batch_rng);
            s.procedure[i] = at.0;
            let clean = &mut s.clean[i * f..][..f];
            self.windows.write(at, &mut self.augmentation_rng, &mut s.history[i * h..][..h], clean);
            let k = self.noise_rng.random_range(0..self.schedule.len());
            s.step[i] = k;
            let noise = &s.noise[i * f..][..f];
            self.schedule.add_noise(k, clean, noise, &mut s.noisy[i * f..][..f]);
            self.schedule.target(self.prediction, k, clean, noise, &mut s.target[i * f..][..f]);
        }
    }
}

/// Everything fixed during a step, shared by the lanes.
struct Pass<'a> {
    architecture: &'a Architecture,
    theta: &'a [f32],
    samples: &'a Samples,
    text: Option<&'a [f32]>,
    weights: [f32; POSE_DIM],
}

impl Pass<'_> {
    /// Gradient and loss of samples `from..to`.
    fn run(&self, lane: &mut Lane, from: usize, to: usize) {
        let c = &self.architecture.config;
        let (h, f) = (c.history * POSE_DIM, c.horizon * POSE_DIM);
        lane.grads.fill(0.0);
        lane.loss = 0.0;
        let mut at = from;
        while at < to {
            let n = MICRO_BATCH.min(to - at);
            let s = self.samples;
            let batch = Batch {
                len: n,
                history: &s.history[at * h..][..n * h],
                procedure: &s.procedure[at..at + n],
                noisy: &s.noisy[at * f..][..n * f],
                step: &s.step[at..at + n],
                text: self.text,
            };
            lane.workspace.forward(self.architecture, self.theta, &batch);
            lane.loss += lane.workspace.backward(
                self.architecture,
                self.theta,
                &batch,
                &s.target[at * f..][..n * f],
                &self.weights,
                &mut lane.grads,
            );
            at += n;
        }
    }
}

fn learning_rate(t: &TrainConfig, step: usize) -> f64 {
    if step <= t.warm_up {
        return t.learning_rate * step as f64 / t.warm_up.max(1) as f64;
    }
    let x = (step - t.warm_up) as f64 / (t.steps.saturating_sub(t.warm_up)).max(1) as f64;
    t.learning_rate * (0.02 + 0.98 * 0.5 * (1.0 + (std::f64::consts::PI * x.min(1.0)).cos()))
}

/// Weights of the squared errors, so that their mean over the pose's numbers is weighted 1.
fn loss_weights(t: &TrainConfig, samples: usize) -> [f32; POSE_DIM] {
    let raw: [f64; POSE_DIM] =
        std::array::from_fn(|c| if c < 3 { t.position_weight } else { t.rotation_weight });
    let total: f64 = raw.iter().sum();
    raw.map(|w| (w / total / samples as f64) as f32)
}

/// Moves every tenth trajectory (at most 20 of a procedure) out of the set, for rollouts.
fn hold_out(set: &TrainingSet) -> (TrainingSet, Vec<RolloutTrial>) {
    let mut kept = set.clone();
    let mut trials = Vec::new();
    for (procedure, p) in kept.procedures.iter_mut().enumerate() {
        let n = (p.trajectories.len() / 10).min(20);
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
    t.validate()?;
    set.validate(policy)?;
    let dimensions = Dimensions {
        procedures: set.procedures.len(),
        text: set.text_embedding.as_ref().map_or(0, Vec::len),
    };
    let architecture = Architecture::new(policy, dimensions)?;
    let normalisers = set.normalisers()?;
    let (set_kept, trials) =
        if t.evaluate_every > 0 { hold_out(set) } else { (set.clone(), Vec::new()) };
    let mut run = Run::new(&architecture, &set_kept, t);
    let schedule = Schedule::squared_cosine(policy.train_steps);
    let mut drawer = Drawer {
        windows: Windows::new(&set_kept, &normalisers, policy, t),
        schedule: &schedule,
        prediction: policy.prediction,
        batch_rng: stream(t.seed, Stream::Batch),
        augmentation_rng: stream(t.seed, Stream::Augmentation),
        noise_rng: stream(t.seed, Stream::Noise),
    };
    let begin = Instant::now();
    let mut loss = 0.0;
    let (mut good, mut last_rollout, mut steps) = (0, None, 0);
    for step in 1..=t.steps {
        drawer.draw(&mut run.samples);
        let lr = learning_rate(t, step);
        let (step_loss, norm) = run.step(step, lr)?;
        steps = step;
        loss = if step == 1 { step_loss } else { 0.98 * loss + 0.02 * step_loss };
        let mut rollout = None;
        if t.evaluate_every > 0 && !trials.is_empty() && step % t.evaluate_every == 0 {
            let candidate = run.policy(set, &normalisers, t, step, loss);
            let mut planner = Planner::new(&candidate, PlannerConfig::default())?;
            let report = evaluate(&mut planner, &trials, &RolloutConfig::default(), t.seed)?;
            let fine = report.success_rate() >= 0.99 && report.median_position < 0.0025;
            good = if fine { good + 1 } else { 0 };
            last_rollout = Some(report.clone());
            rollout = Some(report);
        }
        let step_ms = begin.elapsed().as_secs_f64() * 1e3 / step as f64;
        progress(&TrainProgress {
            step,
            steps: t.steps,
            loss: step_loss,
            learning_rate: lr,
            gradient_norm: norm,
            step_ms,
            eta: step_ms * 1e-3 * (t.steps - step) as f64,
            rollout,
        });
        if t.early_stop && good >= 2 {
            break;
        }
    }
    let mut trained = run.policy(set, &normalisers, t, steps, loss);
    if let Some(r) = last_rollout {
        trained.metrics.insert("rollout_success".into(), r.success_rate());
        trained.metrics.insert("rollout_median_position_m".into(), r.median_position);
    }
    Ok(trained)
}

/// Weights, optimiser and buffers of a run.
struct Run<'a> {
    architecture: &'a Architecture,
    t: &'a TrainConfig,
    text: Option<Vec<f32>>,
    samples: Samples,
    lanes: Vec<Lane>,
    theta: Vec<f32>,
    ema: Vec<f32>,
    m: Vec<f32>,
    v: Vec<f32>,
}

impl<'a> Run<'a> {
    fn new(architecture: &'a Architecture, set: &TrainingSet, t: &'a TrainConfig) -> Self {
        let (c, n) = (&architecture.config, t.batch);
        let (h, f) = (c.history * POSE_DIM, c.horizon * POSE_DIM);
        let zeros = |k: usize| vec![0.0f32; n * k];
        let theta = architecture.initial(t.seed);
        Self {
            architecture,
            t,
            text: set.text_embedding.clone(),
            samples: Samples {
                history: zeros(h),
                clean: zeros(f),
                noise: zeros(f),
                noisy: zeros(f),
                target: zeros(f),
                procedure: vec![0; n],
                step: vec![0; n],
            },
            lanes: (0..LANES)
                .map(|_| Lane {
                    workspace: Workspace::new(architecture, MICRO_BATCH),
                    grads: vec![0.0; architecture.len()],
                    loss: 0.0,
                })
                .collect(),
            ema: theta.clone(),
            m: vec![0.0; theta.len()],
            v: vec![0.0; theta.len()],
            theta,
        }
    }

    /// One optimiser step; loss and gradient norm.
    fn step(&mut self, step: usize, lr: f64) -> Result<(f64, f64), PolicyError> {
        let t = self.t;
        let pass = Pass {
            architecture: self.architecture,
            theta: &self.theta,
            samples: &self.samples,
            text: self.text.as_deref(),
            weights: loss_weights(t, t.batch * self.architecture.config.horizon),
        };
        let (middle, end) = (t.batch.div_ceil(LANES), t.batch);
        let (first, second) = self.lanes.split_at_mut(1);
        let (first, second) = (&mut first[0], &mut second[0]);
        if t.threads > 1 {
            std::thread::scope(|scope| {
                scope.spawn(|| pass.run(second, middle, end));
                pass.run(first, 0, middle);
            });
        } else {
            pass.run(first, 0, middle);
            pass.run(second, middle, end);
        }
        add(&second.grads, &mut first.grads);
        let loss = first.loss + second.loss;
        let grads = &first.grads;
        let norm = squared_norm(grads).sqrt();
        for (value, what) in [(loss, "loss"), (norm, "gradient")] {
            if !value.is_finite() {
                return Err(PolicyError::Diverged { step, what });
            }
        }
        let mut a = AdamW {
            lr: lr as f32,
            beta1: 0.9,
            beta2: 0.98,
            weight_decay: 0.0,
            gradient_scale: (t.clip / norm).min(1.0) as f32,
            step: step as u32,
        };
        for p in self.architecture.parameters() {
            a.weight_decay = if p.decay { t.weight_decay as f32 } else { 0.0 };
            adamw(
                a,
                p.slot.of_mut(&mut self.theta),
                p.slot.of(grads),
                p.slot.of_mut(&mut self.m),
                p.slot.of_mut(&mut self.v),
            );
        }
        let decay = t.ema.min(1.0 - (1.0 + step as f64).powf(-0.75)) as f32;
        for (e, p) in self.ema.iter_mut().zip(&self.theta) {
            *e = decay * *e + (1.0 - decay) * p;
        }
        Ok((loss, norm))
    }

    fn policy(
        &self,
        set: &TrainingSet,
        normalisers: &[Normaliser],
        t: &TrainConfig,
        step: usize,
        loss: f64,
    ) -> TrainedPolicy {
        TrainedPolicy {
            architecture: self.architecture.clone(),
            weights: self.ema.clone(),
            normalisers: normalisers.to_vec(),
            task: set.task.clone(),
            text: set.text.clone(),
            text_embedding: set.text_embedding.clone(),
            procedures: set.procedures.iter().map(|p| p.name.clone()).collect(),
            end_poses: set.end_poses(),
            dataset_hash: set.dataset_hash.clone(),
            seed: t.seed,
            steps: step,
            metrics: [("loss".to_string(), loss)].into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

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
    fn schedule_of_the_learning_rate() {
        let t = TrainConfig { steps: 100, warm_up: 10, learning_rate: 1.0, ..Default::default() };
        assert!((learning_rate(&t, 5) - 0.5).abs() < 1e-12);
        assert!((learning_rate(&t, 10) - 1.0).abs() < 1e-12);
        assert!((learning_rate(&t, 100) - 0.02).abs() < 1e-12);
        let w = loss_weights(&t, 4);
        assert!((w.iter().sum::<f32>() * 4.0 - 1.0).abs() < 1e-6);
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
