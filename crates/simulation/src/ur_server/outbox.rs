use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Answers that may wait for a slow client before it is thrown out.
const MAX_ANSWERS: usize = 64;

/// What waits to be sent to one client: every answer in order, of the data packages only the newest
/// (as the robot does under load).
#[derive(Debug, Default)]
pub(super) struct Outbox {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    answers: VecDeque<Vec<u8>>,
    data: Option<Vec<u8>>,
    closed: bool,
}

/// A lock whose holder panicked still guards usable data here: every write to it is whole.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Outbox {
    /// Queues an answer; false when the client does not read and has to go.
    pub(super) fn answer(&self, bytes: Vec<u8>) -> bool {
        let mut w = lock(&self.waiting);
        w.answers.push_back(bytes);
        self.changed.notify_one();
        w.answers.len() <= MAX_ANSWERS
    }

    /// Queues a text unless much is waiting already: texts are for reading along, not for keeping.
    pub(super) fn text(&self, bytes: Vec<u8>) {
        let mut w = lock(&self.waiting);
        if w.answers.len() < MAX_ANSWERS / 2 {
            w.answers.push_back(bytes);
            self.changed.notify_one();
        }
    }

    /// Replaces the data package.
    pub(super) fn data(&self, bytes: Vec<u8>) {
        lock(&self.waiting).data = Some(bytes);
        self.changed.notify_one();
    }

    /// Ends [`next`](Self::next).
    pub(super) fn close(&self) {
        lock(&self.waiting).closed = true;
        self.changed.notify_all();
    }

    /// Whether the connection is over.
    pub(super) fn closed(&self) -> bool {
        lock(&self.waiting).closed
    }

    /// Waits for something to send; `None` once closed.
    pub(super) fn next(&self) -> Option<Vec<u8>> {
        let mut w = lock(&self.waiting);
        loop {
            if w.closed {
                return None;
            }
            if let Some(bytes) = w.answers.pop_front().or_else(|| w.data.take()) {
                return Some(bytes);
            }
            let (guard, _) = self
                .changed
                .wait_timeout(w, Duration::from_millis(200))
                .unwrap_or_else(PoisonError::into_inner);
            w = guard;
        }
    }
}
