//! One case: all parts, and what lies between them.

use super::CaseResult;
use super::fault::{Fault, FaultKind};
use super::planner::{self, STEP};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::f64::consts::PI;
use std::sync::Arc;
use tdv_geometry::{Pose, Stamp, pose_from_xyz_rpy};
use tdv_robot::executor::{Motion, MotionParams, RobotInput};
use tdv_robot::gripper::{knuckle_from_register, register_from_knuckle};
use tdv_robot::motion::{
    Attach, GripperFeedback, JointState, Moving, ObjectPlace, ObjectReport, Plan, ProcedureState,
    Requests, StatusCode,
};
use tdv_robot::{
    ArmController, ControllerInput, ControllerParams, JointTrajectory, Kinematics, Limits,
};
use tdv_simulation::controller::{RobotMode, SafetyMode, StopReason};
use tdv_simulation::gripper::{Activation, GripperRequest as Registers, ObjectStatus};
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::world::DT;
use tdv_simulation::{Lab, LabAssets, SimulationError};
use tdv_ur_protocol::servo::{Command, ProgramState, ServoProgram};

/// Ticks of 2 ms between two looks at the robot, two frames of the camera, two polls of the gripper.
const CYCLE: u64 = 4;
const FRAME: u64 = 17;
const POLL: u64 = 15;
/// Noise of observed poses: m and rad by axis (uniform).
const NOISE: (f64, f64) = (0.002, 0.0175);
/// The observed arrival has to last this long before the procedure ends, s.
const SETTLED: f64 = 0.25;
/// A case is given up after this time, s.
const PATIENCE: f64 = 80.0;
/// Joint speeds (rad/s) of an arm that moves well, and of one at rest.
const MOVING: f64 = 0.1;
const REST: f64 = 0.01;
/// Silence (s) after which the driver gives its connection up.
const LOST: f64 = 0.2;
/// Share of a limit by which the robot's own motion may exceed it: the servo's filter.
const ROOM: f64 = 1.15;
/// Joint acceleration (rad/s^2) of the robot that counts as a jolt; its servo allows 20.
const JOLT: f64 = 25.0;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    Before,
    During { since: f64 },
    After,
}

pub struct Rig {
    lab: Lab,
    arm: Kinematics,
    limits: Limits,
    controller: ArmController,
    driver: Motion,
    driver_lost: f64,
    heartbeat: i32,
    script: String,
    input: ControllerInput,
    status: Option<StatusCode>,
    sentence: String,
    held: bool,
    plans: VecDeque<(f64, Plan)>,
    trajectories: VecDeque<(f64, JointTrajectory)>,
    gripper_order: Option<(u32, u8)>,
    procedure: u32,
    complete: bool,
    arrived_since: Option<f64>,
    moved_for: f64,
    rest_since: Option<f64>,
    /// The arm was backing off while the trouble lasted.
    backed_off: bool,
    last_qd: [f64; 6],
    ticks: u64,
    fault: Fault,
    stage: Stage,
    result: CaseResult,
    rng: ChaCha8Rng,
    moving: String,
    reference: String,
}

/// Time zero of a case; any will do that is not zero.
const ORIGIN: f64 = 1000.0;

impl Rig {
    pub fn new(assets: Arc<LabAssets>, seed: u64) -> Result<Self, SimulationError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x00c0_ffee);
        let fault = Fault::draw(&mut rng);
        let mut lab = Lab::from_assets(assets, seed)?;
        lab.begin_trial(PlacingGoal { offset: [0.0; 2], yaw: 0.0 })?;
        lab.set_gripper_request(Registers { activate: true, ..Registers::default() });
        let (moving, reference) =
            (lab.scene().task.moving.clone(), lab.scene().task.reference.clone());
        let limits = Limits::default();
        // Never refused: a test of the protocol crate holds the default program within its ranges.
        let script = ServoProgram::cb3().text().unwrap_or_default();
        let result = CaseResult {
            seed,
            kind: fault.kind,
            lasted: 0.0,
            speed: 0.0,
            rest_s: None,
            rest_due: None,
            sentence: String::new(),
            violations: Vec::new(),
            recovered: false,
            placed: false,
        };
        let mut rig = Self {
            arm: Kinematics::ur5(),
            controller: new_controller(),
            driver: new_driver(&limits),
            limits,
            driver_lost: 0.0,
            heartbeat: rng.random_range(0..1000),
            script,
            input: ControllerInput::default(),
            status: None,
            sentence: String::new(),
            held: false,
            plans: VecDeque::new(),
            trajectories: VecDeque::new(),
            gripper_order: None,
            procedure: 0,
            complete: false,
            arrived_since: None,
            moved_for: 0.0,
            rest_since: None,
            backed_off: false,
            last_qd: [0.0; 6],
            ticks: 0,
            fault,
            stage: Stage::Before,
            result,
            rng,
            moving,
            reference,
            lab,
        };
        rig.upload();
        while rig.lab.gripper_status().activation != Activation::Active {
            rig.lab.step();
        }
        Ok(rig)
    }

    fn time(&self) -> f64 {
        self.lab.time()
    }

    fn now(&self) -> Stamp {
        Stamp::from_secs(ORIGIN + self.time())
    }

    fn has(&self, kind: FaultKind) -> bool {
        matches!(self.stage, Stage::During { .. }) && self.fault.kind == kind
    }

    /// Puts the servo program onto the robot, as the driver does.
    fn upload(&mut self) {
        if let Err(e) = self.lab.controller_mut().run_script(&self.script) {
            self.result.violations.push(format!("servo program: {e}"));
        }
    }

    pub fn run(mut self) -> Result<CaseResult, SimulationError> {
        while self.time() < PATIENCE {
            self.tick()?;
            let over = self.stage == Stage::After && self.status == Some(StatusCode::Done);
            self.result.recovered |= over;
            let never = self.stage == Stage::Before && self.status == Some(StatusCode::Done);
            if self.lab.trial().finished && (over || never) {
                break;
            }
        }
        self.result.recovered |=
            self.stage == Stage::Before && self.status == Some(StatusCode::Done);
        self.result.placed = self.lab.trial().success;

        Ok(self.result)
    }

    fn tick(&mut self) -> Result<(), SimulationError> {
        self.lab.step();
        self.ticks += 1;
        self.stage_fault();
        self.judge();
        if self.ticks.is_multiple_of(CYCLE) {
            self.robot_cycle();
        }
        if self.ticks.is_multiple_of(POLL) && !self.has(FaultKind::GripperSilent) {
            self.poll_gripper();
        }
        if self.ticks.is_multiple_of(FRAME) {
            self.observe()?;
        }
        self.deliver();
        // Half a cycle after the robot's state.
        if self.ticks % CYCLE == 2 && !self.has(FaultKind::ControllerKilled) {
            self.control();
        }
        Ok(())
    }

    fn fastest(&self) -> f64 {
        self.lab.joints().1.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
    }

    /// Begins and ends the trouble, and does what an operator does after a stop.
    fn stage_fault(&mut self) {
        let t = self.time();
        match self.stage {
            Stage::Before => {
                if self.fastest() > MOVING {
                    self.moved_for += DT;
                }
                let ready = self.moved_for > self.fault.after && self.fastest() > MOVING;
                if ready && (self.fault.kind != FaultKind::Slip || self.held) {
                    self.begin_fault(t);
                }
            }
            Stage::During { since } => {
                if self.fastest() < REST {
                    self.rest_since.get_or_insert(t);
                } else {
                    self.rest_since = None;
                }
                self.backed_off |= self.status == Some(StatusCode::Retreating);
                self.result.sentence.clone_from(&self.sentence);
                if t - since >= self.duration() {
                    self.result.lasted = t - since;
                    self.result.rest_s = self.rest_since.map(|r| r - since);
                    // Backing off needs no prediction: the arm may go on.
                    let due = self.fault.kind.rest_due().filter(|_| !self.backed_off);
                    self.result.rest_due = due.filter(|due| t - since > due + 0.05);
                    self.stage = Stage::After;
                    self.end_fault();
                }
            }
            Stage::After => {}
        }
        self.operate();
    }

    fn duration(&self) -> f64 {
        match self.fault.kind {
            // As long as the robot insists on.
            FaultKind::ProtectiveStop => 5.5,
            FaultKind::EmergencyStop | FaultKind::SpeedSlider => self.fault.lasts.max(1.0),
            _ => self.fault.lasts,
        }
    }

    fn begin_fault(&mut self, t: f64) {
        self.stage = Stage::During { since: t };
        self.result.speed = self.fastest();
        let c = self.lab.controller_mut();
        match self.fault.kind {
            FaultKind::ProtectiveStop => c.protect(StopReason::Asked),
            FaultKind::EmergencyStop => c.set_safety(SafetyMode::RobotEmergencyStop),
            FaultKind::SpeedSlider => c.set_speed_fraction(0.01),
            FaultKind::Slip => self.lab.make_slippery(0.5),
            FaultKind::Late => self.plans.clear(),
            _ => {}
        }
    }

    fn end_fault(&mut self) {
        let c = self.lab.controller_mut();
        match self.fault.kind {
            FaultKind::ProtectiveStop => {
                if let Err(e) = c.unlock() {
                    self.result.violations.push(format!("unlock: {e}"));
                }
            }
            FaultKind::EmergencyStop => {
                c.set_safety(SafetyMode::Normal);
                if c.power_on(true).is_err() {
                    self.result.violations.push("power on refused".into());
                }
            }
            FaultKind::SpeedSlider => c.set_speed_fraction(1.0),
            FaultKind::ControllerKilled => self.controller = new_controller(),
            FaultKind::DriverKilled => {
                self.driver = new_driver(&self.limits);
                self.heartbeat = self.rng.random_range(0..1000);
            }
            _ => {}
        }
    }

    /// The driver sends its program anew where none runs and the robot is ready; a latched fault of the
    /// driver is reset by the operator once the arm rests.
    fn operate(&mut self) {
        let c = self.lab.controller();
        let ready = c.robot_mode() == RobotMode::Running && c.safety_mode() == SafetyMode::Normal;
        let stopped = self.has(FaultKind::ProtectiveStop) || self.has(FaultKind::EmergencyStop);
        if ready && !c.program_running() && !stopped && self.fastest() < REST {
            self.lab.controller_mut().stop_program();
            self.upload();
        }
        if self.driver.fault().is_some() && self.fastest() < REST {
            self.driver.reset();
        }
    }

    /// One exchange between driver and robot.
    fn robot_cycle(&mut self) {
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

    fn poll_gripper(&mut self) {
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
    fn observe(&mut self) -> Result<(), SimulationError> {
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
            self.input.procedure = Some(ProcedureState { stamp, procedure, complete });
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
    fn deliver(&mut self) {
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

    fn control(&mut self) {
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

    /// The robot's own measure of what happens to it.
    fn judge(&mut self) {
        let (q, qd) = (*self.lab.joints().0, *self.lab.joints().1);
        let mut broken = |what: String| {
            let words = |s: &str| s.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
            if self.result.violations.iter().all(|v| words(v) != words(&what)) {
                self.result.violations.push(what);
            }
        };
        for i in 0..6 {
            if qd[i].abs() > ROOM * self.limits.joint_velocity {
                broken(format!("joint {i} at {:.2} rad/s", qd[i]));
            }
            let jolt = (qd[i] - self.last_qd[i]).abs() / DT;
            if jolt > JOLT {
                broken(format!("joint {i} accelerates by {jolt:.0} rad/s^2"));
            }
            if q[i] < self.limits.joint_lower[i] || q[i] > self.limits.joint_upper[i] {
                broken(format!("joint {i} at {:.2} rad", q[i]));
            }
        }
        let (speed, _) = self.arm.tcp_speed(&q, &qd);
        if speed > ROOM * self.limits.tcp_speed {
            broken(format!("tcp at {speed:.3} m/s"));
        }
        let height = self.lab.world().clearance();
        if height < 0.0 {
            broken(format!("{:.1} mm into the table", -1e3 * height));
        }
        match self.lab.controller().protective_stop() {
            None | Some(StopReason::Asked) => {}
            Some(reason) => broken(format!("the robot stopped itself: {reason:?}")),
        }
        self.last_qd = qd;
    }
}

fn new_controller() -> ArmController {
    let params = ControllerParams { auto_resume: true, ..Default::default() };
    match ArmController::new(Kinematics::ur5(), params) {
        Ok(controller) => controller,
        // The defaults are valid: a test of the robot crate says so.
        Err(problems) => unreachable!("{problems:?}"),
    }
}

fn new_driver(limits: &Limits) -> Motion {
    Motion::new(MotionParams { limits: limits.clone(), following: 0.25 })
}
