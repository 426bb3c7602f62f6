//! Rigid-body geometry shared by every crate: poses, stamps, trajectories, interpolation, frames.
//!
//! Conventions (REP-103, REP-105): metres, radians, seconds; right-handed frames; quaternions are
//! written x, y, z, w. `T_a_b` names the pose of frame b seen from frame a, so that
//! `T_a_c = T_a_b * T_b_c`.

mod frames;
mod interpolation;
mod pose;
mod stamp;
mod symmetry;
mod trajectory;

pub use frames::{FrameError, FrameTree};
pub use interpolation::{interpolate, min_jerk, smooth_step};
pub use pose::{
    GeometryError, Pose, exact_rotation, pose_distance, pose_exp, pose_from_xyz_quat,
    pose_from_xyz_rpy, pose_log, pose_to_xyz_quat, rotation_6d, rotation_from_6d,
    rotation_from_matrix, twist_arc, yaw_of,
};
pub use stamp::Stamp;
pub use symmetry::Symmetry;
pub use trajectory::{PoseTrajectory, TimedPose};

pub use nalgebra;
