//! A bounded queue between a subscription and whoever works on the messages: the oldest message
//! gives way, and is counted.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

struct Shared<M> {
    state: Mutex<State<M>>,
    async_waiters: Notify,
    thread_waiters: Condvar,
    capacity: usize,
}

struct State<M> {
    /// With the time of receipt.
    queue: VecDeque<(Instant, M)>,
    dropped: u64,
    closed: bool,
}

impl<M> Shared<M> {
    fn lock(&self) -> MutexGuard<'_, State<M>> {
        // No user code runs under the lock, so a poisoned state is still whole.
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

/// The receiving end. With capacity 1 it is "newest wins".
pub struct Inbox<M> {
    shared: Arc<Shared<M>>,
}

/// The sending end; dropping it closes the queue.
pub struct Sender<M> {
    shared: Arc<Shared<M>>,
}

/// A queue of at most `capacity` messages (at least one).
pub fn inbox<M>(capacity: usize) -> (Sender<M>, Inbox<M>) {
    let shared = Arc::new(Shared {
        state: Mutex::new(State { queue: VecDeque::new(), dropped: 0, closed: false }),
        async_waiters: Notify::new(),
        thread_waiters: Condvar::new(),
        capacity: capacity.max(1),
    });
    (Sender { shared: shared.clone() }, Inbox { shared })
}

impl<M> Sender<M> {
    /// Puts a message in, pushing the oldest out when full. Never blocks. True when nothing was
    /// lost.
    pub fn send(&self, message: M) -> bool {
        let mut state = self.shared.lock();
        let full = state.queue.len() >= self.shared.capacity;
        if full {
            state.queue.pop_front();
            state.dropped += 1;
        }
        state.queue.push_back((Instant::now(), message));
        drop(state);
        self.shared.async_waiters.notify_one();
        self.shared.thread_waiters.notify_one();
        !full
    }
}

impl<M> Drop for Sender<M> {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.async_waiters.notify_one();
        self.shared.thread_waiters.notify_all();
    }
}

impl<M> Inbox<M> {
    /// The next message; `None` once the node is shut down and the queue is empty.
    pub async fn recv(&mut self) -> Option<M> {
        loop {
            {
                let mut state = self.shared.lock();
                if let Some((_, message)) = state.queue.pop_front() {
                    return Some(message);
                }
                if state.closed {
                    return None;
                }
            }
            // A notification between the check and this wait is stored, not lost.
            self.shared.async_waiters.notified().await;
        }
    }

    /// The next message for a thread that may block; `None` after `timeout` or at the end (tell them
    /// apart with [`Inbox::is_closed`]).
    pub fn recv_timeout(&mut self, timeout: Duration) -> Option<M> {
        let end = Instant::now() + timeout;
        let mut state = self.shared.lock();
        loop {
            if let Some((_, message)) = state.queue.pop_front() {
                return Some(message);
            }
            let left = end.saturating_duration_since(Instant::now());
            if state.closed || left.is_zero() {
                return None;
            }
            state = match self.shared.thread_waiters.wait_timeout(state, left) {
                Ok((state, _)) => state,
                Err(poisoned) => poisoned.into_inner().0,
            };
        }
    }

    /// The next message if there is one.
    pub fn try_recv(&mut self) -> Option<M> {
        self.shared.lock().queue.pop_front().map(|(_, message)| message)
    }

    /// The oldest messages, at most `count`, each with the time at which it was put in.
    pub fn take(&mut self, count: usize) -> Vec<(Instant, M)> {
        let mut state = self.shared.lock();
        let count = count.min(state.queue.len());
        state.queue.drain(..count).collect()
    }

    /// The newest message if there is one; older ones are dropped and counted.
    pub fn try_newest(&mut self) -> Option<M> {
        let mut state = self.shared.lock();
        let newest = state.queue.pop_back();
        state.dropped += state.queue.len() as u64;
        state.queue.clear();
        newest.map(|(_, message)| message)
    }

    /// Messages pushed out unread so far.
    pub fn dropped(&self) -> u64 {
        self.shared.lock().dropped
    }

    /// True once no more messages will come in.
    pub fn is_closed(&self) -> bool {
        self.shared.lock().closed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_oldest_gives_way() {
        let (sender, mut inbox) = inbox(2);
        assert!(sender.send(1) && sender.send(2));
        assert!(!sender.send(3));
        assert_eq!(inbox.dropped(), 1);
        assert_eq!(inbox.recv().await, Some(2));
        assert_eq!(inbox.recv().await, Some(3));
        assert_eq!(inbox.try_recv(), None);
        sender.send(4);
        sender.send(5);
        assert_eq!(inbox.try_newest(), Some(5));
        assert_eq!(inbox.dropped(), 2);
        sender.send(6);
        drop(sender);
        assert_eq!(inbox.recv().await, Some(6));
        assert_eq!(inbox.recv().await, None);
    }

    #[test]
    fn messages_are_taken_with_the_time_of_their_receipt() {
        let (sender, mut inbox) = inbox(8);
        let began = Instant::now();
        sender.send(1);
        let between = Instant::now();
        sender.send(2);
        sender.send(3);
        let taken = inbox.take(2);
        assert!(began <= taken[0].0 && taken[0].0 <= between && between <= taken[1].0);
        assert_eq!((taken.len(), taken[0].1, taken[1].1), (2, 1, 2));
        assert_eq!(inbox.take(9).len(), 1);
        assert_eq!(inbox.dropped(), 0);
    }

    #[tokio::test]
    async fn waiting_ends_with_a_message_or_the_end() {
        let (sender, mut receiver) = inbox(1);
        let task = tokio::spawn(async move { (receiver.recv().await, receiver.recv().await) });
        tokio::task::yield_now().await;
        sender.send(7);
        tokio::task::yield_now().await;
        drop(sender);
        assert_eq!(task.await.expect("ends"), (Some(7), None));
    }

    #[test]
    fn threads_can_wait() {
        let (sender, mut receiver) = inbox(1);
        assert_eq!(receiver.recv_timeout(Duration::ZERO), None);
        assert!(!receiver.is_closed());
        let thread = std::thread::spawn(move || {
            let first = receiver.recv_timeout(Duration::from_secs(60));
            (first, receiver.recv_timeout(Duration::from_secs(60)), receiver.is_closed())
        });
        sender.send(1);
        while sender.shared.lock().queue.len() == 1 {
            std::thread::yield_now();
        }
        drop(sender);
        assert_eq!(thread.join().expect("ends"), (Some(1), None, true));
    }
}
