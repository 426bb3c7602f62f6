//! Sentences to vectors: the BERT family (Devlin et al. 2018) on our own kernels. Only teaching and
//! tools embed text; a checkpoint keeps the result, so nodes need neither the model nor this module.

mod bert;
mod error;
mod tokenizer;

pub use bert::{Pooling, TextEncoder};
pub use error::TextError;
pub use tokenizer::WordPiece;
