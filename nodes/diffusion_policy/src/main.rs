//! The diffusion_policy node.
fn main() {}
