//! A variant of the switch net for comparison: instead of "done or not" it tells which share of the way
//! (SE(3) arc) a procedure has come, and a threshold on that ends it.

use super::SwitchTrainConfig;
use super::policy::{SwitchBuffers, SwitchLayout, SwitchPolicy, Texts};
use crate::kernels::{AdamW, adamw};
use crate::network::initial;
use crate::normaliser::POSE_DIM;
use crate::rng::{Stream, stream};
use crate::samples::write_history;
use crate::tasks::LearnedTask;
use crate::{PolicyConfig, PolicyError, TrainConfig, TrainingSet};
use rand::Rng;
use tdv_geometry::{Pose, twist_arc};

/// Radius (m) at which a rotation counts as a way.
const LEVER: f64 = 0.1;

/// Trains the head: [`SwitchPolicy::probability`] then tells the share of the way instead of a
/// probability. Data, disturbances and optimiser are those of [`super::train_switch`]; the loss is the
/// cross entropy with the share as its soft label.
///
/// # Errors
/// [`PolicyError::Config`], [`PolicyError::Data`], [`PolicyError::Diverged`].
pub fn train_progress(
    set: &TrainingSet,
    policy: &PolicyConfig,
    noise: &TrainConfig,
    t: &SwitchTrainConfig,
) -> Result<SwitchPolicy, PolicyError> {
    t.validate()?;
    noise.validate()?;
    policy.validate()?;
    set.validate(policy)?;
    let normalisers = set.normalisers()?;
    let shares: Vec<Vec<Vec<f64>>> =
        set.procedures.iter().map(|p| p.trajectories.iter().map(|t| shares(t)).collect()).collect();
    let text = set.text_embedding.as_deref().unwrap_or_default();
    let layout = SwitchLayout::new(policy.history, text.len(), normalisers.len());
    let mut rng = stream(t.seed, Stream::Switch);
    let mut theta = initial(&layout.parameters, layout.len, rng.clone());
    let (mut m, mut v) = (vec![0.0; layout.len], vec![0.0; layout.len]);
    let mut grads = vec![0.0; layout.len];
    let mut buffers = SwitchBuffers::new(&layout, t.batch);
    let width = policy.history * POSE_DIM;
    let mut histories = vec![0.0; t.batch * width];
    let tasks = vec![0; t.batch];
    let (mut ids, mut labels) = (vec![0; t.batch], vec![0.0f64; t.batch]);
    let noise = TrainConfig { drift_position: 0.0, drift_rotation: 0.0, ..noise.clone() };
    for step in 1..=t.steps {
        for i in 0..t.batch {
            let s = rng.random_range(0..set.procedures.len());
            let trajectories = &set.procedures[s].trajectories;
            let j = rng.random_range(0..trajectories.len());
            let position = rng.random_range(0..trajectories[j].len() + t.hold_samples);
            ids[i] = s;
            labels[i] = shares[s][j].get(position).copied().unwrap_or(1.0);
            let jitter = 1.0 + noise.time_jitter * rng.random_range(-1.0..1.0);
            let out = &mut histories[i * width..][..width];
            let at = position as f64;
            write_history(&trajectories[j], &normalisers[s], at, jitter, &noise, &mut rng, out);
        }
        buffers.forward(&layout, &theta, &histories, &ids, Texts { table: text, task: &tasks });
        let mut loss = 0.0f64;
        for (z, y) in buffers.logits.iter_mut().zip(&labels) {
            let x = f64::from(*z);
            loss += (x.max(0.0) - x * y + (-x.abs()).exp().ln_1p()) / t.batch as f64;
            *z = ((1.0 / (1.0 + (-x).exp()) - y) / t.batch as f64) as f32;
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
    SwitchPolicy::of(layout, theta, &[LearnedTask::of(set)?], set.dt, Default::default())
}

/// Share of the way at every pose; 1 where nothing moves.
fn shares(poses: &[Pose]) -> Vec<f64> {
    let mut arc = vec![0.0];
    for w in poses.windows(2) {
        arc.push(arc.last().copied().unwrap_or(0.0) + twist_arc(&w[0], &w[1], LEVER));
    }
    let total = arc.last().copied().unwrap_or(0.0);
    arc.iter().map(|s| if total > 1e-9 { s / total } else { 1.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    /// On trajectories that it has not seen, without noise.
    #[test]
    fn tells_the_share_of_the_way() {
        let set = synthetic::reach_and_place_set(25, 3);
        let config = PolicyConfig { dt: set.dt, history: 1, ..PolicyConfig::small() };
        let t = SwitchTrainConfig { steps: 400, ..SwitchTrainConfig::default() };
        let mut head = train_progress(&set, &config, &TrainConfig::default(), &t).unwrap();
        let unseen = synthetic::reach_and_place_set(5, 77);
        let (mut error, mut count, mut told_at) = (0.0, 0, [0.0; 3]);
        for (s, p) in unseen.procedures.iter().enumerate() {
            for poses in &p.trajectories {
                for (pose, share) in poses.iter().zip(&shares(poses)) {
                    let told = head.probability(s, &[*pose]).unwrap();
                    error += (f64::from(told) - share).abs();
                    count += 1;
                }
                let last = poses.len() - 1;
                for (sum, at) in told_at.iter_mut().zip([0, last / 2, last]) {
                    *sum += head.probability(s, &poses[at..=at]).unwrap() / 10.0;
                }
                let end = head.probability(s, &poses[last..]).unwrap();
                assert!(end > 0.93, "{end}");
            }
        }
        // One pose alone does not tell how far away the start was.
        let mean = error / f64::from(count);
        println!("mean error {mean}, start, middle, end {told_at:?}");
        assert!(mean < 0.15 && told_at[0] < 0.4, "{mean} {told_at:?}");
        assert!(told_at[0] + 0.2 < told_at[1] && told_at[1] + 0.1 < told_at[2], "{told_at:?}");
    }
}
