//! One pose per object, from detections, the tool's pose and whether something is held. No pixels.

mod messages;
mod node;
mod params;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("pose_tracker", node::track)
}
