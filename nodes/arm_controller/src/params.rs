use serde::{Deserialize, Serialize};
use std::path::Path;
use tdv_robot::collision::{CollisionWorld, Margins, Workcell};
use tdv_robot::urdf::RobotModel;
use tdv_robot::{Calibration, CalibrationError, ControllerParams, Kinematics};
use tdv_runtime::Parameters;

/// What the driver is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// Short joint trajectories that end at rest.
    Trajectory,
    /// Joint positions at every tick.
    ForwardPosition,
}

/// Type of the gripper's action.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GripperAction {
    /// Of gripper_controllers.
    GripperCommand,
    /// Of parallel_gripper_controller.
    ParallelGripperCommand,
}

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmParameters {
    pub robot: String,
    pub calibration_file: String,
    pub limits_file: String,
    pub robot_description: String,
    pub workcell: String,
    pub command: Command,
    pub trajectory_controller: String,
    pub forward_controller: String,
    pub gripper_controller: String,
    pub gripper_action: GripperAction,
    pub controller_manager: String,
    pub require_program: bool,
    pub unlock_protective_stop: bool,
    pub enable_topic: String,
    pub enable_timeout: f64,
    pub stamp_trajectories: bool,
    pub grasp_offset: Vec<f64>,
    pub control: ControllerParams,
}

impl Default for ArmParameters {
    fn default() -> Self {
        Self {
            robot: "ur5".into(),
            calibration_file: String::new(),
            limits_file: String::new(),
            robot_description: String::new(),
            workcell: String::new(),
            command: Command::Trajectory,
            trajectory_controller: "scaled_joint_trajectory_controller".into(),
            forward_controller: "forward_position_controller".into(),
            gripper_controller: "robotiq_gripper_controller".into(),
            gripper_action: GripperAction::GripperCommand,
            controller_manager: "/controller_manager".into(),
            require_program: true,
            unlock_protective_stop: false,
            enable_topic: String::new(),
            enable_timeout: 0.5,
            stamp_trajectories: true,
            grasp_offset: vec![0.0; 3],
            control: ControllerParams::default(),
        }
    }
}

impl ArmParameters {
    /// The arm: as its maker drew it, or as this one was measured.
    pub fn kinematics(&self) -> Result<Kinematics, CalibrationError> {
        let nominal = if self.robot == "ur5e" { Kinematics::ur5e() } else { Kinematics::ur5() };
        match self.calibration_file.as_str() {
            "" => Ok(nominal),
            path => nominal.with_calibration(Calibration::load(Path::new(path))?),
        }
    }

    /// What the arm may run into, when a description is given.
    pub fn world(&self) -> anyhow::Result<Option<CollisionWorld>> {
        if self.robot_description.is_empty() {
            return Ok(None);
        }
        let model = RobotModel::load(Path::new(&self.robot_description))?;
        let cell = match self.workcell.as_str() {
            "" => Workcell::default(),
            path => Workcell::load(Path::new(path))?,
        };
        let limits = &self.control.limits;
        Ok(Some(CollisionWorld::new(&model, &cell, Margins::of(limits), limits.table_z)?))
    }

    /// The controller that moves the arm.
    pub fn motion_controller(&self) -> &str {
        match self.command {
            Command::Trajectory => &self.trajectory_controller,
            Command::ForwardPosition => &self.forward_controller,
        }
    }
}

impl Parameters for ArmParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = self.control.validate().err().unwrap_or_default();
        if !["ur5", "ur5e"].contains(&self.robot.as_str()) {
            problems.push(format!("'robot' is {:?}: ur5 or ur5e", self.robot));
        }
        if self.grasp_offset.len() != 3 || self.grasp_offset.iter().any(|v| v.abs() > 0.1) {
            problems.push("'grasp_offset' must be x, y, z within 0.1 m".into());
        }
        if !(self.enable_timeout > 0.0 && self.enable_timeout <= 10.0) {
            problems.push(format!("'enable_timeout' is {}: 0 to 10 s", self.enable_timeout));
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "robot" => "ur5 (CB3) or ur5e",
            "calibration_file" => {
                "what ur_calibration wrote for this very arm; empty: the nominal arm"
            }
            "limits_file" => {
                "limits of the motion (config/robot/limits.yaml), instead of those under control"
            }
            "trajectory_controller" => "controller that takes the joint trajectories",
            "gripper_controller" => "controller that offers the gripper action",
            "robot_description" => {
                "URDF of arm and gripper with collision shapes; empty: only the table is known"
            }
            "workcell" => "what stands in the arm's reach (config/robot/workcell.yaml)",
            "command" => {
                "trajectory: short trajectories that end at rest; forward_position: positions at each \
                 tick, which a driver may hold for ever when this node dies"
            }
            "forward_controller" => "controller that takes joint positions",
            "controller_manager" => {
                "node that switches controllers; empty: the right one is active without asking"
            }
            "enable_topic" => "std_msgs/Bool of a dead-man switch; empty for none",
            "enable_timeout" => "silence (s) after which the dead-man switch counts as released",
            "stamp_trajectories" => {
                "say when a trajectory begins; false where the driver runs by another clock"
            }
            "control.dry_run" => {
                "everything but motion; what would go out is on ~/dry_run/joint_trajectory"
            }
            "gripper_action" => "gripper_command or parallel_gripper_command, as the driver has it",
            "require_program" => "move only while robot_program_running is true",
            "unlock_protective_stop" => {
                "end a protective stop by itself after 5.5 s (set_mode); only for the lab"
            }
            "grasp_offset" => {
                "control experiment: shifts all reach plans by x, y, z (m, base_link)"
            }
            "control.auto_resume" => "go on by itself after a stop; only for the lab",
            "control.lookahead" => "seconds ahead on the plan, makes up for the lag of the servo",
            _ => "",
        }
    }
}
