use super::{Desired, ExecutorParams};
use crate::kinematics::Joints;
use thiserror::Error;

/// One `control_msgs/JointTolerance`: 0 keeps the default, a negative value means no limit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointTolerance {
    /// The joint.
    pub name: String,
    /// Rad.
    pub position: f64,
    /// Rad/s.
    pub velocity: f64,
}

/// Tolerances that are not understood.
#[derive(Debug, Error, Clone, PartialEq)]
#[error("tolerance of joint {name:?}: {reason}")]
pub struct ToleranceError {
    /// The joint as it was named.
    pub name: String,
    /// What is wrong.
    pub reason: &'static str,
}

/// How well a goal has to be followed; `None` is no limit.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalTolerances {
    /// Distance between target and arm on the way (rad).
    pub path: [Option<f64>; 6],
    /// Difference in speed on the way (rad/s).
    pub path_velocity: [Option<f64>; 6],
    /// Distance from the goal at its end (rad).
    pub goal: [Option<f64>; 6],
    /// Speed at its end (rad/s).
    pub goal_velocity: [Option<f64>; 6],
    /// Time after the last point to come within the goal tolerance (s); `None` waits for ever.
    pub time: Option<f64>,
}

impl Default for GoalTolerances {
    /// Those of the official driver's configuration: 0.2 rad on the way, 0.1 rad and 0.2 rad/s at the end,
    /// no limit in time.
    fn default() -> Self {
        Self {
            path: [Some(0.2); 6],
            path_velocity: [None; 6],
            goal: [Some(0.1); 6],
            goal_velocity: [Some(0.2); 6],
            time: None,
        }
    }
}

impl GoalTolerances {
    /// The defaults, changed by a goal's lists and its `goal_time_tolerance` (s, 0 keeps the default).
    ///
    /// # Errors
    /// [`ToleranceError`].
    pub fn from_goal(
        path: &[JointTolerance],
        goal: &[JointTolerance],
        time: f64,
        params: &ExecutorParams,
    ) -> Result<Self, ToleranceError> {
        let mut out = Self::default();
        for (list, is_path) in [(path, true), (goal, false)] {
            for t in list {
                let bad = |reason| ToleranceError { name: t.name.clone(), reason };
                let i = params.names.iter().position(|n| *n == t.name);
                let i = i.ok_or_else(|| bad("no such joint"))?;
                let (position, velocity) = if is_path {
                    (&mut out.path[i], &mut out.path_velocity[i])
                } else {
                    (&mut out.goal[i], &mut out.goal_velocity[i])
                };
                for (slot, value) in [(position, t.position), (velocity, t.velocity)] {
                    match value {
                        v if v.is_nan() => return Err(bad("is not a number")),
                        0.0 => {}
                        v if v < 0.0 => *slot = None,
                        v => *slot = Some(v),
                    }
                }
            }
        }
        if time > 0.0 {
            out.time = Some(time);
        }
        Ok(out)
    }

    /// The first joint that is off its path, by how much and how much is allowed.
    pub(super) fn off_path(&self, desired: &Desired, q: &Joints, qd: &Joints) -> Option<String> {
        beyond(&self.path, &desired.q, q, "rad")
            .or_else(|| beyond(&self.path_velocity, &desired.qd, qd, "rad/s"))
    }

    /// What is still missing at the goal, `None` when it is reached.
    pub(super) fn off_goal(&self, goal: &Joints, q: &Joints, qd: &Joints) -> Option<String> {
        beyond(&self.goal, goal, q, "rad")
            .or_else(|| beyond(&self.goal_velocity, &[0.0; 6], qd, "rad/s"))
    }
}

fn beyond(limits: &[Option<f64>; 6], want: &Joints, have: &Joints, unit: &str) -> Option<String> {
    (0..6).find_map(|i| {
        let (allowed, off) = (limits[i]?, (want[i] - have[i]).abs());
        // What is not a number is beyond every limit.
        (!(off <= allowed)).then(|| {
            let joint = crate::kinematics::JOINT_NAMES[i];
            format!("{joint} is off by {off:.3} {unit}, {allowed:.3} is allowed")
        })
    })
}

/// `error_code` of `control_msgs/action/FollowJointTrajectory`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum GoalCode {
    /// Reached.
    Successful = 0,
    /// Replaced, stopped, or nothing to be followed.
    InvalidGoal = -1,
    /// The arm strayed from the path.
    PathTolerance = -4,
    /// The arm did not come to the goal in time.
    GoalTolerance = -5,
}

/// How a goal ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GoalEndReport {
    /// Number of the goal.
    pub id: u64,
    /// Code for the client.
    pub code: GoalCode,
    /// Sentence for the client.
    pub text: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_keeps_and_negative_lifts() {
        let p = ExecutorParams::default();
        let t = |name: &str, position, velocity| JointTolerance {
            name: name.into(),
            position,
            velocity,
        };
        let path = [t("elbow_joint", 0.05, 0.0), t("wrist_1_joint", -1.0, 0.3)];
        let goal = [t("wrist_3_joint", 0.0, -1.0)];
        let g = GoalTolerances::from_goal(&path, &goal, 0.5, &p).unwrap();
        assert_eq!(g.path, [Some(0.2), Some(0.2), Some(0.05), None, Some(0.2), Some(0.2)]);
        assert_eq!(g.path_velocity[3], Some(0.3));
        assert_eq!((g.goal[5], g.goal_velocity[5], g.time), (Some(0.1), None, Some(0.5)));
        assert!(GoalTolerances::from_goal(&[t("elbow", 0.1, 0.0)], &[], 0.0, &p).is_err());
        assert!(
            GoalTolerances::from_goal(&[t("elbow_joint", f64::NAN, 0.0)], &[], 0.0, &p).is_err()
        );
        let at = Desired { q: [0.0; 6], qd: [0.0; 6] };
        assert_eq!(g.off_path(&at, &[0.04; 6], &[0.0; 6]), None);
        assert!(g.off_path(&at, &[0.06; 6], &[0.0; 6]).unwrap().contains("elbow"));
        assert!(g.off_goal(&[0.0; 6], &[f64::NAN; 6], &[0.0; 6]).is_some());
    }
}
