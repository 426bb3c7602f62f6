//! The one place where the physics engine's f32 types meet the project's f64 ones.

use rapier3d::prelude::{Pose as Pose32, Rotation, Vector};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};

/// A vector in the engine's precision.
pub(crate) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A vector back in f64.
pub(crate) fn vector64(v: Vector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

/// A pose in the engine's precision.
pub(crate) fn pose(p: &Pose) -> Pose32 {
    let q = p.rotation.quaternion();
    let rotation = Rotation::from_xyzw(q.i as f32, q.j as f32, q.k as f32, q.w as f32).normalize();
    Pose32::from_parts(vector(&p.translation.vector), rotation)
}

/// A pose back in f64, its rotation normalised again.
pub(crate) fn pose64(p: &Pose32) -> Pose {
    let r = p.rotation;
    let q = Quaternion::new(f64::from(r.w), f64::from(r.x), f64::from(r.y), f64::from(r.z));
    Pose::from_parts(
        Translation3::from(vector64(p.translation)),
        UnitQuaternion::from_quaternion(q),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    #[test]
    fn round_trip_within_f32() {
        let p = pose_from_xyz_rpy([0.4, -0.2, 0.9], [0.3, -1.2, 2.8]);
        let (d, a) = pose_distance(&pose64(&pose(&p)), &p);
        assert!(d < 1e-6 && a < 1e-6, "{d} {a}");
    }
}
