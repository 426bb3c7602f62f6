//! The dashboard server (TCP 29999): its commands and answers, and the way back from any stop.

mod client;
mod recovery;

pub use client::{
    Answer, MAX_ARGUMENT, ROBOT_MODES, Request, SAFETY_MODES, robot_mode_name, safety_mode_name,
};
pub use recovery::{Recovery, RobotStatus, Step, UNLOCK_AFTER};

/// Sent by the server on connection.
pub const GREETING: &str = "Connected: Universal Robots Dashboard Server";
