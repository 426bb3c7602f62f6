use super::{ExecutorParams, JointTrajectory};
use tdv_geometry::Stamp;
use thiserror::Error;

/// Why a trajectory is not executed; [`TrajectoryRejection::code`] gives the result code of
/// `control_msgs/action/FollowJointTrajectory`.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TrajectoryRejection {
    /// Not exactly the six joints.
    #[error("joint names {names:?} are not the six of this arm, each once: {reason}")]
    Joints {
        /// What came.
        names: Vec<String>,
        /// What is wrong with it.
        reason: String,
    },
    /// No point.
    #[error("trajectory has no points")]
    Empty,
    /// Times do not increase.
    #[error(
        "time_from_start of point {index} is {time} s, expected a finite time after the point before"
    )]
    Time {
        /// The point.
        index: usize,
        /// Seconds.
        time: f64,
    },
    /// A field of the wrong length.
    #[error("point {index} has {count} {field}, expected {expected}")]
    Size {
        /// The point.
        index: usize,
        /// Which field.
        field: &'static str,
        /// How many there are.
        count: usize,
        /// How many there should be.
        expected: &'static str,
    },
    /// A NaN or an infinity.
    #[error("point {index} has a {field} that is not finite")]
    NotFinite {
        /// The point.
        index: usize,
        /// Which field.
        field: &'static str,
    },
    /// A position outside the joint's range.
    #[error("point {index}: {joint} at {value:.3} rad is outside {lower:.3}..{upper:.3}")]
    Range {
        /// The point.
        index: usize,
        /// The joint.
        joint: String,
        /// Rad.
        value: f64,
        /// Rad.
        lower: f64,
        /// Rad.
        upper: f64,
    },
    /// The trajectory does not end at rest.
    #[error("last point moves {joint} at {value:.4} rad/s, expected zero velocity")]
    EndsMoving {
        /// The joint.
        joint: String,
        /// Rad/s.
        value: f64,
    },
    /// All of it lies in the past.
    #[error("trajectory ended {:.3} s ago by its header stamp", .ago)]
    Past {
        /// Seconds.
        ago: f64,
    },
}

impl TrajectoryRejection {
    /// -1 invalid goal, -2 invalid joints, -3 old header stamp.
    pub fn code(&self) -> i32 {
        match self {
            Self::Joints { .. } => -2,
            Self::Past { .. } => -3,
            _ => -1,
        }
    }
}

/// `order[i]` is the index in the message of joint `i` of the arm.
pub(super) fn validate(
    t: &JointTrajectory,
    now: Stamp,
    p: &ExecutorParams,
) -> Result<[usize; 6], TrajectoryRejection> {
    let order = joint_order(t, p)?;
    let Some(last) = t.points.last() else { return Err(TrajectoryRejection::Empty) };
    let mut before = f64::NEG_INFINITY;
    for (index, point) in t.points.iter().enumerate() {
        let time = point.time_from_start;
        if !time.is_finite() || time <= before || time < 0.0 {
            return Err(TrajectoryRejection::Time { index, time });
        }
        before = time;
        for (field, v, required) in [
            ("positions", &point.positions, true),
            ("velocities", &point.velocities, false),
            ("accelerations", &point.accelerations, false),
        ] {
            if v.len() != 6 && (required || !v.is_empty()) {
                let expected = if required { "6" } else { "6 or none" };
                return Err(TrajectoryRejection::Size { index, field, count: v.len(), expected });
            }
            if !v.iter().all(|x| x.is_finite()) {
                return Err(TrajectoryRejection::NotFinite { index, field });
            }
        }
        if !point.effort.is_empty() {
            let (count, expected) = (point.effort.len(), "none");
            return Err(TrajectoryRejection::Size { index, field: "efforts", count, expected });
        }
        for i in 0..6 {
            let (value, lower, upper) = (point.positions[order[i]], p.lower[i], p.upper[i]);
            if !(value >= lower && value <= upper) {
                let joint = p.names[i].clone();
                return Err(TrajectoryRejection::Range { index, joint, value, lower, upper });
            }
        }
    }
    if let Some(i) = last.velocities.iter().position(|v| v.abs() > f64::from(f32::EPSILON)) {
        let (joint, value) = (t.names[i].clone(), last.velocities[i]);
        return Err(TrajectoryRejection::EndsMoving { joint, value });
    }
    if let Some(stamp) = t.stamp {
        let ago = now.since(stamp.plus(last.time_from_start));
        if ago > 0.0 {
            return Err(TrajectoryRejection::Past { ago });
        }
    }
    Ok(order)
}

fn joint_order(t: &JointTrajectory, p: &ExecutorParams) -> Result<[usize; 6], TrajectoryRejection> {
    let refuse = |reason: String| TrajectoryRejection::Joints { names: t.names.clone(), reason };
    if t.names.len() != 6 {
        return Err(refuse(format!("{} names", t.names.len())));
    }
    let mut order = [0; 6];
    for (slot, name) in order.iter_mut().zip(&p.names) {
        *slot = t
            .names
            .iter()
            .position(|n| n == name)
            .ok_or_else(|| refuse(format!("{name} is missing")))?;
    }
    Ok(order)
}
