//! The classifier's file.

use super::policy::{SwitchLayout, SwitchPolicy};
use crate::checkpoint::{read_tasks, require};
use crate::tasks::{TaskMetadata, embedding_name};
use crate::tensors::{Loaded, Named, refuse, to_bytes, write_atomically};
use crate::{CheckpointProblem, Normaliser, PolicyError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::Pose;

const KEY: &str = "tdv_switch";
const WHAT: &str = "switch policy";
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    format: u32,
    task: String,
    procedures: Vec<String>,
    history: usize,
    text_dim: usize,
    dt: f64,
    normalisers: Vec<Normaliser>,
    end_poses: Vec<Pose>,
    dataset_hash: String,
    #[serde(default)]
    text: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    others: Vec<TaskMetadata>,
    metrics: BTreeMap<String, f64>,
}

impl SwitchPolicy {
    /// Writes the file; an existing one is replaced only when everything is on the disk.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn save(&self, path: &Path) -> Result<(), PolicyError> {
        let metadata = Metadata {
            format: FORMAT,
            task: self.task.clone(),
            procedures: self.procedures.clone(),
            history: self.layout.history,
            text_dim: self.layout.text,
            dt: self.dt,
            normalisers: self.normalisers.clone(),
            end_poses: self.end_poses.clone(),
            dataset_hash: self.dataset_hash.clone(),
            text: self.text.clone(),
            others: self.others.iter().map(TaskMetadata::of).collect(),
            metrics: self.metrics.clone(),
        };
        let metadata = serde_json::to_string(&metadata)
            .map_err(|e| refuse(path, CheckpointProblem::Metadata(e.to_string())))?;
        let mut tensors: Vec<Named> = self
            .layout
            .parameters
            .iter()
            .map(|p| Named { name: &p.name, shape: &p.shape, values: p.slot.of(&self.weights) })
            .collect();
        let shape = [self.layout.text];
        let others = self.others.iter().map(|t| &t.text_embedding);
        let embeddings: Vec<_> = std::iter::once(&self.text_embedding)
            .chain(others)
            .enumerate()
            .filter_map(|(i, e)| e.as_ref().map(|e| (embedding_name(i), e)))
            .collect();
        for (name, values) in &embeddings {
            tensors.push(Named { name, shape: &shape, values });
        }
        let bytes = to_bytes(KEY, metadata, &tensors).map_err(|p| refuse(path, p))?;
        write_atomically(path, &bytes)
    }

    /// Reads a file and checks all of it.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let bytes = std::fs::read(path).map_err(|e| refuse(path, e))?;
        let (file, m) = Loaded::parse::<Metadata>(path, &bytes, KEY, WHAT, FORMAT)?;
        let broken = |text: &str| refuse(path, CheckpointProblem::Metadata(text.into()));
        if !(m.dt.is_finite() && m.dt > 0.0) {
            return Err(broken("dt is not a sensible number"));
        }
        if !(1..=64).contains(&m.history) || m.text_dim > 1 << 16 {
            return Err(broken("history or text_dim is out of range"));
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
        let count = tasks.iter().map(|t| t.procedures.len()).max().unwrap_or(0);
        if count > 4096 {
            return Err(broken("the number of procedures is out of range"));
        }
        let layout = SwitchLayout::new(m.history, m.text_dim, count);
        let mut weights = vec![0.0; layout.len];
        for p in &layout.parameters {
            file.read(&p.name, &p.shape, p.slot.of_mut(&mut weights))?;
        }
        file.only(|name| {
            (m.text_dim > 0 && (0..tasks.len()).any(|i| embedding_name(i) == name))
                || layout.parameters.iter().any(|p| p.name == name)
        })?;
        Self::of(layout, weights, &tasks, m.dt, m.metrics)
    }

    /// As [`SwitchPolicy::load`], choosing a task and refusing a policy that does not know it or has
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
}
