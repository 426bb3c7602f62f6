use super::*;
use nalgebra::Point3;
use tdv_geometry::{pose_distance, pose_from_xyz_rpy};
use tdv_rendering::look_at;

fn task() -> TaskObjects {
    let spec = |name: &str, symmetry| ObjectSpec { name: name.into(), symmetry };
    TaskObjects {
        objects: vec![
            spec("mug", Symmetry::None),
            spec("coaster", Symmetry::Continuous { axis: [0.0, 0.0, 1.0] }),
        ],
        reference: "coaster".into(),
        moving: "mug".into(),
    }
}

fn camera() -> Pose {
    look_at(&Point3::new(0.95, 0.0, 0.7), &Point3::new(0.475, 0.0, 0.02))
}

fn detection(name: &str, base: &Pose, confidence: f64) -> Detection {
    Detection {
        name: name.into(),
        pose: camera().inverse() * base,
        confidence,
        covariance: Matrix6::identity() * 1e-6,
        found: true,
        reason: String::new(),
    }
}

struct World {
    objects: Objects,
    frame: i64,
}

impl World {
    fn new() -> Self {
        Self { objects: Objects::new(ObjectsConfig::default(), task()), frame: 0 }
    }

    fn step(&mut self, detections: &[Detection], tcp: Option<&Pose>, held: bool) -> ObjectsOutput {
        self.frame += 1;
        let stamp = Stamp(self.frame * 33_333_333);
        if let Some(tcp) = tcp {
            self.objects.push_tcp(stamp, *tcp);
        }
        self.objects.step(&ObjectsInput {
            stamp,
            detections,
            table: None,
            t_base_camera: camera(),
            object_held: held,
        })
    }
}

fn mug_at(x: f64, z: f64) -> Pose {
    pose_from_xyz_rpy([x, 0.1, z], [0.0, 0.0, 0.5])
}

#[test]
fn init_tracking_occluded_lost_and_back() {
    let mut w = World::new();
    let seen = [detection("mug", &mug_at(0.5, 0.0), 0.9)];
    let state = |o: &ObjectsOutput| o.objects[0].state;
    let o = w.step(&seen, None, false);
    assert_eq!((state(&o), o.objects[0].pose), (ObjectState::Init, None));
    w.step(&seen, None, false);
    let o = w.step(&seen, None, false);
    assert_eq!(state(&o), ObjectState::Tracking);
    assert!(pose_distance(&o.objects[0].pose.unwrap(), &mug_at(0.5, 0.0)).0 < 1e-9);
    // Between reject and accept it stays tracked; below it does not.
    let weak = [detection("mug", &mug_at(0.5, 0.0), 0.4)];
    assert_eq!(state(&w.step(&weak, None, false)), ObjectState::Tracking);
    for _ in 0..5 {
        w.step(&[], None, false);
    }
    let o = w.step(&weak, None, false);
    assert_eq!(state(&o), ObjectState::Occluded, "0.4 is not enough to come back");
    for _ in 0..(30.0 * ObjectsConfig::default().lost_after) as usize + 5 {
        w.step(&[], None, false);
    }
    let o = w.step(&[], None, false);
    assert_eq!((state(&o), o.objects[0].confidence), (ObjectState::Lost, 0.0));
    for _ in 0..3 {
        w.step(&seen, None, false);
    }
    assert_eq!(state(&w.step(&seen, None, false)), ObjectState::Tracking);
}

#[test]
fn a_single_wild_detection_is_not_believed() {
    let mut w = World::new();
    for _ in 0..5 {
        w.step(&[detection("mug", &mug_at(0.5, 0.0), 0.9)], None, false);
    }
    let o = w.step(&[detection("mug", &mug_at(0.7, 0.0), 0.9)], None, false);
    assert!((o.objects[0].pose.unwrap().translation.x - 0.5).abs() < 1e-9);
    // Displaced for good: followed after three frames.
    for _ in 0..3 {
        w.step(&[detection("mug", &mug_at(0.6, 0.0), 0.9)], None, false);
    }
    let o = w.step(&[detection("mug", &mug_at(0.6, 0.0), 0.9)], None, false);
    assert!((o.objects[0].pose.unwrap().translation.x - 0.6).abs() < 1e-6);
}

#[test]
fn held_follows_the_tool_through_occlusion_and_is_seen_again_after_release() {
    let mut w = World::new();
    let down = |x: f64, z: f64| pose_from_xyz_rpy([x, 0.1, z], [std::f64::consts::PI, 0.0, 0.3]);
    let start = mug_at(0.5, 0.0);
    for _ in 0..5 {
        w.step(&[detection("mug", &start, 0.9)], Some(&down(0.5, 0.08)), false);
    }
    let attach = down(0.5, 0.08).inverse() * start;
    // Noisy views, one wild, right after the grasp.
    for i in 0..8 {
        let e = if i == 3 { 0.03 } else { 0.001 * f64::from(i % 3 - 1) };
        let seen = pose_from_xyz_rpy([e, 0.0, 0.0], [0.0; 3]) * start;
        let o = w.step(&[detection("mug", &seen, 0.9)], Some(&down(0.5, 0.08)), true);
        assert_eq!(o.objects[0].state, ObjectState::Held);
    }
    let (d, a) = pose_distance(&w.objects.t_attach().unwrap(), &attach);
    assert!(d < 0.001 && a < 1e-3, "{d} {a}");
    // Carried blind.
    for i in 0..60 {
        let tool = down(0.5 - 0.004 * f64::from(i), 0.2);
        let o = w.step(&[], Some(&tool), true);
        let (d, _) = pose_distance(&o.objects[0].pose.unwrap(), &(tool * attach));
        assert!(d < 0.001 && o.objects[0].state == ObjectState::Held);
    }
    // Released: the last pose stands until it is seen.
    let end = down(0.264, 0.2) * attach;
    let o = w.step(&[], Some(&down(0.264, 0.3)), false);
    assert_eq!(o.objects[0].state, ObjectState::Occluded);
    assert!(pose_distance(&o.objects[0].pose.unwrap(), &end).0 < 0.001);
    assert!(w.objects.t_attach().is_none());
    let o = w.step(&[detection("mug", &end, 0.9)], None, false);
    assert_eq!(o.objects[0].state, ObjectState::Tracking);
}

#[test]
fn occluded_at_the_grasp_uses_the_last_good_pose() {
    let mut w = World::new();
    let tool = pose_from_xyz_rpy([0.5, 0.1, 0.08], [std::f64::consts::PI, 0.0, 0.3]);
    for _ in 0..5 {
        w.step(&[detection("mug", &mug_at(0.5, 0.0), 0.9)], Some(&tool), false);
    }
    let o = w.step(&[detection("mug", &mug_at(0.5, 0.0), 0.1)], Some(&tool), true);
    assert_eq!(o.objects[0].state, ObjectState::Held);
    let moved = pose_from_xyz_rpy([0.0, 0.0, 0.1], [0.0; 3]) * tool;
    let o = w.step(&[], Some(&moved), true);
    assert!((o.objects[0].pose.unwrap().translation.z - 0.1).abs() < 1e-6);
}

#[test]
fn a_mug_left_behind_is_noticed() {
    let mut w = World::new();
    let start = mug_at(0.5, 0.0);
    let tool = |z: f64| pose_from_xyz_rpy([0.5, 0.1, z], [std::f64::consts::PI, 0.0, 0.3]);
    for _ in 0..12 {
        w.step(&[detection("mug", &start, 0.9)], Some(&tool(0.08)), true);
    }
    let mut o = None;
    for i in 0..30 {
        o = Some(w.step(
            &[detection("mug", &start, 0.9)],
            Some(&tool(0.08 + 0.006 * f64::from(i))),
            true,
        ));
    }
    let o = o.unwrap();
    assert_ne!(o.objects[0].state, ObjectState::Held);
    assert!((o.objects[0].pose.unwrap().translation.z).abs() < 0.005);
}

#[test]
fn misread_after_a_silence_the_held_mug_stays_held() {
    let mut w = World::new();
    let start = mug_at(0.5, 0.0);
    let tool = pose_from_xyz_rpy([0.5, 0.1, 0.08], [std::f64::consts::PI, 0.0, 0.3]);
    let wrong = mug_at(0.6, 0.0);
    let see = |w: &mut World, pose: &Pose, frames: usize| {
        let frames = (0..frames)
            .map(|_| w.step(&[detection("mug", pose, 0.9)], Some(&tool), true).objects[0].state);
        frames.last().unwrap()
    };
    assert_eq!(see(&mut w, &start, 12), ObjectState::Held);
    w.frame += 30;
    assert_eq!(see(&mut w, &wrong, 40), ObjectState::Held);
    assert!(w.objects.t_attach().is_some());
    assert_eq!(see(&mut w, &start, 1), ObjectState::Held);
    // Followed again, the same counts.
    assert_ne!(see(&mut w, &wrong, 12), ObjectState::Held);
}

#[test]
fn a_round_reference_has_yaw_zero_and_poses_are_relative_to_it() {
    let mut w = World::new();
    let mut last = None;
    for i in 0..6 {
        let coaster = pose_from_xyz_rpy([0.45, -0.22, 0.0], [0.01, 0.0, 1.3 * f64::from(i)]);
        let mug = mug_at(0.5, 0.0);
        last = Some(w.step(
            &[detection("coaster", &coaster, 0.9), detection("mug", &mug, 0.9)],
            None,
            false,
        ));
    }
    let o = last.unwrap();
    let coaster = o.objects[1].pose.unwrap();
    assert!(tdv_geometry::yaw_of(&coaster.rotation).abs() < 0.01);
    let relative = o.objects[0].relative.unwrap();
    assert!((coaster * relative).translation.x - 0.5 < 1e-6);
    assert!((relative.translation.y - 0.32).abs() < 0.01);
}
