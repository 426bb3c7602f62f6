//! A trained policy and its file.

use crate::network::{Architecture, Dimensions};
use crate::tasks::{LearnedTask, TaskMetadata, embedding_name, together};
use crate::tensors::{Loaded, Named, refuse, to_bytes, write_atomically};
use crate::{CheckpointProblem, Normaliser, PolicyConfig, PolicyError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::Pose;

const KEY: &str = "tdv_policy";
const WHAT: &str = "diffusion policy";
const FORMAT: u32 = 1;

/// Weights and everything that is needed to use them. A network that was taught several tasks carries
/// out one of them at a time: the fields from `task` to `dataset_hash` are those of that one,
/// [`TrainedPolicy::choose`] takes another.
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
    /// The other tasks that the same network knows.
    pub others: Vec<LearnedTask>,
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
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    others: Vec<TaskMetadata>,
    seed: u64,
    steps: usize,
    metrics: BTreeMap<String, f64>,
}

impl TrainedPolicy {
    /// A network with the tasks that it was taught; the first one is chosen.
    ///
    /// # Errors
    /// [`PolicyError::Data`] without a task.
    pub(crate) fn of(
        architecture: Architecture,
        weights: Vec<f32>,
        tasks: &[LearnedTask],
        seed: u64,
        steps: usize,
        metrics: BTreeMap<String, f64>,
    ) -> Result<Self, PolicyError> {
        let Some((first, others)) = tasks.split_first() else {
            return Err(PolicyError::Data { reason: "there is no task".into() });
        };
        let t = first.clone();
        Ok(Self {
            architecture,
            weights,
            normalisers: t.normalisers,
            task: t.task,
            text: t.text,
            text_embedding: t.text_embedding,
            procedures: t.procedures,
            end_poses: t.end_poses,
            dataset_hash: t.dataset_hash,
            others: others.to_vec(),
            seed,
            steps,
            metrics,
        })
    }

    /// Names of all tasks that the network knows, the chosen one first.
    pub fn tasks(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.task.as_str()).chain(self.others.iter().map(|t| t.task.as_str()))
    }

    /// The same network for another of its tasks.
    ///
    /// # Errors
    /// [`PolicyError::UnknownTask`] naming those that it knows.
    pub fn choose(mut self, task: &str) -> Result<Self, PolicyError> {
        if self.task == task {
            return Ok(self);
        }
        let Some(other) = self.others.iter_mut().find(|t| t.task == task) else {
            let known = self.tasks().map(str::to_owned).collect();
            return Err(PolicyError::UnknownTask { task: task.into(), known });
        };
        std::mem::swap(&mut self.task, &mut other.task);
        std::mem::swap(&mut self.text, &mut other.text);
        std::mem::swap(&mut self.text_embedding, &mut other.text_embedding);
        std::mem::swap(&mut self.procedures, &mut other.procedures);
        std::mem::swap(&mut self.normalisers, &mut other.normalisers);
        std::mem::swap(&mut self.end_poses, &mut other.end_poses);
        std::mem::swap(&mut self.dataset_hash, &mut other.dataset_hash);
        Ok(self)
    }

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
            others: self.others.iter().map(TaskMetadata::of).collect(),
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
        let others = self.others.iter().map(|t| &t.text_embedding);
        let embeddings: Vec<_> = std::iter::once(&self.text_embedding)
            .chain(others)
            .enumerate()
            .filter_map(|(i, e)| e.as_ref().map(|e| (embedding_name(i), e)))
            .collect();
        for (name, values) in &embeddings {
            tensors.push(Named { name, shape: &shape, values });
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
        if m.text_dim > 1 << 16 {
            return Err(broken(format!("text_dim is {}, at most 65536 is sensible", m.text_dim)));
        }
        let first = TaskMetadata::parts(
            m.task,
            m.text,
            m.procedures,
            m.normalisers,
            m.end_poses,
            m.dataset_hash,
        );
        let tasks = read_tasks(&file, std::iter::once(first).chain(m.others), m.text_dim)?;
        let procedures = tasks.iter().map(|t| t.procedures.len()).max().unwrap_or(0);
        let dimensions = Dimensions { procedures, text: m.text_dim };
        let architecture =
            Architecture::new(&m.config, dimensions).map_err(|e| broken(e.to_string()))?;
        let mut weights = vec![0.0; architecture.len()];
        for p in architecture.parameters() {
            file.read(&p.name, &p.shape, architecture.values_mut(p, &mut weights))?;
        }
        file.only(|name| {
            (m.text_dim > 0 && (0..tasks.len()).any(|i| embedding_name(i) == name))
                || architecture.parameters().iter().any(|p| p.name == name)
        })?;
        Self::of(architecture, weights, &tasks, m.seed, m.steps, m.metrics)
    }

    /// As [`TrainedPolicy::load`], choosing a task and refusing a policy that does not know it or has
    /// other procedures for it.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn load_for(path: &Path, task: &str, procedures: &[&str]) -> Result<Self, PolicyError> {
        let mut policy = Self::load(path)?;
        if policy.others.iter().any(|t| t.task == task) {
            policy = policy.choose(task)?;
        }
        require(path, policy.tasks(), &policy.procedures, task, procedures)?;
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
        let sets = std::slice::from_ref(set);
        let architecture = Architecture::new(config, together(sets, config)?)?;
        let weights = architecture.initial(seed);
        Self::of(architecture, weights, &[LearnedTask::of(set)?], seed, 0, BTreeMap::new())
    }
}

/// The tasks of a file with their embeddings.
pub(crate) fn read_tasks(
    file: &Loaded,
    tasks: impl Iterator<Item = TaskMetadata>,
    width: usize,
) -> Result<Vec<LearnedTask>, PolicyError> {
    tasks
        .enumerate()
        .map(|(i, task)| {
            let embedding = if width > 0 {
                let mut e = vec![0.0; width];
                file.read(&embedding_name(i), &[width], &mut e)?;
                Some(e)
            } else {
                None
            };
            task.with(embedding).map_err(|text| file.refuse(CheckpointProblem::Metadata(text)))
        })
        .collect()
}

/// Compares what a checkpoint was trained for with what is asked.
pub(crate) fn require<'a>(
    path: &Path,
    found_tasks: impl Iterator<Item = &'a str>,
    found: &[String],
    task: &str,
    procedures: &[&str],
) -> Result<(), PolicyError> {
    let known: Vec<&str> = found_tasks.collect();
    if known.first() != Some(&task) {
        let list: Vec<String> = known.iter().map(|t| format!("`{t}`")).collect();
        let plural = if list.len() == 1 { "task" } else { "tasks" };
        let (found, expected) = (format!("{plural} {}", list.join(", ")), task.into());
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
    fn a_file_with_two_tasks_gives_the_one_asked_for() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("both.safetensors");
        let sets = synthetic::two_goal_sets(4, 1);
        let config = PolicyConfig { d_model: 16, heads: 1, dt: 0.1, ..PolicyConfig::small() };
        let t = crate::TrainConfig { steps: 2, batch: 8, ..Default::default() };
        let both = crate::train_tasks(&sets, &config, &t, &mut |_| {}).unwrap();
        assert_eq!(both.tasks().collect::<Vec<_>>(), ["left", "right"]);
        both.save(&path).unwrap();
        let read = TrainedPolicy::load(&path).unwrap();
        assert_eq!(read.to_bytes().unwrap(), both.to_bytes().unwrap());
        for set in &sets {
            let p = TrainedPolicy::load_for(&path, &set.task, &["place"]).unwrap();
            assert_eq!((&p.task, &p.text), (&set.task, &set.text));
            assert_eq!(p.text_embedding, set.text_embedding);
            assert_eq!(p.end_poses, set.end_poses());
            assert_eq!(p.weights, both.weights);
        }
        let other = TrainedPolicy::load_for(&path, "up", &["place"]).unwrap_err().to_string();
        assert!(other.contains("`left`") && other.contains("`up`"), "{other}");
        let other = both.choose("up").unwrap_err().to_string();
        assert!(other.contains("left, right"), "{other}");
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
