use super::Joints;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};
use tdv_geometry::Pose;

/// Denavit-Hartenberg numbers of an arm of the UR shape (m); the twists `alpha` are the same for all.
///
/// Row `i`: turn `q[i]` about z, shift `d[i]` along z, shift `a[i]` along x, turn `ALPHA[i]` about x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DhTable {
    /// Height of the shoulder.
    pub d1: f64,
    /// Upper arm, negative.
    pub a2: f64,
    /// Forearm, negative.
    pub a3: f64,
    /// Offset of wrist 1, sideways from the arm's plane.
    pub d4: f64,
    /// Wrist 2.
    pub d5: f64,
    /// Wrist 3 to flange.
    pub d6: f64,
}

impl DhTable {
    /// UR5, CB3 series (the maker's published table).
    pub const UR5: Self =
        Self { d1: 0.089159, a2: -0.425, a3: -0.39225, d4: 0.10915, d5: 0.09465, d6: 0.0823 };

    /// UR5e (the maker's published table).
    pub const UR5E: Self =
        Self { d1: 0.1625, a2: -0.425, a3: -0.3922, d4: 0.1333, d5: 0.0997, d6: 0.0996 };

    /// Link twists (rad).
    pub const ALPHA: [f64; 6] = [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0];

    fn row(&self, i: usize) -> (f64, f64) {
        match i {
            0 => (0.0, self.d1),
            1 => (self.a2, 0.0),
            2 => (self.a3, 0.0),
            3 => (0.0, self.d4),
            4 => (0.0, self.d5),
            _ => (0.0, self.d6),
        }
    }

    /// Transform from frame `i` to frame `i + 1` at angle `q` (rad); `i` in 0..6.
    pub fn joint(&self, i: usize, q: f64) -> Pose {
        let (a, d) = self.row(i);
        // One sine and cosine, of the half angle, serves both the quaternion and the shift.
        let (sh, ch) = (0.5 * q).sin_cos();
        let (s, c) = (2.0 * sh * ch, 1.0 - 2.0 * sh * sh);
        let (w, x) = match i {
            0 | 3 => (FRAC_1_SQRT_2, FRAC_1_SQRT_2),
            4 => (FRAC_1_SQRT_2, -FRAC_1_SQRT_2),
            _ => (1.0, 0.0),
        };
        let turn = Quaternion::new(ch * w, ch * x, sh * x, sh * w);
        let rotation = UnitQuaternion::new_unchecked(turn);
        Isometry3::from_parts(Translation3::new(a * c, a * s, d), rotation)
    }

    /// `T_base_tool0`, `base` being the UR controller's frame.
    pub fn fk(&self, q: &Joints) -> Pose {
        let mut t = self.joint(0, q[0]);
        for (i, angle) in q.iter().enumerate().skip(1) {
            t *= self.joint(i, *angle);
        }
        t
    }

    /// Origins of the links' frames in the ROS description, each in its parent link at angle zero,
    /// from `base`: xyz (m) and roll, pitch, yaw (rad).
    pub fn link_origins(&self) -> [([f64; 3], [f64; 3]); 6] {
        [
            ([0.0, 0.0, self.d1], [0.0; 3]),
            ([0.0; 3], [FRAC_PI_2, 0.0, 0.0]),
            ([self.a2, 0.0, 0.0], [0.0; 3]),
            ([self.a3, 0.0, self.d4], [0.0; 3]),
            ([0.0, -self.d5, 0.0], [FRAC_PI_2, 0.0, 0.0]),
            ([0.0, self.d6, 0.0], [FRAC_PI_2, PI, PI]),
        ]
    }

    /// The links' frames in `base`.
    pub(super) fn link_poses(&self, q: &Joints) -> [Pose; 6] {
        let mut t = Pose::identity();
        let mut out = [t; 6];
        for (i, (xyz, rpy)) in self.link_origins().into_iter().enumerate() {
            t *= tdv_geometry::pose_from_xyz_rpy(xyz, rpy)
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[i]);
            out[i] = t;
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_its_four_elementary_motions() {
        let dh = DhTable::UR5E;
        for i in 0..6 {
            for q in [-4.0, -0.3, 0.0, 1.1, 3.0] {
                let (a, d) = dh.row(i);
                let want = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q)
                    * Translation3::new(a, 0.0, d)
                    * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), DhTable::ALPHA[i]);
                let apart = (want.to_homogeneous() - dh.joint(i, q).to_homogeneous()).abs().max();
                assert!(apart < 1e-15, "{i} {q} {apart:e}");
            }
        }
    }
}
