//! Parameters of a node: defaults, files, command line, and live changes through `ros2 param`.

mod load;
mod server;
mod store;
mod tree;

pub(crate) use load::load;
pub use load::{ParameterError, load_params};
pub(crate) use server::serve;
pub(crate) use store::Store;

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;
use tokio::sync::watch;

/// A node's parameters: a serde struct whose fields are the ROS parameters. Nested structs become
/// dotted names, `Option` fields may be left unset.
pub trait Parameters:
    Serialize + DeserializeOwned + Default + Clone + Send + Sync + 'static
{
    /// Every problem with the values, each as a sentence that names the parameter. Empty when all
    /// is well.
    fn validate(&self) -> Vec<String> {
        Vec::new()
    }

    /// Dotted names (or prefixes of them) that may change while the node runs. All others are
    /// read-only after the start.
    fn live() -> &'static [&'static str] {
        &[]
    }

    /// What `ros2 param describe` says about a dotted name.
    fn describe(_name: &str) -> &'static str {
        ""
    }
}

/// For nodes without parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, serde::Deserialize)]
pub struct NoParameters {}

impl Parameters for NoParameters {}

/// The current parameter values, shared with the parameter services.
#[derive(Clone, Debug)]
pub struct Params<P> {
    receiver: watch::Receiver<Arc<P>>,
}

impl<P> Params<P> {
    pub(crate) fn new(receiver: watch::Receiver<Arc<P>>) -> Self {
        Self { receiver }
    }

    /// The values now. Cheap: one reference count.
    pub fn get(&self) -> Arc<P> {
        self.receiver.borrow().clone()
    }

    /// Waits for the next change and returns the new values; never returns once the node is gone.
    pub async fn changed(&mut self) -> Arc<P> {
        if self.receiver.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
        self.receiver.borrow_and_update().clone()
    }
}
