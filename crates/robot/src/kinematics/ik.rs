use super::{DhTable, Joints};
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use tdv_geometry::Pose;

/// Sine of the wrist-2 angle below which wrist 1 and wrist 3 turn about one line.
const WRIST_SINGULAR: f64 = 1e-9;
/// Sine below which joint 6 may be moved a little without the pose showing it; solutions are checked.
const NEAR_SINGULAR: f64 = 1e-3;
/// How far outside its range a cosine may be by rounding and still mean "stretched".
const ROUNDING: f64 = 1e-9;
/// Two solutions closer than this (rad, each joint) are one.
const SAME: f64 = 1e-7;
/// A solution must reproduce its target this well (m and rad) to be given.
const RESIDUAL: f64 = 5e-10;

/// Up to eight joint solutions in a fixed order, without allocation; dereferences to a slice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolutions {
    q: [Joints; 8],
    len: usize,
}

impl IkSolutions {
    const EMPTY: Self = Self { q: [[0.0; 6]; 8], len: 0 };

    fn push(&mut self, q: Joints) {
        let same = |a: &Joints| a.iter().zip(&q).all(|(x, y)| wrap(x - y).abs() < SAME);
        if self.len < 8 && !self.iter().any(same) {
            self.q[self.len] = q;
            self.len += 1;
        }
    }
}

impl std::ops::Deref for IkSolutions {
    type Target = [Joints];
    fn deref(&self) -> &[Joints] {
        &self.q[..self.len]
    }
}

/// To (-pi, pi].
pub(super) fn wrap(angle: f64) -> f64 {
    let a = angle.rem_euclid(TAU);
    if a > PI { a - TAU } else { a }
}

/// `target` is `T_base_tool0`; `free` is the value of joint 6 where the wrist is singular.
///
/// Geometry: the axes of joints 2, 3 and 4 are parallel (`z1`), so the wrist centre `p05` lies `d4`
/// from the shoulder's plane, which gives joint 1; `z1` seen from the tool gives joints 5 and 6; the
/// rest is a planar arm of two links. Arc tangents throughout: no loss of digits near the branch points.
pub(super) fn solve(dh: &DhTable, target: &Pose, free: f64) -> IkSolutions {
    let mut out = IkSolutions::EMPTY;
    if !target.translation.vector.iter().chain(target.rotation.coords.iter()).all(|v| v.is_finite())
    {
        return out;
    }
    // Chains of products leave quaternions a little off unit length, which would show as a residual.
    let rotation = UnitQuaternion::new_normalize(target.rotation.into_inner());
    let target = &Pose::from_parts(target.translation, rotation);
    let p05 = target * nalgebra::Point3::new(0.0, 0.0, -dh.d6);
    let r2 = p05.x * p05.x + p05.y * p05.y;
    let along2 = r2 - dh.d4 * dh.d4;
    if along2 < -ROUNDING * dh.d4 {
        return out; // the wrist centre is inside the cylinder about the base axis
    }
    let along = along2.max(0.0).sqrt();
    let phi = p05.y.atan2(p05.x);
    let psi = along.atan2(dh.d4);
    for shoulder in [psi, -psi] {
        let q1 = phi + shoulder + FRAC_PI_2;
        let (s1, c1) = q1.sin_cos();
        let z1 = target.rotation.inverse_transform_vector(&Vector3::new(s1, -c1, 0.0));
        let sine = z1.x.hypot(z1.y);
        for sign in [1.0, -1.0] {
            let q5 = sign * sine.atan2(z1.z);
            let q6 = if sine < WRIST_SINGULAR { free } else { (-sign * z1.y).atan2(sign * z1.x) };
            let reached = planar(dh, target, [q1, q5, q6], &mut out);
            if !reached && sine < NEAR_SINGULAR {
                // Joint 6 is (almost) free, and some of its values put wrist 1 out of reach.
                if let Some(q6) = reachable_q6(dh, target, [q1, q5, q6]) {
                    planar(dh, target, [q1, q5, q6], &mut out);
                }
            }
        }
    }
    out
}

/// Pose of frame 4 in frame 1 for given joints 1, 5, 6.
fn wrist(dh: &DhTable, target: &Pose, [q1, q5, q6]: [f64; 3]) -> Pose {
    dh.joint(0, q1).inverse() * target * (dh.joint(4, q5) * dh.joint(5, q6)).inverse()
}

/// The value of joint 6 nearest to the given one for which wrist 1 is in the planar arm's reach.
///
/// Wrist 1 runs on a circle as joint 6 turns, so its squared distance from the shoulder is
/// `mean + swing cos(q6 - phase)`, and the reach bounds the cosine.
fn reachable_q6(dh: &DhTable, target: &Pose, [q1, q5, q6]: [f64; 3]) -> Option<f64> {
    let at = |q6: f64| wrist(dh, target, [q1, q5, q6]).translation.vector.xy();
    let (p0, p1, p2) = (at(0.0), at(FRAC_PI_2), at(PI));
    let centre = 0.5 * (p0 + p2);
    let (a, b) = (centre.dot(&(0.5 * (p0 - p2))), centre.dot(&(p1 - centre)));
    let (swing, phase) = (2.0 * a.hypot(b), b.atan2(a));
    let mean = centre.norm_squared() + (p1 - centre).norm_squared();
    let cosine = |reach: f64| (reach * reach - mean) / swing;
    let (least, most) = (cosine(dh.a2 - dh.a3), cosine(dh.a2 + dh.a3));
    let wanted = wrap(q6 - phase);
    let bound = wanted.cos().clamp(least.max(-1.0), most.max(-1.0));
    let in_range = bound.abs() <= 1.0 + ROUNDING && most >= -1.0 - ROUNDING;
    in_range.then(|| phase + bound.clamp(-1.0, 1.0).acos().copysign(wanted))
}

/// Joints 2, 3, 4 for given joints 1, 5, 6; false when wrist 1 is out of reach.
fn planar(dh: &DhTable, target: &Pose, [q1, q5, q6]: [f64; 3], out: &mut IkSolutions) -> bool {
    let t14 = wrist(dh, target, [q1, q5, q6]);
    let (x, y) = (t14.translation.x, t14.translation.y);
    let mut c3 = (x * x + y * y - dh.a2 * dh.a2 - dh.a3 * dh.a3) / (2.0 * dh.a2 * dh.a3);
    if c3.abs() > 1.0 + ROUNDING {
        return false;
    }
    c3 = c3.clamp(-1.0, 1.0);
    let s3 = (1.0 - c3 * c3).sqrt();
    // Frame 4 in frame 1 is turned by q2 + q3 + q4 about z and then by pi/2 about x.
    let turned = t14.rotation * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2);
    let ex = turned * Vector3::x();
    let sum = ex.y.atan2(ex.x);
    for s3 in [s3, -s3] {
        let q3 = s3.atan2(c3);
        let (u, v) = (dh.a2 + dh.a3 * c3, dh.a3 * s3);
        let q2 = (u * y - v * x).atan2(u * x + v * y);
        let q = [q1, q2, q3, sum - q2 - q3, q5, q6].map(wrap);
        let (d, a) = error(&dh.fk(&q), target);
        if d < RESIDUAL && a < RESIDUAL {
            out.push(q);
        }
    }
    true
}

/// Metres and radians; accurate for small angles, where an arc cosine is not.
fn error(a: &Pose, b: &Pose) -> (f64, f64) {
    let r = (a.rotation.inverse() * b.rotation).vector().norm();
    ((a.translation.vector - b.translation.vector).norm(), 2.0 * r.min(1.0).asin())
}

#[cfg(test)]
mod tests {
    use super::super::Kinematics;
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn check(k: &Kinematics, q: &Joints) -> (usize, f64) {
        let t = k.fk(q);
        let all = k.ik(&t);
        let mut worst: f64 = 0.0;
        for s in all.iter() {
            let (d, a) = error(&k.fk(s), &t);
            worst = worst.max(d).max(a);
        }
        (all.len(), worst)
    }

    #[test]
    fn round_trip_over_random_poses() {
        // 1e5 poses were run once at this bound; the suite takes fewer for speed.
        let n: usize =
            std::env::var("TDV_IK_POSES").ok().and_then(|v| v.parse().ok()).unwrap_or(20_000);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for k in [Kinematics::ur5(), Kinematics::ur5e()] {
            let mut counts = [0; 9];
            let mut worst: f64 = 0.0;
            for _ in 0..n {
                let q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
                let (found, error) = check(&k, &q);
                counts[found] += 1;
                worst = worst.max(error);
                let back = k.ik(&k.fk(&q));
                let nearest = back
                    .iter()
                    .map(|s| s.iter().zip(&q).map(|(a, b)| wrap(a - b).abs()).fold(0.0, f64::max))
                    .fold(f64::INFINITY, f64::min);
                // Angles lose digits near a singularity, poses do not: see `worst`.
                assert!(nearest < 1e-3, "own configuration {q:?} missed by {nearest:.1e} rad");
            }
            println!("solutions {counts:?}, worst error {worst:.2e}");
            assert!(worst < 1e-9, "{worst:.3e}");
            assert_eq!(counts[0], 0);
            assert_eq!(counts[1] + counts[3] + counts[5] + counts[7], 0, "{counts:?}");
        }
    }

    #[test]
    fn singular_configurations_are_solved() {
        let k = Kinematics::ur5();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for i in 0..3000 {
            let mut q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
            let tiny = [0.0, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4][i % 6];
            match (i / 6) % 4 {
                0 => q[4] = tiny,
                1 => q[4] = PI - tiny,
                2 => q[2] = tiny,
                _ => {
                    q[4] = tiny;
                    q[2] = tiny;
                }
            }
            let (found, error) = check(&k, &q);
            assert!(found >= 1, "no solution at {q:?}");
            assert!(error < 1e-9, "{error:.2e} at {q:?}");
        }
    }

    #[test]
    fn shoulder_singularity_and_out_of_reach() {
        let k = Kinematics::ur5();
        // Wrist centre on the cylinder of radius d4 about the base axis: joint 1 has one value only.
        let mut q = [0.4, -1.9, 2.0, -0.3, 1.1, 0.2];
        let offset = |q2: f64, q: &Joints| {
            let p = k.frames(&[0.0, q2, q[2], q[3], q[4], q[5]])[5].translation.vector;
            p.x // along the arm's plane at q1 = 0
        };
        let (mut lo, mut hi) = (-3.0, 0.0);
        for _ in 0..200 {
            let mid = 0.5 * (lo + hi);
            if (offset(lo, &q) > 0.0) == (offset(mid, &q) > 0.0) { lo = mid } else { hi = mid }
        }
        q[1] = lo;
        let (found, error) = check(&k, &q);
        assert!(found >= 1 && error < 1e-8, "{found} {error:.2e}");
        let far = Pose::translation(1.2, 0.0, 0.3);
        assert!(k.ik(&far).is_empty());
        assert!(k.ik(&Pose::translation(f64::NAN, 0.0, 0.3)).is_empty());
        let inside = Pose::translation(0.02, 0.0, 0.5);
        assert!(k.ik(&inside).is_empty());
    }

    #[test]
    fn order_is_deterministic() {
        let k = Kinematics::ur5();
        let t = k.fk(&[0.1, -1.0, 1.0, 0.3, 0.4, 0.5]);
        let a = k.ik(&t);
        assert_eq!(a.len(), 8);
        assert_eq!(a, k.ik(&t));
        assert!(a[0][2] > 0.0 && a[1][2] < 0.0 && a[0][4] > 0.0 && a[2][4] < 0.0);
    }
}
