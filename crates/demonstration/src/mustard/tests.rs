use super::*;
use crate::{GenerationMode, generate, mustard};
use std::path::PathBuf;

fn task() -> Task {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    Task::load(&root.join("config/tasks/mustard_on_disc.yaml")).unwrap()
}

fn recording() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/dexmv_mustard/dexmv_mustard.json");
    if path.exists() {
        return Some(path);
    }
    println!("skipped: the real recording is not there ({})", path.display());
    None
}

#[test]
fn the_real_recording_becomes_a_demonstration() {
    let Some(path) = recording() else { return };
    let out = mustard::import(&path, &task(), &ImportOptions::default()).unwrap();
    let r = &out.report;
    let k = r.keyframes.unwrap();
    for repair in &r.repairs {
        println!("{:?}", repair);
    }
    println!("{k:?}\ncarried {}", r.carried);
    // Frame ids count from 1, indices from 0.
    assert!(k.contact.abs_diff(65) <= 6, "contact at {}", k.contact);
    assert!(k.onset.abs_diff(72) <= 5, "motion from {}", k.onset);
    assert!(k.settled.abs_diff(114) <= 7, "until {}", k.settled);
    assert!(k.release.is_none(), "the bottle is never released");
    assert!((r.carried - 0.49).abs() < 0.06, "carried {} m", r.carried);

    let place = out.demonstration.procedure("place").unwrap();
    let up = |p: &Pose| (p.rotation * Vector3::z()).angle(&Vector3::z());
    let (first, last) = (place.trajectory.first().pose, place.trajectory.last().pose);
    assert!(up(&first) < 1e-7 && up(&last) < 1e-7);
    assert!(first.translation.z.abs() < 1e-9);
    assert!((last.translation.z - 0.006).abs() < 1e-9);
    assert!(last.translation.vector.xy().norm() < 0.01);
    assert!(tdv_geometry::yaw_of(&last.rotation).abs() < 3f64.to_radians());

    let grasp = out.demonstration.grasp.unwrap();
    assert!((grasp.rotation * Vector3::y()).y.abs() > 0.999, "closes across the narrow side");
    assert_eq!(out.demonstration.grasp_width, Some(0.063));
    for kind in [
        RepairKind::Deflipped,
        RepairKind::Smoothed,
        RepairKind::SetUpright,
        RepairKind::SetOnSurface,
        RepairKind::GraspFitted,
        RepairKind::ReleaseAdded,
        RepairKind::Orthonormalised,
    ] {
        assert!(r.of(kind).next().is_some(), "{kind:?} is not reported");
    }
    assert_eq!(r.of(RepairKind::Assumed).count(), 4);
}

#[test]
fn taught_from_it_in_both_modes() {
    let Some(path) = recording() else { return };
    let mut task = task();
    let out = mustard::import(&path, &task, &ImportOptions::default()).unwrap();
    let (set, report) = generate(&out.demonstration, &task, 40, 1).unwrap();
    println!("{report:#?}");
    assert_eq!(set.procedures.len(), 2);
    for p in &set.procedures {
        assert_eq!(p.trajectories.len(), 60);
    }
    assert!(report.procedures.iter().all(|p| p.worst_end_miss < 1e-9));
    task.generation.mode = GenerationMode::Paper;
    let (_, report) = generate(&out.demonstration, &task, 40, 1).unwrap();
    println!("{report:#?}");
    assert!(report.procedures[1].worst_end_miss > 0.001);
}

#[test]
fn damaged_files_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.json");
    let import = |text: &str| {
        std::fs::write(&path, text).unwrap();
        mustard::import(&path, &task(), &ImportOptions::default()).unwrap_err().to_string()
    };
    assert!(import("{").contains("m.json"));
    let cut =
        r#"{"frame_ids": [1, 2], "joints_m_object_camera": [], "T_object_camera_object": []}"#;
    assert!(import(cut).contains("cut off"));
    let skew = r#"{"frame_ids": [1], "joints_m_object_camera": [[]],
        "T_object_camera_object": [[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]]}"#;
    assert!(import(skew).contains("frame 0"));
}

/// The same recording as a hand task: the hand's path as the disc sees it.
#[test]
fn the_hand_alone_is_a_task_too() {
    let Some(path) = recording() else { return };
    let mut task = task();
    (task.kind, task.moving_object) = (crate::TaskKind::Hand, "tcp".into());
    task.objects.remove("bottle");
    let out = mustard::import(&path, &task, &ImportOptions::default()).unwrap();
    let d = &out.demonstration;
    let follow = d.procedure("follow").unwrap();
    assert_eq!((d.procedures.len(), follow.end), (1, crate::GripperEnd::None));
    assert!(d.grasp.is_none() && follow.trajectory.duration() > 1.5);
    let steps = follow.trajectory.poses().collect::<Vec<_>>();
    let jump = steps.windows(2).map(|w| tdv_geometry::pose_distance(w[0], w[1]));
    let (d_max, a_max) = jump.fold((0.0f64, 0.0f64), |m, j| (m.0.max(j.0), m.1.max(j.1)));
    println!("{} frames, largest step {d_max:.4} m {a_max:.3} rad", steps.len());
    assert!(d_max < 0.05 && a_max < 0.5, "{d_max} m, {a_max} rad");
    // Every ordinary trajectory has the demonstrated path in it as it is, the last pose exactly; but for
    // the beginning, where the hand comes from beside the table.
    let (set, report) = generate(d, &task, 20, 3).unwrap();
    assert!(report.notes.iter().any(|n| n.contains("below the table")), "{:?}", report.notes);
    let table = task.objects[&follow.reference].bottom;
    let above = |p: &&&tdv_geometry::Pose| p.translation.z > table + 0.015;
    assert_eq!(report.procedures[0].rules["lead_in"], 20);
    for t in &set.procedures[0].trajectories[..20] {
        for p in steps.iter().filter(above).step_by(4) {
            let near =
                t.poses().map(|q| tdv_geometry::twist_arc(p, q, 0.1)).fold(f64::INFINITY, f64::min);
            assert!(near < 0.012, "{near} m from the path");
        }
    }
    let (one, report) = generate(d, &task, 1, 3).unwrap();
    assert_eq!(one.procedures[0].trajectories.len(), 1);
    assert_eq!(report.procedures[0].rules["demonstration"], 1);
}

#[test]
fn a_left_handed_rotation_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.json");
    let joints = vec![[0.0; 3]; 21];
    let text = format!(
        r#"{{"frame_ids": [1], "joints_m_object_camera": [{joints:?}],
        "T_object_camera_object": [[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]]}}"#
    );
    std::fs::write(&path, text).unwrap();
    let e = mustard::import(&path, &task(), &ImportOptions::default()).unwrap_err().to_string();
    assert!(e.contains("frame 0"), "{e}");
}
