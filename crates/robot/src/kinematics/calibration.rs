//! The arm as it was built: the link origins that the maker measured for one robot.

use super::ik::{IkSolutions, wrap};
use super::{DhTable, Joints};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use serde::Deserialize;
use std::path::Path;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use thiserror::Error;

/// How far a measured origin may be from the nominal one (m) and still be the same kind of arm.
const MAX_SHIFT: f64 = 0.02;
/// As [`MAX_SHIFT`], rad.
const MAX_TURN: f64 = 0.1;
/// A refined solution reproduces its target this well (m and rad).
const CONVERGED: f64 = 1e-10;
/// Newton's method doubles the digits: from millimetres it needs three steps, near a singularity more.
const MAX_STEPS: usize = 12;
/// Greatest change of a joint by the refinement (rad); farther off is another branch.
const MAX_CHANGE: f64 = 0.3;

/// Why a calibration cannot be used.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum CalibrationError {
    /// The file cannot be read.
    #[error("calibration {path}: {reason}; ur_calibration writes such a file from the robot")]
    Read {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// A joint is far from where the arm's model has it.
    #[error(
        "calibration of {link} is {:.1} mm and {:.2} deg off the nominal arm: another model of robot?",
        .metres * 1e3, .radians.to_degrees()
    )]
    OtherArm {
        /// As in the file: shoulder, upper_arm, ...
        link: &'static str,
        /// Distance from nominal.
        metres: f64,
        /// Angle from nominal.
        radians: f64,
    },
}

/// Names of the links in the file, in order.
const LINKS: [&str; 6] = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];

#[derive(Deserialize)]
struct File {
    kinematics: Chain,
}

#[derive(Deserialize)]
struct Chain {
    shoulder: Origin,
    upper_arm: Origin,
    forearm: Origin,
    wrist_1: Origin,
    wrist_2: Origin,
    wrist_3: Origin,
    #[serde(default)]
    hash: String,
}

#[derive(Deserialize, Clone, Copy)]
struct Origin {
    x: f64,
    y: f64,
    z: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
}

/// Origin of each link in its parent at angle zero, from `base`, as the ROS description of the arm
/// has them (shoulder, upper arm, forearm, wrist 1..3); the last frame is `tool0`.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    origins: [Pose; 6],
    hash: String,
}

impl Calibration {
    /// From the file that the official driver's `ur_calibration` writes: `kinematics:` with `x y z`
    /// (m) and `roll pitch yaw` (rad) of six links, and a `hash` that names the robot.
    ///
    /// # Errors
    /// [`CalibrationError::Read`].
    pub fn load(path: &Path) -> Result<Self, CalibrationError> {
        let name = path.display().to_string();
        let read = |reason: String| CalibrationError::Read { path: name.clone(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| read(e.to_string()))?;
        Self::parse(&text).map_err(read)
    }

    /// As [`Self::load`] from the file's text.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    pub fn parse(text: &str) -> Result<Self, String> {
        let file: File = serde_saphyr::from_str(text).map_err(|e| e.to_string())?;
        let c = file.kinematics;
        let all = [c.shoulder, c.upper_arm, c.forearm, c.wrist_1, c.wrist_2, c.wrist_3];
        for (link, o) in LINKS.iter().zip(&all) {
            if ![o.x, o.y, o.z, o.roll, o.pitch, o.yaw].iter().all(|v| v.is_finite()) {
                return Err(format!("{link} has a number that is not finite"));
            }
        }
        let pose = |o: Origin| pose_from_xyz_rpy([o.x, o.y, o.z], [o.roll, o.pitch, o.yaw]);
        Ok(Self { origins: all.map(pose), hash: c.hash })
    }

    /// The nominal arm, for comparison and tests.
    pub fn nominal(dh: &DhTable) -> Self {
        let pose = |(xyz, rpy)| pose_from_xyz_rpy(xyz, rpy);
        Self { origins: dh.link_origins().map(pose), hash: String::new() }
    }

    /// The origins moved by small poses, each in its own link's frame.
    #[must_use]
    pub fn displaced(mut self, by: &[Pose; 6]) -> Self {
        for (o, d) in self.origins.iter_mut().zip(by) {
            *o *= d;
        }
        self
    }

    /// Which robot this is, empty if the file did not say.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Refuses a calibration of another kind of arm.
    ///
    /// Calibrations may slide a link's frame along two (nearly) parallel axes by metres, shoulder
    /// against elbow; so it is the joints' axes and the flange that are compared, not the frames.
    pub(super) fn check(&self, dh: &DhTable) -> Result<(), CalibrationError> {
        let nominal = Self::nominal(dh);
        let (ours, theirs) = (self.axes(&[0.0; 6]), nominal.axes(&[0.0; 6]));
        for i in 0..6 {
            let (z, w) = (ours[i].rotation * Vector3::z(), theirs[i].rotation * Vector3::z());
            let between = theirs[i].translation.vector - ours[i].translation.vector;
            let metres = (between - z * between.dot(&z)).norm();
            let radians = z.angle(&w);
            if !(metres < MAX_SHIFT && radians < MAX_TURN) {
                return Err(CalibrationError::OtherArm { link: LINKS[i], metres, radians });
            }
        }
        let (a, b) = (self.fk(&[0.0; 6]), nominal.fk(&[0.0; 6]));
        let (metres, radians) = (
            (a.translation.vector - b.translation.vector).norm(),
            a.rotation.angle_to(&b.rotation),
        );
        if !(metres < 2.0 * MAX_SHIFT && radians < 2.0 * MAX_TURN) {
            return Err(CalibrationError::OtherArm { link: LINKS[5], metres, radians });
        }
        Ok(())
    }

    /// Frames whose z is joint `i`'s axis, in `base`, before that joint's turn.
    pub(super) fn axes(&self, q: &Joints) -> [Pose; 6] {
        let mut t = Pose::identity();
        std::array::from_fn(|i| {
            let axis = t * self.origins[i];
            t = axis * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[i]);
            axis
        })
    }

    /// The links' frames in `base`.
    pub(super) fn link_poses(&self, q: &Joints) -> [Pose; 6] {
        let mut t = Pose::identity();
        std::array::from_fn(|i| {
            t = t * self.origins[i] * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[i]);
            t
        })
    }

    /// `T_base_tool0`.
    pub(super) fn fk(&self, q: &Joints) -> Pose {
        self.link_poses(q)[5]
    }

    /// Newton's method on the measured chain from each solution of the nominal arm; solutions that do
    /// not converge (next to a singularity) are left out.
    pub(super) fn refine(&self, nominal: &IkSolutions, target: &Pose) -> IkSolutions {
        let mut out = IkSolutions::EMPTY;
        for q in nominal.iter().filter_map(|q| self.newton(q, target)) {
            out.push(q);
        }
        out
    }

    fn newton(&self, from: &Joints, target: &Pose) -> Option<Joints> {
        let mut q = *from;
        let mut best = f64::INFINITY;
        for _ in 0..MAX_STEPS {
            let axes = self.axes(&q);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[5]);
            let now = axes[5] * turn;
            let p = now.translation.vector;
            let shift = target.translation.vector - p;
            let turn = (target.rotation * now.rotation.inverse()).scaled_axis();
            let size = shift.norm().max(turn.norm());
            // Stops when rounding is all that is left.
            if size < CONVERGED && size >= 0.5 * best {
                break;
            }
            best = best.min(size);
            let mut j = Matrix6::zeros();
            for (i, a) in axes.iter().enumerate() {
                let z = a.rotation * Vector3::z();
                j.fixed_view_mut::<3, 1>(0, i).copy_from(&z.cross(&(p - a.translation.vector)));
                j.fixed_view_mut::<3, 1>(3, i).copy_from(&z);
            }
            let mut e = Vector6::zeros();
            e.fixed_rows_mut::<3>(0).copy_from(&shift);
            e.fixed_rows_mut::<3>(3).copy_from(&turn);
            let step = j.lu().solve(&e)?;
            for i in 0..6 {
                q[i] += step[i];
            }
            if !(0..6).all(|i| (q[i] - from[i]).abs() < MAX_CHANGE) {
                return None;
            }
        }
        let now = self.fk(&q);
        let (shift, turn) = (
            (target.translation.vector - now.translation.vector).norm(),
            (target.rotation * now.rotation.inverse()).scaled_axis().norm(),
        );
        (shift < CONVERGED && turn < CONVERGED).then(|| q.map(wrap))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{IkSelection, Kinematics};
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::PI;

    /// Deviations of the size that robots have: up to 1 mm and 1.5 mrad at each joint.
    fn measured(seed: u64) -> Calibration {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let by: [Pose; 6] = std::array::from_fn(|_| {
            let xyz = std::array::from_fn(|_| rng.random_range(-1e-3..1e-3));
            let rpy = std::array::from_fn(|_| rng.random_range(-1.5e-3..1.5e-3));
            pose_from_xyz_rpy(xyz, rpy)
        });
        Calibration::nominal(&DhTable::UR5).displaced(&by)
    }

    #[test]
    fn inverse_of_the_measured_chain() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut worst, mut lost, mut regular, mut moved): (f64, usize, usize, f64) =
            (0.0, 0, 0, 0.0);
        for seed in 0..20 {
            let nominal = Kinematics::ur5();
            let k = nominal.clone().with_calibration(measured(seed)).unwrap();
            for _ in 0..200 {
                let q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
                let d = nominal.dexterity(&q);
                if d.wrist < 0.1 || d.elbow < 0.2 || d.shoulder < 0.1 {
                    continue;
                }
                regular += 1;
                let t = k.fk(&q);
                moved =
                    moved.max((t.translation.vector - nominal.fk(&q).translation.vector).norm());
                let all = k.ik(&t);
                for s in all.iter() {
                    let f = k.fk(s);
                    let turn = (f.rotation.inverse() * t.rotation).scaled_axis().norm();
                    worst =
                        worst.max((f.translation.vector - t.translation.vector).norm()).max(turn);
                }
                let own = all.iter().any(|s| (0..6).all(|i| wrap(s[i] - q[i]).abs() < 1e-8));
                lost += usize::from(!own);
                let near = k.nearest(&t, &q, &IkSelection::default());
                assert!(!own || near.is_ok_and(|n| (0..6).all(|i| (n[i] - q[i]).abs() < 1e-8)));
            }
        }
        println!(
            "{regular} poses, residual {worst:.1e}, {lost} lost, calibration moves {moved:.4} m"
        );
        assert!(regular > 2000 && moved > 2e-3 && worst < 1e-10 && lost == 0, "{worst:e} {lost}");
    }

    #[test]
    fn the_jacobian_is_that_of_the_measured_chain() {
        let k = Kinematics::ur5().with_calibration(measured(3)).unwrap();
        let q = [0.3, -1.2, 1.4, -0.7, 0.9, 2.2];
        let j = k.jacobian_tcp(&q);
        for i in 0..6 {
            let (mut a, mut b) = (q, q);
            a[i] -= 1e-6;
            b[i] += 1e-6;
            let v = (k.fk_tcp(&b).translation.vector - k.fk_tcp(&a).translation.vector) / 2e-6;
            assert!((j.fixed_view::<3, 1>(0, i) - v).norm() < 1e-7);
        }
    }

    const FILE: &str = "
kinematics:
  shoulder: {x: 0, y: 0, z: 0.08920, roll: 0.0001, pitch: 0, yaw: 0.00002}
  upper_arm: {x: -0.0002, y: 0, z: 0, roll: 1.5709, pitch: 0, yaw: 0.00001}
  forearm: {x: -0.4252, y: 0, z: 0, roll: 0.0003, pitch: 0.0001, yaw: 0}
  wrist_1: {x: -0.3921, y: -0.0001, z: 0.1091, roll: -0.0002, pitch: 0, yaw: 0}
  wrist_2: {x: 0.00003, y: -0.0947, z: 0, roll: 1.5705, pitch: 0, yaw: 0}
  wrist_3: {x: 0, y: 0.0822, z: 0, roll: 1.5708, pitch: 3.14159265, yaw: 3.14159265}
  hash: calib_123
";

    #[test]
    fn files_are_read_and_checked() {
        let c = Calibration::parse(FILE).unwrap();
        assert_eq!(c.hash(), "calib_123");
        let k = Kinematics::ur5().with_calibration(c.clone()).unwrap();
        let off =
            k.fk(&[0.0; 6]).translation.vector - Kinematics::ur5().fk(&[0.0; 6]).translation.vector;
        assert!(off.norm() > 1e-4 && off.norm() < 2e-3, "{off}");
        let e = Kinematics::ur5e().with_calibration(c).unwrap_err();
        assert!(
            matches!(e, CalibrationError::OtherArm { link: "shoulder" | "upper_arm", .. }),
            "{e}"
        );
        assert!(Calibration::parse(&FILE.replace("0.08920", ".nan")).is_err());
        assert!(Calibration::parse("kinematics: {}").unwrap_err().contains("shoulder"));
        assert!(Calibration::load(Path::new("/no.yaml")).is_err());
        // Frames that slid along the parallel axes of shoulder and elbow are the same arm.
        let slid = FILE
            .replace(
                "x: -0.0002, y: 0, z: 0, roll: 1.5709, pitch: 0, yaw: 0.00001",
                "x: -0.0002, y: 300, z: 0, roll: 1.5707963267948966, pitch: 0, yaw: 0",
            )
            .replace(
                "x: -0.4252, y: 0, z: 0, roll: 0.0003, pitch: 0.0001",
                "x: -0.4252, y: 0, z: 300, roll: 0, pitch: 0",
            );
        let slid = Kinematics::ur5().with_calibration(Calibration::parse(&slid).unwrap());
        assert!(slid.is_ok(), "{slid:?}");
    }

    #[test]
    fn the_nominal_calibration_changes_nothing() {
        let plain = Kinematics::ur5();
        let k = plain.clone().with_calibration(Calibration::nominal(&DhTable::UR5)).unwrap();
        let q = [0.3, -1.2, 1.4, -0.7, 0.9, 2.2];
        assert!((k.fk(&q).to_homogeneous() - plain.fk(&q).to_homogeneous()).abs().max() < 1e-14);
        assert!((k.jacobian(&q) - plain.jacobian(&q)).abs().max() < 1e-14);
        let (a, b) = (k.dexterity(&q), plain.dexterity(&q));
        assert!((a.shoulder - b.shoulder).abs() < 1e-12);
    }
}
