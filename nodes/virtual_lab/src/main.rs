//! The virtual lab: arm, gripper, objects and camera behind real sockets and camera topics.

mod camera;
mod node;
mod params;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("virtual_lab", node::simulate)
}
