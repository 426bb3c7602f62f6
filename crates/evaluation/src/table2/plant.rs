//! The robot's side of a trial: physics, the controller with the real servo program, driver, arm
//! controller, gripper, on simulated time. Nothing of it is made simpler than live; only the network
//! between the parts is replaced by stated delays.

use super::Table2Error;
use std::collections::VecDeque;
use std::sync::Arc;
use tdv_geometry::{Pose, Stamp};
use tdv_robot::collision::CollisionWorld;
use tdv_robot::executor::{Motion, MotionParams, RobotInput};
use tdv_robot::gripper::{knuckle_from_register, register_from_knuckle};
use tdv_robot::motion::{GripperFeedback, JointState, Requests, StatusCode};
use tdv_robot::{
    ArmController, ControllerInput, ControllerParams, JointTrajectory, Kinematics, Limits,
};
use tdv_simulation::controller::{RobotMode, SafetyMode};
use tdv_simulation::gripper::{Activation, GripperRequest as Registers, ObjectStatus};
use tdv_simulation::scene::Placement;
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::{Lab, LabAssets};
use tdv_ur_protocol::servo::{Command, ProgramState, ServoProgram};

/// Ticks of 2 ms between two exchanges with the robot (125 Hz) and between two polls of the gripper.
const CYCLE: u64 = 4;
const POLL: u64 = 15;
/// A trajectory reaches the driver after this long, s.
const TRANSPORT: f64 = 0.003;
/// Ticks that the gripper may take to become ready.
const ACTIVATION: u64 = 10_000;
/// Time zero of a trial; any will do that is not zero.
const ORIGIN: f64 = 1000.0;

/// What the arm controller said last.
#[derive(Debug, Clone, Default)]
pub(super) struct Word {
    pub code: Option<StatusCode>,
    pub sentence: String,
    pub held: bool,
    /// The switch policy is to go back to the first procedure, or (true) to the one that grasps.
    pub reset: Option<bool>,
}

pub(super) struct Plant {
    pub lab: Lab,
    pub input: ControllerInput,
    pub word: Word,
    /// How often the gripper was told to close.
    pub grips: u32,
    arm: Kinematics,
    controller: ArmController,
    driver: Motion,
    heartbeat: i32,
    trajectories: VecDeque<(f64, JointTrajectory)>,
    gripper_order: Option<(u32, u8)>,
    closed: bool,
    ticks: u64,
}

/// Start poses of all objects, the varied one where it shall be, and with it what stands on it.
fn starts(
    assets: &Arc<LabAssets>,
    seed: u64,
    (name, (x, y, yaw)): (&str, (f64, f64, f64)),
) -> Result<Vec<Pose>, Table2Error> {
    let drawn = Lab::from_assets(assets.clone(), seed)?;
    let mut poses: Vec<Pose> = drawn.objects().map(|(_, pose)| pose).collect();
    let scene = &assets.scene;
    let pose = &mut poses[scene.index_of(name)?];
    let turn = yaw - tdv_geometry::yaw_of(&pose.rotation);
    let about = tdv_geometry::nalgebra::Vector3::z_axis();
    pose.rotation =
        tdv_geometry::nalgebra::UnitQuaternion::from_axis_angle(&about, turn) * pose.rotation;
    (pose.translation.x, pose.translation.y) = (x, y);
    for (i, object) in scene.objects.iter().enumerate() {
        if let Placement::On(on) = &object.start {
            poses[i] = poses[scene.index_of(&on.object)?] * on.pose();
        }
    }
    Ok(poses)
}

impl Plant {
    /// A lab whose random choices follow from `seed`, with the gripper ready and the program running.
    /// `varied`: an object's name and its x, y (m) and yaw (rad). `world`: what the arm controller is told
    /// of its surroundings.
    pub fn new(
        assets: Arc<LabAssets>,
        seed: u64,
        goal: PlacingGoal,
        varied: (&str, (f64, f64, f64)),
        world: Option<CollisionWorld>,
    ) -> Result<Self, Table2Error> {
        let starts = starts(&assets, seed, varied)?;
        let mut lab = Lab::with_starts(assets, seed, &starts)?;
        lab.set_gripper_request(Registers { activate: true, ..Registers::default() });
        let script = ServoProgram::cb3().text().map_err(|e| Table2Error::Robot(e.to_string()))?;
        lab.controller_mut()
            .run_script(&script)
            .map_err(|e| Table2Error::Robot(format!("servo program: {e}")))?;
        for _ in 0..ACTIVATION {
            if lab.gripper_status().activation == Activation::Active {
                break;
            }
            lab.step();
        }
        lab.begin_trial(goal)?;
        let limits = Limits::default();
        // As in the lab's launch files: nobody is there to press a button.
        let params =
            ControllerParams { auto_resume: true, limits: limits.clone(), ..Default::default() };
        let mut controller = ArmController::new(Kinematics::ur5(), params)
            .map_err(|problems| Table2Error::Robot(problems.join("; ")))?;
        if let Some(world) = world {
            controller = controller.with_world(world);
        }
        Ok(Self {
            lab,
            input: ControllerInput::default(),
            word: Word::default(),
            grips: 0,
            arm: Kinematics::ur5(),
            controller,
            driver: Motion::new(MotionParams { limits, following: 0.25 }),
            heartbeat: 0,
            trajectories: VecDeque::new(),
            gripper_order: None,
            closed: false,
            ticks: 0,
        })
    }

    pub fn now(&self) -> Stamp {
        Stamp::from_secs(ORIGIN + self.lab.time())
    }

    /// `T_base_link_tcp` by the measured joints.
    pub fn tcp(&self) -> Pose {
        self.arm.fk_tcp(self.lab.joints().0)
    }

    /// 2 ms of everything.
    pub fn tick(&mut self) {
        self.lab.step();
        self.ticks += 1;
        if self.ticks.is_multiple_of(CYCLE) {
            self.exchange();
        }
        if self.ticks.is_multiple_of(POLL) {
            self.poll_gripper();
        }
        let time = self.lab.time();
        while self.trajectories.front().is_some_and(|t| t.0 <= time) {
            if let Some((_, trajectory)) = self.trajectories.pop_front() {
                // What the driver refuses it refuses; the arm then comes to rest by itself.
                let _ = self.driver.follow(&trajectory, self.now());
            }
        }
        // Half a cycle after the robot's state.
        if self.ticks % CYCLE == 2 {
            self.control();
        }
    }

    /// One exchange between driver and robot.
    fn exchange(&mut self) {
        let c = self.lab.controller();
        let (q, qd) = (*c.q(), *c.qd());
        let program = ProgramState::from_register(c.outputs().ints[24]);
        let safe = matches!(c.safety_mode(), SafetyMode::Normal | SafetyMode::Reduced);
        let runs = c.program_running() && program != Some(ProgramState::NotRunning);
        let may_move = runs && safe && c.robot_mode() == RobotMode::Running;
        let out = self.driver.step(&RobotInput {
            time: self.lab.time(),
            clock: self.now(),
            q,
            qd,
            may_move,
            watchdog: program == Some(ProgramState::WatchdogStop),
            factor: c.speed_scaling() * c.speed_fraction(),
            enabled: true,
        });
        self.heartbeat = self.heartbeat.wrapping_add(1);
        let command = if out.target.is_some() { Command::Servo } else { Command::Idle };
        let inputs = self.lab.controller_mut().inputs_mut();
        for (i, v) in out.target.unwrap_or(q).into_iter().enumerate() {
            inputs.write_double(24 + i, v);
        }
        inputs.write_int(24, command as i32);
        inputs.write_int(25, self.heartbeat);
        self.input.speed_scaling = self.driver.state().map_or(0.0, |s| s.scale);
        self.input.disabled = (!may_move).then(|| "the robot's program does not run".into());
        self.input.joints = Some(JointState { stamp: self.now(), q, qd });
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

    fn control(&mut self) {
        let out = self.controller.step(self.now(), &self.input);
        self.input.requests = Requests::default();
        self.word = Word {
            code: Some(out.status.code),
            sentence: out.status.sentence,
            held: out.status.object_held,
            reset: out.reset_switch.then_some(out.regrasp).or(self.word.reset),
        };
        if let Some(path) = &out.trajectory {
            self.trajectories.push_back((self.lab.time() + TRANSPORT, path.to_trajectory(true)));
        }
        if let Some(order) = out.gripper {
            let position = register_from_knuckle(order.position);
            let closes = position > 128;
            self.grips += u32::from(closes && !self.closed);
            self.closed = closes;
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use tdv_geometry::pose_distance;
    use tdv_simulation::Scene;

    #[test]
    fn what_stands_on_the_varied_object_goes_with_it() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes");
        let load = |name: &str| {
            let scene = Scene::load(&root.join(format!("{name}.yaml"))).unwrap();
            Arc::new(LabAssets::load(scene).unwrap())
        };
        let assets = load("insert_plug");
        let poses = starts(&assets, 3, ("socket", (0.4, 0.1, 0.5))).unwrap();
        let lab = Lab::with_starts(assets, 3, &poses).unwrap();
        let (socket, plug) = (lab.object_pose("socket").unwrap(), lab.object_pose("plug").unwrap());
        let parked = Pose::translation(-0.045, 0.0, 0.0202);
        assert!(pose_distance(&(socket.inverse() * plug), &parked).0 < 1e-5);
        assert!((tdv_geometry::yaw_of(&socket.rotation) - 0.5).abs() < 1e-5);

        let assets = load("pour_water");
        let poses = starts(&assets, 3, ("mug", (0.35, 0.2, 1.0))).unwrap();
        let lab = Lab::with_starts(assets, 3, &poses).unwrap();
        for drop in lab.world().drops() {
            assert!((drop.x - 0.35).hypot(drop.y - 0.2) < 0.03, "{drop}");
        }
    }
}
