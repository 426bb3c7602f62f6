//! Ending a node: by signal, by its own work, or by a failure.

use std::sync::Arc;
use tokio::sync::watch;

/// Why the node ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// SIGINT or SIGTERM, or the work is done: exit code 0.
    Asked(String),
    /// Something broke: exit code 1.
    Failed(String),
}

/// Tells every task that the node ends. Cloning is cheap; the first reason counts.
#[derive(Clone, Debug)]
pub struct Shutdown {
    sender: Arc<watch::Sender<Option<Reason>>>,
}

impl Default for Shutdown {
    fn default() -> Self {
        Self { sender: Arc::new(watch::channel(None).0) }
    }
}

impl Shutdown {
    /// Asks for a normal end.
    pub fn request(&self, why: impl Into<String>) {
        self.end(Reason::Asked(why.into()));
    }

    /// Asks for an end with exit code 1.
    pub fn fail(&self, why: impl Into<String>) {
        self.end(Reason::Failed(why.into()));
    }

    fn end(&self, reason: Reason) {
        self.sender.send_if_modified(|slot| {
            let first = slot.is_none();
            if first {
                *slot = Some(reason);
            }
            first
        });
    }

    /// True once the end was asked for: for loops in threads.
    pub fn is_requested(&self) -> bool {
        self.sender.borrow().is_some()
    }

    /// Why, once the end was asked for.
    pub fn reason(&self) -> Option<Reason> {
        self.sender.borrow().clone()
    }

    /// Waits until the end is asked for.
    pub async fn wait(&self) -> Reason {
        let mut receiver = self.sender.subscribe();
        loop {
            if let Some(reason) = receiver.borrow_and_update().clone() {
                return reason;
            }
            // The sender lives in `self`, so there is no error to handle.
            let _ = receiver.changed().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_first_reason_counts() {
        let shutdown = Shutdown::default();
        assert!(!shutdown.is_requested());
        let waiter = tokio::spawn({
            let shutdown = shutdown.clone();
            async move { shutdown.wait().await }
        });
        shutdown.fail("broken");
        shutdown.request("too late");
        assert_eq!(waiter.await.expect("ends"), Reason::Failed("broken".into()));
        assert_eq!(shutdown.wait().await, Reason::Failed("broken".into()));
    }
}
