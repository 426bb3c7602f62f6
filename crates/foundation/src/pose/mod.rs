//! FoundationPose: the pose of an object whose mesh is known, from one RGB-D image and a mask, and
//! then from image to image.
//!
//! The weights are NVIDIA's, for research and evaluation only, and the user's to fetch;
//! `launch_scripts/convert_foundationpose.py` turns them into the two files of [`load`].

mod backend;
pub mod crop;
pub mod depth_filter;
mod estimator;
pub mod hypotheses;
pub mod networks;
mod target;

pub use backend::PoseBackend;
pub use estimator::{PoseConfig, PoseEstimator, PoseFound, Rank, Refine};
pub use networks::{RefineNet, ScoreNet};
pub use target::Target;
pub use tdv_perception::availability::{POSE_HINT as HINT, REFINER_FILE, SCORER_FILE};

use crate::{FoundationError, Weights};
use candle_core::Device;
use std::path::Path;

/// Loads both networks from a folder.
///
/// # Errors
/// [`FoundationError`] naming the file, and the tensor that does not fit.
pub fn load(
    folder: &Path,
    device: &Device,
    config: PoseConfig,
) -> Result<PoseEstimator, FoundationError> {
    let file = |name: &str, what| Weights::load(&folder.join(name), device, what, HINT);
    let refiner = RefineNet::new(&file(REFINER_FILE, "FoundationPose's refiner")?)?;
    let scorer = ScoreNet::new(&file(SCORER_FILE, "FoundationPose's scorer")?)?;
    PoseEstimator::new(refiner, scorer, device.clone(), config)
}

#[cfg(test)]
mod parity;
