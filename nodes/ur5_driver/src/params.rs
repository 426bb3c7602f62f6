use serde::{Deserialize, Serialize};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use tdv_robot::{Limits, LimitsError};
use tdv_runtime::Parameters;
use tdv_ur_protocol::{GRIPPER_PORT, RTDE_PORT};

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriverParameters {
    pub robot_ip: String,
    pub rtde_port: u16,
    pub gripper_port: u16,
    pub frequency: f64,
    pub controller_name: String,
    pub gripper_controller_name: String,
    pub gripper_speed: i64,
    pub gripper_force: i64,
    pub limits_file: String,
}

impl Default for DriverParameters {
    fn default() -> Self {
        Self {
            robot_ip: "127.0.0.1".into(),
            rtde_port: RTDE_PORT,
            gripper_port: GRIPPER_PORT,
            frequency: 125.0,
            controller_name: "scaled_joint_trajectory_controller".into(),
            gripper_controller_name: "robotiq_gripper_controller".into(),
            gripper_speed: 128,
            gripper_force: 60,
            limits_file: String::new(),
        }
    }
}

impl DriverParameters {
    /// Limits of the file, or the built-in ones.
    pub fn limits(&self) -> Result<Limits, LimitsError> {
        let file = self.limits_file.as_str();
        if file.is_empty() { Ok(Limits::default()) } else { Limits::load(Path::new(file)) }
    }

    /// Address of a port of the robot; the parameters have been validated.
    pub fn address(&self, port: u16) -> SocketAddr {
        SocketAddr::new(self.robot_ip.parse().unwrap_or(IpAddr::from([127, 0, 0, 1])), port)
    }
}

impl Parameters for DriverParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.robot_ip.parse::<IpAddr>().is_err() {
            problems.push(format!("'robot_ip' is {:?}: not an IP address", self.robot_ip));
        }
        if !(self.frequency >= 1.0 && self.frequency <= 500.0) {
            problems.push(format!("'frequency' is {}: 1 to 500 Hz", self.frequency));
        }
        for (name, value) in
            [("gripper_speed", self.gripper_speed), ("gripper_force", self.gripper_force)]
        {
            if !(0..=255).contains(&value) {
                problems.push(format!("'{name}' is {value}: 0 to 255"));
            }
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "robot_ip" => "address of the controller (the virtual lab: 127.0.0.1)",
            "frequency" => "RTDE packages per second: 125 for CB3, 500 for e-Series",
            "controller_name" => "name under which joint trajectories are taken",
            "gripper_controller_name" => "name of the gripper's action controller",
            "limits_file" => {
                "limits of the motion (config/robot/limits.yaml); '' for the built-in ones"
            }
            "gripper_speed" => "finger speed, 0..255 of 20..150 mm/s",
            "gripper_force" => "grip force, 0..255 of 20..235 N",
            _ => "",
        }
    }
}
