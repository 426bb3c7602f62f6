//! All pixel work: colour and depth images in, object poses in the camera frame out.

mod camera;
mod frames;
mod node;
mod params;
mod picture;
mod remote;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("perception_bridge", node::perceive)
}
