//! RGB-D recordings as bags: reading frames out of one, writing frames into one.

mod read;
mod write;

pub use read::{CameraBag, CameraBagError, CameraFrame};
pub use write::{CameraBagWriter, PosesBagWriter};

/// Topic of the JPEG colour images that we write.
pub const COLOR_TOPIC: &str = "/camera/camera/color/image_raw/compressed";
/// Topic of the compressed depth images that we write.
pub const DEPTH_TOPIC: &str = "/camera/camera/aligned_depth_to_color/image_raw/compressedDepth";
/// Topic of the intrinsics that we write.
pub const INFO_TOPIC: &str = "/camera/camera/color/camera_info";
/// Frame of the images that we write.
pub const CAMERA_FRAME: &str = "camera_color_optical_frame";
