use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use tdv_runtime::Parameters;
use tdv_simulation::controller::Generation;
use tdv_simulation::ur_server::{PRIMARY_PORT, REALTIME_PORT, SECONDARY_PORT};
use tdv_ur_protocol::{DASHBOARD_PORT, GRIPPER_PORT, RTDE_PORT};

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LabParameters {
    pub scene: String,
    pub controller: String,
    pub seed: i64,
    pub address: String,
    pub rtde_port: u16,
    pub gripper_port: u16,
    pub dashboard_port: u16,
    pub primary_port: u16,
    pub secondary_port: u16,
    pub realtime_port: u16,
    pub goal_yaw: f64,
    pub goal_offset: Vec<f64>,
    pub disturb: bool,
    pub drop: bool,
    pub camera: bool,
    pub thread_priority: u8,
}

impl Default for LabParameters {
    fn default() -> Self {
        Self {
            scene: "config/scenes/cup_on_coaster.yaml".into(),
            controller: "scene".into(),
            seed: 1,
            address: "127.0.0.1".into(),
            rtde_port: RTDE_PORT,
            gripper_port: GRIPPER_PORT,
            dashboard_port: DASHBOARD_PORT,
            primary_port: PRIMARY_PORT,
            secondary_port: SECONDARY_PORT,
            realtime_port: REALTIME_PORT,
            goal_yaw: 0.0,
            goal_offset: vec![0.0, 0.0],
            disturb: false,
            drop: false,
            camera: true,
            thread_priority: 50,
        }
    }
}

impl LabParameters {
    /// The controller that is asked for instead of the scene's; `validate` refuses other words.
    pub fn generation(&self) -> Option<Generation> {
        Generation::of(&self.controller)
    }
}

impl Parameters for LabParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.address.parse::<IpAddr>().is_err() {
            problems.push(format!("'address' is {:?}: not an IP address", self.address));
        }
        if self.controller != "scene" && self.generation().is_none() {
            problems.push(format!(
                "'controller' is {:?}: cb3, e_series, or scene: as the scene says",
                self.controller
            ));
        }
        if self.thread_priority > 99 {
            problems.push(format!("'thread_priority' is {}: 0 to 99", self.thread_priority));
        }
        if self.seed < 0 {
            problems.push(format!("'seed' is {}: 0 or more", self.seed));
        }
        if self.goal_offset.len() != 2 || !self.goal_offset.iter().all(|v| v.is_finite()) {
            problems.push("'goal_offset' must be two numbers (m)".into());
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "scene" => "scene file",
            "controller" => "cb3 (125 Hz) or e_series (500 Hz); scene: as the scene says",
            "seed" => "draws start poses, noise, light and what the robot is told wrongly",
            "address" => "address of the simulated controller's servers; loopback",
            "goal_yaw" => "demonstrated yaw of the object in the reference frame (rad)",
            "goal_offset" => "demonstrated place of the object in the reference frame (m)",
            "disturb" => "displace an object by 5 to 10 cm in mid-run",
            "drop" => "the grip fails once, soon after the lift",
            "thread_priority" => {
                "SCHED_FIFO priority of physics and controller (1 to 99); 0: ordinary"
            }
            "camera" => "render and publish the camera",
            _ => "",
        }
    }
}
