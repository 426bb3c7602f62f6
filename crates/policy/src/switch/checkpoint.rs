//! The classifier's file.

use super::policy::{SwitchBuffers, SwitchLayout, SwitchPolicy};
use crate::checkpoint::require;
use crate::normaliser::POSE_DIM;
use crate::tensors::{Loaded, Named, refuse, to_bytes, write_atomically};
use crate::{CheckpointProblem, Normaliser, PolicyError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::Pose;

const KEY: &str = "tdv_switch";
const WHAT: &str = "switch policy";
const FORMAT: u32 = 1;
const TEXT: &str = "text_embedding";

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
        if let Some(e) = &self.text_embedding {
            tensors.push(Named { name: TEXT, shape: &shape, values: e });
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
        let count = m.procedures.len();
        if count == 0 || m.normalisers.len() != count || m.end_poses.len() != count {
            return Err(broken("procedures, normalisers and end poses differ in number"));
        }
        if !m.normalisers.iter().all(Normaliser::is_valid) || !(m.dt.is_finite() && m.dt > 0.0) {
            return Err(broken("normaliser limits or dt are not sensible numbers"));
        }
        if !(1..=64).contains(&m.history) || m.text_dim > 1 << 16 || count > 4096 {
            return Err(broken("history, text_dim or the number of procedures is out of range"));
        }
        let layout = SwitchLayout::new(m.history, m.text_dim, count);
        let mut weights = vec![0.0; layout.len];
        for p in &layout.parameters {
            file.read(&p.name, &p.shape, p.slot.of_mut(&mut weights))?;
        }
        let mut text_embedding = None;
        if m.text_dim > 0 {
            let mut e = vec![0.0; m.text_dim];
            file.read(TEXT, &[m.text_dim], &mut e)?;
            text_embedding = Some(e);
        }
        file.only(|name| {
            (name == TEXT && m.text_dim > 0) || layout.parameters.iter().any(|p| p.name == name)
        })?;
        Ok(Self {
            buffers: SwitchBuffers::new(&layout, 1),
            encoded: vec![0.0; m.history * POSE_DIM],
            weights,
            normalisers: m.normalisers,
            task: m.task,
            procedures: m.procedures,
            end_poses: m.end_poses,
            text_embedding,
            dt: m.dt,
            dataset_hash: m.dataset_hash,
            metrics: m.metrics,
            layout,
        })
    }

    /// As [`SwitchPolicy::load`], refusing a policy of another task or with other procedures.
    ///
    /// # Errors
    /// [`PolicyError::Checkpoint`].
    pub fn load_for(path: &Path, task: &str, procedures: &[&str]) -> Result<Self, PolicyError> {
        let policy = Self::load(path)?;
        require(path, &policy.task, &policy.procedures, task, procedures)?;
        Ok(policy)
    }
}
