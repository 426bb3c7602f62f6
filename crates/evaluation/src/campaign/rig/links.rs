//! What lies between the parts: states, observations, decisions, predictions, orders on their way.

use super::planner::{self, STEP};
use super::{CYCLE, FaultKind, Rig, Stage};
use rand::Rng;
use std::f64::consts::PI;
use tdv_geometry::{Pose, Stamp, pose_from_xyz_rpy};
use tdv_robot::executor::RobotInput;
use tdv_robot::gripper::{knuckle_from_register, register_from_knuckle};
use tdv_robot::motion::{
    Attach, GripperFeedback, JointState, Moving, ObjectPlace, ObjectReport, Plan, ProcedureState,
    Requests, StatusCode,
};
use tdv_simulation::SimulationError;
use tdv_simulation::controller::{RobotMode, SafetyMode};
use tdv_simulation::gripper::{GripperRequest as Registers, ObjectStatus};
use tdv_simulation::world::DT;
use tdv_ur_protocol::servo::{Command, ProgramState};
/// Noise of observed poses: m and rad by axis (uniform).
const NOISE: (f64, f64) = (0.002, 0.0175);
/// The observed arrival has to last this long before the procedure ends, s.
const SETTLED: f64 = 0.25;
/// Silence (s) after which the driver gives its connection up.
const LOST: f64 = 0.2;

impl Rig {
    /// One exchange between driver and robot.
    pub(super) fn robot_cycle(&mut self) {
        let c = self.lab.controller();
        let (t, q, qd) = (self.time(), *c.q(), *c.qd());
        let program = ProgramState::from_register(c.outputs().ints[24]);
        let safe = matches!(c.safety_mode(), SafetyMode::Normal | SafetyMode::Reduced);
        let runs = c.program_running() && program != Some(ProgramState::NotRunning);
        let may_move = runs && safe && c.robot_mode() == RobotMode::Running;
        let factor = c.speed_scaling() * c.speed_fraction();
        if self.has(FaultKind::RtdeCut) || self.has(FaultKind::DriverKilled) {
            self.driver_lost += DT * CYCLE as f64;
            if self.driver_lost > LOST {
                self.driver.forget();
            }
            return;
        }
        self.driver_lost = 0.0;
        let out = self.driver.step(&RobotInput {
            time: t,
            clock: self.now(),
            q,
            qd,
            may_move,
            watchdog: program == Some(ProgramState::WatchdogStop),
            factor,
            enabled: true,
        });
        self.heartbeat = self.heartbeat.wrapping_add(1);
        let command = if out.target.is_some() { Command::Servo } else { Command::Idle };
        let targets = out.target.unwrap_or(q);
        let inputs = self.lab.controller_mut().inputs_mut();
        for (i, v) in targets.into_iter().enumerate() {
            inputs.write_double(24 + i, v);
        }
        inputs.write_int(24, command as i32);
        inputs.write_int(25, self.heartbeat);
        self.input.speed_scaling = self.driver.state().map_or(0.0, |s| s.scale);
        self.input.disabled = (!may_move).then(|| "the robot's program does not run".into());
        let stamp = self.now();
        if self.has(FaultKind::JointStates) {
            if self.fault.strength > 0.5 {
                self.input.joints = Some(JointState { stamp, q: [f64::NAN; 6], qd });
            }
        } else {
            self.input.joints = Some(JointState { stamp, q, qd });
        }
    }

    pub(super) fn poll_gripper(&mut self) {
        let status = self.lab.gripper_status();
        let knuckle = knuckle_from_register(status.position);
        let last = self.input.gripper.map(|g| (g.command, g.stalled, g.reached));
        let (mut command, mut stalled, mut reached) = last.unwrap_or((None, false, false));
        if let Some((id, register)) = self.gripper_order
            && status.requested == register
            && status.object != ObjectStatus::Moving
        {
            command = Some(id);
            reached = status.object == ObjectStatus::AtPosition;
            stalled = !reached;
            self.gripper_order = None;
        }
        self.input.gripper =
            Some(GripperFeedback { stamp: self.now(), command, knuckle, stalled, reached });
    }

    fn noisy(&mut self, p: &Pose) -> Pose {
        let mut any =
            |most: f64| -> [f64; 3] { std::array::from_fn(|_| self.rng.random_range(-most..most)) };
        let (shift, turn) = (any(NOISE.0), any(NOISE.1));
        planner::disturbed(p, shift, turn)
    }

    /// A frame of the camera: poses, decision, prediction.
    pub(super) fn observe(&mut self) -> Result<(), SimulationError> {
        let (object, reference) =
            (self.lab.object_pose(&self.moving)?, self.lab.object_pose(&self.reference)?);
        let truly_held = self.lab.held(&self.moving)?;
        let (seen, place) = (self.noisy(&object), self.noisy(&reference));
        let tcp = self.arm.fk_tcp(self.lab.joints().0);
        let stamp = self.now();
        let held_place =
            if self.held && truly_held { ObjectPlace::Held } else { ObjectPlace::Apart };
        self.input.object = Some(ObjectReport { stamp, place: held_place });
        self.input.attach = self.held.then(|| Attach { stamp, pose: tcp.inverse() * object });
        let (moving, from, base, goal) = if self.procedure == 0 {
            let upright = pose_from_xyz_rpy(
                [seen.translation.x, seen.translation.y, object.translation.z],
                [0.0, 0.0, tdv_geometry::yaw_of(&seen.rotation)],
            );
            (Moving::Tcp, tcp, upright, planner::grasp(&upright))
        } else {
            let t = place.translation;
            let goal = pose_from_xyz_rpy([t.x, t.y, 0.0095], [0.0; 3]);
            (Moving::Object, object, place, goal)
        };
        self.decide(stamp, &from, &goal);
        let inverse = base.inverse();
        let poses = planner::predict(&from, &goal).iter().map(|p| inverse * p).collect();
        let plan = Plan {
            stamp,
            procedure: self.procedure,
            moving,
            reference_pose: base,
            moving_pose: Some(inverse * from),
            poses,
            dt: STEP,
        };
        self.send(plan);
        Ok(())
    }

    /// The switch policy's part.
    fn decide(&mut self, stamp: Stamp, from: &Pose, goal: &Pose) {
        let t = self.time();
        let following = self.status == Some(StatusCode::Following);
        if following && planner::arrived(from, goal) {
            let since = *self.arrived_since.get_or_insert(t);
            if t - since >= SETTLED {
                self.arrived_since = None;
                match self.procedure {
                    0 => self.procedure = 1,
                    _ => self.complete = true,
                }
            }
        } else {
            self.arrived_since = None;
        }
        if !self.has(FaultKind::SwitchSilent) {
            let (procedure, complete) = (self.procedure, self.complete);
            self.input.procedure = Some(ProcedureState::pick_and_place(stamp, procedure, complete));
        }
    }

    /// A prediction on its way, as the trouble has it.
    fn send(&mut self, mut plan: Plan) {
        let mut due = self.time() + self.rng.random_range(0.05..0.09);
        if let Stage::During { .. } = self.stage {
            let strength = self.fault.strength;
            match self.fault.kind {
                FaultKind::MessageLoss => {
                    if self.rng.random_range(0.0..1.0) < 0.3 + 0.65 * strength {
                        return;
                    }
                }
                FaultKind::OutOfOrder => {
                    let again = self.time() + self.rng.random_range(0.05..0.3);
                    self.plans.push_back((again, plan.clone()));
                    due += self.rng.random_range(0.0..0.05);
                }
                FaultKind::PolicySilent => return,
                FaultKind::NotANumber => {
                    let i = self.rng.random_range(0..plan.poses.len());
                    plan.poses[i].translation.vector.y = f64::NAN;
                }
                FaultKind::Flipped => {
                    let turn = if strength > 0.5 { [PI, 0.0, 0.0] } else { [0.0, 0.0, PI] };
                    plan.reference_pose = plan.reference_pose * pose_from_xyz_rpy([0.0; 3], turn);
                }
                FaultKind::Jump => {
                    let angle = 2.0 * PI * strength;
                    plan.reference_pose.translation.x += 0.3 * angle.cos();
                    plan.reference_pose.translation.y += 0.3 * angle.sin();
                }
                FaultKind::Late => due += 0.15 + 0.5 * strength,
                FaultKind::Future => plan.stamp = plan.stamp.plus(0.2 + 5.0 * strength),
                _ => {}
            }
        }
        self.plans.push_back((due, plan));
    }

    /// What is due arrives.
    pub(super) fn deliver(&mut self) {
        let t = self.time();
        let due = |x: &(f64, Plan)| x.0 <= t;
        while let Some(i) = self.plans.iter().position(due) {
            self.input.plan = self.plans.remove(i).map(|x| x.1);
        }
        while self.trajectories.front().is_some_and(|x| x.0 <= t) {
            let Some((_, mut trajectory)) = self.trajectories.pop_front() else { return };
            if self.has(FaultKind::DriverKilled) {
                continue;
            }
            if self.has(FaultKind::WrongNames) {
                trajectory.names[2] = "elbow".into();
            }
            // What the driver refuses it refuses; the arm then comes to rest by itself.
            let _ = self.driver.follow(&trajectory, self.now());
        }
    }

    pub(super) fn control(&mut self) {
        let now = self.now();
        let out = self.controller.step(now, &self.input);
        self.input.requests = Requests::default();
        self.held = out.status.object_held;
        self.status = Some(out.status.code);
        self.sentence = out.status.sentence;
        if let Some(path) = &out.trajectory {
            let arrives = self.time() + self.rng.random_range(0.001..0.005);
            self.trajectories.push_back((arrives, path.to_trajectory(self.fault.stamped)));
        }
        if let Some(order) = out.gripper
            && !self.has(FaultKind::GripperSilent)
        {
            let position = register_from_knuckle(order.position);
            self.gripper_order = Some((order.id, position));
            self.lab.set_gripper_request(Registers {
                activate: true,
                go_to: true,
                position,
                speed: 255,
                force: 40,
                ..Registers::default()
            });
        }
        if out.reset_switch && !self.has(FaultKind::SwitchSilent) {
            (self.procedure, self.complete, self.arrived_since) = (0, false, None);
        }
    }
}
