use super::*;
use crate::testing::{Lab, camera, coaster_model, mug_model, upright, yaw_error};
use nalgebra::Vector3;
use tdv_geometry::{pose_distance, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives;

fn perceiver(prompt: &str) -> Perceiver {
    let config = PerceiverConfig { prompt: prompt.into(), ..PerceiverConfig::default() };
    Perceiver::new(config, vec![coaster_model(), mug_model()])
}

const PROMPT: &str = "put the cup on the coaster";

#[test]
fn mug_and_coaster_are_found_with_the_right_yaw() {
    let (mug, coaster) = (mug_model(), coaster_model());
    let mut lab = Lab::new(3);
    let mut worst = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
    for i in 0..18 {
        let yaw = f64::from(i) * 0.349 + 0.05;
        let (x, y) = (0.30 + 0.08 * f64::from(i % 5), -0.05 + 0.07 * f64::from(i % 4));
        let truth = upright(x, y, 0.0, yaw);
        let disc = upright(0.45, -0.22, 0.0, 0.0);
        let frame = lab.frame(&[(&mug.mesh, truth), (&coaster.mesh, disc)]);
        let out = perceiver(PROMPT).step(&frame).unwrap();
        let d = &out.detections[0];
        assert!(d.found, "yaw {yaw}: {}", d.reason);
        let found = camera() * d.pose;
        let error = yaw_error(&found.rotation, &truth.rotation).to_degrees();
        let shift = (found.translation.vector - truth.translation.vector).norm();
        println!(
            "mug yaw {:6.1}: error {error:.2} deg, {:.2} mm, confidence {:.2} {}",
            yaw.to_degrees(),
            shift * 1e3,
            d.confidence,
            d.reason
        );
        let c = &out.detections[1];
        assert!(c.found, "coaster: {}", c.reason);
        let found = camera() * c.pose;
        let flat = (found.translation.vector - disc.translation.vector).norm();
        let tilt = (found.rotation * Vector3::z()).angle(&Vector3::z()).to_degrees();
        println!(
            "    coaster {:.2} mm, tilt {tilt:.2} deg, confidence {:.2}",
            flat * 1e3,
            c.confidence
        );
        worst = (worst.0.max(error), worst.1.max(shift), worst.2.max(flat), worst.3.max(tilt));
    }
    println!("worst: {worst:?}");
    assert!(worst.0 < 5.0, "yaw {worst:?}");
    assert!(worst.1 < 0.006 && worst.2 < 0.006 && worst.3 < 4.0, "{worst:?}");
}

/// Two fingers on both sides of the mug and the palm above it, about a 2F-85, in the mug's frame.
fn gripper() -> tdv_rendering::Mesh {
    let at = |size: [f64; 3], xyz: [f64; 3]| {
        primitives::cuboid(size, [70, 70, 72]).transformed(&pose_from_xyz_rpy(xyz, [0.0; 3]))
    };
    let mut g = at([0.022, 0.014, 0.11], [0.0, 0.039, 0.10]);
    g.append(&at([0.022, 0.014, 0.11], [0.0, -0.039, 0.10]));
    g.append(&at([0.075, 0.10, 0.10], [0.0, 0.0, 0.205]));
    g
}

#[test]
fn a_carried_mug_is_followed_behind_a_partial_occluder() {
    let (mug, coaster) = (mug_model(), coaster_model());
    let gripper = gripper();
    let mut lab = Lab::new(5);
    let mut p = perceiver(PROMPT);
    let disc = upright(0.45, -0.22, 0.0, 0.0);
    let start = upright(0.52, 0.14, 0.0, 2.2);
    let out = p.step(&lab.frame(&[(&mug.mesh, start), (&coaster.mesh, disc)])).unwrap();
    assert!(out.detections.iter().all(|d| d.found), "{:?}", out.detections);
    let mut errors = Vec::new();
    for i in 0..60 {
        let s = tdv_geometry::smooth_step(f64::from(i) / 59.0);
        let lift = 0.12 * (std::f64::consts::PI * s).sin();
        let truth = upright(0.52 - 0.07 * s, 0.14 - 0.36 * s, lift, 2.2 - 0.6 * s);
        let out = p
            .step(&lab.frame(&[(&mug.mesh, truth), (&coaster.mesh, disc), (&gripper, truth)]))
            .unwrap();
        let d = &out.detections[0];
        assert!(d.found, "frame {i}: {}", d.reason);
        let found = camera() * d.pose;
        let shift = (found.translation.vector - truth.translation.vector).norm();
        let yaw = yaw_error(&found.rotation, &truth.rotation).to_degrees();
        let turn = found.rotation.angle_to(&truth.rotation).to_degrees();
        println!(
            "{i:2}: {:.1} mm, yaw {yaw:.1}, all {turn:.1} deg, confidence {:.2}",
            shift * 1e3,
            d.confidence
        );
        errors.push((shift, yaw));
        let c = &out.detections[1];
        assert!(c.found, "coaster: {}", c.reason);
    }
    let worst = errors.iter().fold((0.0f64, 0.0f64), |w, e| (w.0.max(e.0), w.1.max(e.1)));
    assert!(worst.0 < 0.012 && worst.1 < 10.0, "{worst:?}");
}

#[test]
fn an_object_that_leaves_is_lost_and_found_again() {
    let (mug, coaster) = (mug_model(), coaster_model());
    let mut lab = Lab::new(7);
    let mut p = perceiver(PROMPT);
    let disc = upright(0.45, -0.22, 0.0, 0.0);
    let a = upright(0.5, 0.1, 0.0, 1.0);
    let b = upright(0.35, -0.02, 0.0, 2.5);
    let mug_found = |out: &PerceptionOutput| out.detections[0].found;
    assert!(mug_found(&p.step(&lab.frame(&[(&mug.mesh, a), (&coaster.mesh, disc)])).unwrap()));
    let mut found = true;
    for _ in 0..12 {
        found = mug_found(&p.step(&lab.frame(&[(&coaster.mesh, disc)])).unwrap());
    }
    assert!(!found, "a mug that is not there");
    let mut pose = None;
    for _ in 0..15 {
        let out = p.step(&lab.frame(&[(&mug.mesh, b), (&coaster.mesh, disc)])).unwrap();
        pose = out.detections[0].found.then_some(out.detections[0].pose);
    }
    let (d, _) = pose_distance(&(camera() * pose.expect("found again")), &b);
    assert!(d < 0.006, "{d}");
    assert!(p.reregister("mug") && !p.reregister("plate"));
}

#[test]
fn what_is_not_there_or_not_known_is_said() {
    let coaster = coaster_model();
    let mut lab = Lab::new(9);
    let disc = upright(0.45, -0.22, 0.0, 0.0);
    let frame = lab.frame(&[(&coaster.mesh, disc)]);
    let out = perceiver("put the cup on the plate").step(&frame).unwrap();
    assert_eq!(out.detections.len(), 2);
    assert!(!out.detections[0].found && out.detections[0].reason.contains("no mug"), "{out:?}");
    assert!(!out.detections[1].found && out.detections[1].reason.contains("nearest"));
    let mut blind = frame.clone();
    blind.depth.data.fill(f32::NAN);
    let out = perceiver(PROMPT).step(&blind).unwrap();
    assert_eq!(out.depth, DepthStatus::Empty);
    assert!(out.detections.iter().all(|d| !d.found && d.reason.contains("depth")), "{out:?}");
    let mut broken = frame;
    broken.depth.data.truncate(5);
    assert!(perceiver(PROMPT).step(&broken).is_err());
}

#[test]
fn masks_cover_the_objects() {
    let (mug, coaster) = (mug_model(), coaster_model());
    let mut lab = Lab::new(11);
    let scene = [
        (mug.mesh.as_ref(), upright(0.45, 0.05, 0.0, 0.3)),
        (coaster.mesh.as_ref(), upright(0.45, -0.22, 0.0, 0.0)),
    ];
    let frame = lab.frame(&scene);
    let out = perceiver(PROMPT).step(&frame).unwrap();
    let count = |l: u8| out.masks.iter().filter(|m| **m == l).count();
    assert!((1500..9000).contains(&count(1)), "{}", count(1));
    assert!((1500..9000).contains(&count(2)), "{}", count(2));
    // The plane lies where the table is.
    let table = camera() * out.table.unwrap().pose;
    assert!(table.translation.z.abs() < 0.002, "{}", table.translation.z);
    assert!((table.rotation * Vector3::z()).angle(&Vector3::z()) < 0.006);
}
