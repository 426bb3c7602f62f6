use super::edge::between;
use super::scurve::SCurve;
use crate::executor::{JointTrajectory, TrajectoryPoint};
use crate::kinematics::{JOINT_NAMES, Joints, Kinematics};
use crate::limits::Limits;

/// Time between points (s).
const PERIOD: f64 = 0.008;
/// Looks at the tcp's speed along a line.
const LOOKS: usize = 128;

/// A path of straight joint-space lines in time: an S-curve along each, all joints together, at rest at
/// each corner; joint speed, acceleration and jerk and the tcp's speeds are within `limits`. The path is
/// kept exactly, so what was certified free stays so.
pub fn parametrise(path: &[Joints], k: &Kinematics, limits: &Limits) -> JointTrajectory {
    let mut points = Vec::new();
    let mut begin = 0.0;
    for w in path.windows(2) {
        let dq: Joints = std::array::from_fn(|i| w[1][i] - w[0][i]);
        let most = dq.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        if most < 1e-9 {
            continue;
        }
        let speed = (limits.joint_velocity / most).min(tcp_bound(&w[0], &w[1], k, limits));
        let curve = SCurve::new(speed, limits.joint_acceleration / most, limits.joint_jerk / most)
            .in_periods(PERIOD);
        let count = (curve.duration() / PERIOD).round() as usize;
        for n in 1..=count {
            let [s, v, a] = curve.at(PERIOD * n as f64);
            let last = n == count;
            let moving = |x: f64| dq.iter().map(|d| if last { 0.0 } else { d * x }).collect();
            let q = if last { w[1] } else { between(&w[0], &w[1], s) };
            points.push(TrajectoryPoint {
                positions: q.to_vec(),
                velocities: moving(v),
                accelerations: moving(a),
                effort: Vec::new(),
                time_from_start: begin + PERIOD * n as f64,
            });
        }
        begin += PERIOD * count as f64;
    }
    if let (true, Some(q)) = (points.is_empty(), path.last()) {
        // Already there: one point at rest.
        let (positions, still) = (q.to_vec(), vec![0.0; 6]);
        points.push(TrajectoryPoint {
            positions,
            velocities: still.clone(),
            accelerations: still,
            effort: Vec::new(),
            time_from_start: PERIOD,
        });
    }
    JointTrajectory { names: JOINT_NAMES.map(String::from).to_vec(), stamp: None, points }
}

/// Greatest fraction of the line per second for the tcp's speeds.
///
/// The derivative of the tcp's velocity along the line is at most `(sum |dq|)^2` times its distance from
/// the joints' axes, and of its angular velocity without the distance; so looks half a step away bound
/// everything between.
fn tcp_bound(a: &Joints, b: &Joints, k: &Kinematics, limits: &Limits) -> f64 {
    let dq: Joints = std::array::from_fn(|i| b[i] - a[i]);
    let sum: f64 = dq.iter().map(|d| d.abs()).sum();
    let dh = k.dh();
    let links = [dh.a2, dh.a3, dh.d4, dh.d5, dh.d6];
    let far = links.iter().map(|l| l.abs()).sum::<f64>() + k.tool().translation.vector.norm();
    let (mut linear, mut angular): (f64, f64) = (0.0, 0.0);
    for i in 0..=LOOKS {
        let (v, w) = k.tcp_speed(&between(a, b, i as f64 / LOOKS as f64), &dq);
        (linear, angular) = (linear.max(v), angular.max(w));
    }
    let slack = 0.5 / LOOKS as f64 * sum * sum;
    (limits.tcp_speed / (linear + slack * far)).min(limits.tcp_angular_speed / (angular + slack))
}
