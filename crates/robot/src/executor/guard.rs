use crate::kinematics::{JOINT_NAMES, Joints};
use crate::limits::Limits;
use tdv_geometry::Stamp;
use thiserror::Error;

/// Why a joint target is not passed on to the robot.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum GuardError {
    /// A NaN or an infinity.
    #[error("target of {joint} is not finite")]
    NotFinite {
        /// The joint.
        joint: &'static str,
    },
    /// Outside the joint's range.
    #[error("target of {joint} is {value:.3} rad, its range is {lower:.3}..{upper:.3}")]
    Range {
        /// The joint.
        joint: &'static str,
        /// Rad.
        value: f64,
        /// Rad.
        lower: f64,
        /// Rad.
        upper: f64,
    },
    /// The first target is not where the arm is.
    #[error("first target of {joint} is {apart:.3} rad from the arm, {allowed:.3} is allowed")]
    FarFromArm {
        /// The joint.
        joint: &'static str,
        /// Rad.
        apart: f64,
        /// Rad.
        allowed: f64,
    },
    /// The arm does not follow.
    #[error(
        "target of {joint} is {apart:.3} rad ahead of the arm, {allowed:.3} is allowed while moving"
    )]
    Following {
        /// The joint.
        joint: &'static str,
        /// Rad.
        apart: f64,
        /// Rad.
        allowed: f64,
    },
    /// The target jumps, or moves too fast.
    #[error("target of {joint} moves {step:.4} rad in {:.0} ms, {allowed:.4} is allowed", .period * 1e3)]
    Step {
        /// The joint.
        joint: &'static str,
        /// Rad.
        step: f64,
        /// Seconds.
        period: f64,
        /// Rad.
        allowed: f64,
    },
}

/// The driver's last check on each target before it goes to the robot.
#[derive(Debug, Clone)]
pub struct TargetGuard {
    lower: Joints,
    upper: Joints,
    /// Greatest mean speed between targets (rad/s).
    velocity: f64,
    /// Greatest step whatever the time between (rad).
    max_step: f64,
    /// Greatest distance of the first target from the arm (rad).
    first_within: f64,
    /// Greatest distance of any later target from the arm (rad).
    following: f64,
    last: Option<(Stamp, Joints)>,
}

impl TargetGuard {
    /// For the limits of the motion; single steps may be twice as fast as the joint speed limit (a
    /// trajectory that comes late catches up a little), none larger than 0.1 rad, and the first target must
    /// be within 0.1 rad of the arm, every other one within 0.25 rad: `servoj` lags by about 40 ms, 0.04 rad at
    /// 1 rad/s.
    pub fn new(limits: &Limits) -> Self {
        Self {
            lower: limits.joint_lower,
            upper: limits.joint_upper,
            velocity: 2.0 * limits.joint_velocity,
            max_step: 0.1,
            first_within: 0.1,
            following: 0.25,
            last: None,
        }
    }

    /// With another bound (rad) on the distance between target and arm while moving.
    #[must_use]
    pub fn with_following(mut self, bound: f64) -> Self {
        self.following = bound;
        self
    }

    /// The next target is a first one again (after a stop, or when the robot was moved by others).
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Checks a target for time `now` against the one before, or the first against `measured`.
    ///
    /// # Errors
    /// [`GuardError`]; the caller stops the arm, and the target is not remembered.
    pub fn check(
        &mut self,
        now: Stamp,
        target: &Joints,
        measured: &Joints,
    ) -> Result<(), GuardError> {
        /// Shortest time between targets that is believed (s); two in one tick are one step.
        const SHORTEST: f64 = 0.008;
        /// And the longest: a pause between targets is no licence for a jump.
        const LONGEST: f64 = 0.03;
        for i in 0..6 {
            let (joint, value) = (JOINT_NAMES[i], target[i]);
            let (lower, upper) = (self.lower[i], self.upper[i]);
            if !value.is_finite() {
                return Err(GuardError::NotFinite { joint });
            }
            if value < lower || value > upper {
                return Err(GuardError::Range { joint, value, lower, upper });
            }
            match &self.last {
                None => {
                    let (apart, allowed) = ((value - measured[i]).abs(), self.first_within);
                    if !(apart <= allowed) {
                        return Err(GuardError::FarFromArm { joint, apart, allowed });
                    }
                }
                Some((at, before)) => {
                    let (apart, allowed) = ((value - measured[i]).abs(), self.following);
                    if !(apart <= allowed) {
                        return Err(GuardError::Following { joint, apart, allowed });
                    }
                    let period = now.since(*at).clamp(SHORTEST, LONGEST);
                    let (step, allowed) =
                        ((value - before[i]).abs(), (self.velocity * period).min(self.max_step));
                    if step > allowed {
                        return Err(GuardError::Step { joint, step, period, allowed });
                    }
                }
            }
        }
        self.last = Some((now, *target));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_target_steps_and_ranges() {
        let mut g = TargetGuard::new(&Limits::default());
        let (t, q) = (Stamp::from_secs(5.0), [0.1; 6]);
        let mut far = q;
        far[2] += 0.2;
        assert!(matches!(g.check(t, &far, &q), Err(GuardError::FarFromArm { .. })));
        assert_eq!(g.check(t, &q, &q), Ok(()));
        let mut next = q;
        next[1] += 0.008;
        assert_eq!(g.check(t.plus(0.008), &next, &q), Ok(()));
        next[1] += 0.02;
        let e = g.check(t.plus(0.016), &next, &q).unwrap_err();
        assert!(matches!(e, GuardError::Step { joint: "shoulder_lift_joint", .. }), "{e}");
        next[1] = q[1] + std::f64::consts::TAU - 0.1;
        assert!(g.check(t.plus(9.0), &next, &q).is_err(), "a whole turn never passes");
        next[1] = 7.0;
        assert!(matches!(g.check(t, &next, &q), Err(GuardError::Range { .. })));
        next[1] = f64::NAN;
        assert!(matches!(g.check(t, &next, &q), Err(GuardError::NotFinite { .. })));
        g.reset();
        assert_eq!(g.check(t, &far, &far), Ok(()));
    }

    #[test]
    fn an_arm_that_stays_behind_and_a_long_pause() {
        let mut g = TargetGuard::new(&Limits::default());
        let (mut t, arm) = (Stamp::from_secs(5.0), [0.1; 6]);
        let mut q = arm;
        // The arm stands still while the targets go on at 1 rad/s.
        let refused = (0..60).find_map(|_| {
            t = t.plus(0.008);
            q[4] += 0.008;
            g.check(t, &q, &arm).err()
        });
        let behind = matches!(refused, Some(GuardError::Following { joint: "wrist_2_joint", .. }));
        assert!(behind, "{refused:?}");
        g.reset();
        assert_eq!(g.check(t, &arm, &arm), Ok(()));
        let mut next = arm;
        next[0] += 0.09;
        // One second later 0.09 rad would be slow, but nobody knows what happened in between.
        assert!(matches!(g.check(t.plus(1.0), &next, &arm), Err(GuardError::Step { .. })));
    }
}
