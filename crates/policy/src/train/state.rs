//! A training on the disk: everything that the next step depends on.

use super::Training;
use crate::rollout::RolloutReport;
use crate::tensors::{Loaded, Named, refuse, to_bytes, write_atomically};
use crate::{CheckpointProblem, PolicyConfig, PolicyError, TrainConfig, TrainingSet};
use serde::{Deserialize, Serialize};
use std::path::Path;

const KEY: &str = "tdv_training";
const WHAT: &str = "state of a training";
const FORMAT: u32 = 1;

/// What a training is about; a state is only taken up by one with the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Fingerprint {
    policy: PolicyConfig,
    train: TrainConfig,
    /// Task and hash of all its poses and its embedding.
    tasks: Vec<(String, String)>,
}

impl Fingerprint {
    pub fn of(sets: &[TrainingSet], policy: &PolicyConfig, t: &TrainConfig) -> Self {
        Self {
            policy: policy.clone(),
            // The result does not depend on the number of threads.
            train: TrainConfig { threads: 1, ..t.clone() },
            tasks: sets.iter().map(|s| (s.task.clone(), s.content_hash())).collect(),
        }
    }

    /// What hinders a training of `self` from going on from a state of `found`.
    fn differs(&self, found: &Self) -> Option<CheckpointProblem> {
        let other = |what: &str| Some(CheckpointProblem::OtherSettings { what: what.into() });
        let json = |v: &TrainConfig| serde_json::to_value(v).unwrap_or_default();
        if self.policy != found.policy {
            return other("network configuration");
        }
        if let (Some(here), Some(there)) =
            (json(&self.train).as_object(), json(&found.train).as_object())
            && let Some((name, v)) = here.iter().find(|(k, v)| there.get(*k) != Some(v))
        {
            let there = there.get(name).cloned().unwrap_or_default();
            return other(&format!("`{name}` ({there} there, {v} here)"));
        }
        let names = |f: &Self| f.tasks.iter().map(|t| t.0.clone()).collect::<Vec<_>>();
        if names(self) != names(found) {
            let lists = format!("list of tasks ({:?} there, {:?} here)", names(found), names(self));
            return other(&lists);
        }
        let (here, there) = self.tasks.iter().zip(&found.tasks).find(|(a, b)| a != b)?;
        Some(CheckpointProblem::OtherData {
            task: here.0.clone(),
            found: there.1.clone(),
            expected: here.1.clone(),
        })
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    format: u32,
    fingerprint: Fingerprint,
    step: usize,
    loss: f64,
    good: usize,
    rollout: Option<RolloutReport>,
    /// Decimal, since they are wider than JSON's numbers.
    random: [String; 3],
}

impl Training {
    /// Writes the state; an existing file is replaced only when everything is on the disk.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn save_state(&self, path: &Path) -> Result<(), PolicyError> {
        let metadata = Metadata {
            format: FORMAT,
            fingerprint: self.fingerprint.clone(),
            step: self.step,
            loss: self.loss,
            good: self.good,
            rollout: self.rollout.clone(),
            random: self.drawer.positions().map(|p| p.to_string()),
        };
        let metadata = serde_json::to_string(&metadata)
            .map_err(|e| refuse(path, CheckpointProblem::Metadata(e.to_string())))?;
        let shape = [self.architecture.len()];
        let r = &self.run;
        let tensors: Vec<Named> =
            [("weights", &r.theta), ("average", &r.ema), ("moment1", &r.m), ("moment2", &r.v)]
                .map(|(name, values)| Named { name, shape: &shape, values })
                .into();
        let bytes = to_bytes(KEY, metadata, &tensors).map_err(|p| refuse(path, p))?;
        write_atomically(path, &bytes)
    }

    /// Goes on from a state: the steps that follow give the same bytes as if there had been no break.
    ///
    /// # Errors
    /// As [`Training::new`]; [`PolicyError::Checkpoint`] for a file that is broken or belongs to a
    /// training with other settings or data.
    pub fn resume(
        path: &Path,
        sets: &[TrainingSet],
        policy: &PolicyConfig,
        t: &TrainConfig,
    ) -> Result<Self, PolicyError> {
        let mut training = Self::new(sets, policy, t)?;
        let bytes = std::fs::read(path).map_err(|e| refuse(path, e))?;
        let (file, m) = Loaded::parse::<Metadata>(path, &bytes, KEY, WHAT, FORMAT)?;
        if let Some(problem) = training.fingerprint.differs(&m.fingerprint) {
            return Err(refuse(path, problem));
        }
        let broken = |what: &str| refuse(path, CheckpointProblem::Metadata(what.into()));
        if m.step > t.steps || !m.loss.is_finite() {
            return Err(broken("step or loss is out of range"));
        }
        let mut positions = [0; 3];
        for (p, text) in positions.iter_mut().zip(&m.random) {
            *p = text.parse().map_err(|_| broken("a random generator's position is no number"))?;
        }
        let shape = [training.architecture.len()];
        let r = &mut training.run;
        let names = ["weights", "average", "moment1", "moment2"];
        for (name, into) in names.iter().zip([&mut r.theta, &mut r.ema, &mut r.m, &mut r.v]) {
            file.read(name, &shape, into)?;
        }
        file.only(|name| names.contains(&name))?;
        training.drawer.seek(positions);
        (training.step, training.loss) = (m.step, m.loss);
        (training.good, training.rollout) = (m.good, m.rollout);
        Ok(training)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    fn settings() -> (PolicyConfig, TrainConfig) {
        let policy = PolicyConfig {
            d_model: 16,
            heads: 1,
            decoder_layers: 1,
            encoder_layers: 1,
            dt: 0.1,
            ..PolicyConfig::small()
        };
        let train = TrainConfig {
            steps: 14,
            batch: 21,
            warm_up: 4,
            seed: 9,
            evaluate_every: 3,
            missing: 0.2,
            ..Default::default()
        };
        (policy, train)
    }

    #[test]
    fn a_resumed_training_equals_the_unbroken_one_to_the_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state.safetensors");
        let sets = synthetic::two_goal_sets(12, 1);
        let (policy, t) = settings();
        let mut whole = Vec::new();
        let unbroken = crate::train_tasks(&sets, &policy, &t, &mut |p| whole.push(p.loss)).unwrap();
        // Broken off twice, with another number of threads in between.
        let mut parts = Vec::new();
        let mut training = Training::new(&sets, &policy, &t).unwrap();
        for (pause, threads) in [(5, 2), (9, 1), (14, 2)] {
            while training.steps_done() < pause {
                parts.push(training.step().unwrap().loss);
            }
            training.save_state(&path).unwrap();
            let t = TrainConfig { threads, ..t.clone() };
            training = Training::resume(&path, &sets, &policy, &t).unwrap();
            assert_eq!(training.steps_done(), pause);
        }
        assert!(training.is_done());
        assert_eq!(whole, parts);
        let resumed = training.policy().unwrap();
        assert_eq!(unbroken.to_bytes().unwrap(), resumed.to_bytes().unwrap());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn states_of_other_trainings_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state.safetensors");
        let sets = synthetic::two_goal_sets(12, 1);
        let (policy, t) = settings();
        let mut training = Training::new(&sets, &policy, &t).unwrap();
        training.step().unwrap();
        training.save_state(&path).unwrap();
        let refusal =
            |sets: &[TrainingSet], policy: &PolicyConfig, t: &TrainConfig| match Training::resume(
                &path, sets, policy, t,
            ) {
                Ok(_) => panic!("resumed"),
                Err(e) => e.to_string(),
            };
        let other = TrainConfig { learning_rate: 0.5, ..t.clone() };
        let text = refusal(&sets, &policy, &other);
        assert!(text.contains("state.safetensors") && text.contains("`learning_rate`"), "{text}");
        let other = PolicyConfig { horizon: 12, ..policy.clone() };
        assert!(refusal(&sets, &other, &t).contains("network configuration"));
        let mut moved = sets.clone();
        moved[1].procedures[0].trajectories[3][5].translation.vector.x += 1e-9;
        let text = refusal(&moved, &policy, &t);
        assert!(text.contains("other data of task `right`"), "{text}");
        assert!(refusal(&sets[..1], &policy, &t).contains("list of tasks"));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(refusal(&sets, &policy, &t).contains("is it complete"));
        training.policy().unwrap().save(&path).unwrap();
        assert!(refusal(&sets, &policy, &t).contains("no state of a training"));
        std::fs::remove_file(&path).unwrap();
        assert!(refusal(&sets, &policy, &t).contains("state.safetensors"));
    }
}
