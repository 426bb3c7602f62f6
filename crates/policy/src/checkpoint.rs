//! A trained policy and its file.

use crate::network::{Architecture, Dimensions};
use crate::tensors::{Loaded, Named, refuse, to_bytes, write_atomically};
use crate::{CheckpointProblem, Normaliser, PolicyConfig, PolicyError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::Pose;

const KEY: &str = "tdv_policy";
const WHAT: &str = "diffusion policy";
const FORMAT: u32 = 1;
const TEXT: &str = "text_embedding";

/// Weights and everything that is needed to use them.
#[derive(Debug, Clone)]
pub struct TrainedPolicy {
    /// The network's layout, with its configuration.
    pub architecture: Architecture,
    /// The averaged weights, in the layout's order.
    pub weights: Vec<f32>,
    /// One per procedure.
    pub normalisers: Vec<Normaliser>,
    /// Task that it was trained for.
    pub task: String,
    /// The task in words.
    pub text: String,
    /// Embedding of the words, if it was trained with one.
    pub text_embedding: Option<Vec<f32>>,
    /// Names of the procedures.
    pub procedures: Vec<String>,
    /// Mean last pose of each procedure, `T_reference_moving`.
    pub end_poses: Vec<Pose>,
    /// Hash of the data set.
    pub dataset_hash: String,
    /// Seed of the training.
    pub seed: u64,
    /// Steps trained.
    pub steps: usize,
    /// Figures of the training by name.
    pub metrics: BTreeMap<String, f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    format: u32,
    task: String,
    text: String,
    text_dim: usize,
    procedures: Vec<String>,
    config: PolicyConfig,
    /// In words, for readers of the file.
    schedule: String,
    pose_layout: String,
    normalisers: Vec<Normaliser>,
    end_poses: Vec<Pose>,
    dataset_hash: String,
    seed: u64,
    steps: usize,
    metrics: BTreeMap<String, f64>,
}

impl TrainedPolicy {
    /// The file's bytes.
    ///
    /// # Errors
    /// [`CheckpointProblem::Metadata`] when a metric is not finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CheckpointProblem> {
        if let Some((name, _)) = self.metrics.iter().find(|(_, v)| !v.is_finite()) {
            return Err(CheckpointProblem::Metadata(format!("metric `{name}` is not finite")));
        }
        let metadata = Metadata {
            format: FORMAT,
            task: self.task.clone(),
            text: self.text.clone(),
            text_dim: self.architecture.dimensions.text,
            procedures: self.procedures.clone(),
            config: self.architecture.config.clone(),
            schedule: "squared_cosine".into(),
            pose_layout: "xyz min-max normalised; first two columns of the rotation matrix".into(),
            normalisers: self.normalisers.clone(),
            end_poses: self.end_poses.clone(),
            dataset_hash: self.dataset_hash.clone(),
            seed: self.seed,
            steps: self.steps,
            metrics: self.metrics.clone(),
        };
        let metadata = serde_json::to_string(&metadata)
            .map_err(|e| CheckpointProblem::Metadata(e.to_string()))?;
        let parameters = self.architecture.parameters();
        let mut tensors: Vec<Named> = parameters
            .iter()
            .map(|p| Named {
                name: &p.name,
                shape: &p.shape,
                values: self.architecture.values(p, &self.weights),
            })
            .collect();
        let shape = [self.architecture.dimensions.text];
        if let Some(e) = &self.text_embedding {
            tensors.push(Named { name: TEXT, shape: &shape, values: e });
        }
        to_bytes(KEY, metadata, &tensors)
    }

    /// Writes the file; an existing one is replaced only when everything is on the disk.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let bytes = self.to_bytes().map_err(|p| refuse(path, p))?;
        write_atomically(path, &bytes)
    }

    /// Reads a file and checks all of it.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`] saying what is wrong with it.
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let bytes = std::fs::read(path).map_err(|e| refuse(path, e))?;
        let (file, m) = Loaded::parse::<Metadata>(path, &bytes, KEY, WHAT, FORMAT)?;
        let broken = |text: String| refuse(path, CheckpointProblem::Metadata(text));
        let count = m.procedures.len();
        if m.normalisers.len() != count || m.end_poses.len() != count {
            return Err(broken(format!(
                "{count} procedures, but {} normalisers and {} end poses",
                m.normalisers.len(),
                m.end_poses.len()
            )));
        }
        if !m.normalisers.iter().all(Normaliser::is_valid) {
            return Err(broken("a normaliser's limits are not finite or not ordered".into()));
        }
        let dimensions = Dimensions { procedures: count, text: m.text_dim };
        let architecture =
            Architecture::new(&m.config, dimensions).map_err(|e| broken(e.to_string()))?;
        let mut weights = vec![0.0; architecture.len()];
        for p in architecture.parameters() {
            file.read(&p.name, &p.shape, architecture.values_mut(p, &mut weights))?;
        }
        let mut text_embedding = None;
        if m.text_dim > 0 {
            let mut e = vec![0.0; m.text_dim];
            file.read(TEXT, &[m.text_dim], &mut e)?;
            text_embedding = Some(e);
        }
        file.only(|name| {
            (name == TEXT && m.text_dim > 0)
                || architecture.parameters().iter().any(|p| p.name == name)
        })?;
        Ok(Self {
            architecture,
            weights,
            normalisers: m.normalisers,
            task: m.task,
            text: m.text,
            text_embedding,
            procedures: m.procedures,
            end_poses: m.end_poses,
            dataset_hash: m.dataset_hash,
            seed: m.seed,
            steps: m.steps,
            metrics: m.metrics,
        })
    }

    /// As [`TrainedPolicy::load`], refusing a policy of another task or with other procedures.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn load_for(path: &Path, task: &str, procedures: &[&str]) -> Result<Self, PolicyError> {
        let policy = Self::load(path)?;
        require(path, &policy.task, &policy.procedures, task, procedures)?;
        Ok(policy)
    }

    /// The same network with fresh weights, for controls.
    #[must_use]
    pub fn with_random_weights(mut self, seed: u64) -> Self {
        self.weights = self.architecture.initial(seed);
        self.seed = seed;
        self.steps = 0;
        self
    }

    /// A policy with fresh weights: it knows the task's frame and nothing else. For controls.
    ///
    /// # Errors
    /// As [`crate::train()`].
    pub fn untrained(
        set: &crate::TrainingSet,
        config: &PolicyConfig,
        seed: u64,
    ) -> Result<Self, PolicyError> {
        set.validate(config)?;
        let text = set.text_embedding.as_ref().map_or(0, Vec::len);
        let dimensions = Dimensions { procedures: set.procedures.len(), text };
        let architecture = Architecture::new(config, dimensions)?;
        Ok(Self {
            weights: architecture.initial(seed),
            architecture,
            normalisers: set.normalisers()?,
            task: set.task.clone(),
            text: set.text.clone(),
            text_embedding: set.text_embedding.clone(),
            procedures: set.procedures.iter().map(|p| p.name.clone()).collect(),
            end_poses: set.end_poses(),
            dataset_hash: set.dataset_hash.clone(),
            seed,
            steps: 0,
            metrics: BTreeMap::new(),
        })
    }
}

/// Compares what a checkpoint was trained for with what is asked.
pub(crate) fn require(
    path: &Path,
    found_task: &str,
    found: &[String],
    task: &str,
    procedures: &[&str],
) -> Result<(), PolicyError> {
    if found_task != task {
        let (found, expected) = (found_task.into(), task.into());
        return Err(refuse(path, CheckpointProblem::OtherTask { found, expected }));
    }
    if found != procedures {
        let expected = procedures.iter().map(ToString::to_string).collect();
        let found = found.to_vec();
        return Err(refuse(path, CheckpointProblem::OtherProcedures { found, expected }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Planner, PlannerConfig, synthetic};

    fn policy() -> TrainedPolicy {
        let mut set = synthetic::reach_and_place_set(3, 1);
        set.text_embedding = Some(vec![0.25, -1.5, 3.0]);
        let config = PolicyConfig { d_model: 16, heads: 1, dt: 0.1, ..PolicyConfig::small() };
        let mut p = TrainedPolicy::untrained(&set, &config, 4).unwrap();
        // Zero-initialised outputs would hide a wrong order of the tensors.
        for (i, w) in p.weights.iter_mut().enumerate() {
            *w += 0.05 * ((i % 97) as f32 - 48.0) / 48.0;
        }
        p.metrics.insert("loss".into(), 0.1 + 0.2);
        p
    }

    #[test]
    fn what_is_read_plans_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("policy.safetensors");
        let p = policy();
        p.save(&path).unwrap();
        let q = TrainedPolicy::load_for(&path, "synthetic", &["reach", "place"]).unwrap();
        assert_eq!(p.to_bytes().unwrap(), q.to_bytes().unwrap());
        let history = vec![p.end_poses[1]; 8];
        let plan = |p| Planner::new(p, PlannerConfig::default()).unwrap().plan(1, &history, 7);
        assert_eq!(plan(&p).unwrap(), plan(&q).unwrap());
        // Nothing else is left in the folder.
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn unusable_files_are_refused_by_their_fault() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.safetensors");
        let p = policy();
        let bytes = p.to_bytes().unwrap();
        let check = |content: &[u8], words: &str| {
            std::fs::write(&path, content).unwrap();
            let error = TrainedPolicy::load(&path).unwrap_err().to_string();
            assert!(error.contains("p.safetensors") && error.contains(words), "{error}");
        };
        check(&bytes[..bytes.len() - 5], "is it complete");
        check(&bytes[..100], "is it complete");
        check(b"", "is it complete");
        check(b"PK\x03\x04 a pickle in a zip, or a picture", "not a readable safetensors");
        let foreign =
            safetensors::serialize(Vec::<(String, safetensors::tensor::TensorView)>::new(), None);
        check(&foreign.unwrap(), "no `tdv_policy` metadata");
        let mut nan = bytes.clone();
        let end = nan.len();
        nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
        check(&nan, "not finite");
        let json = |from: &str, to: &str| {
            // Same length, so that the header's own length stays right.
            assert_eq!(from.len(), to.len());
            let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
            let mut b = bytes.clone();
            b[at..at + from.len()].copy_from_slice(to.as_bytes());
            b
        };
        check(&json(r#"\"format\":1"#, r#"\"format\":7"#), "format version 7");
        check(&json(r#"\"d_model\":16"#, r#"\"d_model\":32"#), "asks for f32");
        check(&json(r#"\"d_model\":16"#, r#"\"d_model\":17"#), "multiple of 16");
        check(&json(r#"\"steps\":0"#, r#"\"stepz\":0"#), "stepz");
        std::fs::write(&path, &bytes).unwrap();
        let other = TrainedPolicy::load_for(&path, "tea", &["reach", "place"]).unwrap_err();
        assert!(other.to_string().contains("trained for task `synthetic`"), "{other}");
        let other = TrainedPolicy::load_for(&path, "synthetic", &["place"]).unwrap_err();
        assert!(other.to_string().contains("[\"reach\", \"place\"]"), "{other}");
        let absent = TrainedPolicy::load(&dir.path().join("none")).unwrap_err();
        assert!(absent.to_string().contains("none"), "{absent}");
        assert!(p.save(&dir.path().join("no/such/folder.safetensors")).is_err());
    }

    #[test]
    fn a_switch_is_not_a_policy() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.safetensors");
        let set = synthetic::place_set(5, 1);
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let t = crate::SwitchTrainConfig { steps: 2, ..Default::default() };
        let (mut s, _) = crate::train_switch(&set, &config, &Default::default(), &t).unwrap();
        s.save(&path).unwrap();
        let error = TrainedPolicy::load(&path).unwrap_err().to_string();
        assert!(error.contains("no diffusion policy"), "{error}");
        let mut read = crate::SwitchPolicy::load_for(&path, "synthetic", &["place"]).unwrap();
        let history = vec![s.end_poses[0]; 8];
        assert_eq!(s.probability(0, &history).unwrap(), read.probability(0, &history).unwrap());
        assert!(crate::SwitchPolicy::load_for(&path, "x", &["place"]).is_err());
    }
}
