//! The arm_controller node.
fn main() {}
