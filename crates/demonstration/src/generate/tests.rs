use super::*;
use crate::path::densify;
use std::f64::consts::PI;
use tdv_geometry::nalgebra::Vector3;
use tdv_geometry::{Symmetry, pose_distance, pose_from_xyz_rpy, smooth_step};

pub(crate) fn task() -> Task {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config/tasks/cup_on_coaster.yaml");
    Task::load(&path).unwrap()
}

pub(crate) fn demonstration() -> Demonstration {
    let place: Vec<Pose> = (0..90)
        .map(|i| {
            let s = smooth_step(f64::from(i) / 89.0);
            let z = 0.008 * s + 0.12 * (PI * s).sin();
            pose_from_xyz_rpy([0.05 * (1.0 - s), 0.30 * (1.0 - s), z], [0.0, 0.0, 1.0 - 0.9 * s])
        })
        .collect();
    let grasp = pose_from_xyz_rpy([0.0, 0.0, 0.06], [PI, 0.0, 0.0]);
    let reach: Vec<Pose> = (0..60)
        .map(|i| {
            let s = smooth_step(f64::from(i) / 59.0);
            pose_from_xyz_rpy(
                [-0.2 * (1.0 - s), 0.1 * (1.0 - s), 0.06 + 0.2 * (1.0 - s)],
                [PI, 0.0, 0.0],
            )
        })
        .collect();
    let procedure = |name: &str, moving: &str, reference: &str, poses: &[Pose], moving_symmetry| {
        ProcedureDemo {
            name: name.into(),
            moving: moving.into(),
            reference: reference.into(),
            trajectory: PoseTrajectory::from_poses(poses, 1.0 / 30.0).unwrap(),
            moving_symmetry,
            reference_symmetry: Symmetry::None,
            end: crate::GripperEnd::of_name(name),
            reference_pose: None,
        }
    };
    Demonstration {
        task: "cup_on_coaster".into(),
        text: "put the mug on the coaster".into(),
        procedures: vec![
            procedure("reach", "tcp", "mug", &reach, crate::gripper_symmetry()),
            procedure("place", "mug", "coaster", &place, Symmetry::None),
        ],
        grasp: Some(grasp),
        grasp_width: Some(0.064),
        reference_pose: pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]),
        object_start: Some(pose_from_xyz_rpy([0.50, 0.08, 0.0], [0.0, 0.0, 1.0])),
    }
}

#[test]
fn same_seed_same_bytes() {
    let (a, ra) = generate(&demonstration(), &task(), 10, 7).unwrap();
    let (b, rb) = generate(&demonstration(), &task(), 10, 7).unwrap();
    assert_eq!(a.to_bytes().unwrap(), b.to_bytes().unwrap());
    assert_eq!(ra, rb);
    let (c, _) = generate(&demonstration(), &task(), 10, 8).unwrap();
    assert_ne!(a.hash(), c.hash());
}

#[test]
fn trajectories_obey_the_speed_law_and_end_exactly() {
    let task = task();
    let (set, report) = generate(&demonstration(), &task, 60, 3).unwrap();
    let dt = set.dt;
    for (p, r) in set.procedures.iter().zip(&report.procedures) {
        assert_eq!((r.accepted, r.recoveries, p.trajectories.len()), (60, 30, 90));
        assert!(r.worst_end_miss < 1e-9 && r.longest < 20.0, "{r:?}");
        for t in &p.trajectories {
            let last = t.last().pose;
            let (d, a) = pose_distance(&last, &p.goal);
            assert!(d < 1e-9 && a < 1e-7);
            let held = t.poses().filter(|q| **q == last).count();
            assert!(held >= 13, "{held} samples at rest");
            for w in t.points().windows(2) {
                let (d, a) = pose_distance(&w[0].pose, &w[1].pose);
                assert!(d / dt <= 0.2 + 1e-6, "{} m/s", d / dt);
                assert!(a / dt <= 1.0 + 0.02, "{} rad/s", a / dt);
                assert!((w[1].stamp.since(w[0].stamp) - dt).abs() < 1e-9);
            }
            let v: Vec<f64> = t
                .points()
                .windows(2)
                .map(|w| pose_distance(&w[0].pose, &w[1].pose).0 / dt)
                .collect();
            assert!(v[0] <= 0.5 * 0.6 * dt + 1e-6, "starts from rest");
        }
    }
}

#[test]
fn starts_cover_the_workspace_and_all_yaws() {
    let (set, _) = generate(&demonstration(), &task(), 100, 5).unwrap();
    let place = &set.procedures[1];
    let base = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0; 3]);
    let mut quadrants = [0; 4];
    let mut yaws = [0; 4];
    for t in &place.trajectories[..100] {
        let p = base * t.first().pose;
        assert!(p.translation.z.abs() < 1e-9);
        quadrants[usize::from(p.translation.x > 0.475) + 2 * usize::from(p.translation.y > 0.0)] +=
            1;
        yaws[((tdv_geometry::yaw_of(&p.rotation) + PI) / (PI / 2.0)).min(3.0) as usize] += 1;
        assert!(t.first().pose.translation.vector.xy().norm() >= 0.11 - 1e-9);
    }
    assert!(
        quadrants.iter().all(|n| *n >= 12) && yaws.iter().all(|n| *n >= 15),
        "{quadrants:?} {yaws:?}"
    );
    // Gripper poses are canonical, with the overlap that the live hysteresis needs.
    let reach = &set.procedures[0];
    let angles: Vec<f64> = reach
        .trajectories
        .iter()
        .map(|t| t.first().pose.rotation.angle_to(&reach.goal.rotation).to_degrees())
        .collect();
    assert!(angles.iter().all(|a| *a < 125.0), "{angles:?}");
    assert!(angles.iter().any(|a| *a > 92.0) && angles.iter().filter(|a| **a < 90.0).count() > 60);
}

#[test]
fn the_carried_object_neither_drags_nor_hits() {
    let (set, _) = generate(&demonstration(), &task(), 80, 9).unwrap();
    for t in &set.procedures[1].trajectories[..80] {
        let (first, last) = (t.first().pose, t.last().pose);
        for p in t.poses() {
            let away = (p.translation.vector - first.translation.vector).xy().norm();
            let to_go = (p.translation.vector - last.translation.vector).xy().norm();
            assert!(p.translation.z > -1e-3);
            assert!(away < 0.005 || to_go < 0.03 || p.translation.z > 0.009, "{away} {to_go} {p}");
            assert!(away < 0.03 || to_go < 0.05 || p.translation.z > 0.025, "{away} {to_go} {p}");
        }
    }
}

#[test]
fn the_gripper_comes_from_above_and_never_sweeps_the_mug() {
    let (set, _) = generate(&demonstration(), &task(), 80, 11).unwrap();
    let goal = set.procedures[0].goal;
    for t in &set.procedures[0].trajectories[..80] {
        for p in t.poses() {
            let d = p.translation.vector - goal.translation.vector;
            let near = p.translation.vector.xy().norm() < 0.10;
            if near && p.translation.z < 0.09 + 0.02 {
                assert!(d.xy().norm() < 0.004 && p.rotation.angle_to(&goal.rotation) < 0.03, "{p}");
            }
            assert!(p.translation.z > 0.05);
        }
        // The last 5 cm are straight down, turned as in the grasp.
        let low: Vec<_> =
            t.poses().filter(|p| p.translation.z < goal.translation.z + 0.05).collect();
        assert!(low.len() > 8);
        for p in low {
            assert!((p.translation.vector - goal.translation.vector).xy().norm() < 1e-6);
            assert!(p.rotation.angle_to(&goal.rotation) < 1e-6);
        }
    }
}

#[test]
fn a_reach_from_any_pose_ends_in_the_grasp() {
    let shape = task().objects["mug"].clone();
    let grasp = demonstration().grasp.unwrap();
    let plan = reach::ReachPlan::new(grasp, &shape, 0.10, 0.02);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..400 {
        let mut r = |a: f64| a * (2.0 * rng.random::<f64>() - 1.0);
        let start =
            pose_from_xyz_rpy([r(0.3), r(0.3), 0.2 + r(0.2)], [PI + r(0.3), r(0.3), r(3.0)]);
        let path = plan.path(&start);
        assert_eq!((path[0], path[path.len() - 1]), (start, grasp));
        let dense = densify(&path, 400);
        assert!(dense.iter().all(|p| p.translation.vector.norm() < 1.0));
    }
    // Beside a low start the way leads up first.
    let low = pose_from_xyz_rpy([0.12, 0.0, 0.05], [PI, 0.0, 0.0]);
    let path = plan.path(&low);
    assert!(plan.check(&path).is_ok());
    assert!(
        path.iter()
            .all(|p| p.translation.z > 0.12 || p.translation.x > 0.09 || p.translation.x < 0.004)
    );
    // 5 mm off in the last centimetres goes straight on.
    let off = pose_from_xyz_rpy([0.005, 0.0, 0.08], [PI, 0.0, 0.02]);
    assert!(plan.path(&off).iter().all(|p| p.translation.z <= 0.08 + 1e-9));
}

#[test]
fn rejections_are_counted_by_reason() {
    let reach =
        |p: &Pose| if p.translation.x > 0.55 { Err("out of reach".to_string()) } else { Ok(()) };
    let options = GenerateOptions { reachable: Some(&reach), ..Default::default() };
    let (set, report) = generate_with(&demonstration(), &task(), 20, 1, &options).unwrap();
    assert!(report.procedures.iter().all(|p| p.rejected["out of reach"] > 0), "{report:?}");
    assert_eq!(set.procedures[1].trajectories.len(), 30);
    let never = |_: &Pose| Err("no".to_string());
    let options = GenerateOptions { reachable: Some(&never), ..Default::default() };
    let e = generate_with(&demonstration(), &task(), 5, 1, &options).unwrap_err().to_string();
    assert!(e.contains("x no") && e.contains("reach"), "{e}");
}

#[test]
fn paper_mode_is_literal() {
    let mut task = task();
    task.generation.mode = GenerationMode::Paper;
    let (set, report) = generate(&demonstration(), &task, 20, 2).unwrap();
    // Starts stand on the table, the goal 8 mm above it: the miss is 8 mm times the scale's excess.
    let place = &report.procedures[1];
    assert!(place.worst_end_miss > 1e-3 && place.recoveries == 0, "{place:?}");
    let lengths: Vec<usize> = set.procedures[1].trajectories.iter().map(|t| t.len()).collect();
    assert!(lengths.windows(2).all(|w| w[0] == w[1]), "the number of samples is kept");
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut demo = demonstration();
    demo.task = "other".into();
    let e = generate(&demo, &task(), 5, 1).unwrap_err().to_string();
    assert!(e.contains("other"), "{e}");
    assert!(generate(&demonstration(), &task(), 0, 1).is_err());
    let mut bad = task();
    bad.generation.alpha = -1.0;
    assert!(matches!(
        generate(&demonstration(), &bad, 5, 1),
        Err(DemonstrationError::Invalid { .. })
    ));
}

#[test]
fn yaw_may_follow_the_start() {
    let mut task = task();
    task.generation.yaw_follows = true;
    let (set, _) = generate(&demonstration(), &task, 30, 2).unwrap();
    let demo_first = demonstration().procedures[1].trajectory.first().pose;
    let bearing = |p: &Pose| (-p.translation.y).atan2(-p.translation.x);
    for t in &set.procedures[1].trajectories[..30] {
        let p = t.first().pose;
        let turned = bearing(&p) - bearing(&demo_first);
        let yaw = tdv_geometry::yaw_of(&p.rotation) - tdv_geometry::yaw_of(&demo_first.rotation);
        assert!((yaw - turned).sin().abs() < 1e-6, "{yaw} {turned}");
        assert!((p.rotation * Vector3::z()).z > 0.999);
    }
}
