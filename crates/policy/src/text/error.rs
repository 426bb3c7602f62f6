use std::path::PathBuf;
use thiserror::Error;

/// Why a text has no embedding.
#[derive(Debug, Error)]
pub enum TextError {
    /// Nothing but white space.
    #[error("the text is empty; say in words what is to be done, such as \"put the mug away\"")]
    Empty,
    /// More tokens than the model has positions for.
    #[error("the text has {tokens} tokens, the model takes {limit}; shorten it")]
    TooLong {
        /// Tokens, the two markers included.
        tokens: usize,
        /// Positions of the model.
        limit: usize,
    },
    /// A file of the model folder cannot be read.
    #[error(
        "{}: {source}; the folder needs config.json, vocab.txt or tokenizer.json, and model.safetensors",
        path.display()
    )]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file of the model folder holds something else than it should.
    #[error("{}: {problem}", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}
