//! Planning: from a history of poses to the poses that shall come.

mod inference;
mod packed;

use crate::normaliser::{POSE_DIM, finite};
use crate::rng::{Stream, stream};
use crate::{Normaliser, PolicyError, Sampler, SamplingPlan, Schedule, TrainedPolicy};
use inference::Inference;
use rand::Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, interpolate};

/// Settings of a planner; what is absent is taken from the policy's own configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlannerConfig {
    /// Steps of the sampler.
    pub inference_steps: Option<usize>,
    /// The sampler.
    pub sampler: Option<Sampler>,
    /// Steps of [`Planner::plan_from`], which starts from the plan before.
    pub warm_steps: usize,
    /// Diffusion step to which [`Planner::plan_from`] noises the plan before.
    pub warm_level: usize,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self { inference_steps: None, sampler: None, warm_steps: 4, warm_level: 40 }
    }
}

/// The policy ready to plan, on plain slices with everything allocated beforehand.
pub struct Planner {
    inference: Inference,
    normalisers: Vec<Normaliser>,
    end_poses: Vec<Pose>,
    names: Vec<String>,
    history: usize,
    horizon: usize,
    dt: f64,
    schedule: Schedule,
    cold: SamplingPlan,
    warm: SamplingPlan,
    warm_level: usize,
    encoded: Vec<f32>,
    x: Vec<f32>,
    /// The encoder runs once per plan.
    cached: bool,
}

impl Planner {
    /// Prepares a policy.
    ///
    /// # Errors
    /// [`PolicyError::InferenceSteps`], [`PolicyError::Config`] for a warm start beyond the schedule.
    pub fn new(policy: &TrainedPolicy, config: PlannerConfig) -> Result<Self, PolicyError> {
        let c = &policy.architecture.config;
        let schedule = Schedule::squared_cosine(c.train_steps);
        let clip = 1.0 + c.clip_margin;
        let sampler = config.sampler.unwrap_or(c.sampler);
        let count = config.inference_steps.unwrap_or(c.inference_steps);
        let cold = schedule.plan(sampler, c.prediction, count, clip)?;
        if config.warm_level >= c.train_steps
            || config.warm_steps == 0
            || config.warm_steps > config.warm_level + 1
        {
            return Err(PolicyError::Config {
                problems: vec![format!(
                    "warm start with {} steps from level {}: the level must be below {} and at \
                     least as large as the number of steps",
                    config.warm_steps, config.warm_level, c.train_steps
                )],
            });
        }
        let warm =
            schedule.plan_below(sampler, c.prediction, config.warm_steps, config.warm_level, clip);
        Ok(Self {
            inference: Inference::new(
                &policy.architecture,
                &policy.weights,
                policy.text_embedding.as_deref(),
            ),
            normalisers: policy.normalisers.clone(),
            end_poses: policy.end_poses.clone(),
            names: policy.procedures.clone(),
            history: c.history,
            horizon: c.horizon,
            dt: c.dt,
            schedule,
            cold,
            warm,
            warm_level: config.warm_level,
            encoded: vec![0.0; c.history * POSE_DIM],
            x: vec![0.0; c.horizon * POSE_DIM],
            cached: true,
        })
    }

    /// Off: the encoder runs again at every step of the sampler, as a network without the cache would.
    /// The plans are the same to the bit; only for measuring what the cache saves.
    pub fn set_encoder_cache(&mut self, on: bool) {
        self.cached = on;
    }

    /// Names of the procedures, in their order.
    pub fn procedures(&self) -> &[String] {
        &self.names
    }

    /// Poses that a history must have.
    pub fn history_len(&self) -> usize {
        self.history
    }

    /// Poses of a plan.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Seconds between poses, of histories and of plans.
    pub fn dt(&self) -> f64 {
        self.dt
    }

    /// Where a procedure's demonstrations end, `T_reference_moving`.
    pub fn end_pose(&self, procedure: usize) -> Option<&Pose> {
        self.end_poses.get(procedure)
    }

    /// The poses `T_reference_moving` that shall follow, the first one `dt` after the last of the
    /// history (oldest first, `dt` apart). Equal arguments give equal bytes; keep the seed over a run
    /// and successive plans vary only as the history does.
    ///
    /// # Errors
    /// [`PolicyError::UnknownProcedure`], [`PolicyError::HistoryLength`], [`PolicyError::NotFinite`].
    pub fn plan(
        &mut self,
        procedure: usize,
        history: &[Pose],
        seed: u64,
    ) -> Result<Vec<Pose>, PolicyError> {
        self.check(procedure, history)?;
        let mut rng = stream(seed, Stream::Sampler);
        self.x.iter_mut().for_each(|v| *v = rng.sample(StandardNormal));
        self.sample(procedure, false, &mut rng)
    }

    /// As [`Planner::plan`], but starting from the plan before, which was made `elapsed` seconds
    /// ago: fewer steps, and plans that hang together.
    ///
    /// # Errors
    /// As [`Planner::plan`]; an empty `previous` is planned from noise.
    pub fn plan_from(
        &mut self,
        procedure: usize,
        history: &[Pose],
        previous: &[Pose],
        elapsed: f64,
        seed: u64,
    ) -> Result<Vec<Pose>, PolicyError> {
        let Some(last) = previous.len().checked_sub(1) else {
            return self.plan(procedure, history, seed);
        };
        self.check(procedure, history)?;
        if !elapsed.is_finite() {
            return Err(PolicyError::NotFinite { what: "time since the previous plan".into() });
        }
        let mut rng = stream(seed, Stream::Sampler);
        let ab = self.schedule.alpha_bar(self.warm_level);
        let (keep, spread) = (ab.sqrt() as f32, (1.0 - ab).sqrt() as f32);
        for (i, x) in self.x.chunks_exact_mut(POSE_DIM).enumerate() {
            let t = (i as f64 + elapsed / self.dt).clamp(0.0, last as f64);
            let j = (t.floor() as usize).min(last);
            let pose = interpolate(&previous[j], &previous[(j + 1).min(last)], t - j as f64);
            finite(&pose, || format!("pose {j} of the previous plan"))?;
            for (x, v) in x.iter_mut().zip(self.normalisers[procedure].encode(&pose)) {
                *x = keep * v + spread * rng.sample::<f32, _>(StandardNormal);
            }
        }
        self.sample(procedure, true, &mut rng)
    }

    fn check(&mut self, procedure: usize, history: &[Pose]) -> Result<(), PolicyError> {
        let count = self.normalisers.len();
        let Some(normaliser) = self.normalisers.get(procedure) else {
            return Err(PolicyError::UnknownProcedure { procedure, count });
        };
        if history.len() != self.history {
            return Err(PolicyError::HistoryLength { have: history.len(), need: self.history });
        }
        for (i, (pose, out)) in
            history.iter().zip(self.encoded.chunks_exact_mut(POSE_DIM)).enumerate()
        {
            finite(pose, || format!("pose {i} of the history"))?;
            out.copy_from_slice(&normaliser.encode(pose));
        }
        Ok(())
    }

    fn sample(
        &mut self,
        procedure: usize,
        warm: bool,
        rng: &mut impl Rng,
    ) -> Result<Vec<Pose>, PolicyError> {
        let plan = if warm { &self.warm } else { &self.cold };
        let steps: Vec<usize> = plan.steps.iter().map(|s| s.k).collect();
        self.inference.prepare(&self.encoded, procedure, &steps);
        for (i, step) in plan.steps.iter().enumerate() {
            if !self.cached && i > 0 {
                self.inference.prepare(&self.encoded, procedure, &steps);
            }
            self.inference.denoise(i, &self.x);
            plan.advance(step, &mut self.x, &self.inference.result, || rng.sample(StandardNormal));
        }
        if self.x.iter().any(|v| !v.is_finite()) {
            return Err(PolicyError::NotFinite { what: "the network's output".into() });
        }
        let normaliser = &self.normalisers[procedure];
        let (poses, _) = self.x.as_chunks::<POSE_DIM>();
        Ok(poses.iter().map(|v| normaliser.decode(v)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PolicyConfig, synthetic};

    #[test]
    fn the_encoder_cache_changes_no_bit_of_a_plan() {
        let set = synthetic::reach_and_place_set(5, 1);
        let config = PolicyConfig { dt: set.dt, ..PolicyConfig::small() };
        let mut policy = TrainedPolicy::untrained(&set, &config, 1).unwrap();
        // Fresh weights close every gate; these let the encoder through.
        for (i, w) in policy.weights.iter_mut().enumerate() {
            *w += 0.02 * ((i % 7) as f32 - 3.0);
        }
        let mut planner = Planner::new(&policy, PlannerConfig::default()).unwrap();
        let poses = &set.procedures[0].trajectories[0];
        let mut plan = |cached, at: usize| {
            planner.set_encoder_cache(cached);
            planner.plan(0, &poses[at..at + 8], 3).unwrap()
        };
        assert_eq!(plan(true, 0), plan(false, 0));
        assert_ne!(plan(true, 0), plan(true, 9), "the history does not matter");
    }
}
