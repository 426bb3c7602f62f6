//! What one network holds of each of the tasks that it was taught.

use crate::network::Dimensions;
use crate::{Normaliser, PolicyConfig, PolicyError, TrainingSet};
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;

/// A task as a network knows it: the words that tell it from the others, and what turns the network's
/// numbers into poses.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnedTask {
    /// Its name.
    pub task: String,
    /// The task in words.
    pub text: String,
    /// Embedding of the words, if the network was trained with one.
    pub text_embedding: Option<Vec<f32>>,
    /// Names of its procedures.
    pub procedures: Vec<String>,
    /// One per procedure.
    pub normalisers: Vec<Normaliser>,
    /// Mean last pose of each procedure, `T_reference_moving`.
    pub end_poses: Vec<Pose>,
    /// Hash of its data set.
    pub dataset_hash: String,
}

impl LearnedTask {
    /// Of a set that has been validated.
    ///
    /// # Errors
    /// As [`Normaliser::fit`].
    pub fn of(set: &TrainingSet) -> Result<Self, PolicyError> {
        Ok(Self {
            task: set.task.clone(),
            text: set.text.clone(),
            text_embedding: set.text_embedding.clone(),
            procedures: set.procedures.iter().map(|p| p.name.clone()).collect(),
            normalisers: set.normalisers()?,
            end_poses: set.end_poses(),
            dataset_hash: set.dataset_hash.clone(),
        })
    }
}

/// A [`LearnedTask`] in a file; its embedding is a tensor.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TaskMetadata {
    task: String,
    text: String,
    procedures: Vec<String>,
    normalisers: Vec<Normaliser>,
    end_poses: Vec<Pose>,
    dataset_hash: String,
}

impl TaskMetadata {
    /// Of single values, as a file keeps those of its first task.
    pub fn parts(
        task: String,
        text: String,
        procedures: Vec<String>,
        normalisers: Vec<Normaliser>,
        end_poses: Vec<Pose>,
        dataset_hash: String,
    ) -> Self {
        Self { task, text, procedures, normalisers, end_poses, dataset_hash }
    }

    pub fn of(t: &LearnedTask) -> Self {
        Self {
            task: t.task.clone(),
            text: t.text.clone(),
            procedures: t.procedures.clone(),
            normalisers: t.normalisers.clone(),
            end_poses: t.end_poses.clone(),
            dataset_hash: t.dataset_hash.clone(),
        }
    }

    /// With the embedding that belongs to it; what is wrong with the task, if anything.
    pub fn with(self, text_embedding: Option<Vec<f32>>) -> Result<LearnedTask, String> {
        let (count, name) = (self.procedures.len(), &self.task);
        if count == 0 || self.normalisers.len() != count || self.end_poses.len() != count {
            return Err(format!(
                "task `{name}`: {count} procedures, but {} normalisers and {} end poses",
                self.normalisers.len(),
                self.end_poses.len()
            ));
        }
        if !self.normalisers.iter().all(Normaliser::is_valid) {
            return Err(format!(
                "task `{name}`: a normaliser's limits are not finite or not ordered"
            ));
        }
        Ok(LearnedTask {
            task: self.task,
            text: self.text,
            text_embedding,
            procedures: self.procedures,
            normalisers: self.normalisers,
            end_poses: self.end_poses,
            dataset_hash: self.dataset_hash,
        })
    }
}

/// Name of the tensor with the embedding of the `i`-th task.
pub(crate) fn embedding_name(i: usize) -> String {
    if i == 0 { "text_embedding".into() } else { format!("text_embedding.{i}") }
}

/// Checks sets that shall be learned by one network; what they ask of it.
///
/// # Errors
/// [`PolicyError::Data`] naming the task: none, equal names, or several that the network could not tell
/// apart because their embeddings are missing, equal or of different lengths. As
/// [`TrainingSet::validate`].
pub(crate) fn together(
    sets: &[TrainingSet],
    config: &PolicyConfig,
) -> Result<Dimensions, PolicyError> {
    let fail = |reason: String| Err(PolicyError::Data { reason });
    let Some(first) = sets.first() else { return fail("there is no task".into()) };
    let width = first.text_embedding.as_ref().map_or(0, Vec::len);
    for (i, set) in sets.iter().enumerate() {
        set.validate(config)?;
        let name = &set.task;
        if sets.len() > 1 && set.text_embedding.is_none() {
            return fail(format!(
                "task `{name}` has no text embedding, by which one policy tells its {} tasks \
                 apart; launch_scripts/fetch_text_model.sh gets the model that makes it",
                sets.len()
            ));
        }
        if set.text_embedding.as_ref().map_or(0, Vec::len) != width {
            return fail(format!(
                "the text embeddings of `{}` and `{name}` differ in length",
                first.task
            ));
        }
        for other in &sets[..i] {
            if other.task == *name {
                return fail(format!("task `{name}` is there twice"));
            }
            if other.text_embedding == set.text_embedding {
                return fail(format!(
                    "tasks `{}` and `{name}` have the same text embedding: \"{}\" and \"{}\"",
                    other.task, other.text, set.text
                ));
            }
        }
    }
    let procedures = sets.iter().map(|s| s.procedures.len()).max().unwrap_or(0);
    Ok(Dimensions { procedures, text: width })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn tasks_that_cannot_be_told_apart_are_refused() {
        let config = PolicyConfig { dt: 0.1, ..PolicyConfig::small() };
        let [mut a, mut b] = synthetic::two_goal_sets(3, 1);
        let d = together(&[a.clone(), b.clone()], &config).unwrap();
        assert_eq!(d, Dimensions { procedures: 1, text: 16 });
        let refusal = |sets: &[TrainingSet]| together(sets, &config).unwrap_err().to_string();
        assert!(refusal(&[]).contains("no task"));
        assert!(refusal(&[a.clone(), a.clone()]).contains("`left` is there twice"));
        let mut same = b.clone();
        same.text_embedding = a.text_embedding.clone();
        assert!(refusal(&[a.clone(), same]).contains("`left` and `right` have the same text"));
        b.text_embedding.as_mut().unwrap().pop();
        assert!(refusal(&[a.clone(), b.clone()]).contains("differ in length"));
        b.text_embedding = None;
        a.text_embedding = None;
        assert!(refusal(&[a.clone(), b]).contains("fetch_text_model.sh"));
        // Alone a task needs no words.
        assert_eq!(together(&[a], &config).unwrap().text, 0);
    }
}
