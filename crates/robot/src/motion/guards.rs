//! What keeps the arm from moving: permission, the gripper's word, joint states, an arm that does not follow.

use super::controller::{ArmController, STOPPED};
use super::hold::Cause;
use super::law;
use super::sequence::Phase;
use super::types::{ControllerInput, JointState};
use crate::kinematics::JOINT_NAMES;
use tdv_geometry::Stamp;

/// A measured joint slower than this stands still (rad/s).
const STILL: f64 = 0.01;
/// How long an arm may stand still away from its command (s).
const STUCK_AFTER: f64 = 0.5;

impl ArmController {
    /// Holds the arm when it may not or cannot be moved.
    pub(super) fn guards(
        &mut self,
        now: Stamp,
        input: &ControllerInput,
        joints: Option<&JointState>,
        scaling: f64,
    ) {
        let ready = self.hold.as_ref().is_some_and(|h| h.cause == Cause::Ready);
        if ready {
            return;
        }
        if input.disabled.is_none() && scaling >= STOPPED {
            self.enabled_again();
        }
        if let Some(why) = &input.disabled {
            self.hold(now, Cause::Disabled, format!("not enabled: {why}"));
        } else if let Some(silence) = self.gripper_silence(now, input) {
            let text = format!("no word of the gripper for {silence:.1} s: is its driver alive?");
            self.hold(now, Cause::Gripper, text);
        } else if scaling < STOPPED {
            let text = format!("speed scaling is {scaling:.2}: the robot is stopped or paused");
            self.hold(now, Cause::Disabled, text);
        } else if let Some(j) = joints {
            if self.hold.is_none() {
                self.watch_following(now, j);
            }
        } else if self.hold.as_ref().is_none_or(|h| h.cause == Cause::Joints) {
            let text = match &input.joints {
                Some(j) => format!(
                    "no usable joint state for {:.2} s: is the driver alive?",
                    now.since(j.stamp)
                ),
                None => "no joint state: is the driver alive?".into(),
            };
            let first = self.hold.is_none();
            if first {
                self.hold(now, Cause::Joints, text);
            } else if let Some(h) = &mut self.hold {
                h.sentence = text;
            }
        }
    }

    /// What is said of a hold whose cause is gone.
    fn enabled_again(&mut self) {
        if let Some(h) = self.hold.as_mut().filter(|h| h.cause == Cause::Disabled) {
            h.sentence = "enabled again after a stop".into();
        }
    }

    /// Holds when the arm is too far from its command, or stands still a little way from it.
    fn watch_following(&mut self, now: Stamp, j: &JointState) {
        let Some(c) = self.commanded_state() else { return };
        let error = |i: usize| (c.q[i] - j.q[i]).abs();
        let worst = (0..6).max_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap_or(0);
        let (apart, name) = (error(worst), JOINT_NAMES[worst]);
        let still = law::max_abs(&j.qd) < STILL && apart > self.params.reseed_threshold;
        let since = if still { *self.stuck_since.get_or_insert(now) } else { now };
        if !still {
            self.stuck_since = None;
        }
        let allowed = self.params.max_following_error;
        if apart > allowed {
            let text = format!(
                "{name} is {apart:.3} rad from its command, {allowed:.3} is allowed: the arm does not follow"
            );
            self.hold(now, Cause::Joints, text);
        } else if now.since(since) > STUCK_AFTER {
            self.stuck_since = None;
            let text = format!(
                "{name} stands still {apart:.3} rad from its command: the arm does not follow"
            );
            self.hold(now, Cause::Joints, text);
        }
    }

    /// How long (s) the gripper has been silent, when that is too long and the phase needs it.
    pub(super) fn gripper_silence(&self, now: Stamp, input: &ControllerInput) -> Option<f64> {
        let needed = !matches!(self.phase, Phase::Start | Phase::Homing { .. } | Phase::Done);
        let silence = now.since(input.gripper?.stamp);
        (needed && silence > self.params.grip.feedback_timeout).then_some(silence)
    }
}
