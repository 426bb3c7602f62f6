//! Helpers of the physics tests: a mug, a coaster, and a hand-written tool motion.
#![allow(dead_code)]

pub mod script;

use std::path::Path;
use tdv_geometry::nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use tdv_geometry::{Pose, pose_from_xyz_rpy, smooth_step};
use tdv_rendering::ObjectFile;
use tdv_simulation::arm::ArmModel;
use tdv_simulation::gripper::{FingerDrive, STROKE, TCP_OFFSET};
use tdv_simulation::mount::Mount;
use tdv_simulation::parts::Part;
use tdv_simulation::world::{Body, DT, World, WorldConfig};

pub const HOME_GUESS: [f64; 6] = [0.0, -1.9, 2.0, -1.67, -1.57, 0.0];

/// The tool pointing down with its closing axis turned by `yaw` from y.
pub fn down(x: f64, y: f64, z: f64, yaw: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [std::f64::consts::PI, 0.0, yaw])
}

/// Joint angles that put the tool centre point at `tcp`, by Newton's method from `seed`.
pub fn solve(tcp: &Pose, seed: &[f64; 6]) -> [f64; 6] {
    let goal = tcp * Pose::translation(0.0, 0.0, -TCP_OFFSET);
    let mut q = *seed;
    let error = |q: &[f64; 6]| -> Vector6<f64> {
        let now = ArmModel::Ur5.link_frames(q)[6];
        let t = goal.translation.vector - now.translation.vector;
        let r = (goal.rotation * now.rotation.inverse()).scaled_axis();
        Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
    };
    for _ in 0..200 {
        let e = error(&q);
        if e.norm() < 1e-10 {
            break;
        }
        let mut jacobian = Matrix6::zeros();
        for i in 0..6 {
            let mut p = q;
            p[i] += 1e-6;
            jacobian.set_column(i, &((error(&p) - e) * -1e6));
        }
        let damped = jacobian.transpose() * jacobian + Matrix6::identity() * 1e-6;
        let step = damped.try_inverse().unwrap() * jacobian.transpose() * e;
        let step = step * (0.3 / step.norm().max(0.3));
        for i in 0..6 {
            q[i] += step[i];
        }
    }
    assert!(error(&q).norm() < 1e-6, "no solution for {tcp}");
    q
}

/// An object of the catalogue.
pub fn object(name: &str, pose: Pose) -> Body {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects").join(name);
    let file = ObjectFile::load(&dir).unwrap();
    Body {
        name: name.into(),
        mass: file.mass,
        friction: file.friction,
        parts: file.collision.iter().map(Part::from).collect(),
        pose,
        mount: Mount::Free,
    }
}

pub fn mug(pose: Pose) -> Body {
    object("mug", pose)
}

pub fn coaster(pose: Pose) -> Body {
    object("coaster", pose)
}

/// A world and the joint angles its arm was last sent to.
pub struct Rig {
    pub world: World,
    pub q: [f64; 6],
    pub tcp: Pose,
    /// Most that the measured grip has moved in the tool since `watch` was set.
    pub watch: Option<(usize, Pose)>,
    pub slip: f64,
}

impl Rig {
    pub fn new(bodies: &[Body], tcp: Pose) -> Self {
        let q = solve(&tcp, &HOME_GUESS);
        let world = World::new(WorldConfig::default(), bodies, &q);
        Self { world, q, tcp, watch: None, slip: 0.0 }
    }

    fn tick(&mut self) {
        self.world.step(&self.q);
        if let Some((object, grip)) = self.watch {
            let now = self.tcp.inverse() * self.world.object_pose(object);
            self.slip = self.slip.max((now.translation.vector - grip.translation.vector).norm());
        }
    }

    pub fn wait(&mut self, seconds: f64) {
        for _ in 0..(seconds / DT).round() as usize {
            self.tick();
        }
    }

    /// Straight tool motion with a minimum-jerk profile whose peak is `speed` (m/s; rad/s times 0.2).
    pub fn go(&mut self, to: Pose, speed: f64) {
        let from = self.tcp;
        let length = (to.translation.vector - from.translation.vector).norm();
        let turn = from.rotation.angle_to(&to.rotation);
        let duration = (1.875 * length / speed).max(1.875 * turn / 1.0).max(0.05);
        let ticks = (duration / DT).ceil() as usize;
        for k in 1..=ticks {
            let s = smooth_step(k as f64 / ticks as f64);
            let rotation: UnitQuaternion<f64> = from.rotation.slerp(&to.rotation, s);
            let t: Vector3<f64> = from.translation.vector.lerp(&to.translation.vector, s);
            self.tcp = Pose::from_parts(t.into(), rotation);
            self.q = solve(&self.tcp, &self.q);
            self.tick();
        }
    }

    pub fn fingers(&mut self, gap: f64, force: f64) {
        self.world.set_drive(FingerDrive { gap, speed: 0.1, force });
    }

    pub fn open(&mut self) {
        self.fingers(STROKE, 40.0);
        self.wait(0.9);
    }

    pub fn close(&mut self, force: f64) {
        self.fingers(0.0, force);
        self.wait(0.9);
    }

    pub fn watch(&mut self, object: usize) {
        self.watch = Some((object, self.tcp.inverse() * self.world.object_pose(object)));
        self.slip = 0.0;
    }
}
