//! Between messages and the types of the pure crates.

mod image;

pub use image::{
    color_from_compressed, color_from_image, compressed_from_color, compressed_from_depth,
    depth_from_compressed, depth_from_image, has_distortion, image_from_color, image_from_depth,
    image_from_labels, info_from_intrinsics, intrinsics_from_info, labels_from_image,
};

use nalgebra::{Matrix6, Point3};
use tdv_geometry::{GeometryError, Pose, Stamp, pose_from_xyz_quat, pose_to_xyz_quat};
use tdv_msgs::builtin_interfaces::msg::Time;
use tdv_msgs::geometry_msgs::msg;
use tdv_msgs::std_msgs::msg::Header;
use tdv_rendering::DepthError;
use tdv_rendering::codec::CodecError;

/// A message whose content cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConvertError {
    /// A pose with NaN, infinities or a quaternion that is not one.
    #[error("{what}: {source}")]
    Pose {
        /// Topic or field.
        what: String,
        /// What is wrong.
        source: GeometryError,
    },
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

/// A message field as a stamp.
pub fn stamp_from_time(time: &Time) -> Stamp {
    Stamp::from_ros(time.sec, time.nanosec)
}

/// A header.
pub fn header(stamp: Stamp, frame_id: &str) -> Header {
    Header { stamp: time_from_stamp(stamp), frame_id: frame_id.into() }
}

/// A pose as a message (m; quaternion x, y, z, w).
pub fn pose_to_msg(pose: &Pose) -> msg::Pose {
    let ([x, y, z], [qx, qy, qz, qw]) = pose_to_xyz_quat(pose);
    msg::Pose {
        position: msg::Point { x, y, z },
        orientation: msg::Quaternion { x: qx, y: qy, z: qz, w: qw },
    }
}

/// A message as a pose; `what` names topic or field for the error.
///
/// # Errors
/// [`ConvertError::Pose`] for NaN, infinities, or a quaternion whose norm is off by more than 1e-3.
pub fn pose_from_msg(message: &msg::Pose, what: &str) -> Result<Pose, ConvertError> {
    let (p, q) = (&message.position, &message.orientation);
    pose_from_xyz_quat([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        .map_err(|source| ConvertError::Pose { what: what.into(), source })
}

/// A pose as a transform message.
pub fn transform_to_msg(pose: &Pose) -> msg::Transform {
    let ([x, y, z], [qx, qy, qz, qw]) = pose_to_xyz_quat(pose);
    msg::Transform {
        translation: msg::Vector3 { x, y, z },
        rotation: msg::Quaternion { x: qx, y: qy, z: qz, w: qw },
    }
}

/// A transform message as a pose; `what` names topic or field for the error.
///
/// # Errors
/// [`ConvertError::Pose`].
pub fn transform_from_msg(message: &msg::Transform, what: &str) -> Result<Pose, ConvertError> {
    let (p, q) = (&message.translation, &message.rotation);
    pose_from_xyz_quat([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        .map_err(|source| ConvertError::Pose { what: what.into(), source })
}

/// A stamped transform `T_parent_child` for `/tf`.
pub fn transform_stamped(
    stamp: Stamp,
    parent: &str,
    child: &str,
    pose: &Pose,
) -> msg::TransformStamped {
    msg::TransformStamped {
        header: header(stamp, parent),
        child_frame_id: child.into(),
        transform: transform_to_msg(pose),
    }
}

/// A pose with covariance (row-major; m^2, m rad, rad^2; order x, y, z and rotation about x, y, z).
pub fn pose_with_covariance(pose: &Pose, covariance: &Matrix6<f64>) -> msg::PoseWithCovariance {
    msg::PoseWithCovariance {
        pose: pose_to_msg(pose),
        covariance: std::array::from_fn(|i| covariance[(i / 6, i % 6)]),
    }
}

/// The covariance of a message.
pub fn covariance_from_msg(message: &msg::PoseWithCovariance) -> Matrix6<f64> {
    Matrix6::from_fn(|row, column| message.covariance[6 * row + column])
}

/// A point as a message.
pub fn point_to_msg(point: &Point3<f64>) -> msg::Point {
    msg::Point { x: point.x, y: point.y, z: point.z }
}

/// A message as a point. NaN passes: callers decide what a missing point means.
pub fn point_from_msg(message: &msg::Point) -> Point3<f64> {
    Point3::new(message.x, message.y, message.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    #[test]
    fn poses_round_trip() {
        let pose = pose_from_xyz_rpy([0.1, -0.2, 0.3], [0.4, -1.5, 3.0]);
        for back in [
            pose_from_msg(&pose_to_msg(&pose), "x").expect("valid"),
            transform_from_msg(&transform_to_msg(&pose), "x").expect("valid"),
        ] {
            let (metres, radians) = pose_distance(&pose, &back);
            assert!(metres < 1e-12 && radians < 1e-7, "{metres} {radians}");
        }
    }

    #[test]
    fn bad_poses_are_refused_by_name() {
        let mut message = msg::Pose::default();
        message.position.x = f64::NAN;
        let text = pose_from_msg(&message, "/objects cup").expect_err("NaN").to_string();
        assert!(text.starts_with("/objects cup: "), "{text}");
        let mut message = msg::Pose::default();
        message.orientation.w = 0.0;
        assert!(pose_from_msg(&message, "x").is_err());
    }

    #[test]
    fn covariance_is_row_major() {
        let m = Matrix6::from_fn(|r, c| (10 * r + c) as f64);
        let message = pose_with_covariance(&Pose::identity(), &m);
        assert_eq!(message.covariance[7], 11.0);
        assert_eq!(message.covariance[1], 1.0);
        assert_eq!(covariance_from_msg(&message), m);
    }
}
