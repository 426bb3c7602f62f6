use super::{DhTable, Joints};
use nalgebra::{UnitQuaternion, Vector2};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use tdv_geometry::Pose;

/// Sine of the wrist-2 angle below which wrist 1 and wrist 3 turn about one line; small enough that any
/// value of joint 6 keeps the pose within [`RESIDUAL`].
const WRIST_SINGULAR: f64 = 2e-10;
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
    pub(super) const EMPTY: Self = Self { q: [[0.0; 6]; 8], len: 0 };

    pub(super) fn push(&mut self, q: Joints) {
        let same = |a: &Joints| a.iter().zip(&q).all(|(x, y)| wrap(x - y).abs() < SAME);
        if !self.iter().any(same) {
            self.append(q);
        }
    }

    /// For solutions that cannot be equal to an earlier one.
    #[inline]
    fn append(&mut self, q: Joints) {
        if self.len < 8 {
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

/// An angle with |angle| <= 3 pi to (-pi, pi]; one step, as the sums of two or three angles need.
#[inline]
fn wrap_once(angle: f64) -> f64 {
    if angle > PI {
        angle - TAU
    } else if angle <= -PI {
        angle + TAU
    } else {
        angle
    }
}

/// Sine and cosine of the direction `(x, y)`; those of zero where it has no length.
fn direction(x: f64, y: f64) -> (f64, f64) {
    let n = (x * x + y * y).sqrt();
    if n > 0.0 { (y / n, x / n) } else { (0.0, 1.0) }
}

/// What is known once joint 1 is chosen, in the axes of frame 1 (x along the arm's plane, y up).
struct Plane<'a> {
    dh: &'a DhTable,
    target: &'a Pose,
    q1: f64,
    /// Origin of frame 5.
    p5: [f64; 2],
    /// The tool's x and y axes, each along frame 1's x and y.
    tool_x: [f64; 2],
    tool_y: [f64; 2],
    /// Near the base axis' cylinder: a clamp was needed or both shoulder branches are one.
    check: bool,
}

impl Plane<'_> {
    /// Axis of joint 5 in the plane for the sine and cosine of joint 6; it is minus the y axis of
    /// frame 5, which joint 6 turns into the tool's x and y.
    fn wrist_axis(&self, (s6, c6): (f64, f64)) -> [f64; 2] {
        std::array::from_fn(|i| -(s6 * self.tool_x[i] + c6 * self.tool_y[i]))
    }
}

/// `target` is `T_base_tool0`; `free` is the value of joint 6 where the wrist is singular.
///
/// Geometry: the axes of joints 2, 3 and 4 are parallel (`z1`), so the wrist centre `p05` lies `d4`
/// from the shoulder's plane, which gives joint 1; `z1` seen from the tool gives joints 5 and 6; the
/// rest is a planar arm of two links. Arc tangents throughout: no loss of digits near the branch points.
///
/// Sines and cosines are carried as ratios of lengths, so that arc tangents are the only transcendental
/// functions (20 for eight solutions). Away from singularities each solution is exact by construction;
/// where a cosine was clamped or joint 6 is (nearly) free, it is checked by forward kinematics.
pub(super) fn solve(dh: &DhTable, target: &Pose, free: f64) -> IkSolutions {
    let mut out = IkSolutions::EMPTY;
    if !target.translation.vector.iter().chain(target.rotation.coords.iter()).all(|v| v.is_finite())
    {
        return out;
    }
    // Chains of products leave quaternions a little off unit length, which would show as a residual.
    let rotation = UnitQuaternion::new_normalize(target.rotation.into_inner());
    let target = &Pose::from_parts(target.translation, rotation);
    let r = rotation.to_rotation_matrix();
    let p = target.translation.vector;
    let (x, y) = (p.x - dh.d6 * r[(0, 2)], p.y - dh.d6 * r[(1, 2)]);
    let height = p.z - dh.d6 * r[(2, 2)] - dh.d1;
    let along2 = x * x + y * y - dh.d4 * dh.d4;
    if along2 < -ROUNDING * dh.d4 {
        return out; // the wrist centre is inside the cylinder about the base axis
    }
    let along = along2.max(0.0).sqrt();
    let (phi, psi) = (y.atan2(x), along.atan2(dh.d4));
    let ((s_phi, c_phi), (s_psi, c_psi)) = (direction(x, y), direction(dh.d4, along));
    for (psi, s_psi) in [(psi, s_psi), (-psi, -s_psi)] {
        let q1 = wrap_once(phi + psi + FRAC_PI_2);
        let (s1, c1) = (c_phi * c_psi - s_phi * s_psi, -(s_phi * c_psi + c_phi * s_psi));
        let plane = Plane {
            dh,
            target,
            q1,
            p5: [x * c1 + y * s1, height],
            tool_x: [r[(0, 0)] * c1 + r[(1, 0)] * s1, r[(2, 0)]],
            tool_y: [r[(0, 1)] * c1 + r[(1, 1)] * s1, r[(2, 1)]],
            check: psi.abs() < SAME,
        };
        let z1: [f64; 3] = std::array::from_fn(|i| r[(0, i)] * s1 - r[(1, i)] * c1);
        let sine = (z1[0] * z1[0] + z1[1] * z1[1]).sqrt();
        let q5 = sine.atan2(z1[2]);
        if sine < NEAR_SINGULAR {
            near_singular(&plane, z1, sine, q5, free, &mut out);
            continue;
        }
        let q6 = (-z1[1]).atan2(z1[0]);
        let axis = plane.wrist_axis((-z1[1] / sine, z1[0] / sine));
        let sum = axis[0].atan2(-axis[1]);
        planar(&plane, axis, sum, [q5, q6], plane.check, &mut out);
        // The other wrist branch: joint 6 half a turn on, the wrist axis reversed.
        let half = |a: f64| if a > 0.0 { a - PI } else { a + PI };
        let axis = [-axis[0], -axis[1]];
        planar(&plane, axis, half(sum), [-q5, half(q6)], plane.check, &mut out);
    }
    out
}

/// Both wrist branches where wrist 1 and wrist 3 turn (nearly) about one line.
fn near_singular(
    plane: &Plane,
    z1: [f64; 3],
    sine: f64,
    q5: f64,
    free: f64,
    out: &mut IkSolutions,
) {
    for sign in [1.0, -1.0] {
        let q5 = wrap_once(sign * q5);
        let q6 = if sine < WRIST_SINGULAR { free } else { (-sign * z1[1]).atan2(sign * z1[0]) };
        let mut try_at = |q6: f64| {
            let axis = plane.wrist_axis(q6.sin_cos());
            planar(plane, axis, axis[0].atan2(-axis[1]), [q5, wrap(q6)], true, out)
        };
        if !try_at(q6) {
            // Joint 6 is (almost) free, and some of its values put wrist 1 out of reach.
            if let Some(q6) = reachable_q6(plane, q6) {
                try_at(q6);
            }
        }
    }
}

/// The value of joint 6 nearest to the given one for which wrist 1 is in the planar arm's reach.
///
/// Wrist 1 runs on a circle as joint 6 turns, so its squared distance from the shoulder is
/// `mean + swing cos(q6 - phase)`, and the reach bounds the cosine.
fn reachable_q6(plane: &Plane, q6: f64) -> Option<f64> {
    let dh = plane.dh;
    let at = |q6: f64| {
        let axis = plane.wrist_axis(q6.sin_cos());
        Vector2::new(plane.p5[0] - dh.d5 * axis[0], plane.p5[1] - dh.d5 * axis[1])
    };
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

/// Joints 2, 3, 4 for given joints 1, 5, 6, the wrist axis in the plane and `sum` = q2 + q3 + q4;
/// false when wrist 1 is out of reach.
#[inline]
fn planar(
    plane: &Plane,
    axis: [f64; 2],
    sum: f64,
    [q5, q6]: [f64; 2],
    check: bool,
    out: &mut IkSolutions,
) -> bool {
    let dh = plane.dh;
    let (x, y) = (plane.p5[0] - dh.d5 * axis[0], plane.p5[1] - dh.d5 * axis[1]);
    let mut c3 = (x * x + y * y - dh.a2 * dh.a2 - dh.a3 * dh.a3) / (2.0 * dh.a2 * dh.a3);
    if c3.is_nan() || c3.abs() > 1.0 + ROUNDING {
        return false;
    }
    // Within `SAME` of stretched or folded the two elbow branches are one solution.
    let check = check || c3.abs() > 1.0 - SAME * SAME;
    c3 = c3.clamp(-1.0, 1.0);
    let s3 = (1.0 - c3 * c3).sqrt();
    let q3 = s3.atan2(c3);
    let (towards, inner) = (y.atan2(x), (dh.a3 * s3).atan2(dh.a2 + dh.a3 * c3));
    for (q3, inner) in [(q3, inner), (-q3, -inner)] {
        let q2 = wrap_once(towards - inner);
        let q = [plane.q1, q2, wrap_once(q3), wrap_once(sum - q2 - q3), q5, q6];
        if !check {
            out.append(q);
            continue;
        }
        let (d, a) = error(&dh.fk(&q), plane.target);
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
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for k in [Kinematics::ur5(), Kinematics::ur5e()] {
            let mut counts = [0; 9];
            let (mut worst, mut near): (f64, f64) = (0.0, 0.0);
            for _ in 0..50_000 {
                let q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
                let t = k.fk(&q);
                let back = k.ik(&t);
                counts[back.len()] += 1;
                for s in back.iter() {
                    let (d, a) = error(&k.fk(s), &t);
                    let regular = s[4].sin().abs() > 1e-3 && s[2].sin().abs() > 1e-3;
                    let which = if regular { &mut worst } else { &mut near };
                    *which = which.max(d).max(a);
                    assert!(s.iter().all(|v| *v > -PI && *v <= PI), "{s:?}");
                }
                let nearest = back
                    .iter()
                    .map(|s| s.iter().zip(&q).map(|(a, b)| wrap(a - b).abs()).fold(0.0, f64::max))
                    .fold(f64::INFINITY, f64::min);
                // Angles lose digits near a singularity, poses do not: see `worst`.
                assert!(nearest < 1e-3, "own configuration {q:?} missed by {nearest:.1e} rad");
            }
            println!("solutions {counts:?}, worst error {worst:.2e}, nearly singular {near:.2e}");
            assert!(worst < 1e-12 && near < 1e-9, "{worst:.3e} {near:.3e}");
            assert_eq!(counts[0], 0);
            assert_eq!(counts[1] + counts[3] + counts[5] + counts[7], 0, "{counts:?}");
        }
    }

    #[test]
    fn singular_configurations_are_solved() {
        let k = Kinematics::ur5();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut worst: f64 = 0.0;
        for i in 0..6000 {
            let mut q: Joints = std::array::from_fn(|_| rng.random_range(-PI..PI));
            // Also in between, where the treatment changes.
            let between = 10f64.powf(rng.random_range(-13.0..-3.0));
            let tiny = [0.0, 1e-13, 1e-10, 1e-8, 1e-6, between][i % 6];
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
            worst = worst.max(error);
        }
        println!("worst error of singular configurations {worst:.2e}");
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
