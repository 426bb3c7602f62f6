//! One pose out of several that mean the same.
//!
//! A two-finger gripper turned by half a turn about its approach is the same gripper, a bottle turned
//! by half a turn about its axis is the same bottle, a round coaster has no yaw at all. A policy that is
//! trained on absolute poses needs ONE of them. The rules, used alike for the training set and live:
//!
//! - **Reference with a continuous symmetry** (coaster): its frame keeps its position and takes the
//!   orientation "symmetry axis along the table normal, yaw zero of base_link", see
//!   [`canonical_reference`]. So the demonstrated yaw of the object placed on it is a yaw in base_link.
//! - **Moving frame with a symmetry** (gripper, bottle) and **reference frames whose symmetry is free**
//!   (the bottle that is reached for): the variant whose orientation is nearest to the goal orientation of
//!   the procedure, see [`Canonical`]. It is chosen for the NEWEST pose and applied to the whole history;
//!   it is kept until another is nearer by more than [`Canonical::HYSTERESIS`]. A prediction made from
//!   canonical poses goes back through [`Variant::undo`] before the arm follows it, otherwise the wrist
//!   would turn by half a turn for nothing.

use tdv_geometry::nalgebra::{Unit, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, Symmetry};

/// Symmetry of a two-finger gripper: half a turn about its approach axis z.
pub fn gripper_symmetry() -> Symmetry {
    Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] }
}

/// The one of `pose` and `pose * Rz(pi)` whose orientation is nearer to `near`'s, and whether it is the
/// turned one. Ties keep `pose`.
pub fn canonical_tool(pose: &Pose, near: &Pose) -> (Pose, bool) {
    let turned = Pose::from_parts(pose.translation, pose.rotation * half_turn());
    let (a, b) = (pose.rotation.angle_to(&near.rotation), turned.rotation.angle_to(&near.rotation));
    if b < a - 1e-9 { (turned, true) } else { (*pose, false) }
}

fn half_turn() -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(tdv_geometry::nalgebra::Quaternion::new(0.0, 0.0, 0.0, 1.0))
}

/// `T_base_reference` with a well-defined orientation: unchanged unless the object has a continuous
/// symmetry. Then position stays; an axis within 30 deg of the table normal (either way round) is set
/// upright with the yaw of base_link; any other axis keeps its direction, reached by the smallest
/// turn from base_link's axes.
pub fn canonical_reference(pose: &Pose, symmetry: &Symmetry) -> Pose {
    let Symmetry::Continuous { axis } = symmetry else { return *pose };
    let Some(axis) = Unit::try_new(Vector3::from(*axis), 1e-9) else { return *pose };
    let seen = pose.rotation * axis.into_inner();
    let up = if seen.z.abs() > 30f64.to_radians().cos() { Vector3::z() } else { seen };
    let rotation = UnitQuaternion::rotation_between(&axis, &up).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
    Pose::from_parts(pose.translation, rotation)
}

/// Which of the equivalent descriptions of a procedure's pose is in use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variant {
    left: UnitQuaternion<f64>,
    right: UnitQuaternion<f64>,
}

impl Default for Variant {
    fn default() -> Self {
        Self { left: UnitQuaternion::identity(), right: UnitQuaternion::identity() }
    }
}

impl Variant {
    /// Observed `T_reference_moving` -> canonical.
    pub fn apply(&self, pose: &Pose) -> Pose {
        self.left * pose * self.right
    }

    /// Canonical `T_reference_moving` -> as observed.
    pub fn undo(&self, pose: &Pose) -> Pose {
        self.left.inverse() * pose * self.right.inverse()
    }

    /// Whether it changes nothing.
    pub fn is_identity(&self) -> bool {
        self.left.angle() < 1e-9 && self.right.angle() < 1e-9
    }
}

/// Chooses the [`Variant`] of a procedure's poses, see the module's text.
#[derive(Debug, Clone, PartialEq)]
pub struct Canonical {
    goal: UnitQuaternion<f64>,
    moving: Symmetry,
    reference: Symmetry,
}

impl Canonical {
    /// Another variant takes over when its orientation is nearer to the goal's by more than this (rad).
    /// The training set covers the band in which both are possible.
    pub const HYSTERESIS: f64 = 20.0 * std::f64::consts::PI / 180.0;

    /// For a procedure that ends at `goal` (`T_reference_moving`).
    pub fn new(goal: Pose, moving: Symmetry, reference: Symmetry) -> Self {
        Self { goal: goal.rotation, moving, reference }
    }

    /// The variant for an observed pose; `previous` is the one of the last observation, none at the
    /// start of a procedure.
    pub fn choose(&self, pose: &Pose, previous: Option<Variant>) -> Variant {
        self.choose_with(pose, previous.unwrap_or_default(), Self::HYSTERESIS)
    }

    pub(crate) fn choose_with(&self, pose: &Pose, previous: Variant, hysteresis: f64) -> Variant {
        let mut best: Option<(f64, Variant)> = None;
        for candidate in self.candidates(pose) {
            let angle = self.angle(pose, &candidate);
            if best.is_none_or(|(a, _)| angle < a - 1e-9) {
                best = Some((angle, candidate));
            }
        }
        let Some((angle, best)) = best else { return previous };
        // A continuous symmetry has no jumps to guard against: always the nearest.
        let keep = !self.is_continuous() && self.angle(pose, &previous) - angle <= hysteresis;
        if keep { previous } else { best }
    }

    /// Every variant of a discrete symmetry; for continuous ones those nearest to the goal.
    pub(crate) fn candidates(&self, pose: &Pose) -> Vec<Variant> {
        let mut out = Vec::new();
        for left in Self::group(&self.reference, &(self.goal * pose.rotation.inverse())) {
            let turned = left * pose.rotation;
            for right in Self::group(&self.moving, &(turned.inverse() * self.goal)) {
                out.push(Variant { left, right });
            }
        }
        out
    }

    fn angle(&self, pose: &Pose, v: &Variant) -> f64 {
        (v.left * pose.rotation * v.right).angle_to(&self.goal)
    }

    fn is_continuous(&self) -> bool {
        [&self.moving, &self.reference].iter().any(|s| matches!(s, Symmetry::Continuous { .. }))
    }

    /// The rotations of a symmetry; of a continuous one the twist of `wanted` about its axis.
    fn group(symmetry: &Symmetry, wanted: &UnitQuaternion<f64>) -> Vec<UnitQuaternion<f64>> {
        let Symmetry::Continuous { axis } = symmetry else { return symmetry.rotations() };
        let Some(axis) = Unit::try_new(Vector3::from(*axis), 1e-9) else {
            return vec![UnitQuaternion::identity()];
        };
        let twist = 2.0 * wanted.vector().dot(&axis).atan2(wanted.w);
        vec![UnitQuaternion::from_axis_angle(&axis, twist)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    fn down(yaw: f64) -> Pose {
        pose_from_xyz_rpy([0.1, 0.2, 0.3], [PI, 0.0, yaw])
    }

    #[test]
    fn the_nearer_gripper_is_taken() {
        for k in -40..40 {
            let yaw = 0.1 * f64::from(k);
            let (c, flipped) = canonical_tool(&down(yaw), &down(0.0));
            assert!(c.rotation.angle_to(&down(0.0).rotation) <= PI / 2.0 + 1e-9);
            assert_eq!(flipped, yaw.cos() < 0.0, "{yaw}");
            assert_eq!(c.translation, down(yaw).translation);
        }
    }

    #[test]
    fn choice_has_hysteresis_and_undo_is_exact() {
        let c = Canonical::new(down(0.0), gripper_symmetry(), Symmetry::None);
        let near = c.choose(&down(95f64.to_radians()), None);
        assert!(near.is_identity(), "5 deg beyond the middle is not enough");
        let far = c.choose(&down(105f64.to_radians()), Some(near));
        assert!(!far.is_identity());
        let back = c.choose(&down(85f64.to_radians()), Some(far));
        assert_eq!(back, far);
        let p = down(2.0);
        let (d, a) = pose_distance(&far.undo(&far.apply(&p)), &p);
        assert!(d < 1e-12 && a < 1e-7);
    }

    #[test]
    fn a_two_fold_bottle_reached_from_above_has_one_description() {
        // Turning the bottle AND the gripper changes nothing but the sign of x and y: stay with identity.
        let bottle = Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] };
        let c = Canonical::new(down(0.0), gripper_symmetry(), bottle);
        let tilted = pose_from_xyz_rpy([0.1, 0.2, 0.3], [PI - 0.1, 0.05, 0.3]);
        assert!(c.choose(&tilted, None).is_identity());
        assert_eq!(c.candidates(&tilted).len(), 4);
    }

    #[test]
    fn free_yaw_follows_the_goal() {
        let round = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
        let c = Canonical::new(down(0.4), gripper_symmetry(), round);
        for k in 0..20 {
            let p = down(f64::from(k));
            let q = c.choose(&p, None).apply(&p);
            assert!(q.rotation.angle_to(&down(0.4).rotation) < 1e-7);
            assert!((q.translation.z - 0.3).abs() < 1e-12);
        }
    }

    #[test]
    fn a_round_reference_takes_the_yaw_of_base_link() {
        let round = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
        for rpy in [[0.1, -0.05, 2.0], [PI, 0.1, -1.0]] {
            let p = canonical_reference(&pose_from_xyz_rpy([0.4, 0.1, 0.0], rpy), &round);
            assert!(p.rotation.angle() < 1e-9 && p.translation.x == 0.4);
        }
        let wheel = canonical_reference(&pose_from_xyz_rpy([0.0; 3], [PI / 2.0, 0.7, 0.0]), &round);
        assert!((wheel.rotation * Vector3::z()).z.abs() < 0.1);
        let box_ = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, 2.0]);
        assert_eq!(canonical_reference(&box_, &Symmetry::None), box_);
    }
}
