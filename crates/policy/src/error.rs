use std::path::PathBuf;
use thiserror::Error;

/// Everything that can go wrong in learning, loading and planning.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// A configuration with values that do not work; every problem is listed.
    #[error("configuration: {}", problems.join("; "))]
    Config {
        /// One sentence per problem, naming the field and its value.
        problems: Vec<String>,
    },
    /// A training set that nothing can be learned from.
    #[error("training set: {reason}")]
    Data {
        /// What is wrong, naming the procedure and trajectory.
        reason: String,
    },
    /// The sampler was asked for more steps than the diffusion has, or for none.
    #[error(
        "inference_steps is {inference} but the diffusion has {train} steps; choose 1..={train}"
    )]
    InferenceSteps {
        /// Steps asked for.
        inference: usize,
        /// Steps of the diffusion.
        train: usize,
    },
    /// A procedure number that the policy was not trained for.
    #[error("procedure {procedure} does not exist: the policy knows {count}")]
    UnknownProcedure {
        /// The number asked for.
        procedure: usize,
        /// How many procedures there are.
        count: usize,
    },
    /// A task that the policy was not taught.
    #[error("the policy was not taught task `{task}`; it knows {}", known.join(", "))]
    UnknownTask {
        /// The task asked for.
        task: String,
        /// Those that it knows.
        known: Vec<String>,
    },
    /// A history of the wrong length.
    #[error("the history has {have} poses, the policy was trained with {need}")]
    HistoryLength {
        /// Poses given.
        have: usize,
        /// Poses needed.
        need: usize,
    },
    /// A pose with a component that is not a number.
    #[error("{what} is not finite")]
    NotFinite {
        /// Which pose or value.
        what: String,
    },
    /// Training produced numbers that are not finite.
    #[error("training diverged at step {step}: the {what} is not finite; lower the learning rate")]
    Diverged {
        /// The step.
        step: usize,
        /// Loss or gradient.
        what: &'static str,
    },
    /// A checkpoint that cannot be used.
    #[error("{}: {problem}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// Why not.
        problem: CheckpointProblem,
    },
}

/// Why a checkpoint was refused.
#[derive(Debug, Error)]
pub enum CheckpointProblem {
    /// It could not be read or written.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Its bytes are not a safetensors file.
    #[error("not a readable safetensors file ({0}); is it complete, and made by `tdv teach`?")]
    NotSafetensors(String),
    /// A safetensors file of something else.
    #[error(
        "the file holds no {expected} (it has no `{key}` metadata); give a file made by `tdv teach`"
    )]
    Foreign {
        /// What was looked for.
        expected: &'static str,
        /// The missing metadata key.
        key: &'static str,
    },
    /// Its metadata do not parse.
    #[error("its metadata cannot be read: {0}")]
    Metadata(String),
    /// Another version of the format.
    #[error("format version {found}, this program reads version {expected}; train it again")]
    Version {
        /// In the file.
        found: u32,
        /// In this program.
        expected: u32,
    },
    /// A tensor is absent.
    #[error("tensor `{0}` is missing")]
    MissingTensor(String),
    /// A tensor that the configuration in the file does not ask for.
    #[error("tensor `{0}` does not belong to the network that the file describes")]
    ExtraTensor(String),
    /// A tensor of another shape than the configuration asks for.
    #[error("tensor `{name}` is {found}, the configuration in the file asks for f32 {expected:?}")]
    Shape {
        /// Its name.
        name: String,
        /// Type and shape in the file.
        found: String,
        /// Shape needed.
        expected: Vec<usize>,
    },
    /// A weight is not a number.
    #[error("tensor `{0}` holds values that are not finite")]
    NotFinite(String),
    /// It was trained for another task.
    #[error(
        "it was trained for {found}, this run is about `{expected}`; choose its checkpoint or teach the task"
    )]
    OtherTask {
        /// In the file, in words.
        found: String,
        /// Asked for.
        expected: String,
    },
    /// The state of a training with other data.
    #[error(
        "it was trained on other data of task `{task}` (hash {found}, the set at hand has {expected}); \
         teach without resuming, or with the data of before"
    )]
    OtherData {
        /// The task.
        task: String,
        /// Hash in the file.
        found: String,
        /// Hash of the set at hand.
        expected: String,
    },
    /// The state of a training with other settings.
    #[error(
        "it belongs to a training with another {what}; teach with the same, or without resuming"
    )]
    OtherSettings {
        /// Which setting, with both values where they are short.
        what: String,
    },
    /// Its procedures differ from what the task has.
    #[error("it knows the procedures {found:?}, the task has {expected:?}; teach the task again")]
    OtherProcedures {
        /// In the file.
        found: Vec<String>,
        /// Asked for.
        expected: Vec<String>,
    },
}
