//! Messages to what the controller's core takes.

use tdv_geometry::{Pose, Stamp};
use tdv_msgs::sensor_msgs::msg::JointState as JointMessage;
use tdv_msgs::tdv_msgs::msg::{PoseTrajectory, Procedure, TrackedObject, TrackedObjects};
use tdv_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use tdv_robot::JOINT_NAMES;
use tdv_robot::gripper::KNUCKLE_JOINT;
use tdv_robot::motion::{
    Attach, GripperEnd, JointPath, JointState, Moving, ObjectPlace, ObjectReport, Plan,
    ProcedureState,
};
use tdv_runtime::tracked;

/// The arm's joints (rad, UR order), found by name; none when one is missing or no number.
pub fn arm_joints(m: &JointMessage) -> Option<JointState> {
    let mut state = JointState { stamp: tracked::stamp(&m.header), q: [0.0; 6], qd: [0.0; 6] };
    for (i, name) in JOINT_NAMES.iter().enumerate() {
        let at = m.name.iter().position(|n| n == name)?;
        state.q[i] = *m.position.get(at).filter(|v| v.is_finite())?;
        state.qd[i] = m.velocity.get(at).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
    }
    Some(state)
}

/// The gripper's knuckle angle (rad), which may come in a message of its own.
pub fn knuckle(m: &JointMessage) -> Option<f64> {
    let at = m.name.iter().position(|n| n == KNUCKLE_JOINT)?;
    m.position.get(at).copied().filter(|v| v.is_finite())
}

/// A prediction; none for one without poses.
///
/// # Errors
/// A sentence that says which number is no pose.
pub fn plan(m: &PoseTrajectory, grasp_offset: &[f64]) -> Result<Option<Plan>, String> {
    if m.poses.is_empty() {
        return Ok(None);
    }
    let pose = |what: &str, p| tracked::pose(p).map_err(|e| format!("{what}: {e}"));
    let mut reference_pose = pose("reference_pose", &m.reference_pose)?;
    let moving = if m.moving == "tcp" { Moving::Tcp } else { Moving::Object };
    if moving == Moving::Tcp {
        for (v, offset) in reference_pose.translation.vector.iter_mut().zip(grasp_offset) {
            *v += offset;
        }
    }
    let poses = m
        .poses
        .iter()
        .enumerate()
        .map(|(i, p)| pose(&format!("pose {i}"), p))
        .collect::<Result<Vec<Pose>, _>>()?;
    Ok(Some(Plan {
        stamp: tracked::stamp(&m.header),
        procedure: m.procedure,
        moving,
        reference_pose,
        moving_pose: Some(pose("moving_pose", &m.moving_pose)?),
        poses,
        dt: m.dt,
    }))
}

/// The switch policy's word.
pub fn procedure(m: &Procedure) -> ProcedureState {
    ProcedureState {
        stamp: tracked::stamp(&m.header),
        procedure: m.procedure,
        complete: m.complete,
        grip: m.grip,
        moving: if m.moving == "tcp" { Moving::Tcp } else { Moving::Object },
        end: match m.end {
            Procedure::END_CLOSE => GripperEnd::Close,
            Procedure::END_OPEN => GripperEnd::Open,
            _ => GripperEnd::None,
        },
    }
}

/// Pose of the held object in the gripper, while the tracker says that one is held.
pub fn attach(m: &TrackedObjects) -> Option<Attach> {
    let held = m.objects.iter().find(|o| o.state == TrackedObject::HELD)?;
    let tcp = tracked::usable_pose(m, "tcp")?;
    let object = tracked::pose(&held.pose.pose).ok()?;
    Some(Attach { stamp: tracked::stamp(&m.header), pose: tcp.inverse() * object })
}

/// What the tracker says of the object `name`; none when it says nothing.
pub fn report(m: &TrackedObjects, name: &str) -> Option<ObjectReport> {
    let object = m.objects.iter().find(|o| o.name == name)?;
    let place = match object.state {
        TrackedObject::HELD => ObjectPlace::Held,
        TrackedObject::TRACKING => ObjectPlace::Apart,
        _ => ObjectPlace::Unknown,
    };
    Some(ObjectReport { stamp: tracked::stamp(&m.header), place })
}

/// A path as the joint trajectory controller takes it: without its stamp it starts on arrival.
pub fn trajectory(path: &JointPath, stamped: bool) -> JointTrajectory {
    let begin = if stamped { path.stamp } else { Stamp(0) };
    JointTrajectory {
        header: tracked::header_in(begin, ""),
        joint_names: JOINT_NAMES.map(String::from).to_vec(),
        points: path
            .points
            .iter()
            .map(|p| JointTrajectoryPoint {
                positions: p.q.to_vec(),
                velocities: p.qd.to_vec(),
                time_from_start: tracked::duration(p.time),
                ..Default::default()
            })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn joints_are_found_by_name_in_any_order() {
        let mut m = JointMessage::default();
        for (i, name) in JOINT_NAMES.iter().enumerate().rev() {
            m.name.push((*name).into());
            m.position.push(i as f64);
            m.velocity.push(f64::NAN);
        }
        let s = arm_joints(&m).unwrap();
        assert_eq!(s.q, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(s.qd, [0.0; 6]);
        assert_eq!(knuckle(&m), None);
        m.position[2] = f64::NAN;
        assert!(arm_joints(&m).is_none());
        m.name.pop();
        assert!(arm_joints(&m).is_none());
    }

    #[test]
    fn procedures_say_what_the_gripper_does() {
        let mut m = Procedure { moving: "mug".into(), grip: true, ..Default::default() };
        assert_eq!((procedure(&m).end, procedure(&m).moving), (GripperEnd::None, Moving::Object));
        (m.end, m.moving) = (Procedure::END_OPEN, "tcp".into());
        assert_eq!((procedure(&m).end, procedure(&m).moving), (GripperEnd::Open, Moving::Tcp));
        assert!(procedure(&m).grip && !procedure(&m).complete);
    }

    #[test]
    fn empty_and_broken_plans() {
        let mut m = PoseTrajectory { moving: "tcp".into(), ..Default::default() };
        assert_eq!(plan(&m, &[0.0; 3]), Ok(None));
        let pose = tracked::pose_message(&pose_from_xyz_rpy([0.1, 0.0, 0.0], [0.0; 3]));
        m.reference_pose = pose.clone();
        m.moving_pose = pose.clone();
        m.poses = vec![pose; 2];
        let p = plan(&m, &[0.03, 0.0, 0.0]).unwrap().unwrap();
        assert!((p.reference_pose.translation.x - 0.13).abs() < 1e-12);
        m.poses[1].position.y = f64::NAN;
        assert!(plan(&m, &[0.0; 3]).unwrap_err().contains("pose 1"));
    }
}
