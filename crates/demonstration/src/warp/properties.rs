//! What holds for every start and every way of bending. `TDV_STARTS=100000` looks at as many starts.

use super::tests::{demo, from_above};
use super::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

fn starts() -> usize {
    std::env::var("TDV_STARTS").ok().and_then(|n| n.parse().ok()).unwrap_or(10_000)
}

fn sound(path: &[Pose], what: &str) {
    for p in path {
        let numbers = p.translation.vector.iter().chain(p.rotation.coords.iter());
        assert!(numbers.copied().all(f64::is_finite), "{what}: {p}");
        assert!((p.rotation.norm() - 1.0).abs() < 1e-9, "{what}: {p}");
    }
}

/// A loop that ends where it starts, and a path that only turns.
fn odd(kind: usize) -> Vec<Pose> {
    let at = |i: usize| {
        let s = smooth_step(i as f64 / 79.0);
        let a = std::f64::consts::TAU * s;
        match kind {
            0 => pose_from_xyz_rpy([0.1 * a.cos(), 0.1 * a.sin(), 0.1], [0.0, 0.0, 0.3]),
            _ => pose_from_xyz_rpy([0.1, 0.0, 0.1], [0.0, 1.2 * s, 3.0 * s]),
        }
    };
    (0..80).map(at).collect()
}

#[test]
fn every_mode_starts_exactly_and_ends_as_it_promises() {
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let demos = [demo(), from_above(), odd(0), odd(1)];
    let (mut worst_dmp, mut refused) = (0.0f64, 0);
    for case in 0..starts() {
        let demo = &demos[case % demos.len()];
        let mut r = |a: f64| a * (2.0 * rng.random::<f64>() - 1.0);
        // Also above the goal, at the goal, and at the demonstrated start.
        let shrink = [1.0, 1e-3, 0.0][case % 3];
        let mut start = pose_from_xyz_rpy(
            [0.6 * shrink * r(1.0), 0.6 * shrink * r(1.0), 0.15 + r(0.2)],
            [r(0.6), r(0.6), r(3.2)],
        );
        match case % 50 {
            48 => start = demo[0],
            49 => start = demo[79],
            _ => {}
        }
        let alpha = [0.25, 0.02, 0.85][case % 3];
        let same =
            |p: &Pose, q: &Pose| pose_distance(p, q).0 < 1e-9 && pose_distance(p, q).1 < 1e-7;

        let config = WarpConfig { alpha, ..Default::default() };
        let ours = warp_repaired(demo, &start, &config).poses;
        let rigid = warp_rigid(demo, &start, alpha).poses;
        let dmp = warp_dmp(demo, &start).poses;
        let arcs = arcs(demo);
        for (name, path) in [("repaired", &ours), ("rigid", &rigid), ("dmp", &dmp)] {
            sound(path, name);
            assert_eq!((path.len(), path[0]), (80, start), "{name}");
        }
        for (name, path) in [("repaired", &ours), ("rigid", &rigid)] {
            assert!(same(&path[79], &demo[79]), "{name}");
            let tail = (1..80).filter(|i| arcs[*i] >= (1.0 - alpha) * arcs[79]);
            for i in tail {
                assert!(same(&path[i], &demo[i]), "{name}: sample {i} of the tail");
            }
        }
        let weights = fade(demo, &config);
        assert!(weights.windows(2).all(|w| w[1] <= w[0] + 1e-15));
        assert!(weights[0] == 1.0 && weights[79] == 0.0);

        let shift = pose_distance(&start, &demo[0]);
        let miss = pose_distance(&dmp[79], &demo[79]);
        let allowed = 0.003 * shift.0 + 1e-9;
        assert!(miss.0 <= allowed && miss.1 <= 0.003 * 6.3 + 1e-7, "dmp misses by {miss:?}");
        worst_dmp = worst_dmp.max(miss.0);

        match warp_paper(demo, &start, alpha) {
            Ok(w) => {
                sound(&w.poses, "paper");
                assert!(pose_distance(&w.poses[0], &start).0 < 1e-9);
                // The horizontal end is exact unless the scale is absurd; the height misses as the formula does.
                let (v, vh) = (
                    demo[79].translation.vector - demo[0].translation.vector,
                    demo[79].translation.vector - start.translation.vector,
                );
                let miss = w.poses[79].translation.vector - demo[79].translation.vector;
                let absurd = 1e-9 * (1.0 + w.scale);
                assert!(miss.x.hypot(miss.y) < absurd, "{miss}");
                assert!((miss.z.abs() - (w.scale * v.z - vh.z).abs()).abs() < absurd);
            }
            Err(e) => {
                refused += 1;
                assert!(e.contains("no scale"), "{e}");
            }
        }
    }
    println!(
        "{} starts: movement primitives miss by up to {:.2} mm, the paper refuses {refused}",
        starts(),
        1e3 * worst_dmp
    );
}

#[test]
fn from_the_demonstrated_start_every_mode_gives_the_demonstration() {
    for demo in [demo(), from_above(), odd(0), odd(1)] {
        let start = demo[0];
        let same = |path: &[Pose], what: &str, from: usize| {
            for (i, (p, q)) in path.iter().zip(&demo).enumerate().skip(from) {
                let (d, a) = pose_distance(p, q);
                assert!(d < 1e-9 && a < 1e-6, "{what}: sample {i} is {d} m, {a} rad off");
            }
        };
        same(&warp_repaired(&demo, &start, &WarpConfig::default()).poses, "repaired", 0);
        same(&warp_dmp(&demo, &start).poses, "dmp", 0);
        // Only the last part is the demonstration's where a straight line leads to it.
        let arcs = arcs(&demo);
        let seam = arcs.partition_point(|s| *s < 0.75 * arcs[79]);
        same(&warp_rigid(&demo, &start, 0.25).poses, "rigid", seam);
    }
}

#[test]
fn comparators_take_degenerate_demonstrations() {
    let p = pose_from_xyz_rpy([0.1, 0.0, 0.0], [0.0; 3]);
    let q = pose_from_xyz_rpy([0.3, 0.1, 0.0], [0.0, 0.0, 1.0]);
    assert!(warp_rigid(&[], &p, 0.25).poses.is_empty() && warp_dmp(&[], &p).poses.is_empty());
    assert_eq!(warp_rigid(&[p], &q, 0.25).poses, [q]);
    assert_eq!(warp_dmp(&[p], &q).poses, [q]);
    for n in [2, 3, 5] {
        let still = vec![p; n];
        for path in [warp_rigid(&still, &q, 0.25).poses, warp_dmp(&still, &q).poses] {
            assert_eq!((path.len(), path[0]), (n, q));
            sound(&path, "still");
        }
        assert!(pose_distance(&warp_dmp(&still, &q).poses[n - 1], &p).0 < 1e-3);
    }
    // Quaternions of either sign are one rotation.
    let mut flipped = demo();
    for p in flipped.iter_mut().step_by(2) {
        p.rotation = UnitQuaternion::new_unchecked(-p.rotation.into_inner());
    }
    for (a, b) in [
        (warp_dmp(&flipped, &q).poses, warp_dmp(&demo(), &q).poses),
        (warp_rigid(&flipped, &q, 0.25).poses, warp_rigid(&demo(), &q, 0.25).poses),
        (
            warp_repaired(&flipped, &q, &WarpConfig::default()).poses,
            warp_repaired(&demo(), &q, &WarpConfig::default()).poses,
        ),
    ] {
        for (a, b) in a.iter().zip(&b) {
            let (d, t) = pose_distance(a, b);
            assert!(d < 1e-9 && t < 1e-6, "{d} {t}");
        }
    }
}
