use std::path::PathBuf;
use thiserror::Error;

/// Why a foundation model could not be loaded or run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FoundationError {
    /// A file that the user has to supply is not there.
    #[error("{path}: no such file ({what}). {hint}")]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
        /// What it holds.
        what: &'static str,
        /// How to get it, and under which licence.
        hint: &'static str,
    },
    /// A file exists but cannot be used.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A tensor of a weight file is missing or has another shape.
    #[error("{path}: tensor `{name}` {reason}")]
    Tensor {
        /// The file.
        path: PathBuf,
        /// The tensor's name.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// An input that no network can be run on.
    #[error("{what} {reason}")]
    Input {
        /// Which input.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The tensor library refused an operation.
    #[error("tensor operation failed: {0}")]
    Candle(#[from] candle_core::Error),
    /// onnxruntime refused a file or an input.
    #[cfg(feature = "onnx")]
    #[error("{what}: onnxruntime says: {reason}")]
    Onnx {
        /// Which network.
        what: String,
        /// Its message.
        reason: String,
    },
}

impl FoundationError {
    pub(crate) fn input(what: &'static str, reason: impl Into<String>) -> Self {
        Self::Input { what, reason: reason.into() }
    }
}
