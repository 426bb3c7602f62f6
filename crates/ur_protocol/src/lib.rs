//! Wire protocols of a Universal Robots controller and a Robotiq 2F-85, free of sockets and clocks:
//! bytes in, typed packages out. The driver uses one half, the virtual lab the other.
//!
//! Sources: "Real-Time Data Exchange (RTDE) Guide" (Universal Robots), Robotiq 2F-85 instruction
//! manual (socket interface of the URCap, port 63352), UR dashboard server manual.

pub mod dashboard;
pub mod gripper;
pub mod modbus;
pub mod rtde;
pub mod script;
pub mod servo;

use thiserror::Error;

/// TCP port of the dashboard server.
pub const DASHBOARD_PORT: u16 = 29999;
/// TCP port of the RTDE interface.
pub const RTDE_PORT: u16 = 30004;
/// TCP port of the Robotiq URCap's socket server.
pub const GRIPPER_PORT: u16 = 63352;

/// What can be wrong with received bytes or with what is to be sent.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ProtocolError {
    /// An RTDE package that states a size below its header or above [`rtde::MAX_PACKAGE`].
    #[error("RTDE package of {size} bytes; 3 to {max} are possible: the peer does not speak RTDE")]
    PackageSize {
        /// The stated size.
        size: usize,
        /// The largest one.
        max: usize,
    },
    /// A package type nobody sends.
    #[error("unknown RTDE package type {0}")]
    PackageType(u8),
    /// A package that ends before its fields do.
    #[error("RTDE package {kind} is too short: {have} bytes, {need} needed")]
    Truncated {
        /// Which package.
        kind: &'static str,
        /// Bytes there.
        have: usize,
        /// Bytes needed.
        need: usize,
    },
    /// A field name or type that the other side does not know.
    #[error("RTDE field `{field}`: {reason}")]
    Field {
        /// The field.
        field: String,
        /// Why it is refused.
        reason: String,
    },
    /// A recipe id that was never set up.
    #[error("RTDE data for recipe {0}, which was never set up")]
    Recipe(u8),
    /// Values that do not fit the recipe.
    #[error("{have} values for a recipe of {need} fields")]
    ValueCount {
        /// Values given.
        have: usize,
        /// Fields of the recipe.
        need: usize,
    },
    /// A line that the gripper protocol does not have.
    #[error("gripper line `{0}` is not understood")]
    GripperLine(String),
    /// A text that would not stay on its line.
    #[error("`{0}` cannot be sent: one line of 1 to 200 characters is possible")]
    Argument(String),
    /// A line without an end, or a text that is not ASCII.
    #[error("text line longer than {0} bytes, or not ASCII")]
    Line(usize),
}
