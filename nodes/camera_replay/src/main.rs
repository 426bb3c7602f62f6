//! The camera_replay node.
fn main() {}
