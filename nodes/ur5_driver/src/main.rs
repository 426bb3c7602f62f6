//! UR5 and 2F-85 over their own protocols, with the ROS surface of ur_robot_driver.

mod arm;
mod arm_state;
mod broadcast;
mod controllers;
mod dashboard;
mod dashboard_services;
mod description;
mod gripper;
mod gripper_action;
mod gripper_link;
mod io_services;
mod node;
mod params;
mod program;
mod recovery;
mod serial;
mod settings;
mod state;
mod switching;
mod trajectory;
mod upload;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("ur5_driver", node::drive)
}
