//! UR5 and 2F-85 over their own protocols, with the ROS surface of ur_robot_driver.

mod arm;
mod gripper;
mod node;
mod params;
mod state;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("ur5_driver", node::drive)
}
