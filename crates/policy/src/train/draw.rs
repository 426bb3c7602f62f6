//! What a step is trained on: every random number of a training comes from here, on one thread.

use crate::normaliser::POSE_DIM;
use crate::rng::{Stream, stream};
use crate::samples::Windows;
use crate::tasks::LearnedTask;
use crate::{PolicyConfig, Prediction, Schedule, TrainConfig, TrainingSet};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A batch.
pub(super) struct Samples {
    pub history: Vec<f32>,
    clean: Vec<f32>,
    noise: Vec<f32>,
    pub noisy: Vec<f32>,
    pub target: Vec<f32>,
    pub task: Vec<usize>,
    pub procedure: Vec<usize>,
    pub step: Vec<usize>,
}

impl Samples {
    pub fn new(c: &PolicyConfig, count: usize) -> Self {
        let (h, f) = (c.history * POSE_DIM, c.horizon * POSE_DIM);
        let zeros = |k: usize| vec![0.0f32; count * k];
        Self {
            history: zeros(h),
            clean: zeros(f),
            noise: zeros(f),
            noisy: zeros(f),
            target: zeros(f),
            task: vec![0; count],
            procedure: vec![0; count],
            step: vec![0; count],
        }
    }
}

/// Draws a step's samples.
pub(super) struct Drawer {
    windows: Windows,
    schedule: Schedule,
    prediction: Prediction,
    batch_rng: ChaCha8Rng,
    augmentation_rng: ChaCha8Rng,
    noise_rng: ChaCha8Rng,
}

impl Drawer {
    pub fn new(
        sets: Vec<TrainingSet>,
        tasks: &[LearnedTask],
        policy: &PolicyConfig,
        t: &TrainConfig,
    ) -> Self {
        let normalisers = tasks.iter().map(|t| t.normalisers.clone()).collect();
        Self {
            windows: Windows::new(sets, normalisers, policy, t),
            schedule: Schedule::squared_cosine(policy.train_steps),
            prediction: policy.prediction,
            batch_rng: stream(t.seed, Stream::Batch),
            augmentation_rng: stream(t.seed, Stream::Augmentation),
            noise_rng: stream(t.seed, Stream::Noise),
        }
    }

    /// How far each stream has been read: all that a training must remember of its draws.
    pub fn positions(&self) -> [u128; 3] {
        [&self.batch_rng, &self.augmentation_rng, &self.noise_rng].map(ChaCha8Rng::get_word_pos)
    }

    /// Goes on from positions that were remembered.
    pub fn seek(&mut self, positions: [u128; 3]) {
        self.batch_rng.set_word_pos(positions[0]);
        self.augmentation_rng.set_word_pos(positions[1]);
        self.noise_rng.set_word_pos(positions[2]);
    }

    pub fn draw(&mut self, s: &mut Samples) {
        let count = s.procedure.len();
        let (h, f) = (s.history.len() / count, s.clean.len() / count);
        for v in &mut s.noise {
            *v = self.noise_rng.sample(StandardNormal);
        }
        for i in 0..count {
            let at = self.windows.draw(&mut self.batch_rng);
            (s.task[i], s.procedure[i]) = (at.task, at.procedure);
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
