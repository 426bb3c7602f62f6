//! Which controller has the arm after a `switch_controller`, by the rules of ros2_control.

use tdv_robot::MotionController;

/// `strictness` of the service; zero is the default, best effort.
const STRICT: i32 = 2;
const AUTO: i32 = 3;
const FORCE_AUTO: i32 = 4;

/// The controllers by name: those that move the arm exclude each other, the others are always active.
pub struct Controllers {
    motion: [(String, MotionController); 3],
}

/// Controllers that only publish or serve; they cannot be switched off.
pub const BROADCASTERS: [(&str, &str); 5] = [
    ("joint_state_broadcaster", "joint_state_broadcaster/JointStateBroadcaster"),
    ("io_and_status_controller", "ur_controllers/GPIOController"),
    ("speed_scaling_state_broadcaster", "ur_controllers/SpeedScalingStateBroadcaster"),
    (
        "force_torque_sensor_broadcaster",
        "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster",
    ),
    ("tcp_pose_broadcaster", "pose_broadcaster/PoseBroadcaster"),
];

impl Controllers {
    /// `trajectory` is the configured name of the trajectory controller.
    pub fn new(trajectory: &str) -> Self {
        Self {
            motion: [
                (trajectory.to_owned(), MotionController::Trajectory),
                ("forward_position_controller".to_owned(), MotionController::Position),
                ("forward_velocity_controller".to_owned(), MotionController::Velocity),
            ],
        }
    }

    /// Names and kinds of those that move the arm.
    pub fn motion(&self) -> impl Iterator<Item = (&str, MotionController)> {
        self.motion.iter().map(|(name, kind)| (name.as_str(), *kind))
    }

    fn kind(&self, name: &str) -> Result<Option<MotionController>, String> {
        if let Some((_, kind)) = self.motion.iter().find(|m| m.0 == name) {
            return Ok(Some(*kind));
        }
        if BROADCASTERS.iter().any(|b| b.0 == name) {
            return Ok(None);
        }
        Err(format!("there is no controller {name:?}"))
    }

    /// The active one after the switch.
    ///
    /// # Errors
    /// A sentence; then nothing changes.
    pub fn switch(
        &self,
        active: Option<MotionController>,
        activate: &[String],
        deactivate: &[String],
        strictness: i32,
    ) -> Result<Option<MotionController>, String> {
        let strict = matches!(strictness, STRICT | AUTO | FORCE_AUTO);
        let mut next = active;
        let mut good = 0;
        for name in deactivate {
            match self.kind(name) {
                Ok(Some(kind)) if active == Some(kind) => {
                    next = None;
                    good += 1;
                }
                Ok(Some(_)) if strict => return Err(format!("{name:?} is not active")),
                Ok(None) => return Err(format!("{name:?} is always active here")),
                Err(why) if strict => return Err(why),
                _ => {}
            }
        }
        if !deactivate.is_empty() && good == 0 && !strict {
            return Err(format!("none of {deactivate:?} can be deactivated"));
        }
        let mut wanted = Vec::new();
        for name in activate {
            match self.kind(name) {
                Ok(Some(kind)) if next == Some(kind) => {
                    if strict {
                        return Err(format!("{name:?} is already active"));
                    }
                }
                Ok(Some(kind)) => wanted.push((name, kind)),
                Ok(None) if strict => return Err(format!("{name:?} is already active")),
                Err(why) if strict => return Err(why),
                _ => {}
            }
        }
        match wanted[..] {
            [] if !activate.is_empty() && activate.iter().all(|n| self.kind(n).is_err()) => {
                Err(format!("none of {activate:?} is known"))
            }
            [] => Ok(next),
            [(_, kind)] if next.is_none() || strictness == FORCE_AUTO => Ok(Some(kind)),
            [(name, _)] => Err(format!(
                "{name:?} needs the joints that {:?} has: deactivate that one in the same call",
                self.name_of(next)
            )),
            _ => Err(format!("{activate:?} need the same joints: only one can be active")),
        }
    }

    fn name_of(&self, kind: Option<MotionController>) -> &str {
        self.motion().find(|m| Some(m.1) == kind).map_or("none", |m| m.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use MotionController::{Position, Trajectory, Velocity};

    const JTC: &str = "scaled_joint_trajectory_controller";
    const FPC: &str = "forward_position_controller";
    const FVC: &str = "forward_velocity_controller";

    fn switch(
        active: Option<MotionController>,
        on: &[&str],
        off: &[&str],
        strictness: i32,
    ) -> Result<Option<MotionController>, String> {
        let list = |l: &[&str]| l.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        Controllers::new(JTC).switch(active, &list(on), &list(off), strictness)
    }

    #[test]
    fn strict_refuses_what_best_effort_overlooks() {
        let t = Some(Trajectory);
        assert_eq!(switch(t, &[FPC], &[JTC], STRICT), Ok(Some(Position)));
        assert_eq!(switch(t, &[], &[JTC], STRICT), Ok(None));
        assert_eq!(switch(None, &[FVC], &[], STRICT), Ok(Some(Velocity)));
        for (on, off) in [
            (&["nobody"][..], &[JTC][..]),
            (&[FPC], &["nobody"]),
            (&[FPC], &[FVC]),
            (&[JTC], &[]),
            (&[FPC, FVC], &[JTC]),
            (&[FPC], &[]),
        ] {
            assert!(switch(t, on, off, STRICT).is_err(), "{on:?} {off:?}");
        }
        assert_eq!(switch(t, &[FPC, "nobody"], &[JTC, "no one"], 1), Ok(Some(Position)));
        assert_eq!(switch(t, &[JTC], &[], 1), Ok(t));
        assert!(switch(t, &["nobody"], &[], 1).is_err());
        assert!(switch(t, &[FPC], &[], 1).is_err(), "best effort does not take joints away");
        assert_eq!(switch(t, &[FPC], &[], FORCE_AUTO), Ok(Some(Position)));
        assert!(switch(t, &[], &["joint_state_broadcaster"], 1).is_err());
    }
}
