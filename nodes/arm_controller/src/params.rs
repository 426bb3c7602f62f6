use serde::{Deserialize, Serialize};
use tdv_robot::ControllerParams;
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmParameters {
    pub robot: String,
    pub limits_file: String,
    pub trajectory_controller: String,
    pub gripper_controller: String,
    pub require_program: bool,
    pub grasp_offset: Vec<f64>,
    pub control: ControllerParams,
}

impl Default for ArmParameters {
    fn default() -> Self {
        Self {
            robot: "ur5".into(),
            limits_file: String::new(),
            trajectory_controller: "scaled_joint_trajectory_controller".into(),
            gripper_controller: "robotiq_gripper_controller".into(),
            require_program: true,
            grasp_offset: vec![0.0; 3],
            control: ControllerParams::default(),
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
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "robot" => "ur5 (CB3) or ur5e",
            "limits_file" => {
                "limits of the motion (config/robot/limits.yaml), instead of those under control"
            }
            "trajectory_controller" => "controller that takes the joint trajectories",
            "gripper_controller" => "controller that offers the gripper action",
            "require_program" => "move only while robot_program_running is true",
            "grasp_offset" => {
                "control experiment: shifts all reach plans by x, y, z (m, base_link)"
            }
            "control.auto_resume" => "go on by itself after a stop; only for the lab",
            "control.lookahead" => "seconds ahead on the plan, makes up for the lag of the servo",
            _ => "",
        }
    }
}
