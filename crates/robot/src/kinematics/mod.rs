//! Forward and closed-form inverse kinematics of the UR5 family from its Denavit-Hartenberg numbers.
//!
//! Three frames at the root are easily mixed up: `base_link` (REP-103, the frame of every pose in
//! this crate's public API) and `base` (the UR controller's frame), which is `base_link` turned by
//! pi about z. The end is `tool0` (the flange with a zero tool) or `tcp` (between the pads).

mod calibration;
mod dh;
mod ik;
mod jacobian;
mod select;

pub use calibration::{Calibration, CalibrationError};
pub use dh::DhTable;
pub use ik::IkSolutions;
pub use jacobian::Dexterity;
pub use select::{IkError, IkSelection, unwrap_near};

use nalgebra::{Translation3, UnitQuaternion};
use tdv_geometry::Pose;

/// Joint angles (rad) in UR order, see [`JOINT_NAMES`].
pub type Joints = [f64; 6];

/// The arm's joints in the order of every six-array in this crate.
pub const JOINT_NAMES: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// Distance (m) from `tool0` to `tcp` along the flange's z axis.
pub const TCP_OFFSET: f64 = 0.150;

/// `T_tool0_tcp`: a shift along z, same orientation.
pub fn default_tool() -> Pose {
    Pose::from_parts(Translation3::new(0.0, 0.0, TCP_OFFSET), UnitQuaternion::identity())
}

/// `T_base_link_base`: the half turn between the REP-103 root and the UR controller's frame.
pub fn base_link_to_base() -> Pose {
    let half_turn = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 1.0));
    Pose::from_parts(Translation3::identity(), half_turn)
}

/// Kinematics of one arm with a tool.
#[derive(Debug, Clone, PartialEq)]
pub struct Kinematics {
    dh: DhTable,
    tool: Pose,
    tool_inverse: Pose,
    calibration: Option<Calibration>,
}

impl Kinematics {
    /// An arm given by its table, with `T_tool0_tcp`.
    pub fn new(dh: DhTable, tool: Pose) -> Self {
        Self { dh, tool, tool_inverse: tool.inverse(), calibration: None }
    }

    /// The CB3 UR5 with the default tool.
    pub fn ur5() -> Self {
        Self::new(DhTable::UR5, default_tool())
    }

    /// The e-Series UR5e with the default tool.
    pub fn ur5e() -> Self {
        Self::new(DhTable::UR5E, default_tool())
    }

    /// The same arm with another `T_tool0_tcp`.
    #[must_use]
    pub fn with_tool(self, tool: Pose) -> Self {
        Self { tool, tool_inverse: tool.inverse(), ..self }
    }

    /// The arm as it was measured: forward kinematics and Jacobian by the measured chain, inverse by
    /// the closed form of the nominal arm and a few steps of Newton's method. Poses within millimetres
    /// of the reach's edge or of a singularity may have fewer solutions than the nominal arm.
    ///
    /// # Errors
    /// [`CalibrationError::OtherArm`].
    pub fn with_calibration(self, calibration: Calibration) -> Result<Self, CalibrationError> {
        calibration.check(&self.dh)?;
        Ok(Self { calibration: Some(calibration), ..self })
    }

    /// The measured chain, if one was given.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref()
    }

    /// The Denavit-Hartenberg numbers.
    pub fn dh(&self) -> &DhTable {
        &self.dh
    }

    /// `T_tool0_tcp`.
    pub fn tool(&self) -> &Pose {
        &self.tool
    }

    /// `T_base_link_tool0` at joint angles `q` (rad).
    pub fn fk(&self, q: &Joints) -> Pose {
        base_link_to_base() * self.calibration.as_ref().map_or_else(|| self.dh.fk(q), |c| c.fk(q))
    }

    /// `T_base_link_tcp` at joint angles `q` (rad).
    pub fn fk_tcp(&self, q: &Joints) -> Pose {
        self.fk(q) * self.tool
    }

    /// `T_tool0_tcp` at knuckle angle `knuckle` (rad). The fingers swing, so the place between the
    /// pads moves 13.5 mm outward as the gripper closes. [`Self::tool`] is the tcp of the open gripper;
    /// every method without a knuckle angle means that one, whatever the gripper does.
    pub fn tool_at(&self, knuckle: f64) -> Pose {
        self.tool * Translation3::new(0.0, 0.0, crate::gripper::tip_advance(knuckle))
    }

    /// As [`Self::fk_tcp`] with the tcp where the pads are at `knuckle` (rad).
    pub fn fk_tcp_at(&self, q: &Joints, knuckle: f64) -> Pose {
        self.fk(q) * self.tool_at(knuckle)
    }

    /// As [`Self::ik_tcp`] with the tcp where the pads are at `knuckle` (rad): the flange stays back by
    /// what the fingers advance.
    pub fn ik_tcp_at(&self, target: &Pose, knuckle: f64) -> IkSolutions {
        self.ik(&(target * self.tool_at(knuckle).inverse()))
    }

    /// Frames 0..=6 in `base_link`: frame `i` is fixed to link `i` (frame 6 is `tool0`); joint `i`
    /// turns about z of frame `i`. Without a calibration these are the Denavit-Hartenberg frames and
    /// frame 0 is `base`; with one, frame `i` is the measured link `i`'s at angle zero.
    pub fn frames(&self, q: &Joints) -> [Pose; 7] {
        let Some(c) = &self.calibration else { return self.nominal_frames(q) };
        let (axes, end) = (c.axes(q), c.fk(q));
        std::array::from_fn(|i| base_link_to_base() * if i < 6 { axes[i] } else { end })
    }

    fn nominal_frames(&self, q: &Joints) -> [Pose; 7] {
        let mut out = [base_link_to_base(); 7];
        for i in 0..6 {
            out[i + 1] = out[i] * self.dh.joint(i, q[i]);
        }
        out
    }

    /// The six moving links' frames in `base_link`, by the convention of the ROS description of the
    /// arm (shoulder, upper arm, forearm, wrist 1..3), which differs from the Denavit-Hartenberg one:
    /// each frame sits on its own joint's axis.
    pub fn link_poses(&self, q: &Joints) -> [Pose; 6] {
        let poses =
            self.calibration.as_ref().map_or_else(|| self.dh.link_poses(q), |c| c.link_poses(q));
        poses.map(|p| base_link_to_base() * p)
    }

    /// All joint solutions (0..=8, angles in (-pi, pi]) that bring `tool0` to `target` =
    /// `T_base_link_tool0`. The order is fixed: shoulder branch, then wrist branch, then elbow branch.
    /// Where the wrist is singular, joint 6 is free and given as zero.
    pub fn ik(&self, target: &Pose) -> IkSolutions {
        self.solve(target, 0.0)
    }

    fn solve(&self, target: &Pose, free: f64) -> IkSolutions {
        let target = base_link_to_base() * target;
        let nominal = ik::solve(&self.dh, &target, free);
        self.calibration.as_ref().map_or(nominal, |c| c.refine(&nominal, &target))
    }

    /// As [`Self::ik`] for `T_base_link_tcp`.
    pub fn ik_tcp(&self, target: &Pose) -> IkSolutions {
        self.ik(&(target * self.tool_inverse))
    }

    /// The solution for `T_base_link_tool0` nearest to `seed` inside the limits of `selection`;
    /// each angle is unwrapped by whole turns to the seed.
    ///
    /// # Errors
    /// [`IkError`]: not finite, unreachable, outside the limits, or only a branch farther than
    /// `selection.max_step` away. It is never clamped.
    pub fn nearest(
        &self,
        target: &Pose,
        seed: &Joints,
        selection: &IkSelection,
    ) -> Result<Joints, IkError> {
        select::nearest(|| self.solve(target, seed[5]), target, seed, selection)
    }

    /// As [`Self::nearest`] for `T_base_link_tcp`.
    ///
    /// # Errors
    /// As [`Self::nearest`].
    pub fn nearest_tcp(
        &self,
        target: &Pose,
        seed: &Joints,
        selection: &IkSelection,
    ) -> Result<Joints, IkError> {
        self.nearest(&(target * self.tool_inverse), seed, selection)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_distance;

    #[test]
    fn zero_configuration() {
        let k = Kinematics::ur5();
        let p = k.fk(&[0.0; 6]).translation.vector;
        // base: (-0.81725, -0.19145, -0.005491); base_link has x and y negated.
        assert!((p.x - 0.81725).abs() < 1e-12 && (p.y - 0.19145).abs() < 1e-12, "{p}");
        assert!((p.z + 0.005491).abs() < 1e-12);
    }

    #[test]
    fn the_tcp_advances_as_the_gripper_closes() {
        let k = Kinematics::ur5();
        let q = [0.3, -1.2, 1.4, -0.7, 0.9, 2.2];
        assert_eq!(k.fk_tcp_at(&q, 0.0), k.fk_tcp(&q));
        let (open, closed) = (k.fk_tcp_at(&q, 0.0), k.fk_tcp_at(&q, 0.7929));
        let moved = open.inverse() * closed;
        assert!((moved.translation.z - 0.0135).abs() < 2e-4 && moved.translation.x.abs() < 1e-12);
        let back = k.ik_tcp_at(&closed, 0.7929);
        assert!(back.iter().any(|s| (0..6).all(|i| (s[i] - q[i]).abs() < 1e-9)));
    }

    #[test]
    fn frames_end_at_tool0_and_links_agree() {
        let k = Kinematics::ur5e();
        let q = [0.3, -1.2, 1.4, -0.7, 0.9, 2.2];
        let (d, a) = pose_distance(&k.frames(&q)[6], &k.fk(&q));
        assert!(d < 1e-12 && a < 1e-7);
        let (d, a) = pose_distance(&k.link_poses(&q)[5], &k.fk(&q));
        assert!(d < 1e-12 && a < 1e-7, "{d} {a}");
    }
}
