//! Launch files in ROS 2's YAML form, read without a ROS installation, and the processes they start.

mod file;
mod process;
mod substitution;

pub use file::{LaunchError, LaunchFile, NodeCommand};
pub use process::{Launched, NodeExit, StartOptions};
