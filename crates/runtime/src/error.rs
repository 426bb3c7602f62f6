//! What can go wrong while a node is set up.

use crate::names::NameError;

/// A node, topic or service that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// A name that ROS does not allow.
    #[error(transparent)]
    Name(#[from] NameError),
    /// `ROS_DOMAIN_ID` and its kind.
    #[error("environment variable {name}={value:?} is not valid: {reason}")]
    Environment {
        /// Variable.
        name: &'static str,
        /// Its value.
        value: String,
        /// What is wrong.
        reason: String,
    },
    /// The participant could not be made, for example because all ports of the domain are in use.
    #[error(
        "cannot join ROS domain {domain}: {reason} (is the domain full or the network down? another ROS_DOMAIN_ID may help)"
    )]
    Join {
        /// Domain number.
        domain: u16,
        /// What the middleware says.
        reason: String,
    },
    /// A topic, service or action could not be made.
    #[error("cannot create {what} {name:?}: {reason}")]
    Create {
        /// Publisher, subscription, ...
        what: &'static str,
        /// Name in the graph.
        name: String,
        /// What the middleware says.
        reason: String,
    },
    /// The node has been shut down.
    #[error("the node is shut down: cannot create {what} {name:?}")]
    Gone {
        /// Publisher, subscription, ...
        what: &'static str,
        /// Name in the graph.
        name: String,
    },
}
