//! Which frames belong to which procedure, as a file that a person can correct.

use crate::sequence::{self, ProcedureSpec};
use crate::{DemonstrationError, FrameObservation, GripperEnd, Task, file};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The frames of one procedure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// As in the task.
    pub name: String,
    /// Stamp of its first frame (ns).
    pub first: i64,
    /// Stamp of its last frame (ns); the gripper acts here.
    pub last: i64,
    /// What moves: an object, or `tcp`.
    pub moving: String,
    /// The object it is seen from.
    pub reference: String,
    /// What the gripper does at its end.
    #[serde(default)]
    pub end: GripperEnd,
}

/// The procedures of a recording, as parsing found them or as a person says.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segments {
    /// Name of the task.
    pub task: String,
    /// In order; they may leave frames out between them, but not overlap.
    pub procedures: Vec<Segment>,
}

impl Segments {
    /// Reads a YAML file.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`], [`DemonstrationError::Format`] naming line and field.
    pub fn load(path: &Path) -> Result<Self, DemonstrationError> {
        serde_saphyr::from_str(&file::read(path)?).map_err(|e| DemonstrationError::Format {
            path: path.to_path_buf(),
            reason: e.to_string(),
        })
    }

    /// Writes YAML, whole or not at all.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`], [`DemonstrationError::Format`].
    pub fn save(&self, path: &Path) -> Result<(), DemonstrationError> {
        let text = serde_saphyr::to_string(self).map_err(|e| DemonstrationError::Format {
            path: path.to_path_buf(),
            reason: e.to_string(),
        })?;
        let head = "# Which frames belong to which procedure (stamps in ns). `tdv teach --segments` takes it.\n";
        file::write_atomically(path, format!("{head}{text}").as_bytes())
    }

    /// The procedures, each with what the task says of it.
    pub(super) fn specs(&self, task: &Task) -> Result<Vec<ProcedureSpec>, DemonstrationError> {
        let sequence = task.sequence();
        let mut problems = Vec::new();
        if self.task != task.name {
            problems.push(format!("they are of task '{}', not '{}'", self.task, task.name));
        }
        let mut specs = Vec::new();
        for s in &self.procedures {
            let Some(known) = sequence.iter().find(|k| k.name == s.name) else {
                let names: Vec<&str> = sequence.iter().map(|k| k.name.as_str()).collect();
                return Err(DemonstrationError::UnknownProcedure {
                    asked: format!("'{}' in the task", s.name),
                    known: names.join(", "),
                });
            };
            specs.push(ProcedureSpec {
                moving: s.moving.clone(),
                reference: s.reference.clone(),
                end: s.end,
                ..known.clone()
            });
        }
        problems.extend(sequence::problems(&specs, |name| task.objects.contains_key(name)));
        for (i, s) in self.procedures.iter().enumerate() {
            if s.last <= s.first {
                problems.push(format!("'{}' ends ({} ns) before it begins", s.name, s.last));
            }
            if i > 0 && s.first < self.procedures[i - 1].last {
                let before = &self.procedures[i - 1].name;
                problems.push(format!("'{}' begins before '{before}' has ended", s.name));
            }
        }
        if problems.is_empty() {
            return Ok(specs);
        }
        Err(DemonstrationError::Invalid { what: "segments".into(), problems })
    }

    /// First and last frame of each procedure.
    pub(super) fn bounds(
        &self,
        frames: &[FrameObservation],
    ) -> Result<Vec<[usize; 2]>, DemonstrationError> {
        let index = |stamp: i64| frames.partition_point(|f| f.stamp.0 < stamp);
        let mut out = Vec::new();
        let mut problems = Vec::new();
        for s in &self.procedures {
            let a = index(s.first);
            let b = frames.partition_point(|f| f.stamp.0 <= s.last).saturating_sub(1);
            if a + 1 > b || b >= frames.len() {
                problems.push(format!("'{}' has fewer than two frames of the recording", s.name));
            }
            out.push([a, b]);
        }
        if problems.is_empty() {
            return Ok(out);
        }
        Err(DemonstrationError::Invalid { what: "segments".into(), problems })
    }

    pub(super) fn of(
        task: &Task,
        specs: &[ProcedureSpec],
        bounds: &[[usize; 2]],
        frames: &[FrameObservation],
    ) -> Self {
        let segment = |(s, b): (&ProcedureSpec, &[usize; 2])| Segment {
            name: s.name.clone(),
            first: frames[b[0]].stamp.0,
            last: frames[b[1]].stamp.0,
            moving: s.moving.clone(),
            reference: s.reference.clone(),
            end: s.end,
        };
        Self {
            task: task.name.clone(),
            procedures: specs.iter().zip(bounds).map(segment).collect(),
        }
    }
}
