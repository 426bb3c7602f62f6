//! Safetensors files with one metadata entry of ours, written whole or not at all.

use crate::{CheckpointProblem, PolicyError};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::de::DeserializeOwned;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

/// A named f32 tensor.
pub(crate) struct Named<'a> {
    pub name: &'a str,
    pub shape: &'a [usize],
    pub values: &'a [f32],
}

pub(crate) fn refuse(path: &Path, problem: impl Into<CheckpointProblem>) -> PolicyError {
    PolicyError::Checkpoint { path: path.to_path_buf(), problem: problem.into() }
}

/// The bytes of a file. There is only one metadata entry because the library writes several in
/// random order, and equal policies shall be equal files.
pub(crate) fn to_bytes(
    key: &'static str,
    metadata: String,
    tensors: &[Named],
) -> Result<Vec<u8>, CheckpointProblem> {
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|t| t.values.iter().flat_map(|v| v.to_le_bytes()).collect()).collect();
    let broken = |e: safetensors::SafeTensorError| CheckpointProblem::Metadata(e.to_string());
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|(t, b)| Ok((t.name, TensorView::new(Dtype::F32, t.shape.to_vec(), b)?)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(broken)?;
    let metadata = HashMap::from([(key.to_string(), metadata)]);
    safetensors::serialize(views, Some(metadata)).map_err(broken)
}

/// Writes beside the target, flushes to the disk, then renames.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), PolicyError> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.partial", std::process::id()));
    let partial = path.with_file_name(name);
    let write = || -> std::io::Result<()> {
        let mut file = std::fs::File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    };
    write().map_err(|e| {
        // The partial file is of no use; that it may not exist is no news.
        let _ = std::fs::remove_file(&partial);
        refuse(path, e)
    })
}

/// A file's metadata and tensors.
pub(crate) struct Loaded<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
}

impl<'a> Loaded<'a> {
    /// Reads the header; `what` names in words what the file should hold.
    pub fn parse<M: DeserializeOwned>(
        path: &'a Path,
        bytes: &'a [u8],
        key: &'static str,
        what: &'static str,
        version: u32,
    ) -> Result<(Self, M), PolicyError> {
        let broken = |e: safetensors::SafeTensorError| {
            refuse(path, CheckpointProblem::NotSafetensors(e.to_string()))
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
        let text = header
            .metadata()
            .as_ref()
            .and_then(|m| m.get(key))
            .ok_or_else(|| refuse(path, CheckpointProblem::Foreign { expected: what, key }))?;
        let unreadable =
            |e: serde_json::Error| refuse(path, CheckpointProblem::Metadata(e.to_string()));
        // The version first: what follows may look different in another one.
        let value: serde_json::Value = serde_json::from_str(text).map_err(unreadable)?;
        let found = value.get("format").and_then(serde_json::Value::as_u64).unwrap_or(0);
        if found != u64::from(version) {
            let found = u32::try_from(found).unwrap_or(u32::MAX);
            return Err(refuse(path, CheckpointProblem::Version { found, expected: version }));
        }
        // From the text, not from the value: numbers keep their bits.
        let metadata = serde_json::from_str(text).map_err(unreadable)?;
        Ok((Self { path, tensors }, metadata))
    }

    /// What is wrong with this file, as an error.
    pub fn refuse(&self, problem: CheckpointProblem) -> PolicyError {
        refuse(self.path, problem)
    }

    /// Copies a tensor of the given shape.
    pub fn read(&self, name: &str, shape: &[usize], into: &mut [f32]) -> Result<(), PolicyError> {
        let fail = |p: CheckpointProblem| Err(refuse(self.path, p));
        let Ok(view) = self.tensors.tensor(name) else {
            return fail(CheckpointProblem::MissingTensor(name.into()));
        };
        if view.dtype() != Dtype::F32 || view.shape() != shape {
            return fail(CheckpointProblem::Shape {
                name: name.into(),
                found: format!("{:?} {:?}", view.dtype(), view.shape()),
                expected: shape.to_vec(),
            });
        }
        let (chunks, _) = view.data().as_chunks::<4>();
        for (v, c) in into.iter_mut().zip(chunks) {
            *v = f32::from_le_bytes(*c);
        }
        if into.iter().any(|v| !v.is_finite()) {
            return fail(CheckpointProblem::NotFinite(name.into()));
        }
        Ok(())
    }

    /// Refuses tensors beyond those named.
    pub fn only(&self, mut known: impl FnMut(&str) -> bool) -> Result<(), PolicyError> {
        let mut names: Vec<_> = self.tensors.names();
        names.sort();
        match names.into_iter().find(|n| !known(n)) {
            None => Ok(()),
            Some(n) => Err(refuse(self.path, CheckpointProblem::ExtraTensor(n.to_string()))),
        }
    }
}
