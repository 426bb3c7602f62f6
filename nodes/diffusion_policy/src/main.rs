//! Predicts where the moving frame shall go: history + procedure -> future poses, on every observation.

mod node;
mod params;

fn main() -> std::process::ExitCode {
    tdv_policy::tune_allocator();
    tdv_runtime::run("diffusion_policy", node::predict)
}
