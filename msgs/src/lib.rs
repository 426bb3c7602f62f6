//! Rust types of every ROS 2 interface that the graph uses, generated at build time from the
//! interface text in `interfaces/` (standard packages) and `tdv_msgs/` (our own).
//!
//! `tdv_msgs::<package>::msg::<Type>` is the message, `tdv_msgs::<package>::srv::<Type>` names a
//! service ([`RosService`]) with `<Type>Request` and `<Type>Response`, and
//! `tdv_msgs::<package>::action::<Type>` names an action ([`RosAction`]) with `<Type>Goal`,
//! `<Type>Result` and `<Type>Feedback`. Field order is the wire order. Sequences of octets are
//! `Vec<u8>` moved as one block.

mod cdr;
#[cfg(test)]
#[path = "../codegen/mod.rs"]
#[allow(dead_code)] // the tests call the parser only
mod codegen;
mod raw;
mod wire;

pub use cdr::{CdrError, from_cdr_bytes, to_cdr_bytes};
pub use raw::RawMessage;

use std::fmt::Debug;

include!(concat!(env!("OUT_DIR"), "/interfaces.rs"));

/// A message type that can be published.
pub trait RosMessage:
    ros2_client::Message + Clone + Debug + Default + PartialEq + Send + Sync + 'static
{
    /// Package, e.g. `geometry_msgs`.
    const PACKAGE: &'static str;
    /// Type without package, e.g. `PoseStamped`.
    const NAME: &'static str;
    /// e.g. `geometry_msgs/msg/PoseStamped`.
    const FULL_NAME: &'static str;
    /// The `ros2msg` schema text: the definition and all definitions that it needs.
    const SCHEMA: &'static str;

    /// [`Self::SCHEMA`], for bags.
    fn schema() -> &'static str {
        Self::SCHEMA
    }
}

/// A service type.
pub trait RosService: Send + Sync + 'static {
    /// What the client sends.
    type Request: ros2_client::Message + Clone + Debug + Default + Send + Sync + 'static;
    /// What the server answers.
    type Response: ros2_client::Message + Clone + Debug + Default + Send + Sync + 'static;
    /// Package, e.g. `std_srvs`.
    const PACKAGE: &'static str;
    /// Type without package, e.g. `Trigger`.
    const NAME: &'static str;
}

/// An action type.
pub trait RosAction: Send + Sync + 'static {
    /// What the client asks for.
    type Goal: ros2_client::Message + Clone + Debug + Default + Send + Sync + 'static;
    /// How it ended.
    type Result: ros2_client::Message + Clone + Debug + Default + Send + Sync + 'static;
    /// How it goes.
    type Feedback: ros2_client::Message + Clone + Debug + Default + Send + Sync + 'static;
    /// Package, e.g. `control_msgs`.
    const PACKAGE: &'static str;
    /// Type without package, e.g. `GripperCommand`.
    const NAME: &'static str;
}

/// The `ros2msg` schema text of a message by its full name, e.g. `sensor_msgs/msg/Image`.
pub fn schema_of(full_name: &str) -> Option<&'static str> {
    SCHEMAS.iter().find(|(name, _)| *name == full_name).map(|(_, schema)| *schema)
}

/// Full names of all message types known to this crate, sorted.
pub fn message_types() -> impl Iterator<Item = &'static str> {
    SCHEMAS.iter().map(|(name, _)| *name)
}

#[cfg(test)]
mod tests;
