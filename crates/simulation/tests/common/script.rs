//! A scripted robot that is told everything, through the controller's registers and the gripper's.

use super::down;
use tdv_geometry::{Pose, smooth_step, yaw_of};
use tdv_robot::{IkSelection, Kinematics};
use tdv_simulation::Lab;
use tdv_simulation::disturbance::ForcedDrop;
use tdv_simulation::gripper::{Activation, GripperRequest, ObjectStatus};
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::world::DT;
use tdv_ur_protocol::servo::ServoProgram;

/// A robot that is told everything.
pub struct Script {
    pub lab: Lab,
    pub arm: Kinematics,
    pub beat: i32,
    pub q: [f64; 6],
    pub tcp: Pose,
    pub request: GripperRequest,
    pub ticks: u64,
    /// Errors that it makes: grasp off by x, y (m) and yaw (rad), set down too high (m; negative: it
    /// presses).
    pub slop: [f64; 4],
    /// Height of the grasp over the object's underside, thickness of the reference, m.
    pub heights: [f64; 2],
    pub drop: Option<ForcedDrop>,
}

impl Script {
    pub fn new(lab: Lab) -> Self {
        let arm = Kinematics::ur5();
        let q = *lab.joints().0;
        let tcp = arm.fk_tcp(&q);
        let request = GripperRequest { activate: true, ..GripperRequest::default() };
        let mut s = Self {
            lab,
            arm,
            beat: 0,
            q,
            tcp,
            request,
            ticks: 0,
            slop: [0.0; 4],
            heights: [0.058, 0.008],
            drop: None,
        };
        let program = ServoProgram::cb3().text().unwrap();
        s.lab.controller_mut().run_script(&program).unwrap();
        s.lab.set_gripper_request(request);
        while s.lab.gripper_status().activation != Activation::Active {
            s.tick();
        }
        s
    }

    pub fn tick(&mut self) {
        if self.ticks % 4 == 0 {
            self.beat += 1;
            let inputs = self.lab.controller_mut().inputs_mut();
            inputs.write_int(24, 1);
            inputs.write_int(25, self.beat);
            self.q.iter().enumerate().for_each(|(i, q)| inputs.write_double(24 + i, *q));
        }
        self.ticks += 1;
        self.lab.step();
        if let Some(drop) = &mut self.drop {
            drop.step(&mut self.lab).unwrap();
        }
    }

    pub fn wait(&mut self, seconds: f64) {
        for _ in 0..(seconds / DT) as usize {
            self.tick();
        }
    }

    /// Straight to `to`, peak speed 0.2 m/s; false when the arm cannot.
    pub fn go(&mut self, to: Pose) -> bool {
        let from = self.tcp;
        let length = (to.translation.vector - from.translation.vector).norm();
        let seconds = (1.875 * length / 0.2).max(from.rotation.angle_to(&to.rotation) * 2.5);
        let n = (seconds / DT).ceil().max(1.0);
        for k in 1..=n as usize {
            let target = tdv_geometry::interpolate(&from, &to, smooth_step(k as f64 / n));
            let Ok(q) = self.arm.nearest_tcp(&target, &self.q, &IkSelection::default()) else {
                return false;
            };
            self.q = q;
            self.tcp = target;
            self.tick();
        }
        self.wait(0.15);
        true
    }

    pub fn fingers(&mut self, position: u8) -> ObjectStatus {
        self.request =
            GripperRequest { go_to: true, position, speed: 255, force: 40, ..self.request };
        self.lab.set_gripper_request(self.request);
        self.tick();
        while self.lab.gripper_status().object == ObjectStatus::Moving {
            self.tick();
        }
        self.lab.gripper_status().object
    }

    /// Takes the mug and puts it down where its target was seen before `between` ran.
    pub fn pick_and_place(&mut self, goal: PlacingGoal, between: impl FnOnce(&mut Lab)) -> bool {
        let task = self.lab.scene().task.clone();
        let mug = self.lab.object_pose(&task.moving).unwrap();
        let coaster = self.lab.object_pose(&task.reference).unwrap();
        let [low, thick] = self.heights;
        let above = low + 0.14;
        let yaw = yaw_of(&mug.rotation);
        let m = mug.translation;
        // The fingers close across the handle's plane.
        let [dx, dy, turn, high] = self.slop;
        let grasp = |z| down(m.x + dx, m.y + dy, z, yaw + turn);
        if !(self.go(grasp(above)) && self.go(grasp(low))) {
            return false;
        }
        if self.fingers(255) != ObjectStatus::ContactClosing
            || !self.lab.held(&task.moving).unwrap()
        {
            return false;
        }
        between(&mut self.lab);
        let t = coaster.translation;
        let place = |z| down(t.x + goal.offset[0], t.y + goal.offset[1], z, goal.yaw);
        let there = self.go(grasp(above))
            && self.go(place(above))
            && self.go(place(low + thick + 0.001 + high));
        self.fingers(0);
        there && self.go(place(above))
    }
}
