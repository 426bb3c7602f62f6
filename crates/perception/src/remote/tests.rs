use super::*;
use crate::perceiver::PerceiverConfig;
use crate::testing::{Lab, camera, coaster_model, mug_model, upright};
use nalgebra::Translation3;

const CAMERA: &str = "camera_color_optical_frame";

struct Stage {
    frame: RgbdFrame,
    remote: RemotePoses,
    /// `T_camera_object` of mug and coaster.
    truth: [Pose; 2],
}

fn stage() -> Stage {
    let (mug, coaster) = (mug_model(), coaster_model());
    let poses = [upright(0.45, 0.05, 0.0, 0.8), upright(0.5, -0.15, 0.0, 0.0)];
    let frame = Lab::new(3).frame(&[(&mug.mesh, poses[0]), (&coaster.mesh, poses[1])]);
    let perceiver = Perceiver::new(PerceiverConfig::default(), vec![mug, coaster]);
    let remote = RemotePoses::new(RemoteConfig::default(), &perceiver);
    Stage { frame, remote, truth: poses.map(|p| camera().inverse() * p) }
}

fn answer(stamp: Stamp, pose: Pose) -> Answer {
    Answer { stamp, frame_id: CAMERA.into(), pose: Ok(pose) }
}

impl Stage {
    fn moved(&self, object: usize, by: [f64; 3]) -> Pose {
        // Sideways in the table's plane: the base frame's axes.
        let base = camera() * self.truth[object];
        camera().inverse() * Translation3::new(by[0], by[1], by[2]) * base
    }
}

#[test]
fn true_answers_are_believed_and_masks_are_the_objects() {
    let mut s = stage();
    let requests = s.remote.begin(&s.frame, CAMERA).unwrap();
    assert_eq!(requests.len(), 2);
    let on = requests[0].mask.iter().filter(|m| **m == 255).count();
    assert!((2000..30_000).contains(&on), "{on}");
    for i in 0..2 {
        assert!(s.remote.is_waiting());
        assert_eq!(s.remote.answer(i, &answer(s.frame.stamp, s.truth[i])), Verdict::Taken);
    }
    assert!(!s.remote.is_waiting());
    let out = s.remote.finish(&s.frame, 0.1).unwrap();
    assert!(out.table.is_some());
    for (i, d) in out.detections.iter().enumerate() {
        assert!(d.found && d.confidence > 0.7, "{} {} {}", d.name, d.confidence, d.reason);
        assert_eq!(d.pose, s.truth[i]);
        assert!(out.masks.iter().any(|m| usize::from(*m) == i + 1));
    }
    assert_eq!(s.remote.counts().believed, 2);
}

#[test]
fn wrong_answers_are_no_detections_and_say_why() {
    let mut s = stage();
    let cases = [
        // The mug through the table, beside itself; the coaster, which agrees in depth anywhere.
        (0, s.moved(0, [0.0, 0.0, -0.05])),
        (0, s.moved(0, [0.0, 0.12, 0.0])),
        (1, s.moved(1, [0.0, 0.10, 0.0])),
        // What an estimator gives for an empty mask, and a pose behind the camera.
        (0, Pose::identity()),
        (1, Pose::translation(0.0, 0.0, -0.7)),
    ];
    for (i, (object, pose)) in cases.into_iter().enumerate() {
        s.remote.begin(&s.frame, CAMERA).unwrap();
        assert_eq!(s.remote.answer(object, &answer(s.frame.stamp, pose)), Verdict::Taken);
        let out = s.remote.finish(&s.frame, 0.1).unwrap();
        let d = &out.detections[object];
        assert!(!d.found && d.confidence == 0.0, "{i}: {}", d.confidence);
        assert!(d.reason.contains("disagrees with the image"), "{i}: {}", d.reason);
    }
    assert_eq!(s.remote.counts().disagreeing, 5);
}

#[test]
fn stale_missing_and_foreign_answers_have_a_state_each() {
    let mut s = stage();
    assert_eq!(s.remote.answer(0, &answer(s.frame.stamp, s.truth[0])), Verdict::Stale, "unasked");
    s.remote.begin(&s.frame, CAMERA).unwrap();
    let old = answer(Stamp(s.frame.stamp.0 - 1), s.truth[0]);
    assert_eq!(s.remote.answer(0, &old), Verdict::Stale);
    assert_eq!(s.remote.answer(9, &answer(s.frame.stamp, s.truth[0])), Verdict::Stale);
    let mut foreign = answer(s.frame.stamp, s.truth[1]);
    foreign.frame_id = "base_link".into();
    assert_eq!(s.remote.answer(1, &foreign), Verdict::WrongFrame);
    let late = answer(s.frame.stamp, s.truth[1]);
    assert_eq!(s.remote.answer(1, &late), Verdict::Stale, "one answer a frame");
    assert!(s.remote.is_waiting());
    let out = s.remote.finish(&s.frame, 0.25).unwrap();
    assert!(out.detections.iter().all(|d| !d.found));
    assert!(out.detections[0].reason.contains("no answer within 0.25 s"));
    assert!(out.detections[1].reason.contains("\"base_link\""));
    assert_eq!(s.remote.answer(0, &answer(s.frame.stamp, s.truth[0])), Verdict::Stale, "too late");
    s.remote.begin(&s.frame, CAMERA).unwrap();
    let broken = Answer { pose: Err("position is NaN".into()), ..late };
    assert_eq!(s.remote.answer(1, &broken), Verdict::Unusable);
    let out = s.remote.finish(&s.frame, 0.25).unwrap();
    assert!(out.detections[1].reason.contains("position is NaN"));
    let counts = s.remote.counts();
    assert_eq!((counts.asked, counts.believed, counts.unanswered), (4, 0, 2));
    assert_eq!((counts.stale, counts.wrong_frame, counts.unusable), (5, 1, 1));
}

#[test]
fn nobody_is_asked_about_what_is_not_there() {
    let mut s = stage();
    let mut lab = Lab::new(4);
    let empty = lab.frame(&[]);
    assert!(s.remote.begin(&empty, CAMERA).unwrap().is_empty());
    assert!(!s.remote.is_waiting());
    let out = s.remote.finish(&empty, 0.0).unwrap();
    assert!(out.detections[0].reason.contains("no mug seen"), "{}", out.detections[0].reason);
    // What was believed a moment ago is asked about once more, and only for so long.
    s.remote.begin(&s.frame, CAMERA).unwrap();
    s.remote.answer(0, &answer(s.frame.stamp, s.truth[0]));
    s.remote.finish(&s.frame, 0.0).unwrap();
    let mut soon = lab.frame(&[]);
    soon.stamp = Stamp(s.frame.stamp.0 + 33_000_000);
    let objects = |requests: Vec<Request>| requests.iter().map(|r| r.object).collect::<Vec<_>>();
    assert_eq!(objects(s.remote.begin(&soon, CAMERA).unwrap()), [0]);
    s.remote.answer(0, &answer(soon.stamp, s.truth[0]));
    assert!(!s.remote.finish(&soon, 0.0).unwrap().detections[0].found, "it is not there any more");
    soon.stamp = Stamp(s.frame.stamp.0 + 2_000_000_000);
    assert!(s.remote.begin(&soon, CAMERA).unwrap().is_empty());
}
