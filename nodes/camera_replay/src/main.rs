//! Replays a recorded bag onto the graph: in its own time, faster or slower, looped, or in lockstep
//! with the nodes that answer each frame.

mod frames;
mod node;
mod params;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("camera_replay", node::replay)
}
