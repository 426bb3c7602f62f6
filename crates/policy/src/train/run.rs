//! The optimiser's side of a training: weights, moments, average, and the passes over a batch.

use super::draw::Samples;
use crate::kernels::{AdamW, adamw, add, squared_norm};
use crate::network::{Architecture, Batch, Workspace};
use crate::normaliser::POSE_DIM;
use crate::tasks::LearnedTask;
use crate::{PolicyError, TrainConfig};

/// Samples that go through the network at once: few, so that they stay in the cache.
const MICRO_BATCH: usize = 16;
/// The batch is always split into this many parts, whatever the number of threads, so that the
/// gradient's sum has one order.
const LANES: usize = 2;

/// One of the batch's parts: own buffers, own gradient.
struct Lane {
    workspace: Workspace,
    grads: Vec<f32>,
    loss: f64,
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
                task: &s.task[at..at + n],
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

/// Weights of the squared errors, so that their mean over the pose's numbers is weighted 1.
pub(super) fn loss_weights(t: &TrainConfig, samples: usize) -> [f32; POSE_DIM] {
    let raw: [f64; POSE_DIM] =
        std::array::from_fn(|c| if c < 3 { t.position_weight } else { t.rotation_weight });
    let total: f64 = raw.iter().sum();
    raw.map(|w| (w / total / samples as f64) as f32)
}

/// Weights, optimiser and buffers of a run.
pub(super) struct Run {
    /// Embeddings of the tasks, one after the other.
    text: Option<Vec<f32>>,
    pub samples: Samples,
    lanes: Vec<Lane>,
    pub theta: Vec<f32>,
    pub ema: Vec<f32>,
    pub m: Vec<f32>,
    pub v: Vec<f32>,
}

impl Run {
    pub fn new(architecture: &Architecture, tasks: &[LearnedTask], t: &TrainConfig) -> Self {
        let theta = architecture.initial(t.seed);
        let text: Vec<f32> =
            tasks.iter().filter_map(|t| t.text_embedding.as_deref()).flatten().copied().collect();
        Self {
            text: (!text.is_empty()).then_some(text),
            samples: Samples::new(&architecture.config, t.batch),
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
    pub fn step(
        &mut self,
        architecture: &Architecture,
        t: &TrainConfig,
        step: usize,
        lr: f64,
    ) -> Result<(f64, f64), PolicyError> {
        let pass = Pass {
            architecture,
            theta: &self.theta,
            samples: &self.samples,
            text: self.text.as_deref(),
            weights: loss_weights(t, t.batch * architecture.config.horizon),
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
        for p in architecture.parameters() {
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
}
