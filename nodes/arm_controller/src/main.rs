//! Plans of the policy in, short joint trajectories that end at rest out, and the gripper's sequence.

mod controllers;
mod gripper;
mod inputs;
mod node;
mod params;
mod permissions;
mod safety;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("arm_controller", node::control)
}
