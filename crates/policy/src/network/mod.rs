//! The trajectory diffusion transformer.
//!
//! An encoder reads one token per past pose (a two-layer MLP), one for the text and one for the
//! procedure, each with a learned position and a learned modality vector; its mean-pooled result `e`
//! plus the embedding of the diffusion step modulates every block of a denoising decoder (DiT with
//! adaLN-Zero, Peebles and Xie 2023: `x (1 + scale) + shift`, weightless norms, gates and output
//! initialised to zero) over the horizon's poses.
//!
//! The graph is fixed, so the training step is written by hand over a preallocated workspace.

mod block;
#[cfg(test)]
mod golden;
mod layout;
mod model;

pub(crate) use block::{BlockSlots, linear, linear_backward};
pub use layout::{Architecture, Dimensions, Parameter};
pub(crate) use layout::{Builder, Init, Linear, Slot, initial};
pub(crate) use model::time_features;
pub use model::{Batch, Workspace};

/// Widening of the feed-forward layers.
pub(crate) const FEED_FORWARD: usize = 4;
