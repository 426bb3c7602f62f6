use super::tests::{demonstration, task};
use super::*;
use crate::DemonstrationError as E;
use std::cell::RefCell;
use tdv_geometry::nalgebra::Vector3;
use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

#[test]
fn one_trajectory_is_the_demonstration_itself() {
    for mode in [GenerationMode::Repaired, GenerationMode::Paper, GenerationMode::Dmp] {
        let mut task = task();
        task.generation.mode = mode;
        let demo = demonstration();
        let (set, report) = generate(&demo, &task, 1, 4).unwrap();
        for ((p, d), r) in set.procedures.iter().zip(&demo.procedures).zip(&report.procedures) {
            assert_eq!((p.trajectories.len(), r.recoveries), (1, 0));
            let t = &p.trajectories[0];
            assert_eq!((t.first().pose, t.last().pose), (d.trajectory.first().pose, d.goal()));
            for q in d.trajectory.poses() {
                let near = t.poses().map(|p| tdv_geometry::twist_arc(p, q, 0.1));
                assert!(near.fold(f64::INFINITY, f64::min) < 0.012);
            }
        }
    }
}

#[test]
fn the_comparators_make_sets_too() {
    for (mode, rule, miss) in
        [(GenerationMode::Rigid, "rigid", 1e-9), (GenerationMode::Dmp, "dmp", 0.003)]
    {
        let mut task = task();
        task.generation.mode = mode;
        let (set, report) = generate(&demonstration(), &task, 20, 2).unwrap();
        assert_eq!(set.mode, mode);
        for (p, r) in set.procedures.iter().zip(&report.procedures) {
            assert_eq!((p.trajectories.len(), r.recoveries, r.rules[rule]), (20, 0, 20));
            assert!(r.worst_end_miss < miss, "{mode:?} misses by {} m", r.worst_end_miss);
        }
    }
}

#[test]
fn starts_keep_to_the_polygon_and_take_any_orientation() {
    let mut task = task();
    // A triangle, well away from the coaster.
    task.workspace.polygon = vec![[0.30, 0.0], [0.65, 0.0], [0.30, 0.24]];
    task.generation.roll_deg = [-20.0, 20.0];
    task.generation.pitch_deg = [10.0, 10.0];
    assert_eq!(task.validate(), Vec::<String>::new());
    let (set, report) = generate(&demonstration(), &task, 40, 6).unwrap();
    let place = &set.procedures[1];
    let reach = &report.procedures[0];
    assert!(reach.rejected["start in the excluded disc"] > 10, "{:?}", reach.rejected);
    let mut tilts: Vec<f64> = place.trajectories[..40]
        .iter()
        .map(|t| {
            let p = t.first().pose;
            let up = p.rotation * Vector3::z();
            assert!(lowest(&p, &task.objects["mug"]) > -1e-9);
            up.angle(&Vector3::z()).to_degrees()
        })
        .collect();
    tilts.sort_by(f64::total_cmp);
    assert!((9.9..11.0).contains(&tilts[0]) && (18.0..23.0).contains(&tilts[39]), "{tilts:?}");
}

#[test]
fn a_workspace_without_room_is_an_error_and_a_start_outside_a_note() {
    let mut t = task();
    t.workspace.exclude_radius = 0.9;
    let e = generate(&demonstration(), &t, 5, 1).unwrap_err();
    assert!(matches!(e, E::EmptyWorkspace { .. }), "{e}");
    assert!(e.to_string().contains("exclude_radius"), "{e}");
    let mut t = task();
    t.workspace.y = [-0.25, -0.05];
    let (_, report) = generate(&demonstration(), &t, 5, 1).unwrap();
    assert!(report.notes.iter().any(|n| n.contains("outside the workspace")), "{:?}", report.notes);
    let mut t = task();
    t.workspace.polygon = vec![[0.3, 0.0], [0.4, 0.0]];
    assert!(t.validate().iter().any(|p| p.contains("2 corners")));
}

#[test]
fn the_outside_is_told_what_is_carried() {
    let seen = RefCell::new((0, 0));
    let collides = |p: &ToolPose<'_>| {
        match &p.object {
            Some((name, pose)) => {
                assert!(*name == "mug" && p.grip);
                let grasp = pose.inverse() * p.tool;
                assert!(pose_distance(&grasp, &demonstration().grasp.unwrap()).0 < 1e-9);
                seen.borrow_mut().1 += 1;
            }
            None => {
                assert!(!p.grip);
                seen.borrow_mut().0 += 1;
            }
        }
        if p.tool.translation.x > 0.6 { Err("hits the wall".into()) } else { Ok(()) }
    };
    let options = GenerateOptions { collides: Some(&collides), ..Default::default() };
    let (_, report) = generate_with(&demonstration(), &task(), 10, 1, &options).unwrap();
    assert!(
        report.procedures.iter().any(|p| p.rejected.contains_key("hits the wall")),
        "{report:?}"
    );
    assert!(seen.borrow().0 > 100 && seen.borrow().1 > 100);
}

#[test]
fn demonstrations_that_cannot_be_bent_are_named() {
    let broken = |change: &dyn Fn(&mut Demonstration)| {
        let mut d = demonstration();
        change(&mut d);
        generate(&d, &task(), 5, 1).unwrap_err()
    };
    let trajectory = |poses: &[Pose]| PoseTrajectory::from_poses(poses, 0.05).unwrap();
    let p = pose_from_xyz_rpy([0.1, 0.0, 0.0], [0.0; 3]);
    let e = broken(&|d| d.procedures[1].trajectory = trajectory(&[p]));
    assert!(matches!(e, E::Invalid { .. }) && e.to_string().contains("single pose"), "{e}");
    let e = broken(&|d| d.procedures[1].trajectory = trajectory(&[p; 30]));
    assert!(matches!(e, E::StandsStill { poses: 30, .. }), "{e}");
    let e = broken(&|d| d.object_start = None);
    assert!(e.to_string().contains("object_start"), "{e}");
    let e = broken(&|d| d.procedures[1].reference = "vase".into());
    assert!(e.to_string().contains("vase"), "{e}");
    let e = bend_to(&demonstration(), &task(), 7, &p).unwrap_err();
    assert!(
        matches!(e, E::UnknownProcedure { .. }) && e.to_string().contains("reach, place"),
        "{e}"
    );
    for alpha in [0.0, 1.0, f64::NAN] {
        let mut t = task();
        t.generation.alpha = alpha;
        assert!(generate(&demonstration(), &t, 5, 1).unwrap_err().to_string().contains("alpha"));
    }
}
