use crate::PolicyError;
use serde::{Deserialize, Serialize};

/// What the network is trained to predict from a noisy trajectory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prediction {
    /// The clean trajectory. Measured best by far on nearly deterministic trajectories.
    #[default]
    Sample,
    /// The noise, the paper's form.
    Epsilon,
    /// `sqrt(ab) noise - sqrt(1 - ab) clean` (Salimans and Ho 2022).
    V,
}

/// How a trajectory is drawn from the trained network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampler {
    /// Ancestral sampling (Ho et al. 2020), random at every step.
    Ddpm,
    /// Deterministic given the first noise (Song et al. 2021, eta 0).
    #[default]
    Ddim,
}

/// The network and its diffusion. Poses are 9 numbers: xyz and the 6D rotation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyConfig {
    /// Poses of the past that the policy sees.
    pub history: usize,
    /// Poses that it predicts.
    pub horizon: usize,
    /// Seconds between poses.
    pub dt: f64,
    /// Width of the network, a multiple of 16.
    pub d_model: usize,
    /// Attention heads; `d_model / heads` is a multiple of 16.
    pub heads: usize,
    /// Blocks of the encoder of history, text and procedure.
    pub encoder_layers: usize,
    /// Blocks of the denoising decoder.
    pub decoder_layers: usize,
    /// What the network predicts.
    pub prediction: Prediction,
    /// Steps K of the diffusion in training (squared-cosine schedule).
    pub train_steps: usize,
    /// Steps of the sampler.
    pub inference_steps: usize,
    /// The sampler.
    pub sampler: Sampler,
    /// The sampler keeps every normalised number within 1 plus this.
    pub clip_margin: f64,
}

impl Default for PolicyConfig {
    fn default() -> Self {
        Self::small()
    }
}

impl PolicyConfig {
    /// 0.37 million weights: enough for one task, planned in about a millisecond.
    pub fn small() -> Self {
        Self {
            history: 8,
            horizon: 16,
            dt: 0.05,
            d_model: 64,
            heads: 2,
            encoder_layers: 2,
            decoder_layers: 3,
            prediction: Prediction::Sample,
            train_steps: 100,
            inference_steps: 10,
            sampler: Sampler::Ddim,
            clip_margin: 0.1,
        }
    }

    /// 1.7 million weights.
    pub fn base() -> Self {
        Self { d_model: 128, heads: 4, decoder_layers: 4, ..Self::small() }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`PolicyError::Config`] with all problems.
    pub fn validate(&self) -> Result<(), PolicyError> {
        let mut p = Vec::new();
        let mut range = |name: &str, value: usize, low: usize, high: usize| {
            if !(low..=high).contains(&value) {
                p.push(format!("{name} is {value}, must be {low}..={high}"));
            }
        };
        range("history", self.history, 1, 64);
        range("horizon", self.horizon, 1, 128);
        range("encoder_layers", self.encoder_layers, 1, 12);
        range("decoder_layers", self.decoder_layers, 1, 24);
        range("d_model", self.d_model, 16, 1024);
        range("heads", self.heads, 1, 64);
        range("train_steps", self.train_steps, 2, 10_000);
        if self.heads == 0
            || !self.d_model.is_multiple_of(self.heads)
            || !(self.d_model / self.heads).is_multiple_of(16)
        {
            p.push(format!(
                "d_model {} over {} heads must give heads whose width is a multiple of 16",
                self.d_model, self.heads
            ));
        }
        if self.inference_steps == 0 || self.inference_steps > self.train_steps {
            p.push(format!(
                "inference_steps is {}, must be 1..={} (train_steps)",
                self.inference_steps, self.train_steps
            ));
        }
        if !(self.dt.is_finite() && self.dt > 0.0 && self.dt <= 1.0) {
            p.push(format!("dt is {}, must be within 0..1 s", self.dt));
        }
        if !(0.0..=2.0).contains(&self.clip_margin) {
            p.push(format!("clip_margin is {}, must be 0..=2", self.clip_margin));
        }
        if p.is_empty() { Ok(()) } else { Err(PolicyError::Config { problems: p }) }
    }
}

/// How the policy is trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Optimiser steps.
    pub steps: usize,
    /// Windows per step.
    pub batch: usize,
    /// Highest learning rate; 1e-3 suits `d_model` 64, 5e-4 suits 128.
    pub learning_rate: f64,
    /// Steps of linear warm-up; a cosine down to 2 % follows.
    pub warm_up: usize,
    /// Decoupled weight decay, not on biases, embeddings and norms.
    pub weight_decay: f64,
    /// Largest norm of the gradient.
    pub clip: f64,
    /// Highest decay of the exponential moving average of the weights, which is what is deployed.
    pub ema: f64,
    /// Everything random follows from it.
    pub seed: u64,
    /// Samples of rest that follow each trajectory's end: where the policy learns to stop.
    pub hold_samples: usize,
    /// Tracker noise on every pose of a history, standard deviation (m).
    pub noise_position: f64,
    /// The same for rotation (rad).
    pub noise_rotation: f64,
    /// Offset common to a whole history (m): being off the path, which the target corrects.
    pub drift_position: f64,
    /// The same for rotation (rad).
    pub drift_rotation: f64,
    /// Largest shift of a window between samples, and relative error of the history's spacing.
    pub time_jitter: f64,
    /// Part of the histories whose older poses repeat a younger one: a start, or a stall on the way.
    pub padding: f64,
    /// Chance of each pose of a history but the newest to be missing; what the history buffer makes of
    /// its neighbours stands there then.
    pub missing: f64,
    /// A history that moved less than this (m, rotations at a radius of 0.1 m) counts as rest, and the
    /// plan then begins where the trajectory is this far away: plans leave a standstill. 0 for off.
    pub leave: f64,
    /// Weight of the position errors against the rotation errors: with 1 the rotation is learned long
    /// before the last centimetre (measured after 300 steps: 10 mm and 0.6 degrees, with 4 2.5 mm and
    /// 0.3).
    pub position_weight: f64,
    /// Weight of the rotation errors.
    pub rotation_weight: f64,
    /// Threads; the result does not depend on it (at most 2 are used).
    pub threads: usize,
    /// Steps between rollouts on unseen starts; 0 for none.
    pub evaluate_every: usize,
    /// Stop after two good rollout evaluations in a row.
    pub early_stop: bool,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            steps: 600,
            batch: 128,
            learning_rate: 1e-3,
            warm_up: 50,
            weight_decay: 1e-4,
            clip: 1.0,
            ema: 0.999,
            seed: 0,
            hold_samples: 10,
            noise_position: 0.002,
            noise_rotation: 0.0175,
            drift_position: 0.004,
            drift_rotation: 0.035,
            time_jitter: 0.3,
            padding: 0.2,
            missing: 0.05,
            leave: 0.003,
            position_weight: 4.0,
            rotation_weight: 1.0,
            threads: 2,
            evaluate_every: 0,
            early_stop: false,
        }
    }
}

impl TrainConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// [`PolicyError::Config`] with all problems.
    pub fn validate(&self) -> Result<(), PolicyError> {
        let mut p = Vec::new();
        for (name, v, low, high) in [
            ("steps", self.steps, 1, 10_000_000),
            ("batch", self.batch, 1, 65_536),
            ("threads", self.threads, 1, 1024),
            ("hold_samples", self.hold_samples, 0, 1000),
        ] {
            if !(low..=high).contains(&v) {
                p.push(format!("{name} is {v}, must be {low}..={high}"));
            }
        }
        for (name, v, low, high) in [
            ("learning_rate", self.learning_rate, 1e-8, 1.0),
            ("weight_decay", self.weight_decay, 0.0, 1.0),
            ("clip", self.clip, 1e-6, 1e6),
            ("ema", self.ema, 0.0, 0.999_999),
            ("noise_position", self.noise_position, 0.0, 0.1),
            ("noise_rotation", self.noise_rotation, 0.0, 0.5),
            ("drift_position", self.drift_position, 0.0, 0.2),
            ("drift_rotation", self.drift_rotation, 0.0, 1.0),
            ("time_jitter", self.time_jitter, 0.0, 0.9),
            ("padding", self.padding, 0.0, 1.0),
            ("missing", self.missing, 0.0, 0.9),
            ("leave", self.leave, 0.0, 0.1),
            ("position_weight", self.position_weight, 1e-3, 1e3),
            ("rotation_weight", self.rotation_weight, 1e-3, 1e3),
        ] {
            if !(low..=high).contains(&v) {
                p.push(format!("{name} is {v}, must be {low}..={high}"));
            }
        }
        if self.early_stop && self.evaluate_every == 0 {
            p.push("early_stop is on, but evaluate_every is 0: nothing would stop it".into());
        }
        if p.is_empty() { Ok(()) } else { Err(PolicyError::Config { problems: p }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_problems_are_all_named() {
        PolicyConfig::small().validate().unwrap();
        PolicyConfig::base().validate().unwrap();
        TrainConfig::default().validate().unwrap();
        let bad =
            PolicyConfig { heads: 3, inference_steps: 101, dt: f64::NAN, ..Default::default() };
        let text = bad.validate().unwrap_err().to_string();
        for word in ["heads", "inference_steps is 101", "dt is NaN"] {
            assert!(text.contains(word), "{text}");
        }
        assert!(TrainConfig { clip: f64::NAN, ..Default::default() }.validate().is_err());
        assert!(serde_json::from_str::<PolicyConfig>(r#"{"d_modle": 3}"#).is_err());
    }
}
