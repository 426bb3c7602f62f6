//! Publishers and subscriptions.

use crate::diagnostics::TopicCounters;
use crate::inbox::Sender;
use futures::StreamExt;
use ros2_client::Message;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Publishes messages of one topic. Any thread may use it through a shared reference.
pub struct Publisher<M: Message> {
    pub(crate) inner: ros2_client::Publisher<M>,
    pub(crate) counters: Arc<TopicCounters>,
}

impl<M: Message> Publisher<M> {
    /// Hands the message to the middleware without ever waiting. False when it was dropped, because
    /// a reliable subscriber is far behind or the message cannot be encoded; drops are counted and
    /// appear in the diagnostics.
    pub fn publish(&self, message: M) -> bool {
        match self.inner.publish(message) {
            Ok(()) => {
                self.counters.messages.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(error) => {
                let n = self.counters.dropped.fetch_add(1, Ordering::Relaxed) + 1;
                if n.is_power_of_two() {
                    tracing::warn!("{}: {n} messages not sent: {error}", self.counters.name);
                }
                false
            }
        }
    }

    /// Name in the graph.
    pub fn topic(&self) -> &str {
        &self.counters.name
    }

    /// Messages dropped so far.
    pub fn dropped(&self) -> u64 {
        self.counters.dropped.load(Ordering::Relaxed)
    }
}

/// Reads a subscription until its task is ended.
pub(crate) async fn pump<M: Message + Send + Sync + 'static>(
    subscription: ros2_client::Subscription<M>,
    counters: Arc<TopicCounters>,
    mut deliver: impl FnMut(M),
) {
    let mut stream = pin!(subscription.async_stream());
    while let Some(item) = stream.next().await {
        match item {
            Ok((message, _info)) => {
                counters.messages.fetch_add(1, Ordering::Relaxed);
                deliver(message);
            }
            Err(error) => report(&counters.undecodable, &counters.name, &error),
        }
    }
}

fn report(counter: &AtomicU64, topic: &str, error: &dyn std::fmt::Display) {
    let n = counter.fetch_add(1, Ordering::Relaxed) + 1;
    // Every message of a publisher with another definition fails: say so, but not every time.
    if n.is_power_of_two() {
        tracing::warn!(
            "{topic}: {n} messages could not be decoded (does the publisher use another definition \
             of the type?): {error}"
        );
    }
}

/// Delivery into an inbox, counting what falls out.
pub(crate) fn into_inbox<M>(sender: Sender<M>, counters: Arc<TopicCounters>) -> impl FnMut(M) {
    move |message| {
        if !sender.send(message) {
            counters.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}
