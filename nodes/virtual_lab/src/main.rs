//! The virtual_lab node.
fn main() {}
