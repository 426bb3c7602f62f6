//! One case: all parts, and what lies between them.

mod judge;
mod links;
mod trouble;

use super::fault::{Fault, FaultKind};
use super::{CaseResult, planner};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::sync::Arc;
use tdv_geometry::Stamp;
use tdv_robot::executor::{Motion, MotionParams};
use tdv_robot::motion::{Plan, StatusCode};
use tdv_robot::{
    ArmController, ControllerInput, ControllerParams, JointTrajectory, Kinematics, Limits,
};
use tdv_simulation::gripper::{Activation, GripperRequest as Registers};
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::{Lab, LabAssets, SimulationError};
use tdv_ur_protocol::servo::ServoProgram;

/// Ticks of 2 ms between two looks at the robot, two frames of the camera, two polls of the gripper.
const CYCLE: u64 = 4;
const FRAME: u64 = 17;
const POLL: u64 = 15;
/// A case is given up after this time, s.
const PATIENCE: f64 = 80.0;
/// Joint speeds (rad/s) of an arm that moves well, and of one at rest.
const MOVING: f64 = 0.1;
const REST: f64 = 0.01;

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
            carrying: None,
            helped: None,
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
