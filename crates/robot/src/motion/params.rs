use crate::gripper::{KNUCKLE_CLOSED, KNUCKLE_OPEN};
use crate::kinematics::Joints;
use crate::limits::Limits;
use serde::{Deserialize, Serialize};

/// How the gripper is used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GripParams {
    /// Knuckle angle (rad) commanded to close; full closing, so that only an object stops it.
    pub close_position: f64,
    /// Knuckle angle (rad) commanded to open.
    pub open_position: f64,
    /// The gripper counts as open within this of `open_position` (rad).
    pub open_tolerance: f64,
    /// Greatest effort sent with a command (the action's `max_effort`).
    pub max_effort: f64,
    /// Pads nearer to each other than this (m) hold nothing; fully closed they are 1.0 mm apart.
    pub min_gap: f64,
    /// Contact must come within this time (s) of the close command.
    pub close_timeout: f64,
    /// The gripper must be open within this time (s) of the open command.
    pub open_timeout: f64,
    /// The arm has been commanded at rest for this long (s) before the gripper moves.
    pub settle: f64,
    /// Pause (s) between the confirmed grip and the next procedure.
    pub dwell: f64,
    /// Pads closed for longer than this (s) while holding: the object is lost.
    pub lost_after: f64,
    /// Pads that have come nearer to each other by this (m) since the grip hold the object no more.
    pub slip_gap: f64,
    /// An object that the camera sees apart from the gripper for longer than this (s) has slipped out.
    pub slip_after: f64,
    /// Without a word of the gripper for longer than this (s) the arm holds.
    pub feedback_timeout: f64,
}

impl Default for GripParams {
    fn default() -> Self {
        Self {
            close_position: KNUCKLE_CLOSED,
            open_position: KNUCKLE_OPEN,
            open_tolerance: 0.06,
            max_effort: 50.0,
            min_gap: 0.002,
            close_timeout: 3.0,
            open_timeout: 3.0,
            settle: 0.12,
            dwell: 0.4,
            lost_after: 0.15,
            slip_gap: 0.008,
            slip_after: 0.4,
            feedback_timeout: 0.6,
        }
    }
}

/// Parameters of [`super::ArmController`]; times in seconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControllerParams {
    /// Limits of the motion.
    pub limits: Limits,
    /// Period of [`super::ArmController::step`].
    pub tick: f64,
    /// A trajectory goes out every this many ticks.
    pub publish_every: u32,
    /// How far ahead of now the plan is read; makes up for what lies between command and motion, so
    /// that replanning from the measured pose does not stall.
    pub lookahead: f64,
    /// Time constant with which a new plan takes over from the one before.
    pub blend_time: f64,
    /// How long a trajectory follows the plan before it decelerates to rest.
    pub horizon: f64,
    /// Time of the first point sent. At 0 it is the present command: a joint trajectory controller of
    /// ros2_control would otherwise go to the first point from the measured joints, which lag behind.
    pub first_point: f64,
    /// A plan whose observation is older than this makes no trajectory.
    pub stale_after: f64,
    /// A stamp further than this in the future is refused.
    pub future_tolerance: f64,
    /// Joint states older than this stop the motion.
    pub joint_state_timeout: f64,
    /// Greatest distance (m) of a new plan from the commanded tool.
    pub max_plan_jump: f64,
    /// Greatest rotation (rad) of a new plan from the commanded tool.
    pub max_plan_turn: f64,
    /// Greatest change of a joint (rad) from the commanded configuration to the plan's; more is
    /// another branch of the inverse kinematics.
    pub max_ik_jump: f64,
    /// Greatest difference (rad) between commanded and measured joints.
    pub max_following_error: f64,
    /// Below this difference (rad) a restart goes on from the commanded joints, above from the
    /// measured ones.
    pub reseed_threshold: f64,
    /// Gain (1/s) from joint error to velocity.
    pub position_gain: f64,
    /// Gain (1/s) from velocity error to acceleration.
    pub velocity_gain: f64,
    /// A plan below the table's clearance by at most this (m) slides along it; deeper is refused.
    pub table_slide: f64,
    /// Everything but motion: paths are made from where the arm is and shown, nothing is commanded.
    pub dry_run: bool,
    /// After a stop go on by itself once the cause is gone; for the lab only.
    pub auto_resume: bool,
    /// The gripper.
    pub grip: GripParams,
    /// Pause before the release.
    pub release_dwell: f64,
    /// Way back along the tool's -z after a release or a failed grip (m).
    pub retreat_distance: f64,
    /// Greatest speed on that way (m/s).
    pub retreat_speed: f64,
    /// Joint angles (rad) of the home pose.
    pub home: Joints,
    /// Greatest joint speed on the way home (rad/s).
    pub home_speed: f64,
}

impl Default for ControllerParams {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            tick: 0.008,
            publish_every: 2,
            lookahead: 0.15,
            blend_time: 0.1,
            horizon: 0.064,
            first_point: 0.0,
            stale_after: 0.150,
            future_tolerance: 0.02,
            joint_state_timeout: 0.15,
            max_plan_jump: 0.20,
            max_plan_turn: 1.2,
            max_ik_jump: 1.5,
            max_following_error: 0.25,
            reseed_threshold: 0.02,
            position_gain: 8.0,
            velocity_gain: 32.0,
            table_slide: 0.010,
            dry_run: false,
            auto_resume: false,
            grip: GripParams::default(),
            release_dwell: 0.3,
            retreat_distance: 0.10,
            retreat_speed: 0.12,
            home: [0.0, -1.9, 1.9, -1.5708, -1.5708, 0.0],
            home_speed: 0.5,
        }
    }
}

impl ControllerParams {
    /// Checks every value.
    ///
    /// # Errors
    /// One sentence for each problem.
    pub fn validate(&self) -> Result<(), Vec<String>> {
        let mut bad = self.limits.validate().err().unwrap_or_default();
        let mut range = |name: &str, v: f64, lo: f64, hi: f64| {
            if !(v >= lo && v <= hi) {
                bad.push(format!("{name} is {v}, expected {lo}..{hi}"));
            }
        };
        range("tick", self.tick, 0.001, 0.02);
        range("publish_every", f64::from(self.publish_every), 1.0, 10.0);
        range("lookahead", self.lookahead, 0.0, 0.5);
        range("blend_time", self.blend_time, 0.0, 1.0);
        range("horizon", self.horizon, 2.0 * self.tick, 0.15);
        range("first_point", self.first_point, 0.0, self.horizon);
        range("stale_after", self.stale_after, 0.02, 1.0);
        range("future_tolerance", self.future_tolerance, 0.0, 0.1);
        range("joint_state_timeout", self.joint_state_timeout, 0.01, 1.0);
        range("max_plan_jump", self.max_plan_jump, 0.01, 1.0);
        range("max_plan_turn", self.max_plan_turn, 0.05, 3.2);
        range("max_ik_jump", self.max_ik_jump, 0.05, 3.2);
        range("max_following_error", self.max_following_error, 0.02, 1.0);
        range("reseed_threshold", self.reseed_threshold, 0.0, self.max_following_error);
        range("position_gain", self.position_gain, 0.5, 30.0);
        range("velocity_gain", self.velocity_gain, 2.0 * self.position_gain, 60.0);
        range("table_slide", self.table_slide, 0.0, 0.05);
        range("grip.close_position", self.grip.close_position, 0.0, KNUCKLE_CLOSED);
        range("grip.open_position", self.grip.open_position, 0.0, self.grip.close_position);
        range("grip.min_gap", self.grip.min_gap, 0.0, 0.08);
        range("grip.close_timeout", self.grip.close_timeout, 0.1, 30.0);
        range("grip.open_timeout", self.grip.open_timeout, 0.1, 30.0);
        range("grip.settle", self.grip.settle, 0.0, 5.0);
        range("grip.dwell", self.grip.dwell, 0.0, 10.0);
        range("grip.slip_gap", self.grip.slip_gap, 0.001, 0.085);
        range("grip.slip_after", self.grip.slip_after, 0.05, 10.0);
        range("grip.feedback_timeout", self.grip.feedback_timeout, 0.05, 10.0);
        range("release_dwell", self.release_dwell, 0.0, 10.0);
        range("retreat_distance", self.retreat_distance, 0.0, 0.3);
        range("retreat_speed", self.retreat_speed, 0.01, self.limits.tcp_speed);
        range("home_speed", self.home_speed, 0.01, self.limits.joint_velocity);
        let stop = self.stop_time();
        if !(stop > 0.0) {
            bad.push(format!(
                "horizon {} leaves no time to stop within rest_within {}",
                self.horizon, self.limits.rest_within
            ));
        } else if 1.5 * self.limits.joint_velocity / stop > self.limits.stop_acceleration {
            bad.push(format!(
                "stopping from joint_velocity {} in {stop:.3} s takes {:.1} rad/s^2, stop_acceleration is {}",
                self.limits.joint_velocity,
                1.5 * self.limits.joint_velocity / stop,
                self.limits.stop_acceleration
            ));
        }
        for (i, v) in self.home.iter().enumerate() {
            if !(*v >= self.limits.joint_lower[i] && *v <= self.limits.joint_upper[i]) {
                bad.push(format!("home[{i}] is {v}, outside the joint's limits"));
            }
        }
        if bad.is_empty() { Ok(()) } else { Err(bad) }
    }

    /// Seconds a trajectory has for its deceleration.
    pub(super) fn stop_time(&self) -> f64 {
        self.limits.rest_within - self.law_steps() as f64 * self.tick - 1e-6
    }

    /// Ticks a trajectory follows the plan.
    pub(super) fn law_steps(&self) -> usize {
        (self.horizon / self.tick).round().max(1.0) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_problems_are_named() {
        assert_eq!(ControllerParams::default().validate(), Ok(()));
        let mut p = ControllerParams { lookahead: f64::NAN, ..Default::default() };
        p.limits.stop_acceleration = 2.0;
        let e = p.validate().unwrap_err();
        assert_eq!(e.len(), 2, "{e:?}");
        assert!(serde_saphyr::from_str::<ControllerParams>("lookahed: 1.0").is_err());
        let read: ControllerParams = serde_saphyr::from_str("lookahead: 0.1").unwrap();
        assert_eq!(read, ControllerParams { lookahead: 0.1, ..Default::default() });
    }
}
