//! The ur5_driver node.
fn main() {}
