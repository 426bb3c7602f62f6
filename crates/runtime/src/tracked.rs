//! Our types and the fields of tracked objects and plans.

use crate::convert_time;
use tdv_geometry::{GeometryError, Pose, Stamp, pose_from_xyz_quat, pose_to_xyz_quat};
use tdv_msgs::builtin_interfaces::msg::Duration;
use tdv_msgs::geometry_msgs::msg::{
    Point, Pose as PoseMessage, Quaternion, Transform, TransformStamped, Vector3,
};
use tdv_msgs::std_msgs::msg::Header;
use tdv_msgs::tdv_msgs::msg::{TrackedObject, TrackedObjects};
use tdv_msgs::vision_msgs::msg::{Detection3D, ObjectHypothesisWithPose};

/// Stamp of a header.
pub fn stamp(header: &Header) -> Stamp {
    Stamp::from_ros(header.stamp.sec, header.stamp.nanosec)
}

/// A header in `base_link`.
pub fn header(stamp: Stamp) -> Header {
    header_in(stamp, "base_link")
}

/// A header in another frame.
pub fn header_in(stamp: Stamp, frame_id: &str) -> Header {
    Header { stamp: convert_time(stamp), frame_id: frame_id.into() }
}

/// Seconds as a message field; negative and non-finite ones become zero.
pub fn duration(seconds: f64) -> Duration {
    let ns = if seconds.is_finite() { (seconds.max(0.0) * 1e9).round() as i64 } else { 0 };
    Duration { sec: (ns / 1_000_000_000) as i32, nanosec: (ns % 1_000_000_000) as u32 }
}

/// A pose as a message field.
pub fn pose_message(pose: &Pose) -> PoseMessage {
    let ([x, y, z], q) = pose_to_xyz_quat(pose);
    PoseMessage {
        position: Point { x, y, z },
        orientation: Quaternion { x: q[0], y: q[1], z: q[2], w: q[3] },
    }
}

/// A pose from a message field.
///
/// # Errors
/// [`GeometryError`] for numbers that are no pose.
pub fn pose(message: &PoseMessage) -> Result<Pose, GeometryError> {
    let (p, q) = (&message.position, &message.orientation);
    pose_from_xyz_quat([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
}

/// A transform for `/tf`.
pub fn transform(parent: &str, child: &str, stamp: Stamp, pose: &Pose) -> TransformStamped {
    let ([x, y, z], q) = pose_to_xyz_quat(pose);
    TransformStamped {
        header: header_in(stamp, parent),
        child_frame_id: child.into(),
        transform: Transform {
            translation: Vector3 { x, y, z },
            rotation: Quaternion { x: q[0], y: q[1], z: q[2], w: q[3] },
        },
    }
}

/// The pose of a transform.
///
/// # Errors
/// [`GeometryError`] for numbers that are no pose.
pub fn transform_pose(t: &TransformStamped) -> Result<Pose, GeometryError> {
    let (v, q) = (&t.transform.translation, &t.transform.rotation);
    pose_from_xyz_quat([v.x, v.y, v.z], [q.x, q.y, q.z, q.w])
}

/// One object of a `Detection3DArray`: name, `T_camera_object`, covariance (row-major: xyz, then rotation),
/// score 0..1 (0: not found).
pub fn detection_message(
    header: &Header,
    name: &str,
    pose: &Pose,
    covariance: [f64; 36],
    score: f64,
) -> Detection3D {
    let mut result = ObjectHypothesisWithPose::default();
    result.hypothesis.class_id = name.into();
    result.hypothesis.score = score;
    result.pose.pose = pose_message(pose);
    result.pose.covariance = covariance;
    let mut detection =
        Detection3D { header: header.clone(), id: name.into(), ..Default::default() };
    detection.bbox.center = pose_message(pose);
    detection.results = vec![result];
    detection
}

/// Name, `T_camera_object`, covariance and score of a detection; other programs' detections that carry the
/// name only as class are understood too.
///
/// # Errors
/// A sentence that names what is missing or wrong.
pub fn detection_parts(d: &Detection3D) -> Result<(String, Pose, [f64; 36], f64), String> {
    let name = if d.id.is_empty() {
        d.results.first().map(|r| r.hypothesis.class_id.clone()).unwrap_or_default()
    } else {
        d.id.clone()
    };
    let Some(best) =
        d.results.iter().max_by(|a, b| a.hypothesis.score.total_cmp(&b.hypothesis.score))
    else {
        return Err(format!("the detection of {name:?} has no result"));
    };
    if !best.hypothesis.score.is_finite() || best.pose.covariance.iter().any(|v| !v.is_finite()) {
        return Err(format!("score or covariance of {name:?} is not finite"));
    }
    let pose = pose(&best.pose.pose).map_err(|e| format!("{name:?}: {e}"))?;
    Ok((name, pose, best.pose.covariance, best.hypothesis.score))
}

/// `T_base_object` of a tracked frame that may be acted on: tracked, held, or hidden for a short time.
pub fn usable_pose(objects: &TrackedObjects, name: &str) -> Option<Pose> {
    let object = objects.objects.iter().find(|o| o.name == name)?;
    let usable = matches!(
        object.state,
        TrackedObject::TRACKING | TrackedObject::OCCLUDED | TrackedObject::HELD
    );
    if usable { pose(&object.pose.pose).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn only_believed_and_whole_poses_are_usable() {
        let object = |name: &str, state| {
            let mut o = TrackedObject { name: name.into(), state, ..Default::default() };
            o.pose.pose = pose_message(&pose_from_xyz_rpy([0.1, 0.2, 0.3], [0.0, 0.0, 1.0]));
            o
        };
        let mut broken = object("broken", TrackedObject::TRACKING);
        broken.pose.pose.position.x = f64::NAN;
        let objects = TrackedObjects {
            header: header(Stamp(5)),
            objects: vec![
                object("a", TrackedObject::TRACKING),
                object("lost", TrackedObject::LOST),
                object("new", TrackedObject::INIT),
                broken,
            ],
        };
        assert_eq!(stamp(&objects.header), Stamp(5));
        assert!((usable_pose(&objects, "a").unwrap().translation.z - 0.3).abs() < 1e-12);
        for name in ["lost", "new", "broken", "absent"] {
            assert!(usable_pose(&objects, name).is_none(), "{name}");
        }
    }
}
