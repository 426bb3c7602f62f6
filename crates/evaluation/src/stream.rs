//! How smooth the executed motion is, and how near to what was predicted.

use crate::percentile;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tdv_geometry::nalgebra::Vector3;
use tdv_geometry::{Pose, Stamp};

/// The true joints at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionSample {
    /// When.
    pub stamp: Stamp,
    /// Joint angles (rad).
    pub q: [f64; 6],
    /// Joint speeds (rad/s).
    pub qd: [f64; 6],
}

/// A prediction as the arm controller got it.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedPath {
    /// When it came.
    pub received: Stamp,
    /// Tool poses in base_link; the first one is where the tool was observed.
    pub tool: Vec<Pose>,
}

/// Figures over a whole evaluation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamFigures {
    /// Seconds during which the arm moved.
    pub moving_s: f64,
    /// Greatest change of a joint's speed over one sample of 8 ms, rad/s.
    pub velocity_step: f64,
    /// Greatest jerk of a joint, rad/s^3, from differences over 8 ms.
    pub jerk_max: f64,
    /// 99.9th percentile of the largest joint jerk.
    pub jerk_p999: f64,
    /// Distance of the executed tool path from the predicted one, mm: median, 99th percentile, greatest.
    pub path_mm: [f64; 3],
    /// Interval between fresh commands at the robot, ms, and others that the driver and the robot
    /// measured, by name.
    #[serde(default)]
    pub measured: BTreeMap<String, f64>,
}

/// Joint speed (rad/s) of an arm that moves.
const MOVING: f64 = 0.02;
/// A prediction steers the arm for this long (s) at most.
const STEERS: f64 = 0.15;
/// Samples farther apart than this (s) are not compared.
const GAP: f64 = 0.012;

/// Collects the trials of an evaluation.
#[derive(Debug, Clone, Default)]
pub struct StreamStatistics {
    moving_s: f64,
    steps: Vec<f64>,
    jerks: Vec<f64>,
    paths: Vec<f64>,
}

impl StreamStatistics {
    /// Adds a trial. `tool` is the forward kinematics, `T_base_link_tcp`. Predictions that come after a
    /// stop of the arm count as well; a path is compared from when it came until the next one.
    pub fn add(
        &mut self,
        motion: &[MotionSample],
        predictions: &[PredictedPath],
        tool: impl Fn(&[f64; 6]) -> Pose,
    ) {
        let dt = |w: &[MotionSample]| w[1].stamp.since(w[0].stamp);
        let fastest = |s: &MotionSample| s.qd.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        for w in motion.windows(2).filter(|w| dt(w) > 0.0 && dt(w) < GAP) {
            if fastest(&w[1]) > MOVING {
                self.moving_s += dt(w);
            }
            let step = (0..6).map(|i| (w[1].qd[i] - w[0].qd[i]).abs()).fold(0.0, f64::max);
            self.steps.push(step);
        }
        for w in motion.windows(3).filter(|w| w.windows(2).all(|w| dt(w) > 0.0 && dt(w) < GAP)) {
            let (a, b) = (dt(&w[0..2]), dt(&w[1..3]));
            let jerk = |i: usize| {
                let (first, second) =
                    ((w[1].qd[i] - w[0].qd[i]) / a, (w[2].qd[i] - w[1].qd[i]) / b);
                ((second - first) / (0.5 * (a + b))).abs()
            };
            self.jerks.push((0..6).map(jerk).fold(0.0, f64::max));
        }
        for (i, p) in predictions.iter().enumerate() {
            let until = predictions.get(i + 1).map_or(STEERS, |n| n.received.since(p.received));
            let until = until.min(STEERS);
            let begin = motion.partition_point(|m| m.stamp < p.received);
            for m in &motion[begin..] {
                if m.stamp.since(p.received) >= until {
                    break;
                }
                if fastest(m) > MOVING {
                    self.paths.push(1e3 * distance(&tool(&m.q), &p.tool));
                }
            }
        }
    }

    /// The figures so far.
    pub fn figures(&self) -> StreamFigures {
        let most = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
        let at = |v: &[f64], q: f64| percentile(v, q).unwrap_or(0.0);
        StreamFigures {
            moving_s: self.moving_s,
            velocity_step: most(&self.steps),
            jerk_max: most(&self.jerks),
            jerk_p999: at(&self.jerks, 0.999),
            path_mm: [at(&self.paths, 0.5), at(&self.paths, 0.99), most(&self.paths)],
            measured: BTreeMap::new(),
        }
    }
}

/// Metres from a point to the line through the poses.
fn distance(tool: &Pose, line: &[Pose]) -> f64 {
    let p = tool.translation.vector;
    let to = |a: Vector3<f64>, b: Vector3<f64>| {
        let d = b - a;
        let x = ((p - a).dot(&d) / d.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (p - a - d * x).norm()
    };
    line.windows(2)
        .map(|w| to(w[0].translation.vector, w[1].translation.vector))
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_jerk_and_distance_of_a_known_motion() {
        // Constant jerk of 10 rad/s^3 in joint 0, tool 3 mm beside the predicted line.
        let sample = |k: i64| {
            let t = 0.008 * k as f64;
            MotionSample {
                stamp: Stamp(k * 8_000_000),
                q: [10.0 * t * t * t / 6.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                qd: [5.0 * t * t, 0.0, 0.0, 0.0, 0.0, 0.0],
            }
        };
        let motion: Vec<MotionSample> = (0..100).map(sample).collect();
        let line = [0.0, 0.5, 1.0].map(|x| Pose::translation(x, 0.003, 0.0)).to_vec();
        let predictions = [0.5, 0.55]
            .map(|t| PredictedPath { received: Stamp::from_secs(t), tool: line.clone() });
        let mut s = StreamStatistics::default();
        s.add(&motion, &predictions, |q| Pose::translation(q[0], 0.0, 0.0));
        let f = s.figures();
        assert!((f.jerk_max - 10.0).abs() < 1e-6 && (f.jerk_p999 - 10.0).abs() < 1e-6, "{f:?}");
        assert!((f.velocity_step - 5.0 * (0.792_f64.powi(2) - 0.784_f64.powi(2))).abs() < 1e-9);
        assert!(f.path_mm.iter().all(|d| (d - 3.0).abs() < 1e-6), "{f:?}");
        // Moving from 0.02 rad/s on, which is at 63 ms.
        assert!((f.moving_s - (0.792 - 0.064)).abs() < 0.009, "{f:?}");
    }

    #[test]
    fn a_gap_is_no_step() {
        let at = |t: f64, v: f64| MotionSample {
            stamp: Stamp::from_secs(t),
            q: [0.0; 6],
            qd: [v, 0.0, 0.0, 0.0, 0.0, 0.0],
        };
        let mut s = StreamStatistics::default();
        s.add(&[at(0.0, 0.0), at(0.008, 0.1), at(1.0, 0.9)], &[], |_| Pose::identity());
        assert!((s.figures().velocity_step - 0.1).abs() < 1e-12);
    }
}
