//! A synthetic placing task: one smooth demonstration in the goal frame, turned, stretched and faded
//! to random starts. For tests and for measuring the learner apart from the rest.

use crate::rng::{Stream, stream};
use crate::{ProcedureData, TrainingSet};
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use tdv_geometry::{Pose, smooth_step};

/// Samples of the demonstration.
const SAMPLES: usize = 60;
/// Part of the path, at its end, that is not warped by height and orientation offsets.
const TAIL: f64 = 0.2;

fn demonstration(u: f64) -> Pose {
    let s = smooth_step(u);
    let (from, to) = (Vector3::new(0.25, -0.15, 0.05), Vector3::new(0.0, 0.0, 0.03));
    let mut p = from.lerp(&to, s);
    p.z += 0.15 * (std::f64::consts::PI * s).sin();
    p.x += 0.03 * (2.0 * std::f64::consts::PI * s).sin();
    let start = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1.0)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.3);
    Pose::from_parts(p.into(), start.slerp(&UnitQuaternion::identity(), (s / 0.8).min(1.0)))
}

/// A random start: xy within 30 cm but more than 8 cm from the goal's axis, z 3..15 cm, yaw up to
/// 86 and tilt up to 23 degrees.
fn start(rng: &mut ChaCha8Rng) -> Pose {
    let (x, y) = loop {
        let (x, y): (f64, f64) = (rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3));
        if x.hypot(y) > 0.08 {
            break (x, y);
        }
    };
    let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let axis = nalgebra::Unit::new_normalize(Vector3::new(angle.cos(), angle.sin(), 0.0));
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-1.5..1.5))
        * UnitQuaternion::from_axis_angle(&axis, rng.random_range(0.0..0.4));
    Pose::from_parts(Vector3::new(x, y, rng.random_range(0.03..0.15)).into(), rotation)
}

/// The demonstration fitted to a start.
pub fn trajectory_from(start: &Pose) -> Vec<Pose> {
    let (first, end) = (demonstration(0.0), demonstration(1.0));
    let v = first.translation.vector - end.translation.vector;
    let w = start.translation.vector - end.translation.vector;
    let turn = w.y.atan2(w.x) - v.y.atan2(v.x);
    let scale = w.xy().norm() / v.xy().norm();
    let offset = first.rotation.inverse() * start.rotation;
    let offset = offset.scaled_axis();
    let n = (SAMPLES as f64 * scale.max(0.6)).ceil() as usize;
    // Fractions of the demonstration's arc length, for the fade.
    let arc: Vec<f64> = (0..n)
        .scan((0.0, first.translation.vector), |(s, last), i| {
            let p = demonstration(i as f64 / (n - 1) as f64).translation.vector;
            *s += (p - *last).norm();
            *last = p;
            Some(*s)
        })
        .collect();
    (0..n)
        .map(|i| {
            let pose = demonstration(i as f64 / (n - 1) as f64);
            let fade = (1.0 - arc[i] / arc[n - 1] / (1.0 - TAIL)).max(0.0);
            let mut p = pose.translation.vector - end.translation.vector;
            let xy = nalgebra::Rotation2::new(turn) * p.xy() * scale;
            p.x = xy.x;
            p.y = xy.y;
            p.z += fade * (w.z - v.z);
            let rotation = pose.rotation * UnitQuaternion::from_scaled_axis(offset * fade);
            Pose::from_parts((p + end.translation.vector).into(), rotation)
        })
        .collect()
}

/// `count` trajectories of the placing task, 0.1 s between poses.
pub fn place_set(count: usize, seed: u64) -> TrainingSet {
    let mut rng = stream(seed, Stream::Synthetic);
    let trajectories = (0..count).map(|_| trajectory_from(&start(&mut rng))).collect();
    set(vec![ProcedureData { name: "place".into(), trajectories }])
}

/// Two procedures: a reach (the same shapes seen from another frame, upside down, ending 4 cm from
/// the reference) and the placing.
pub fn reach_and_place_set(count: usize, seed: u64) -> TrainingSet {
    let mut place = place_set(count, seed);
    let flip = Pose::from_parts(
        Vector3::new(0.04, 0.0, 0.05).into(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
    );
    let trajectories = place_set(count, seed ^ 0x5eed)
        .procedures
        .remove(0)
        .trajectories
        .into_iter()
        .map(|t| {
            t.into_iter()
                .map(|p| {
                    let shifted = p.translation.vector + flip.translation.vector;
                    Pose::from_parts(shifted.into(), p.rotation * flip.rotation)
                })
                .collect()
        })
        .collect();
    place.procedures.insert(0, ProcedureData { name: "reach".into(), trajectories });
    set(place.procedures)
}

/// Two tasks in the same scene, `left` and `right`: from the same starts to goals 20 cm to either side,
/// each with an embedding of 16 numbers. Their normalisers are nearly the same, so that only the
/// embedding tells them apart.
pub fn two_goal_sets(count: usize, seed: u64) -> [TrainingSet; 2] {
    let towards = |name: &str, side: f64, phase: f32| {
        let place = place_set(count, seed).procedures.remove(0);
        let end = demonstration(1.0).translation.vector;
        let trajectories = place
            .trajectories
            .iter()
            .map(|t| {
                // The goal moves aside and the start stays: the offset grows along the path.
                let length = |p: &Pose| (p.translation.vector - end).norm();
                let far = length(&t[0]).max(1e-6);
                t.iter()
                    .map(|p| {
                        let s = smooth_step((1.0 - length(p) / far).clamp(0.0, 1.0));
                        let moved = p.translation.vector + Vector3::new(0.0, side * s, 0.0);
                        Pose::from_parts(moved.into(), p.rotation)
                    })
                    .collect()
            })
            .collect();
        let mut set = set(vec![ProcedureData { name: "place".into(), trajectories }]);
        set.task = name.into();
        set.text = format!("put it on the {name}");
        set.text_embedding = Some((0..16).map(|i| (phase + i as f32).sin()).collect());
        set.dataset_hash = set.content_hash();
        set
    };
    [towards("left", 0.2, 0.0), towards("right", -0.2, 2.0)]
}

fn set(procedures: Vec<ProcedureData>) -> TrainingSet {
    let mut set = TrainingSet {
        task: "synthetic".into(),
        text: "put it there".into(),
        text_embedding: None,
        procedures,
        dt: 0.1,
        dataset_hash: String::new(),
    };
    set.dataset_hash = set.content_hash();
    set
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_distance;

    #[test]
    fn starts_and_ends_are_met() {
        let mut rng = stream(4, Stream::Synthetic);
        for _ in 0..50 {
            let s = start(&mut rng);
            let t = trajectory_from(&s);
            let (d, a) = pose_distance(&t[0], &s);
            assert!(d < 1e-9 && a < 1e-6, "{d} {a}");
            let (d, a) = pose_distance(&t[t.len() - 1], &demonstration(1.0));
            assert!(d < 1e-9 && a < 1e-6);
        }
    }
}
