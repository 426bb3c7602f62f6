//! Everything about ROS 2 that the nodes need, so that no other library has to know it: arguments,
//! parameters, names, quality of service, topics, services, actions, clock, diagnostics, logging and
//! a clean end. See README.md for how to write a node.

mod action;
mod action_client;
mod args;
pub mod camera_bag;
mod clock;
mod context;
pub mod convert;
mod diagnostics;
mod error;
mod farewell;
mod graph;
pub mod host;
mod inbox;
pub mod launch;
mod logging;
mod matcher;
mod names;
mod node;
mod parameters;
mod qos;
pub mod realtime;
pub mod record;
mod run;
mod service;
mod shutdown;
mod topics;
pub mod tracked;
pub mod trial;

pub use action::{Goal, GoalEnd};
pub use action_client::{ActionClient, ActionError, GoalTicket};
pub use args::{ArgumentError, Arguments, Assignment, Remap, Usage};
pub use clock::Clock;
pub use context::{DiscoveryRange, Environment};
pub use diagnostics::{Diagnostics, LatencySummary, LatencyWindow, Level, process_usage};
pub use error::RuntimeError;
pub use graph::{Endpoint, Graph, GraphObserver, TopicInfo};
pub use inbox::{Inbox, Sender, inbox};
pub use logging::init as init_logging;
pub use matcher::StampMatcher;
pub use names::{NameError, Resolver};
pub use node::Node;
pub use parameters::{NoParameters, ParameterError, Parameters, Params, load_params};
pub use qos::{Qos, QosError};
pub use run::{parameter_table, run, run_with};
pub use service::{CallError, ServiceClient};
pub use shutdown::{Reason, Shutdown};
pub use topics::Publisher;

use convert::time_from_stamp as convert_time;
