//! Learned perception backends: FoundationPose in candle; GroundingDINO and SAM2 through onnxruntime
//! (feature `onnx`). Weights are the user's: none is bundled, and a missing file is an error that says
//! where to get it and under which licence.
//!
//! Frames: camera poses are in the optical frame (x right, y down, z forward), metres.

mod availability;
mod error;
pub mod layers;
#[cfg(feature = "onnx")]
pub mod onnx;
pub mod pose;
pub mod text_image;
mod weights;

pub use availability::availability;
pub use error::FoundationError;
pub use tdv_perception::availability::Availability;
pub use weights::Weights;
