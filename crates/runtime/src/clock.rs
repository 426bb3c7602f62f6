//! The graph's clock: the system's, or `/clock` when `use_sim_time` is set.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tdv_geometry::Stamp;
use tokio::sync::watch;

/// A clock that any thread may ask. Cloning is cheap.
#[derive(Clone, Debug)]
pub struct Clock {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    simulated: bool,
    /// Nanoseconds of the last `/clock` message.
    nanos: AtomicI64,
    ticks: watch::Sender<i64>,
}

impl Clock {
    /// System time.
    pub fn system() -> Self {
        Self::new(false)
    }

    /// Simulated time, zero until the first [`Clock::set`].
    pub fn simulated() -> Self {
        Self::new(true)
    }

    fn new(simulated: bool) -> Self {
        let (ticks, _) = watch::channel(0);
        Self { inner: Arc::new(Inner { simulated, nanos: AtomicI64::new(0), ticks }) }
    }

    /// True when time comes from `/clock`.
    pub fn is_simulated(&self) -> bool {
        self.inner.simulated
    }

    /// The time now. Zero under simulated time before the first `/clock` message.
    pub fn now(&self) -> Stamp {
        if self.inner.simulated {
            return Stamp(self.inner.nanos.load(Ordering::Acquire));
        }
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Stamp(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Moves simulated time. Without effect on a system clock. Time may jump back (a bag that starts
    /// over).
    pub fn set(&self, now: Stamp) {
        if self.inner.simulated {
            self.inner.nanos.store(now.0, Ordering::Release);
            self.inner.ticks.send_replace(now.0);
        }
    }

    /// Waits until the clock has moved on by `duration`; under simulated time for as long as that
    /// takes. A jump back ends the wait too, since the goal may never come.
    pub async fn sleep(&self, duration: Duration) {
        if !self.inner.simulated {
            tokio::time::sleep(duration).await;
            return;
        }
        let mut ticks = self.inner.ticks.subscribe();
        let start = self.now().0;
        let goal = start.saturating_add(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX));
        let mut last = start;
        // The sender lives in `self`, so the wait only ends by time.
        let _ = ticks
            .wait_for(|now| {
                let back = *now < last;
                last = *now;
                *now >= goal || back
            })
            .await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_clock_runs_and_cannot_be_set() {
        let clock = Clock::system();
        let before = clock.now();
        clock.set(Stamp(5));
        assert!(clock.now() >= before);
    }

    #[tokio::test]
    async fn simulated_sleep_follows_the_clock() {
        let clock = Clock::simulated();
        assert_eq!(clock.now(), Stamp(0));
        clock.set(Stamp(1_000));
        let sleeper = tokio::spawn({
            let clock = clock.clone();
            async move { clock.sleep(Duration::from_nanos(100)).await }
        });
        tokio::task::yield_now().await;
        clock.set(Stamp(1_099));
        tokio::task::yield_now().await;
        assert!(!sleeper.is_finished());
        clock.set(Stamp(1_100));
        sleeper.await.expect("ends");
        let sleeper = tokio::spawn({
            let clock = clock.clone();
            async move { clock.sleep(Duration::from_secs(1)).await }
        });
        tokio::task::yield_now().await;
        clock.set(Stamp(10));
        sleeper.await.expect("a jump back ends the wait");
    }
}
