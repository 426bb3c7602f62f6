use super::*;
use crate::{GenerationMode, GripperEnd, ProcedureSpec, TaskKind, generate};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use tdv_geometry::nalgebra::{Point3, UnitQuaternion, Vector3};
use tdv_geometry::{Symmetry, pose_distance, pose_from_xyz_rpy, smooth_step, yaw_of};

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

fn cup_and(procedures: &[(&str, &str, &str, GripperEnd)]) -> Task {
    let mut t = task();
    t.procedures = procedures.iter().map(|(n, m, r, e)| ProcedureSpec::new(n, m, r, *e)).collect();
    t
}

#[test]
fn segments_are_found_written_and_taken_back() {
    let s = scene(0.002, 2);
    let (d, r) = parse(&s.frames, &task(), &ParseConfig::default()).unwrap();
    let segments = r.segments.unwrap();
    let names: Vec<_> = segments.procedures.iter().map(|p| (p.name.as_str(), p.end)).collect();
    assert_eq!(names, [("reach", GripperEnd::Close), ("place", GripperEnd::Open)]);
    let frame = |stamp: i64| (stamp - s.frames[0].stamp.0) / 33_333_333;
    let place = &segments.procedures[1];
    assert!((50..63).contains(&frame(place.first)) && (97..112).contains(&frame(place.last)));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("segments.yaml");
    segments.save(&path).unwrap();
    let mut back = Segments::load(&path).unwrap();
    assert_eq!(back, segments);
    let again = |segments: &Segments| {
        let config = ParseConfig { segments: Some(segments.clone()), ..Default::default() };
        parse(&s.frames, &task(), &config)
    };
    let (e, _) = again(&back).unwrap();
    let goal = |d: &Demonstration| d.procedure("place").unwrap().goal();
    assert!(pose_distance(&goal(&d), &goal(&e)).0 < 0.003);
    // A person lets the carry end earlier, in the air, with the object in the hand.
    back.procedures[1].last = s.frames[80].stamp.0;
    back.procedures[1].end = GripperEnd::None;
    let (e, r) = again(&back).unwrap();
    assert!(e.procedure("place").unwrap().goal().translation.z > 0.08);
    assert_eq!(e.procedures[1].end, GripperEnd::None);
    assert_eq!(r.segments.unwrap().procedures[1].last, s.frames[80].stamp.0);

    let refused = |change: &dyn Fn(&mut Segments)| {
        let mut bad = segments.clone();
        change(&mut bad);
        again(&bad).unwrap_err()
    };
    use DemonstrationError as E;
    let e = refused(&|s| s.procedures[1].name = "pour".into());
    assert!(matches!(e, E::UnknownProcedure { .. }), "{e}");
    let e = refused(&|s| s.procedures[0].last = s.procedures[0].first).to_string();
    assert!(e.contains("ends"), "{e}");
    let e = refused(&|s| s.procedures[1].first = s.procedures[0].first).to_string();
    assert!(e.contains("begins before"), "{e}");
    let e = refused(&|s| s.procedures[0].end = GripperEnd::None).to_string();
    assert!(e.contains("no procedure before it"), "{e}");
    let e = refused(&|s| s.task = "other".into()).to_string();
    assert!(e.contains("other"), "{e}");
    let e = refused(&|s| s.procedures[1].first = i64::MAX - 1).to_string();
    assert!(e.contains("ends"), "{e}");
    std::fs::write(&path, "task: x\nproceedures: []\n").unwrap();
    assert!(matches!(Segments::load(&path), Err(E::Format { .. })));
}

/// The mug goes to the coaster, then a bottle that stood aside to a disc, in one recording.
fn two_objects(noise: f64, seed: u64) -> Vec<FrameObservation> {
    let (first, second) = (scene(noise, seed).frames, scene(noise, seed + 50).frames);
    let aside = Pose::translation(-0.05, 0.25, 0.0);
    let seconds = 1.0;
    let gap = (seconds * 30.0) as usize;
    let (mug_end, disc) = (first[149].objects.clone(), second[0].objects["coaster"]);
    let moved = |p: &(Pose, f64)| (aside * p.0, p.1);
    let mut frames = Vec::new();
    for (i, f) in first.iter().enumerate() {
        let mut f = f.clone();
        let j = i % 40;
        f.objects.insert("bottle".into(), moved(&second[j].objects["mug"]));
        f.objects.insert("disc".into(), moved(&disc));
        frames.push(f);
    }
    for f in &second {
        let mut objects = mug_end.clone();
        objects.insert("coaster".into(), f.objects["coaster"]);
        objects.insert("bottle".into(), moved(&f.objects["mug"]));
        objects.insert("disc".into(), moved(&f.objects["coaster"]));
        let stamp = Stamp(f.stamp.0 + (150 + gap as i64) * 33_333_333);
        let hand = f.hand.map(|h| h.map(|p| aside * p));
        frames.push(FrameObservation { stamp, objects, hand });
    }
    frames
}

fn two_object_task() -> Task {
    use GripperEnd::{Close, Open};
    let mut t = cup_and(&[
        ("reach_mug", "tcp", "mug", Close),
        ("place_mug", "mug", "coaster", Open),
        ("reach_bottle", "tcp", "bottle", Close),
        ("place_bottle", "bottle", "disc", Open),
    ]);
    t.objects.insert("bottle".into(), t.objects["mug"].clone());
    t.objects.insert("disc".into(), t.objects["coaster"].clone());
    t
}

#[test]
fn two_objects_are_carried_in_turn() {
    for seed in [1, 2] {
        let frames = two_objects(0.002, seed);
        let task = two_object_task();
        let (d, r) = parse(&frames, &task, &ParseConfig::default()).unwrap();
        let names: Vec<_> = d.procedures.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["reach_mug", "place_mug", "reach_bottle", "place_bottle"]);
        assert_eq!(d.grasp, Some(d.procedures[0].goal()));
        assert_eq!(d.grasp_of(1), d.grasp);
        assert_eq!(d.grasp_of(3), Some(d.procedures[2].goal()));
        assert_eq!((d.retry_from(3), d.retry_from(1), d.retry_from(2)), (2, 0, 2));
        // Both are put where they were put.
        let goal = scene(0.0, 1).goal;
        let aside = Pose::translation(-0.05, 0.25, 0.0);
        for (i, want) in [(1, goal), (3, aside * goal)] {
            let got = d.reference_of(i) * d.procedures[i].goal();
            let (dp, dr) = pose_distance(&got, &want);
            assert!(dp < 0.005 && dr < 0.05, "procedure {i}: {dp} m, {dr} rad");
        }
        let segments = r.segments.unwrap().procedures;
        assert!(segments.windows(2).all(|w| w[0].last <= w[1].first), "{segments:?}");
        let (set, report) = generate(&d, &task, 12, seed).unwrap();
        assert_eq!(set.procedures.len(), 4);
        assert!(set.procedures.iter().all(|p| p.trajectories.len() == 18));
        assert!(report.procedures.iter().all(|p| p.worst_end_miss < 1e-9));
    }
    // The other way round is not what the task says.
    let mut swapped = two_object_task();
    swapped.procedures.rotate_left(2);
    let e = parse(&two_objects(0.002, 1), &swapped, &ParseConfig::default()).unwrap_err();
    assert!(e.to_string().contains("other way round"), "{e}");
}

/// A carry that stops above the coaster, tilts there and stays.
fn pouring(noise: f64, seed: u64) -> Vec<FrameObservation> {
    let mut frames = scene(noise, seed).frames;
    frames.truncate(81);
    let last = frames[80].clone();
    let mug = last.objects["mug"].0;
    for i in 1..110 {
        let tilt = 1.9 * smooth_step((f64::from(i) - 30.0) / 50.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
        let now = Pose::from_parts(mug.translation, turn * mug.rotation);
        let mut f = last.clone();
        f.stamp = Stamp(last.stamp.0 + i64::from(i) * 33_333_333);
        f.objects.get_mut("mug").unwrap().0 = now;
        f.hand = last.hand.map(|h| h.map(|p| now * (mug.inverse() * p)));
        frames.push(f);
    }
    frames
}

#[test]
fn a_pour_ends_in_the_hand_and_may_be_a_procedure_of_its_own() {
    use GripperEnd::{Close, None as Stay};
    let frames = pouring(0.0, 1);
    let one = cup_and(&[("reach", "tcp", "mug", Close), ("pour", "mug", "coaster", Stay)]);
    let (d, r) = parse(&frames, &one, &ParseConfig::default()).unwrap();
    let tilt = |p: &Pose| (p.rotation * Vector3::z()).angle(&Vector3::z());
    let pour = d.procedure("pour").unwrap();
    assert!((tilt(&pour.goal()) - 1.9).abs() < 0.03, "{}", tilt(&pour.goal()));
    assert!(tilt(&pour.trajectory.first().pose) < 1e-6 && pour.goal().translation.z > 0.08);
    assert_eq!(r.of(RepairKind::ReleaseAdded).count(), 0);
    let (set, report) = generate(&d, &one, 10, 1).unwrap();
    assert!(report.procedures[1].worst_end_miss < 1e-9, "{report:?}");
    assert!(set.procedures[1].trajectories.iter().all(|t| tilt(&t.last().pose) > 1.8));

    // Carry over, then pour: the pause between the two is the boundary.
    let two = cup_and(&[
        ("reach", "tcp", "mug", Close),
        ("over", "mug", "coaster", Stay),
        ("pour", "mug", "coaster", Stay),
    ]);
    let (d, _) = parse(&frames, &two, &ParseConfig::default()).unwrap();
    let (over, pour) = (d.procedure("over").unwrap(), d.procedure("pour").unwrap());
    assert_eq!(pour.trajectory.first().pose, over.goal(), "chained");
    assert!(tilt(&over.goal()) < 0.3 && tilt(&pour.goal()) > 1.8, "{}", tilt(&over.goal()));
    let (set, _) = generate(&d, &two, 10, 1).unwrap();
    for t in &set.procedures[2].trajectories[..10] {
        let (dp, dr) = pose_distance(&t.first().pose, &over.goal());
        assert!(dp < 0.02 && dr < 0.2, "starts where the carry ends: {dp} m, {dr} rad");
    }
}

/// A hand, tilted by 0.3 rad, takes a handle and draws it out by 0.12 m.
fn drawn_out() -> (Vec<FrameObservation>, Task) {
    use GripperEnd::{Close, Open};
    let mut frames = Vec::new();
    let drawer = pose_from_xyz_rpy([0.55, 0.1, 0.1], [0.0; 3]);
    let handle = pose_from_xyz_rpy([0.40, 0.1, 0.12], [PI, 0.3, 0.0]);
    for i in 0..150 {
        let f = f64::from(i);
        let near = 0.25 * (1.0 - smooth_step(f / 50.0));
        let pull = 0.12 * smooth_step((f - 65.0) / 40.0);
        let open = 0.03 * (1.0 - smooth_step((f - 50.0) / 8.0) + smooth_step((f - 112.0) / 8.0));
        let tool = Pose::translation(-pull, 0.0, 0.0) * handle * Pose::translation(0.0, 0.0, -near);
        frames.push(FrameObservation {
            stamp: Stamp(i64::from(i) * 33_333_333),
            objects: BTreeMap::from([("drawer".to_string(), (drawer, 0.9))]),
            hand: Some(hand(&tool, open)),
        });
    }
    let mut t = cup_and(&[("approach", "tcp", "drawer", Close), ("pull", "tcp", "drawer", Open)]);
    (t.kind, t.moving_object, t.reference_object) = (TaskKind::Hand, "tcp".into(), "drawer".into());
    t.objects = BTreeMap::from([(
        "drawer".to_string(),
        crate::ObjectShape {
            symmetry: Symmetry::None,
            radius: 0.1,
            height: 0.1,
            bottom: -0.1,
            stands: false,
        },
    )]);
    (frames, t)
}

#[test]
fn a_hand_task_with_a_grip_in_the_middle() {
    let (mut frames, t) = drawn_out();
    let (d, r) = parse(&frames, &t, &ParseConfig::default()).unwrap();
    let bounds: Vec<i64> =
        r.segments.unwrap().procedures.iter().map(|s| s.last / 33_333_333).collect();
    assert!((50..60).contains(&bounds[0]) && (90..122).contains(&bounds[1]), "{bounds:?}");
    assert!(d.grasp.is_none() && d.grasp_of(1).is_none());
    assert_eq!(d.procedures[0].goal(), d.procedures[1].trajectory.first().pose);
    let moved =
        d.procedures[1].goal().translation.vector - d.procedures[0].goal().translation.vector;
    assert!((moved.x + 0.12).abs() < 0.005, "{moved}");
    let (set, report) = generate(&d, &t, 10, 1).unwrap();
    assert_eq!(report.procedures[0].rules["lead_in"], 10);
    assert!(
        set.procedures[1].trajectories[..10]
            .iter()
            .all(|t| { pose_distance(&t.first().pose, &d.procedures[0].goal()).0 < 0.02 })
    );
    // A hand that never closes leaves no boundary to see.
    for f in &mut frames {
        f.hand = f.hand.map(|mut h| {
            h[4] = h[3];
            h[8] = h[3];
            h
        });
    }
    let e = parse(&frames, &t, &ParseConfig::default()).unwrap_err();
    assert!(matches!(e, DemonstrationError::NoBoundary { .. }), "{e}");
}

#[test]
fn the_gripper_closes_where_the_task_says_that_the_handle_is() {
    let (frames, mut t) = drawn_out();
    // In the drawer's frame the hand's tool closes at (-0.15, 0.0, 0.02), tilted.
    t.grasp = crate::GraspConfig {
        closing: vec![crate::ClosingAxis { axis: [0.0, 1.0, 0.0], width: 0.02 }],
        max_tilt_deg: 0.0,
        centre: true,
        middle: Some([-0.142, 0.006]),
        height: Some([0.035, 0.045]),
        ..Default::default()
    };
    let (d, r) = parse(&frames, &t, &ParseConfig::default()).unwrap();
    assert!((r.grasp_change.sideways - 0.010).abs() < 1e-3, "{:?}", r.grasp_change);
    assert!((r.grasp_change.height - 0.015).abs() < 1e-3, "{:?}", r.grasp_change);
    assert!((r.grasp_change.approach_deg - 0.3f64.to_degrees()).abs() < 1.0);
    let grip = d.procedures[0].goal();
    let off = grip.translation.vector - Vector3::new(-0.142, 0.006, 0.035);
    assert!(off.norm() < 1e-9 && (grip.rotation * Vector3::z()).z < -1.0 + 1e-9, "{grip}");
    // Before, the gripper is where the hand has it, and comes down with it along the hand's approach.
    let reach: Vec<Pose> = d.procedures[0].trajectory.poses().copied().collect();
    assert!((reach[0].translation.vector - grip.translation.vector).norm() > 0.2);
    for p in &reach {
        assert!(p.rotation.angle_to(&grip.rotation) < 0.02);
    }
    // What is held goes where the hand takes it, no farther aside than a millimetre, not turned.
    let pull = &d.procedures[1].trajectory;
    assert_eq!(pull.first().pose, grip);
    let mut x = 0.0;
    for p in pull.poses() {
        let moved = p.translation.vector - grip.translation.vector;
        assert!(moved.yz().norm() < 1e-3 && p.rotation.angle_to(&grip.rotation) < 0.01, "{moved}");
        assert!(moved.x < x + 1e-3, "back by {}", moved.x - x);
        x = moved.x;
    }
    assert!((x + 0.12).abs() < 1e-3, "drawn out by {x}");
    // As demonstrated where the task says nothing.
    t.grasp = crate::GraspConfig::default();
    let (d, r) = parse(&frames, &t, &ParseConfig::default()).unwrap();
    assert!(r.of(RepairKind::GraspFitted).next().is_none());
    let shown = d.procedures[0].goal();
    assert!(shown.rotation.angle_to(&grip.rotation) > 0.25);
}

#[test]
fn rotations_that_are_none_and_uneven_stamps() {
    let mut s = scene(0.001, 1);
    let q = s.frames[40].objects["mug"].0.rotation.into_inner() * 1.2;
    s.frames[40].objects.get_mut("mug").unwrap().0.rotation = UnitQuaternion::new_unchecked(q);
    let e = parse(&s.frames, &task(), &ParseConfig::default()).unwrap_err();
    assert!(matches!(e, DemonstrationError::NotARotation { frame: 40, .. }), "{e}");

    // Quaternions of either sign, jittered stamps, dropped frames: the same demonstration.
    let clean = scene(0.0, 1).frames;
    let (want, _) = parse(&clean, &task(), &ParseConfig::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut frames = clean.clone();
    for f in &mut frames {
        let m = f.objects.get_mut("mug").unwrap();
        if rng.random::<bool>() {
            m.0.rotation = UnitQuaternion::new_unchecked(-m.0.rotation.into_inner());
        }
    }
    let mut i = 0;
    frames.retain(|_| {
        i += 1;
        i % 7 != 0
    });
    let (got, r) = parse(&frames, &task(), &ParseConfig::default()).unwrap();
    assert!(r.of(RepairKind::UnevenStamps).next().is_some_and(|u| u.magnitude > 0.06));
    let place = |d: &Demonstration| d.procedure("place").unwrap().clone();
    let (a, b) = (place(&want), place(&got));
    assert!(pose_distance(&a.goal(), &b.goal()).0 < 1e-3);
    for w in b.trajectory.points().windows(2) {
        let (d, t) = pose_distance(&w[0].pose, &w[1].pose);
        assert!(d < 0.05 && t < 0.1, "{d} m, {t} rad");
        let (p, q) = (w[0].pose.rotation.coords, w[1].pose.rotation.coords);
        assert!(p.dot(&q) > 0.0, "one sign");
    }
}
