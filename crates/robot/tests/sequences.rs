//! Tasks of other procedures than reach and place: two objects in turn, an end without a release, a grip on
//! what is no tracked object, and going back to the right grasp.

mod bench;

use bench::*;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_robot::ControllerParams;
use tdv_robot::motion::{GripperEnd, Moving, StatusCode as S};

fn lab() -> Bench {
    Bench::new(ControllerParams { auto_resume: true, ..Default::default() })
}

fn policy(path: Vec<Pose>) -> Policy {
    Policy { path, phase: 0.0 }
}

/// Mug on coaster, then a second object, which is gripped alike, on a disc.
fn two_objects() -> Bench {
    let mut b = lab();
    let bottle = pose_from_xyz_rpy([0.42, 0.22, 0.0], [0.0, 0.0, -0.3]);
    let disc = pose_from_xyz_rpy([0.62, -0.10, 0.0], [0.0; 3]);
    let grasp = bottle * b.attach.inverse();
    let coaster = b.references[1];
    let placed = *b.policies[1].path.last().unwrap();
    let retreated = coaster * placed * b.attach.inverse() * Pose::translation(0.0, 0.0, -0.10);
    b.references.extend([bottle, disc]);
    b.policies.push(policy(path(bottle.inverse() * retreated, bottle.inverse() * grasp, 0.1)));
    b.policies.push(policy(path(disc.inverse() * bottle, placed, 0.12)));
    b.steps.extend([
        Step::new(Moving::Tcp, false, GripperEnd::Close),
        Step::new(Moving::Object, true, GripperEnd::Open),
    ]);
    b
}

fn in_order(b: &Bench, wanted: &[S]) {
    let mut codes = b.log.codes.iter();
    for want in wanted {
        assert!(codes.any(|c| c == want), "{want:?} in order in {:?}", b.log.codes);
    }
}

#[test]
fn two_objects_in_turn() {
    let mut b = two_objects();
    b.run(80.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    let one =
        [S::Following, S::Grasping, S::AwaitingAttach, S::Following, S::Releasing, S::Retreating];
    in_order(&b, &[&one[..], &one[..], &[S::Done]].concat());
    assert_eq!(b.log.ends.len(), 4);
    assert!(b.log.ends.iter().all(|e| e.0 < 0.002), "{:?}", b.log.ends);
    assert!(b.gap() > 0.08 && b.went_back.is_empty());
}

#[test]
fn after_a_drop_the_procedure_comes_again_that_grasps_the_object() {
    let mut b = two_objects();
    // Until the second object is under way.
    for _ in 0..60 {
        b.run(1.0);
        if b.procedure == 3 && b.last_code() == S::Following {
            break;
        }
    }
    assert_eq!((b.procedure, b.last_code()), (3, S::Following), "{:?}", b.log.codes);
    b.object = None;
    b.run(0.8);
    assert_eq!(b.last_code(), S::Recovering, "{}", b.last_sentence());
    b.object = Some(0.064);
    for _ in 0..100 {
        if !b.went_back.is_empty() {
            break;
        }
        b.run(0.1);
    }
    // The bench's policy knows one path: here it is the one from where the arm is now.
    let here = b.references[2].inverse() * b.k.fk_tcp(&b.q);
    let grasp = *b.policies[2].path.last().unwrap();
    b.policies[2] = policy(path(here, grasp, 0.05));
    b.policies[3].phase = 0.0;
    b.run(60.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    assert!(!b.went_back.is_empty() && b.went_back.iter().all(|p| *p == 2), "{:?}", b.went_back);
    // A reset by the operator begins with the first object.
    b.input.requests.reset = true;
    b.run(3.0);
    b.input.requests.resume = true;
    b.run(1.0);
    assert_eq!(b.went_back.last(), Some(&0), "{:?}", b.went_back);
}

#[test]
fn a_task_may_end_with_the_object_in_the_hand() {
    let mut b = lab();
    b.steps[1].end = GripperEnd::None;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    assert!(!b.log.codes.contains(&S::Releasing) && !b.log.codes.contains(&S::Retreating));
    let (closed, at) = (b.knuckle, b.q);
    // A switch policy that begins anew does not make it fall.
    (b.procedure, b.complete) = (0, false);
    for _ in 0..250 {
        b.tick();
    }
    assert_eq!(b.last_code(), S::Done);
    assert!((b.knuckle - closed).abs() < 0.01);
    assert!((0..6).all(|i| (b.q[i] - at[i]).abs() < 0.01), "the arm stays");
}

#[test]
fn the_hands_own_path_needs_no_object_in_the_gripper() {
    // Approach a handle, close, pull 12 cm, open; no pose of an object in the gripper is ever known.
    let mut b = lab();
    let drawer = b.references[0];
    let handle = *b.policies[0].path.last().unwrap();
    let pulled = Pose::translation(-0.12, 0.0, 0.0) * handle;
    b.references[1] = drawer;
    b.policies[1] = policy(path(handle, pulled, 0.0));
    b.steps[1].moving = Moving::Tcp;
    b.place = tdv_robot::motion::ObjectPlace::Unknown;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    in_order(&b, &[S::Following, S::Grasping, S::Following, S::Releasing, S::Retreating, S::Done]);
    assert!(b.log.ends[1].0 < 0.002 && b.gap() > 0.08, "{:?}", b.log.ends);
}

#[test]
fn a_task_may_end_with_a_grasp() {
    let mut b = lab();
    b.steps.truncate(1);
    b.run(30.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    assert!((b.gap() - 0.064).abs() < 0.003 && !b.log.codes.contains(&S::Retreating));
}
