//! Geometric paths: even spacing, rounded corners, one speed law.

use tdv_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, interpolate, twist_arc};

/// Radius (m) at which a rotation is weighed against a translation in path lengths.
pub(crate) const RHO: f64 = 0.1;

/// The speed law of [`retime`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// m/s of the frame's origin.
    pub speed: f64,
    /// m/s^2 along the path and across it.
    pub acceleration: f64,
    /// rad/s.
    pub angular_speed: f64,
    /// Length of the path's last part (m, SE(3) arc) that is driven at `tail_speed`.
    pub tail: f64,
    /// m/s in the tail.
    pub tail_speed: f64,
}

/// Rotation with these columns, which must be orthonormal and right-handed. (nalgebra's
/// `UnitQuaternion::from_matrix` searches from the identity and stays there for half turns, such as a
/// gripper that points straight down.)
pub(crate) fn from_axes(
    x: &Vector3<f64>,
    y: &Vector3<f64>,
    z: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let m = Matrix3::from_columns(&[*x, *y, *z]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
}

/// Cumulative SE(3) arc length (m) of a path, see [`twist_arc`].
pub(crate) fn arcs(path: &[Pose]) -> Vec<f64> {
    let mut s = 0.0;
    let mut out = Vec::with_capacity(path.len());
    for (i, p) in path.iter().enumerate() {
        if i > 0 {
            s += twist_arc(&path[i - 1], p, RHO);
        }
        out.push(s);
    }
    out
}

/// The pose at arc length `s`; `arcs` must be those of `path`, not empty.
pub(crate) fn at_arc(path: &[Pose], arcs: &[f64], s: f64) -> Pose {
    let i = arcs.partition_point(|a| *a <= s);
    if i == 0 {
        return path[0];
    }
    if i == path.len() {
        return path[i - 1];
    }
    let (a, b) = (arcs[i - 1], arcs[i]);
    interpolate(&path[i - 1], &path[i], if b > a { (s - a) / (b - a) } else { 0.0 })
}

/// At least `count` poses, evenly spaced along the SE(3) arc; first and last pose are kept exactly.
pub fn densify(path: &[Pose], count: usize) -> Vec<Pose> {
    let (Some(first), Some(last)) = (path.first(), path.last()) else { return Vec::new() };
    let arcs = arcs(path);
    let total = arcs[arcs.len() - 1];
    let n = count.max(2);
    let mut out: Vec<_> =
        (0..n).map(|i| at_arc(path, &arcs, total * i as f64 / (n - 1) as f64)).collect();
    out[0] = *first;
    out[n - 1] = *last;
    out
}

/// Rounds the corners of a path by a moving average of half width `radius` (m of SE(3) arc) that narrows
/// to nothing at the start and before the last `keep` metres, which stay exactly.
pub fn round_corners(path: &[Pose], radius: f64, keep: f64) -> Vec<Pose> {
    const STEP: f64 = 0.003;
    let arcs = arcs(path);
    let Some(total) = arcs.last().copied() else { return Vec::new() };
    if total < 2.0 * STEP || radius < STEP {
        return path.to_vec();
    }
    let n = (total / STEP).ceil() as usize + 1;
    let even = densify(path, n);
    let step = total / (n - 1) as f64;
    let mut out: Vec<Pose> = (0..n)
        .map(|i| {
            let s = i as f64 * step;
            let half = radius.min(s).min((total - keep - s).max(0.0));
            let k = (half / step) as usize;
            if k == 0 { even[i] } else { mean(&even[i - k..=i + k]) }
        })
        .collect();
    out[0] = even[0];
    out[n - 1] = even[n - 1];
    out
}

/// Mean position and normalised quaternion mean of poses that are near each other; not empty.
fn mean(poses: &[Pose]) -> Pose {
    let mut p = Vector3::zeros();
    let mut q = Quaternion::new(0.0, 0.0, 0.0, 0.0);
    let near = poses[poses.len() / 2].rotation;
    for x in poses {
        p += x.translation.vector;
        let c = x.rotation.into_inner();
        q += if c.coords.dot(&near.coords) < 0.0 { -c } else { c };
    }
    let rotation = UnitQuaternion::try_new(q, 1e-9).unwrap_or(near);
    Pose::from_parts((p / poses.len() as f64).into(), rotation)
}

/// Drives a path from rest to rest as fast as the limits allow and samples it every `dt` seconds; the
/// time is stretched so that the last sample falls on the end. First and last pose are exact.
pub fn retime(path: &[Pose], limits: &Limits, dt: f64) -> Vec<Pose> {
    let (Some(first), Some(last)) = (path.first(), path.last()) else { return Vec::new() };
    let mut points: Vec<Pose> = Vec::with_capacity(path.len());
    for p in path {
        if points.last().is_none_or(|q| twist_arc(q, p, RHO) > 1e-7) {
            points.push(*p);
        }
    }
    if points.len() < 2 {
        return vec![*first, *last];
    }
    // A few corners are not enough to speed up and slow down between.
    if points.len() < 50 {
        points = densify(&points, 50);
    }
    let arcs = arcs(&points);
    let speeds = speed_profile(&points, &arcs, limits);
    let mut times = vec![0.0];
    for i in 1..points.len() {
        let step = 2.0 * (arcs[i] - arcs[i - 1]) / (speeds[i] + speeds[i - 1]).max(1e-6);
        times.push(times[i - 1] + step);
    }
    let total = times[times.len() - 1];
    let n = (total / dt - 1e-9).ceil().max(1.0) as usize;
    let mut out: Vec<Pose> = (0..=n)
        .map(|k| {
            let t = total * k as f64 / n as f64;
            let i = times.partition_point(|x| *x <= t).clamp(1, times.len() - 1);
            let (t0, t1) = (times[i - 1], times[i]);
            let tau = t - t0;
            let a = (speeds[i] - speeds[i - 1]) / (t1 - t0).max(1e-12);
            at_arc(&points, &arcs, arcs[i - 1] + speeds[i - 1] * tau + 0.5 * a * tau * tau)
        })
        .collect();
    out[0] = *first;
    out[n] = *last;
    out
}

/// Largest speed along the arc at every point: limits of the segments and of the curves, then an
/// acceleration pass forwards and one backwards.
fn speed_profile(points: &[Pose], arcs: &[f64], limits: &Limits) -> Vec<f64> {
    let n = points.len();
    let total = arcs[n - 1];
    let move_of = |i: usize| points[i + 1].translation.vector - points[i].translation.vector;
    let segment: Vec<f64> = (0..n - 1)
        .map(|i| {
            let ds = (arcs[i + 1] - arcs[i]).max(1e-12);
            let shift = move_of(i).norm() / ds;
            let turn = points[i].rotation.angle_to(&points[i + 1].rotation) / ds;
            let in_tail = arcs[i + 1] > total - limits.tail;
            let speed = if in_tail { limits.tail_speed.min(limits.speed) } else { limits.speed };
            (speed / shift.max(1e-9)).min(limits.angular_speed / turn.max(1e-9))
        })
        .collect();
    let mut v = vec![0.0; n];
    for i in 1..n - 1 {
        let (a, b) = (move_of(i - 1), move_of(i));
        let mut limit = segment[i - 1].min(segment[i]);
        let length = 0.5 * (a.norm() + b.norm());
        if a.norm() > 1e-6 && b.norm() > 1e-6 {
            let curvature = a.angle(&b) / length;
            let shift = 2.0 * length / (arcs[i + 1] - arcs[i - 1]).max(1e-12);
            limit = limit.min((limits.acceleration / curvature.max(1e-9)).sqrt() / shift.max(1e-9));
        }
        v[i] = limit.max(1e-3);
    }
    for i in 1..n {
        v[i] = v[i].min(f64::sqrt(
            v[i - 1] * v[i - 1] + 2.0 * limits.acceleration * (arcs[i] - arcs[i - 1]),
        ));
    }
    for i in (0..n - 1).rev() {
        v[i] = v[i].min(f64::sqrt(
            v[i + 1] * v[i + 1] + 2.0 * limits.acceleration * (arcs[i + 1] - arcs[i]),
        ));
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    pub(crate) const LIMITS: Limits =
        Limits { speed: 0.2, acceleration: 0.6, angular_speed: 1.0, tail: 0.0, tail_speed: 0.2 };

    fn corner() -> Vec<Pose> {
        vec![
            pose_from_xyz_rpy([0.0, 0.0, 0.3], [0.0; 3]),
            pose_from_xyz_rpy([0.3, 0.0, 0.3], [0.0, 0.0, 1.5]),
            pose_from_xyz_rpy([0.3, 0.0, 0.2], [0.0, 0.0, 1.5]),
        ]
    }

    #[test]
    fn a_corner_is_rounded_and_the_tail_kept() {
        let r = round_corners(&corner(), 0.03, 0.05);
        assert_eq!(r[0], corner()[0]);
        assert_eq!(*r.last().unwrap(), corner()[2]);
        let tail: Vec<_> = r.iter().filter(|p| p.translation.z < 0.25 - 1e-6).collect();
        assert!(tail.len() > 10);
        assert!(tail.iter().all(|p| (p.translation.x - 0.3).abs() < 1e-9));
        assert!(
            r.iter()
                .all(|p| (corner()[1].translation.vector - p.translation.vector).norm() > 0.003)
        );
        assert!(round_corners(&[], 0.03, 0.0).is_empty());
    }

    #[test]
    fn speed_acceleration_and_rotation_keep_their_limits() {
        let path = round_corners(&corner(), 0.03, 0.05);
        let dt = 0.05;
        let t = retime(&path, &LIMITS, dt);
        assert_eq!((t[0], t[t.len() - 1]), (path[0], path[path.len() - 1]));
        let v: Vec<_> = t.windows(2).map(|w| pose_distance(&w[0], &w[1])).collect();
        assert!(v.iter().all(|(d, a)| d / dt <= 0.2 + 1e-6 && a / dt <= 1.0 + 1e-3));
        let speeds: Vec<_> = v.iter().map(|(d, _)| d / dt).collect();
        assert!(speeds.windows(2).all(|w| (w[1] - w[0]).abs() / dt <= 0.6 * 1.3), "{speeds:?}");
        assert!(speeds[0] < 0.03 && speeds[speeds.len() - 1] < 0.03);
        // 1.5 rad at no more than 1 rad/s.
        assert!(t.len() as f64 * dt > 1.5);
        let slow = retime(&path, &Limits { tail: 0.1, tail_speed: 0.05, ..LIMITS }, dt);
        assert!(slow.len() > t.len());
    }

    #[test]
    fn nothing_to_do_is_not_a_panic() {
        let p = pose_from_xyz_rpy([0.1; 3], [0.0; 3]);
        assert_eq!(retime(&[p], &LIMITS, 0.05), vec![p, p]);
        assert_eq!(retime(&[p, p, p], &LIMITS, 0.05), vec![p, p]);
        assert!(retime(&[], &LIMITS, 0.05).is_empty());
        let q = pose_from_xyz_rpy([0.1; 3], [0.0, 0.0, 1.0]);
        let turn = retime(&[p, q], &LIMITS, 0.05);
        assert!(turn.len() > 20 && turn.len() < 60, "{}", turn.len());
    }
}
