//! The switch_policy node.
fn main() {}
