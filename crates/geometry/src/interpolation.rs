use crate::Pose;

/// Linear in position, Slerp (short arc) in orientation; `t` is clamped to 0..1.
pub fn interpolate(a: &Pose, b: &Pose, t: f64) -> Pose {
    let t = t.clamp(0.0, 1.0);
    let translation = a.translation.vector.lerp(&b.translation.vector, t);
    let qa = a.rotation;
    let mut qb = b.rotation.into_inner();
    if qa.coords.dot(&qb.coords) < 0.0 {
        qb = -qb;
    }
    let qb = nalgebra::UnitQuaternion::new_unchecked(qb);
    let rotation = qa.try_slerp(&qb, t, 1e-9).unwrap_or(qa);
    Pose::from_parts(translation.into(), rotation)
}

/// The quintic `10 x^3 - 15 x^4 + 6 x^5` on 0..1 (clamped): zero velocity and acceleration at both ends.
pub fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (-15.0 + 6.0 * x))
}

/// Minimum-jerk motion from `a` to `b` (Flash and Hogan 1985) at fraction `t` of its time.
pub fn min_jerk(a: &Pose, b: &Pose, t: f64) -> Pose {
    interpolate(a, b, smooth_step(t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{pose_distance, pose_from_xyz_rpy};

    #[test]
    fn ends_and_short_arc() {
        let a = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, 3.0]);
        let b = pose_from_xyz_rpy([1.0, 0.0, 0.0], [0.0, 0.0, -3.0]);
        assert!(pose_distance(&interpolate(&a, &b, 0.0), &a).1 < 1e-9);
        assert!(pose_distance(&interpolate(&a, &b, 2.0), &b).1 < 1e-9);
        let (d, r) = pose_distance(&interpolate(&a, &b, 0.5), &a);
        assert!((d - 0.5).abs() < 1e-12);
        assert!((r - (std::f64::consts::PI - 3.0)).abs() < 1e-9, "short arc over +-pi, got {r}");
        assert_eq!(min_jerk(&a, &b, 0.5), interpolate(&a, &b, 0.5));
    }
}
