use super::*;
use crate::{GenerationMode, generate};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{pose_distance, pose_from_xyz_rpy, smooth_step, yaw_of};

fn task() -> Task {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config/tasks/cup_on_coaster.yaml");
    Task::load(&path).unwrap()
}

/// A hand whose gripper (method tdv, tip distance 0.03) is `tool`.
fn hand(tool: &Pose, open: f64) -> [Point3<f64>; 21] {
    let mut j = [Point3::new(0.0, 0.0, -0.12); 21];
    let half = 0.03 + open;
    j[2] = Point3::new(0.0, -half, -0.07);
    j[3] = Point3::new(0.0, -half, -0.03);
    j[4] = Point3::new(0.0, -half, 0.0);
    j[5] = Point3::new(0.0, half, -0.06);
    j[8] = Point3::new(0.0, half, 0.0);
    j[12] = Point3::new(0.01, half, 0.0);
    j.map(|p| tool * p)
}

struct Scene {
    frames: Vec<FrameObservation>,
    start: Pose,
    goal: Pose,
    grasp: Pose,
}

/// Contact 40, carry 50..110, release 120, 150 frames at 30 Hz; noise in m, ten times that in rad.
fn scene(noise: f64, seed: u64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let n = Normal::new(0.0, noise).unwrap();
    let start = pose_from_xyz_rpy([0.55, 0.12, 0.0], [0.0, 0.0, 1.1]);
    let coaster = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.0, 0.0, 2.2]);
    let goal = pose_from_xyz_rpy([0.452, -0.221, 0.008], [0.0, 0.0, 0.1]);
    let grasp = pose_from_xyz_rpy([0.004, -0.003, 0.064], [PI - 0.1, 0.05, 0.15]);
    let mut frames = Vec::new();
    for i in 0..150 {
        let f = f64::from(i);
        let s = smooth_step((f - 50.0) / 60.0);
        let mut mug = tdv_geometry::interpolate(&start, &goal, s);
        mug.translation.z += 0.13 * (PI * s).sin();
        let away = 0.35 * (1.0 - smooth_step(f / 40.0)) + 0.25 * smooth_step((f - 118.0) / 25.0);
        let open = 0.02 * (1.0 - smooth_step((f - 30.0) / 10.0));
        let tool = mug * grasp * Pose::translation(0.0, 0.0, -away);
        let mut jitter = |p: &Pose| {
            let mut v = || n.sample(&mut rng);
            let d = Vector3::new(v(), v(), v());
            let w = Vector3::new(v(), v(), v()) * 10.0;
            Pose::from_parts(
                (p.translation.vector + d).into(),
                UnitQuaternion::from_scaled_axis(w) * p.rotation,
            )
        };
        let objects = BTreeMap::from([
            ("mug".to_string(), (jitter(&mug), 0.9)),
            ("coaster".to_string(), (jitter(&coaster), 0.8)),
        ]);
        let joints = hand(&tool, open)
            .map(|p| p + Vector3::new(n.sample(&mut rng), n.sample(&mut rng), n.sample(&mut rng)));
        frames.push(FrameObservation {
            stamp: Stamp(1_000_000_000_000 + i64::from(i) * 33_333_333),
            objects,
            hand: Some(joints),
        });
    }
    Scene { frames, start, goal, grasp }
}

#[test]
fn a_clean_recording_gives_the_truth() {
    let s = scene(0.0, 1);
    let mut task = task();
    task.grasp = crate::GraspConfig::default();
    let (d, r) = parse(&s.frames, &task, &ParseConfig::default()).unwrap();
    let (dp, dr) = pose_distance(&d.grasp.unwrap(), &s.grasp);
    assert!(dp < 0.002 && dr < 0.02, "grasp off by {dp} m, {dr} rad");
    let place = d.procedure("place").unwrap();
    let base = d.reference_pose;
    assert!(base.rotation.angle() < 1e-9, "a round coaster takes base_link's yaw");
    let (a, b) = (place.trajectory.first().pose, place.goal());
    assert!(
        pose_distance(&(base * a), &s.start).0 < 5e-4
            && pose_distance(&(base * b), &s.goal).0 < 5e-4
    );
    assert!((yaw_of(&b.rotation) - 0.1).abs() < 2e-3);
    let k = r.keyframes.unwrap();
    assert!(k.onset.abs_diff(56) < 7 && k.settled.abs_diff(104) < 7, "{k:?}");
    assert!(
        r.of(RepairKind::DwellTrimmed).count() == 2 && r.of(RepairKind::ReleaseAdded).count() == 0
    );
    let reach = d.procedure("reach").unwrap();
    assert_eq!(reach.goal(), d.grasp.unwrap());
    assert!(reach.trajectory.first().pose.translation.vector.norm() > 0.3);
    assert!(pose_distance(&d.object_start.unwrap(), &s.start).0 < 5e-4);
}

#[test]
#[ignore = "open: a step of 18 mm stays in the path after a long gap"]
fn noise_gaps_and_doubtful_frames() {
    for seed in 0..4 {
        let mut s = scene(0.004, seed);
        let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
        for (i, f) in s.frames.iter_mut().enumerate() {
            if rng.random::<f64>() < 0.15 || (70..82).contains(&i) {
                f.objects.remove("mug");
            } else if rng.random::<f64>() < 0.1
                && let Some(m) = f.objects.get_mut("mug")
            {
                // nonsense that knows it
                *m = (pose_from_xyz_rpy([1.0, 1.0, 1.0], [1.0, 0.0, 0.0]), 0.1);
            }
            if rng.random::<f64>() < 0.2 {
                f.hand = None;
            }
        }
        let (d, r) = parse(&s.frames, &task(), &ParseConfig::default()).unwrap();
        let place = d.procedure("place").unwrap();
        let (dp, dr) = pose_distance(&(d.reference_pose * place.goal()), &s.goal);
        assert!(dp < 0.006 && dr < 0.05, "seed {seed}: goal off by {dp} m, {dr} rad");
        let grasp = d.grasp.unwrap();
        assert!((grasp.rotation * Vector3::y()).y.abs() > 1.0 - 1e-9, "closes beside the handle");
        assert!((grasp.rotation * Vector3::z() + Vector3::z()).norm() < 1e-9, "from above");
        assert!(grasp.translation.vector.xy().norm() < 1e-9 && r.grasp_change.sideways < 0.015);
        for kind in [RepairKind::LowConfidence, RepairKind::GapFilled, RepairKind::GraspFitted] {
            assert!(r.of(kind).next().is_some(), "{kind:?}");
        }
        // Smooth: no step beyond what the carry's own speed gives.
        let p: Vec<_> = place.trajectory.poses().collect();
        for w in p.windows(3) {
            let jerk =
                w[2].translation.vector - w[1].translation.vector * 2.0 + w[0].translation.vector;
            assert!(jerk.norm() < 0.010, "seed {seed}: {} m", jerk.norm());
        }
        for mode in [GenerationMode::Repaired, GenerationMode::Paper] {
            let mut task = task();
            task.generation.mode = mode;
            let (set, _) = generate(&d, &task, 10, seed).unwrap();
            assert_eq!(set.procedures.len(), 2);
        }
    }
}

#[test]
fn flips_of_a_symmetric_object_are_undone_and_reported() {
    let mut s = scene(0.001, 3);
    let mut task = task();
    task.objects.get_mut("mug").unwrap().symmetry =
        Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] };
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    for f in s.frames.iter_mut().skip(5).step_by(3) {
        f.objects.get_mut("mug").unwrap().0.rotation *= turn;
    }
    let (d, r) = parse(&s.frames, &task, &ParseConfig::default()).unwrap();
    let flips = r.of(RepairKind::Deflipped).next().unwrap();
    assert_eq!(flips.frames, 49);
    assert!((flips.magnitude - 180.0).abs() < 1e-6);
    let goal = d.reference_pose * d.procedure("place").unwrap().goal();
    assert!(pose_distance(&goal, &s.goal).1 < 0.03);
    assert_eq!(d.procedure("reach").unwrap().reference_symmetry.rotations().len(), 2);
}

#[test]
fn a_fixed_target_yaw_is_set_and_reported() {
    let s = scene(0.0, 1);
    let mut task = task();
    task.target_yaw = crate::TargetYaw::Fixed(90.0);
    let (d, r) = parse(&s.frames, &task, &ParseConfig::default()).unwrap();
    assert!((yaw_of(&d.procedure("place").unwrap().goal().rotation) - PI / 2.0).abs() < 1e-9);
    assert_eq!(r.of(RepairKind::YawFixed).count(), 1);
}

#[test]
fn a_recording_cut_before_the_release() {
    let s = scene(0.002, 2);
    let (_, r) = parse(&s.frames[..117], &task(), &ParseConfig::default()).unwrap();
    assert_eq!(r.of(RepairKind::ReleaseAdded).count(), 1);
}

#[test]
fn a_hand_task_follows_the_hand() {
    let s = scene(0.002, 2);
    let mut task = task();
    (task.kind, task.moving_object) = (TaskKind::Hand, "tcp".into());
    task.objects.remove("mug");
    let (d, _) = parse(&s.frames, &task, &ParseConfig::default()).unwrap();
    assert_eq!((d.procedures.len(), d.procedures[0].name.as_str()), (1, "follow"));
    assert!(d.procedures[0].trajectory.duration() > 3.0 && d.grasp.is_none());
    let (set, _) = generate(&d, &task, 10, 1).unwrap();
    assert_eq!(set.procedures[0].trajectories.len(), 15);
}

type Expect = fn(&DemonstrationError) -> bool;

#[test]
fn every_defect_has_its_own_error() {
    let good = scene(0.001, 1).frames;
    let run = |f: &[FrameObservation]| parse(f, &task(), &ParseConfig::default());
    let edit = |change: &dyn Fn(usize, &mut FrameObservation)| {
        let mut f = good.clone();
        f.iter_mut().enumerate().for_each(|(i, x)| change(i, x));
        f
    };
    use DemonstrationError as E;
    let cases: Vec<(&str, Vec<FrameObservation>, Expect)> = vec![
        ("empty", vec![], |e| matches!(e, E::TooFewFrames { .. })),
        ("one frame", good[..1].to_vec(), |e| matches!(e, E::TooFewFrames { .. })),
        ("no hand", edit(&|_, f| f.hand = None), |e| matches!(e, E::NoHand { .. })),
        (
            "never moves",
            edit(&|_, f| f.objects.get_mut("mug").unwrap().0 = Pose::translation(0.5, 0.1, 0.0)),
            |e| matches!(e, E::ObjectNeverMoves { .. }),
        ),
        (
            "no reference",
            edit(&|_, f| {
                f.objects.remove("coaster");
            }),
            |e| matches!(e, E::ReferenceMissing { .. }),
        ),
        (
            "no object",
            edit(&|_, f| {
                f.objects.remove("mug");
            }),
            |e| matches!(e, E::ObjectMissing { .. }),
        ),
        (
            "NaN pose",
            edit(&|i, f| {
                if i == 33 {
                    f.objects.get_mut("mug").unwrap().0.translation.x = f64::NAN;
                }
            }),
            |e| matches!(e, E::NotFinite { frame: 33, .. }),
        ),
        (
            "NaN joint",
            edit(&|i, f| {
                if i == 12 {
                    f.hand.as_mut().unwrap()[7].z = f64::INFINITY;
                }
            }),
            |e| matches!(e, E::NotFinite { frame: 12, .. }),
        ),
        (
            "stamps",
            edit(&|i, f| {
                if i == 20 {
                    f.stamp = Stamp(0);
                }
            }),
            |e| matches!(e, E::StampsOutOfOrder { index: 20, .. }),
        ),
        (
            "gap",
            edit(&|i, f| {
                if (55..105).contains(&i) {
                    f.objects.remove("mug");
                }
            }),
            |e| matches!(e, E::GapTooLong { .. }),
        ),
        (
            "hand elsewhere",
            edit(&|_, f| {
                f.hand = f.hand.map(|h| h.map(|p| p + Vector3::new(0.0, 0.0, 0.5)));
            }),
            |e| matches!(e, E::NoGrasp { .. }),
        ),
        (
            "lying",
            edit(&|_, f| {
                let p = &mut f.objects.get_mut("mug").unwrap().0;
                p.rotation *= UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI / 2.0);
            }),
            |e| matches!(e, E::Invalid { .. }),
        ),
    ];
    for (name, frames, expected) in cases {
        let e = run(&frames).expect_err(name);
        assert!(expected(&e), "{name}: {e}");
    }
    let mut bad = task();
    bad.text.clear();
    assert!(matches!(parse(&good, &bad, &ParseConfig::default()), Err(E::Invalid { .. })));
}
