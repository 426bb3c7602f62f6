//! Between camera messages and the types of the pure crates; poses and objects are in [`crate::tracked`].

mod image;

pub use image::{
    color_from_compressed, color_from_image, compressed_from_color, compressed_from_depth,
    depth_from_compressed, depth_from_image, has_distortion, image_from_color, image_from_depth,
    image_from_depth_in_metres, image_from_labels, info_from_intrinsics, intrinsics_from_info,
    labels_from_image, lens_from_info,
};

use tdv_geometry::Stamp;
use tdv_msgs::builtin_interfaces::msg::Time;
use tdv_msgs::std_msgs::msg::Header;
use tdv_rendering::DepthError;
use tdv_rendering::codec::CodecError;

/// A message whose content cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// An encoding that is not understood.
    #[error("{topic}: encoding {encoding:?} is not supported here: expected {expected}")]
    Encoding {
        /// Where the image came from.
        topic: String,
        /// The message's encoding or format.
        encoding: String,
        /// What would do.
        expected: &'static str,
    },
    /// Sizes that do not fit each other.
    #[error(
        "{topic}: image {width}x{height} {encoding} with step {step} needs {need} bytes, got {have}"
    )]
    Size {
        /// Where the image came from.
        topic: String,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// The message's encoding.
        encoding: String,
        /// Bytes a row, as the message says.
        step: u32,
        /// Bytes needed.
        need: u64,
        /// Bytes there.
        have: usize,
    },
    /// Compressed data that does not decode.
    #[error("{topic}: {source}")]
    Codec {
        /// Where the image came from.
        topic: String,
        /// What is wrong.
        source: CodecError,
    },
    /// Depth of the wrong size.
    #[error("{topic}: {source}")]
    Depth {
        /// Where the image came from.
        topic: String,
        /// What is wrong.
        source: DepthError,
    },
    /// A camera matrix that is not one.
    #[error("{topic}: camera matrix is not usable: {reason}")]
    Camera {
        /// Where the calibration came from.
        topic: String,
        /// What is wrong.
        reason: String,
    },
}

/// A stamp as a message field.
pub fn time_from_stamp(stamp: Stamp) -> Time {
    let (sec, nanosec) = stamp.to_ros();
    Time { sec, nanosec }
}

/// A header.
pub fn header(stamp: Stamp, frame_id: &str) -> Header {
    Header { stamp: time_from_stamp(stamp), frame_id: frame_id.into() }
}
