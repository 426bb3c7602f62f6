use super::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;
use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

/// The demonstration of the table: 29 cm in the plane, 12 cm of lift, ends 7 cm above its start.
pub(super) fn demo() -> Vec<Pose> {
    (0..80)
        .map(|i| {
            let s = smooth_step(f64::from(i) / 79.0);
            let z = 0.03 + 0.07 * s + 0.12 * (PI * s).sin();
            pose_from_xyz_rpy([0.25 * (1.0 - s), -0.15 * (1.0 - s), z], [0.0, 0.0, 0.3 * (1.0 - s)])
        })
        .collect()
}

/// A demonstration that starts 2 mm beside the vertical above its end.
pub(super) fn from_above() -> Vec<Pose> {
    (0..80)
        .map(|i| {
            let s = smooth_step(f64::from(i) / 79.0);
            let x = 0.002 * (1.0 - s) + 0.03 * (2.0 * PI * s).sin();
            pose_from_xyz_rpy([x, 0.0, 0.30 - 0.25 * s], [0.0; 3])
        })
        .collect()
}

fn start(x: f64, y: f64, z: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [0.0, 0.0, 0.3])
}

fn miss(path: &[Pose], demo: &[Pose]) -> f64 {
    pose_distance(&path[path.len() - 1], &demo[demo.len() - 1]).0
}

/// Angle (deg) between the last motions (sample T-12 to T-1) of two paths.
fn approach_error(path: &[Pose], demo: &[Pose]) -> f64 {
    let last = |p: &[Pose]| p[p.len() - 1].translation.vector - p[p.len() - 12].translation.vector;
    last(path).angle(&last(demo)).to_degrees()
}

/// The degenerate cases, their figures with the paper's formula and with the repaired one.
#[test]
fn table_of_degenerate_cases() {
    let demo = demo();
    let config = WarpConfig::default();
    // start, end miss of the literal formula (m)
    let rows = [
        (start(0.5, -0.3, 0.03), 0.070),
        (start(0.125, -0.075, 0.03), 0.035),
        (start(0.25, -0.15, 0.13), 0.100),
        (start(-0.25, 0.15, 0.03), 0.0),
        (start(0.0, 0.001, 0.2), 0.100),
    ];
    for (s, paper_miss) in rows {
        let paper = warp_paper(&demo, &s, 0.25).unwrap();
        assert!((miss(&paper.poses, &demo) - paper_miss).abs() < 1.5e-3, "{s}");
        let ours = warp_repaired(&demo, &s, &config);
        assert!(miss(&ours.poses, &demo) < 1e-12, "{s}");
        assert!(approach_error(&ours.poses, &demo) < 1e-6, "{s}");
        assert_eq!(ours.poses[0], s);
    }
    // Twice as far: the literal formula also doubles the lift, the repaired one keeps it.
    let top = |p: &[Pose]| p.iter().map(|p| p.translation.z).fold(0.0, f64::max);
    let far = rows[0].0;
    assert!((top(&warp_paper(&demo, &far, 0.25).unwrap().poses) - 0.34).abs() < 0.02);
    assert!((top(&warp_repaired(&demo, &far, &config).poses) - top(&demo)).abs() < 0.02);
    // From the opposite side the literal formula arrives from the wrong side.
    let opposite = warp_paper(&demo, &rows[3].0, 0.25).unwrap();
    assert!((approach_error(&opposite.poses, &demo) - 87.0).abs() < 4.0);
    // Above the end its path shrinks to a point.
    let above = warp_paper(&demo, &rows[4].0, 0.25).unwrap();
    let extent = above.poses.iter().map(|p| pose_distance(p, &rows[4].0).0).fold(0.0, f64::max);
    assert!(extent < 0.002, "{extent}");
    assert_eq!(warp_repaired(&demo, &rows[4].0, &config).rule, WarpRule::OffsetFade);
    let beside = warp_repaired(&demo, &start(0.003, -0.002, 0.03), &config);
    assert!(miss(&beside.poses, &demo) < 1e-12 && beside.rule == WarpRule::OffsetFade);

    // The demonstration itself starts above its end.
    let tall = from_above();
    let s = start(0.2, 0.1, 0.3);
    let paper = warp_paper(&tall, &s, 0.25).unwrap();
    assert!((paper.scale - 112.0).abs() < 1.0);
    assert!(paper.poses.iter().any(|p| p.translation.z < -20.0));
    let ours = warp_repaired(&tall, &s, &config);
    assert_eq!(ours.rule, WarpRule::OffsetFade);
    assert!(miss(&ours.poses, &tall) < 1e-12 && approach_error(&ours.poses, &tall) < 1e-6);
    assert!(ours.poses.iter().all(|p| p.translation.z > 0.0 && p.translation.vector.norm() < 0.5));
    // Exactly above: the literal formula has no scale at all.
    let mut vertical = from_above();
    vertical[0].translation.x = 0.0;
    assert!(warp_paper(&vertical, &s, 0.25).is_err());
}

#[test]
fn opposite_starts_go_round_the_same_way() {
    let v = Vector3::new(1.0, 0.0, 0.0);
    for deg in [171.0f64, 179.9, 180.1, 189.0] {
        let w = Vector3::new(deg.to_radians().cos(), deg.to_radians().sin(), 0.0);
        assert!((signed_angle(&v, &w).to_degrees() - deg).abs() < 1e-9);
    }
    let w = Vector3::new(0.0, -1.0, 0.0);
    assert!((signed_angle(&v, &w) + PI / 2.0).abs() < 1e-12);
}

#[test]
fn a_half_turn_of_the_start_turns_about_the_vertical() {
    let demo = demo();
    for yaw in [0.3 + PI, 0.3 + PI - 0.01, 0.3 - PI + 0.01] {
        let s = pose_from_xyz_rpy([0.2, -0.1, 0.03], [0.0, 0.0, yaw]);
        let w = warp_repaired(&demo, &s, &WarpConfig::default());
        for p in &w.poses {
            assert!((p.rotation * Vector3::z()).z > 1.0 - 1e-9, "stays upright");
        }
        let steps = w.poses.windows(2).map(|w| pose_distance(&w[0], &w[1]).1).fold(0.0, f64::max);
        assert!(steps < 0.3, "{steps}");
    }
}

#[test]
fn the_lift_comes_before_the_sideways_motion() {
    let demo = crate::densify(&demo(), 240);
    let (held, from) = lift_first(&demo, 0.03, 0.25);
    let config = WarpConfig { fade_from: from.unwrap(), ..Default::default() };
    for s in [start(0.5, -0.3, 0.03), start(-0.25, 0.15, 0.03), start(0.1, 0.2, 0.03)] {
        let w = warp_repaired(&held, &s, &config).poses;
        for p in &w {
            let d = p.translation.vector - s.translation.vector;
            let sideways = d.x.hypot(d.y);
            assert!(sideways < 0.003 || d.z > 0.012, "{} mm at {} mm", 1e3 * sideways, 1e3 * d.z);
            assert!(sideways < 0.02 || d.z > 0.03 - 1e-3 || pose_distance(p, &w[239]).0 < 0.1);
        }
    }
    // What never rises stays as it is.
    let flat: Vec<Pose> = (0..50).map(|i| start(0.01 * f64::from(i), 0.0, 0.0)).collect();
    let (same, none) = lift_first(&flat, 0.03, 0.25);
    assert!(none.is_none() && same == flat);
}

#[test]
fn empty_and_single() {
    let p = start(0.1, 0.0, 0.0);
    assert!(warp_repaired(&[], &p, &WarpConfig::default()).poses.is_empty());
    assert!(warp_paper(&[], &p, 0.25).is_err());
    assert_eq!(warp_repaired(&[p], &start(0.2, 0.0, 0.0), &WarpConfig::default()).poses.len(), 1);
    assert!(lift_first(&[], 0.03, 0.25).1.is_none());
}

#[test]
fn any_start_is_exact_and_ends_as_demonstrated() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for case in 0..3000 {
        let mut r = |a: f64| a * (2.0 * rng.random::<f64>() - 1.0);
        // Every third start lies (nearly) above the goal.
        let shrink = [1.0, 1e-3, 0.0][case % 3];
        let demo = if case % 2 == 0 { demo() } else { from_above() };
        let s = pose_from_xyz_rpy(
            [0.6 * shrink * r(1.0), 0.6 * shrink * r(1.0), 0.15 + r(0.2)],
            [r(0.6), r(0.6), r(3.2)],
        );
        let config = WarpConfig { alpha: 0.3 + r(0.25), ..Default::default() };
        let w = warp_repaired(&demo, &s, &config);
        assert_eq!((w.poses[0], w.poses[79]), (s, demo[79]));
        let weights = fade(&demo, &config);
        assert!(weights.windows(2).all(|v| v[1] <= v[0] + 1e-15), "monotone");
        assert!(weights.iter().filter(|w| **w == 0.0).count() >= 2, "a kept tail");
        for ((p, q), weight) in w.poses.iter().zip(&demo).zip(&weights) {
            assert!(
                p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite())
            );
            assert!((p.rotation.norm() - 1.0).abs() < 1e-9);
            assert!(*weight > 0.0 || p == q, "the tail is the demonstration's");
        }
        // No jump: the warp stretches steps by no more than its scale, its turn and the shifts.
        let step = w.poses.windows(2).map(|v| pose_distance(&v[0], &v[1]).0).fold(0.0, f64::max);
        assert!(step < 0.15, "{step} m");
    }
}
