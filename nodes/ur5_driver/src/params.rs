use crate::gripper_link::GripperAddress;
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use tdv_robot::{Limits, LimitsError};
use tdv_runtime::Parameters;
use tdv_ur_protocol::script::SECONDARY_PORT;
use tdv_ur_protocol::servo::ServoProgram;
use tdv_ur_protocol::{DASHBOARD_PORT, GRIPPER_PORT, RTDE_PORT};

/// Type of the gripper's action.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GripperAction {
    /// `control_msgs/action/GripperCommand`: Humble and Jazzy.
    GripperCommand,
    /// `control_msgs/action/ParallelGripperCommand`: later.
    ParallelGripperCommand,
}

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DriverParameters {
    pub robot_ip: String,
    pub rtde_port: u16,
    pub dashboard_port: u16,
    pub script_port: u16,
    pub gripper_port: u16,
    pub gripper_device: String,
    pub frequency: f64,
    pub thread_priority: u8,
    pub headless: bool,
    pub keep_program: bool,
    pub servoj_gain: f64,
    pub servoj_lookahead_time: f64,
    pub payload: f64,
    pub payload_center: Vec<f64>,
    pub tcp_offset: Vec<f64>,
    pub controller_name: String,
    pub following_error: f64,
    pub enable_required: bool,
    pub limits_file: String,
    pub description_file: String,
    pub gripper_controller_name: String,
    pub gripper_action: GripperAction,
    pub gripper_speed: i64,
    pub gripper_force: i64,
}

impl Default for DriverParameters {
    fn default() -> Self {
        let program = ServoProgram::cb3();
        Self {
            robot_ip: "127.0.0.1".into(),
            rtde_port: RTDE_PORT,
            dashboard_port: DASHBOARD_PORT,
            script_port: SECONDARY_PORT,
            gripper_port: GRIPPER_PORT,
            gripper_device: String::new(),
            frequency: 0.0,
            thread_priority: 50,
            headless: true,
            keep_program: false,
            servoj_gain: program.gain,
            servoj_lookahead_time: program.lookahead,
            payload: program.payload,
            payload_center: program.center_of_gravity.to_vec(),
            tcp_offset: program.tcp.to_vec(),
            controller_name: "scaled_joint_trajectory_controller".into(),
            following_error: 0.25,
            enable_required: false,
            limits_file: String::new(),
            description_file: String::new(),
            gripper_controller_name: "robotiq_gripper_controller".into(),
            gripper_action: GripperAction::GripperCommand,
            gripper_speed: 128,
            gripper_force: 60,
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

    /// Where the gripper is: its serial line if one is named.
    pub fn gripper_address(&self) -> GripperAddress {
        if self.gripper_device.is_empty() {
            GripperAddress::Socket(self.address(self.gripper_port))
        } else {
            GripperAddress::Modbus(self.gripper_device.clone())
        }
    }

    /// The servo program; lists of a wrong length keep its defaults, but `validate` refuses them.
    pub fn program(&self) -> ServoProgram {
        let default = ServoProgram::cb3();
        ServoProgram {
            gain: self.servoj_gain,
            lookahead: self.servoj_lookahead_time,
            payload: self.payload,
            tcp: self.tcp_offset[..].try_into().unwrap_or(default.tcp),
            center_of_gravity: self.payload_center[..]
                .try_into()
                .unwrap_or(default.center_of_gravity),
            ..default
        }
    }
}

impl Parameters for DriverParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.robot_ip.parse::<IpAddr>().is_err() {
            problems.push(format!("'robot_ip' is {:?}: not an IP address", self.robot_ip));
        }
        if self.thread_priority > 99 {
            problems.push(format!("'thread_priority' is {}: 0 to 99", self.thread_priority));
        }
        if self.frequency != 0.0 && !(1.0..=500.0).contains(&self.frequency) {
            problems.push(format!("'frequency' is {}: 0 or 1 to 500 Hz", self.frequency));
        }
        if !(0.05..=1.0).contains(&self.following_error) {
            problems.push(format!("'following_error' is {}: 0.05 to 1 rad", self.following_error));
        }
        for (name, list, count) in
            [("payload_center", &self.payload_center, 3), ("tcp_offset", &self.tcp_offset, 6)]
        {
            if list.len() != count {
                problems.push(format!("'{name}' has {} numbers: {count} are needed", list.len()));
            }
        }
        if let Err(error) = self.program().text() {
            problems.push(error.to_string());
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
            "script_port" => "where URScript is sent: 30002, or 30003",
            "frequency" => "RTDE packages per second; 0: 125 on a CB3, 500 on an e-Series",
            "thread_priority" => "SCHED_FIFO priority of the robot's thread (1 to 99); 0: ordinary",
            "headless" => "send the servo program; false: somebody plays it on the robot",
            "keep_program" => "send it again also after somebody has stopped it",
            "servoj_gain" => "gain of servoj, 100..2000",
            "servoj_lookahead_time" => "look-ahead time of servoj (s), 0.03..0.2",
            "payload" => "mass at the flange (kg)",
            "payload_center" => "its centre of gravity in the flange (m)",
            "tcp_offset" => "tool centre point in the flange (m, rotation vector); 0: tool0",
            "controller_name" => "name under which joint trajectories are taken",
            "following_error" => "greatest distance of target and arm while moving (rad)",
            "enable_required" => "move only while ~/enable (std_msgs/Bool) says true, every 0.5 s",
            "limits_file" => {
                "limits of the motion (config/robot/limits.yaml); '' for the built-in ones"
            }
            "description_file" => "URDF for /robot_description and the links' /tf; '' for none",
            "gripper_controller_name" => "name of the gripper's action controller",
            "gripper_action" => "gripper_command, or parallel_gripper_command",
            "gripper_device" => "serial device of the gripper (Modbus RTU); '' for its socket",
            "gripper_speed" => "finger speed, 0..255 of 20..150 mm/s",
            "gripper_force" => "grip force, 0..255 of 20..235 N",
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_good_and_problems_are_named() {
        assert!(DriverParameters::default().validate().is_empty());
        let bad = DriverParameters {
            robot_ip: "ur5".into(),
            servoj_gain: 5000.0,
            tcp_offset: vec![0.0; 3],
            following_error: f64::NAN,
            ..Default::default()
        };
        assert_eq!(bad.validate().len(), 4, "{:?}", bad.validate());
    }
}
