use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

/// A rigid transform in f64, metres.
pub type Pose = Isometry3<f64>;

/// What can be wrong with numbers that should be a pose.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum GeometryError {
    /// A component is NaN or infinite.
    #[error("{what} is not finite: {value}")]
    NotFinite {
        /// What was read.
        what: &'static str,
        /// The numbers as text.
        value: String,
    },
    /// A quaternion whose norm is not one within 1e-3.
    #[error("quaternion {value} has norm {norm:.4}, expected 1; normalise it at its source")]
    NotUnit {
        /// The quaternion as text.
        value: String,
        /// Its norm.
        norm: f64,
    },
    /// A 3x3 matrix that is not a rotation (determinant not +1 or columns not orthonormal).
    #[error("matrix is not a rotation: {reason}")]
    NotRotation {
        /// What is wrong with it.
        reason: String,
    },
    /// Stamps that do not increase.
    #[error("stamps do not increase at sample {index}")]
    NotIncreasing {
        /// The first sample that is not later than the one before.
        index: usize,
    },
    /// Fewer samples than the operation needs.
    #[error("{have} samples, at least {need} are needed")]
    TooShort {
        /// How many there are.
        have: usize,
        /// How many are needed.
        need: usize,
    },
}

/// Pose from a position (m) and a quaternion in x, y, z, w order.
///
/// # Errors
/// [`GeometryError::NotFinite`], [`GeometryError::NotUnit`] (norm off by more than 1e-3).
pub fn pose_from_xyz_quat(xyz: [f64; 3], xyzw: [f64; 4]) -> Result<Pose, GeometryError> {
    if !xyz.iter().chain(&xyzw).all(|v| v.is_finite()) {
        return Err(GeometryError::NotFinite { what: "pose", value: format!("{xyz:?} {xyzw:?}") });
    }
    let q = nalgebra::Quaternion::new(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
    if (q.norm() - 1.0).abs() > 1e-3 {
        return Err(GeometryError::NotUnit { value: format!("{xyzw:?}"), norm: q.norm() });
    }
    Ok(Pose::from_parts(Translation3::from(xyz), UnitQuaternion::from_quaternion(q)))
}

/// Pose from a position (m) and fixed-axis roll, pitch, yaw (rad), the URDF convention.
pub fn pose_from_xyz_rpy(xyz: [f64; 3], rpy: [f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::from(xyz),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// Position (m) and quaternion x, y, z, w.
pub fn pose_to_xyz_quat(pose: &Pose) -> ([f64; 3], [f64; 4]) {
    let q = pose.rotation.quaternion();
    (pose.translation.vector.into(), [q.i, q.j, q.k, q.w])
}

/// A rotation from a 3x3 matrix, refusing what is not one (columns within `tolerance` of orthonormal,
/// determinant +1); the nearest exact rotation is returned.
///
/// # Errors
/// [`GeometryError::NotFinite`], [`GeometryError::NotRotation`].
pub fn rotation_from_matrix(
    m: &Matrix3<f64>,
    tolerance: f64,
) -> Result<UnitQuaternion<f64>, GeometryError> {
    if !m.iter().all(|v| v.is_finite()) {
        return Err(GeometryError::NotFinite { what: "rotation matrix", value: format!("{m}") });
    }
    let off = (m.transpose() * m - Matrix3::identity()).abs().max();
    if off > tolerance {
        return Err(GeometryError::NotRotation {
            reason: format!("columns are off orthonormal by {off:.2e}"),
        });
    }
    if m.determinant() < 0.0 {
        return Err(GeometryError::NotRotation { reason: "left-handed (determinant < 0)".into() });
    }
    let svd = m.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else {
        return Err(GeometryError::NotRotation {
            reason: "no singular value decomposition".into(),
        });
    };
    Ok(exact_rotation(u * vt))
}

/// A rotation from a matrix that is one. (`UnitQuaternion::from_matrix` iterates and fails for half turns.)
pub fn exact_rotation(m: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
}

/// Distance between two poses: metres, and radians of the geodesic rotation angle.
pub fn pose_distance(a: &Pose, b: &Pose) -> (f64, f64) {
    ((a.translation.vector - b.translation.vector).norm(), a.rotation.angle_to(&b.rotation))
}

/// SE(3) arc length between two poses, `sqrt(|dp|^2 + (rho * dtheta)^2)` in metres; `rho` (m) is the
/// radius at which a rotation is weighed against a translation.
pub fn twist_arc(a: &Pose, b: &Pose, rho: f64) -> f64 {
    let (dp, dr) = pose_distance(a, b);
    dp.hypot(rho * dr)
}

/// The first two columns of the rotation matrix, column after column: the continuous 6D
/// representation (Zhou et al. 2019). pytorch3d takes the first two rows instead.
pub fn rotation_6d(r: &UnitQuaternion<f64>) -> [f64; 6] {
    let m = r.to_rotation_matrix();
    let m = m.matrix();
    [m[(0, 0)], m[(1, 0)], m[(2, 0)], m[(0, 1)], m[(1, 1)], m[(2, 1)]]
}

/// Inverse of [`rotation_6d`] by Gram-Schmidt; any six finite numbers give a rotation (degenerate
/// columns are replaced by the least aligned axis).
pub fn rotation_from_6d(v: &[f64; 6]) -> UnitQuaternion<f64> {
    let a = Vector3::new(v[0], v[1], v[2]);
    let b = Vector3::new(v[3], v[4], v[5]);
    let x = if a.norm() > 1e-6 { a.normalize() } else { Vector3::x() };
    let mut y = b - x * x.dot(&b);
    if y.norm() < 1e-6 {
        let k = x.iamin();
        y = Vector3::ith(k, 1.0);
        y -= x * x.dot(&y);
    }
    let y = y.normalize();
    let z = x.cross(&y);
    exact_rotation(Matrix3::from_columns(&[x, y, z]))
}

/// Twist `[v, w]` (m, rad) with `pose = (v, exp(w))`: translation and rotation taken apart, not the
/// coupled SE(3) logarithm.
pub fn pose_log(pose: &Pose) -> Vector6<f64> {
    let v = pose.translation.vector;
    let w = pose.rotation.scaled_axis();
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Inverse of [`pose_log`].
pub fn pose_exp(twist: &Vector6<f64>) -> Pose {
    Pose::from_parts(
        Translation3::new(twist[0], twist[1], twist[2]),
        UnitQuaternion::from_scaled_axis(Vector3::new(twist[3], twist[4], twist[5])),
    )
}

/// Yaw (rad) of the frame's x axis projected into the xy plane of the parent frame.
pub fn yaw_of(r: &UnitQuaternion<f64>) -> f64 {
    let x = r * Vector3::x();
    x.y.atan2(x.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn six_d_round_trip_and_degenerate_columns() {
        for k in 0..50 {
            let w =
                Vector3::new((k as f64).sin() * 2.0, (k as f64 * 0.7).cos(), 0.1 * k as f64 % 3.0);
            let r = UnitQuaternion::from_scaled_axis(w);
            assert!(rotation_from_6d(&rotation_6d(&r)).angle_to(&r) < 1e-7);
        }
        for v in [[0.0; 6], [1.0, 0.0, 0.0, 2.0, 0.0, 0.0]] {
            assert!((rotation_from_6d(&v).norm() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn half_turns_survive_the_round_trip() {
        for yaw in 0..360 {
            let down = pose_from_xyz_rpy([0.0; 3], [PI, 0.0, f64::from(yaw).to_radians()]).rotation;
            assert!(rotation_from_6d(&rotation_6d(&down)).angle_to(&down) < 1e-7, "yaw {yaw}");
        }
    }

    #[test]
    fn bad_poses_are_refused_by_name() {
        assert!(matches!(
            pose_from_xyz_quat([f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
            Err(GeometryError::NotFinite { .. })
        ));
        assert!(matches!(
            pose_from_xyz_quat([0.0; 3], [0.0, 0.0, 0.0, 0.5]),
            Err(GeometryError::NotUnit { .. })
        ));
        let left = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        assert!(matches!(
            rotation_from_matrix(&left, 1e-3),
            Err(GeometryError::NotRotation { .. })
        ));
    }

    #[test]
    fn yaw_and_log() {
        let p = pose_from_xyz_rpy([1.0, 2.0, 3.0], [0.0, 0.0, 0.4]);
        assert!((yaw_of(&p.rotation) - 0.4).abs() < 1e-12);
        assert!(pose_distance(&pose_exp(&pose_log(&p)), &p).1 < 1e-9);
        let (d, a) = pose_distance(&p, &pose_from_xyz_rpy([1.0, 2.0, 4.0], [0.0, 0.0, 0.4 + PI]));
        assert!((d - 1.0).abs() < 1e-12 && (a - PI).abs() < 1e-9);
    }
}
