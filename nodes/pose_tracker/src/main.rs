//! The pose_tracker node.
fn main() {}
