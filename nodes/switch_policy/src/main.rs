//! Decides which procedure of the task is on.

mod node;
mod params;

fn main() -> std::process::ExitCode {
    tdv_runtime::run("switch_policy", node::decide)
}
