//! Grasping is friction and nothing else: what holds, what does not.

mod common;

use common::{Rig, coaster, down, mug, object};
use std::f64::consts::FRAC_PI_2;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Vector3;
use tdv_simulation::world::Body;

const MUG: usize = 0;
const GRASP_Z: f64 = 0.058;

fn tilt(pose: &Pose) -> f64 {
    (pose.rotation * Vector3::z()).angle(&Vector3::z())
}

fn at(x: f64, y: f64, yaw: f64) -> Pose {
    tdv_geometry::pose_from_xyz_rpy([x, y, 0.0], [0.0, 0.0, yaw])
}

/// Grasps at (x, y) + offset in the tool's plane and lifts by 15 cm; the rise in metres.
fn lift_of(make: fn(Pose) -> Body, force: f64, offset: [f64; 2]) -> (Rig, f64) {
    let (x, y) = (0.50, 0.05);
    let mut rig = Rig::new(&[make(at(x, y, 0.0))], down(x, y, 0.25, 0.0));
    rig.wait(0.2);
    let (gx, gy) = (x + offset[0], y + offset[1]);
    rig.go(down(gx, gy, 0.25, 0.0), 0.2);
    rig.go(down(gx, gy, GRASP_Z, 0.0), 0.2);
    rig.close(force);
    let before = rig.world.object_pose(0).translation.z;
    rig.watch(0);
    rig.go(down(gx, gy, GRASP_Z + 0.15, 0.0), 0.2);
    rig.wait(0.5);
    let rise = rig.world.object_pose(0).translation.z - before;
    (rig, rise)
}

fn lift(force: f64, offset: [f64; 2]) -> (Rig, f64) {
    lift_of(mug, force, offset)
}

#[test]
fn a_mug_rests_still() {
    let mut rig = Rig::new(
        &[mug(at(0.5, 0.0, 0.3)), coaster(at(0.45, -0.22, 0.0))],
        down(0.4, 0.0, 0.35, 0.0),
    );
    rig.wait(3.0);
    let p = rig.world.object_pose(MUG);
    println!("rest {p}, tilt {}", tilt(&p));
    assert!((p.translation.vector - Vector3::new(0.5, 0.0, 0.0)).norm() < 3e-4, "{p}");
    assert!(tilt(&p) < 0.002);
    let c = rig.world.contacts();
    assert!(c.objects[0].table && c.objects[1].table && !c.objects[0].robot());
}

#[test]
fn grasp_lift_carry_place_release() {
    let (mut rig, rise) = lift(40.0, [0.0, 0.0]);
    println!("rise {rise:.5}, slip {:.6}, gap {:.5}", rig.slip, rig.world.gap());
    assert!((rise - 0.15).abs() < 0.002 && rig.slip < 0.002);
    assert!((rig.world.gap() - 0.064).abs() < 0.0015, "{}", rig.world.gap());
    // Carried at 0.25 m/s, turned by 90 degrees on the way.
    rig.go(down(0.45, -0.22, 0.21, FRAC_PI_2), 0.25);
    rig.go(down(0.55, 0.20, 0.21, 0.0), 0.25);
    println!("carried: slip {:.6}", rig.slip);
    assert!(rig.slip < 0.002, "{}", rig.slip);
    rig.go(down(0.55, 0.20, GRASP_Z + 0.002, 0.0), 0.2);
    rig.watch = None;
    rig.open();
    rig.go(down(0.55, 0.20, 0.20, 0.0), 0.2);
    rig.wait(1.0);
    let p = rig.world.object_pose(MUG);
    println!("placed {p} tilt {:.5} speed {:?}", tilt(&p), rig.world.object_speed(MUG));
    assert!(tilt(&p) < 0.02 && p.translation.z.abs() < 0.001);
    assert!((p.translation.x - 0.55).hypot(p.translation.y - 0.20) < 0.004, "{p}");
    assert!(rig.world.object_speed(MUG).0 < 1e-3);
}

#[test]
fn too_little_force_drops_the_mug() {
    let (_, rise) = lift(1.0, [0.0, 0.0]);
    println!("1 N: rise {rise:.4}");
    assert!(rise < 0.02, "{rise}");
    let (rig, rise) = lift(4.0, [0.0, 0.0]);
    println!("4 N: rise {rise:.4} slip {:.5}", rig.slip);
    assert!((rise - 0.15).abs() < 0.004, "{rise}");
}

#[test]
fn every_force_of_the_gripper_is_stable() {
    for force in [20.0, 100.0, 235.0] {
        let (rig, rise) = lift(force, [0.0, 0.0]);
        println!("{force} N: rise {rise:.5} slip {:.6} gap {:.5}", rig.slip, rig.world.gap());
        assert!((rise - 0.15).abs() < 0.002 && rig.slip < 0.002);
    }
}

/// Off along the pads' width the round wall is squeezed out of the grip. Off along the closing axis one
/// finger stands inside the mug and takes it by its wall, as a real one would; off towards the handle
/// the pads may take that. Those are other grasps, not failed ones.
#[test]
fn a_grasp_3_cm_off_fails_to_lift() {
    let (rig, rise) = lift(40.0, [-0.03, 0.0]);
    println!("rise {rise:.4}, gap {:.4}", rig.world.gap());
    assert!(rise < 0.01, "{rise}");
    for offset in [[0.03, 0.0], [0.0, 0.03], [0.0, -0.03]] {
        let (rig, rise) = lift(40.0, offset);
        println!("offset {offset:?}: rise {rise:.4}, gap {:.4}", rig.world.gap());
    }
}

#[test]
fn other_objects_are_lifted_too() {
    for (name, above, width) in [("bottle", 0.131, 0.0624), ("cube", 0.0, 0.085)] {
        let lowest = if name == "cube" { 0.0425 } else { 0.0 };
        let start = Pose::translation(0.5, 0.0, lowest) * at(0.0, 0.0, 0.0);
        let mut rig = Rig::new(&[object(name, start)], down(0.5, 0.0, 0.30, 0.0));
        rig.wait(0.5);
        rig.go(down(0.5, 0.0, lowest + above, 0.0), 0.2);
        rig.close(60.0);
        let gap = rig.world.gap();
        rig.watch(0);
        rig.go(down(0.5, 0.0, 0.30, 0.0), 0.2);
        rig.go(down(0.45, 0.2, 0.30, 1.0), 0.25);
        // Nothing creeps in a grip that is held for long.
        rig.wait(5.0);
        let rise = rig.world.object_pose(0).translation.z - lowest;
        println!("{name}: rise {rise:.4}, slip {:.5}, gap {gap:.4}", rig.slip);
        assert!((rise - (0.30 - lowest - above)).abs() < 0.003, "{name}");
        assert!(rig.slip < 0.0005 && (gap - width).abs() < 0.002, "{name}");
    }
}

#[test]
fn same_inputs_same_bits() {
    let hash = || {
        let (rig, _) = lift(40.0, [0.002, 0.001]);
        rig.world.state_hash()
    };
    assert_eq!(hash(), hash());
}
