//! The perception_bridge node.
fn main() {}
