//! Pairs messages of two topics by their stamps.

use std::collections::VecDeque;
use tdv_geometry::Stamp;

/// Stamps that step back farther (s) belong to another stream: a recording that starts over, or one
/// wrong stamp from the future before them.
const STEP_BACK: f64 = 0.5;

/// Pairs two streams whose stamps agree within a tolerance, such as colour and aligned depth. Keeps
/// at most `capacity` unpaired items of each. A stream whose stamps step back by more than half a
/// second starts over: what waits of it is given up.
#[derive(Debug)]
pub struct StampMatcher<A, B> {
    left: Lane<A>,
    right: Lane<B>,
    tolerance: f64,
    capacity: usize,
}

/// What waits of one stream, by stamp.
#[derive(Debug)]
struct Lane<T> {
    waiting: VecDeque<(Stamp, T)>,
    newest: Option<Stamp>,
    given_up: u64,
}

impl<A, B> StampMatcher<A, B> {
    /// `tolerance` in seconds (0 for equal stamps).
    pub fn new(tolerance: f64, capacity: usize) -> Self {
        Self { left: Lane::new(), right: Lane::new(), tolerance, capacity: capacity.max(1) }
    }

    /// Takes an item of the first stream; the pair if its partner is there.
    pub fn left(&mut self, stamp: Stamp, item: A) -> Option<(Stamp, A, B)> {
        self.left.arrived(stamp);
        if let Some((partner_stamp, partner)) = self.right.take(stamp, self.tolerance) {
            self.left.give_up_before(stamp);
            self.right.give_up_before(partner_stamp);
            return Some((stamp, item, partner));
        }
        self.left.keep(stamp, item, self.capacity);
        None
    }

    /// Takes an item of the second stream; the pair, with the stamp of the first one, if its partner
    /// is there.
    pub fn right(&mut self, stamp: Stamp, item: B) -> Option<(Stamp, A, B)> {
        self.right.arrived(stamp);
        if let Some((partner_stamp, partner)) = self.left.take(stamp, self.tolerance) {
            self.right.give_up_before(stamp);
            self.left.give_up_before(partner_stamp);
            return Some((partner_stamp, partner, item));
        }
        self.right.keep(stamp, item, self.capacity);
        None
    }

    /// Items that were given up without a partner.
    pub fn unpaired(&self) -> u64 {
        self.left.given_up + self.right.given_up
    }
}

impl<T> Lane<T> {
    fn new() -> Self {
        Self { waiting: VecDeque::new(), newest: None, given_up: 0 }
    }

    /// Notes a stamp of the stream; forgets what waits when the stream starts over.
    fn arrived(&mut self, stamp: Stamp) {
        if self.newest.is_some_and(|newest| newest.since(stamp) > STEP_BACK) {
            self.given_up += self.waiting.len() as u64;
            self.waiting.clear();
            self.newest = None;
        }
        self.newest = self.newest.max(Some(stamp));
    }

    /// The item nearest to `stamp` within the tolerance.
    fn take(&mut self, stamp: Stamp, tolerance: f64) -> Option<(Stamp, T)> {
        let distance = |s: &Stamp| s.since(stamp).abs();
        let (index, nearest) = self
            .waiting
            .iter()
            .enumerate()
            .map(|(i, (s, _))| (i, distance(s)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        if nearest > tolerance {
            return None;
        }
        self.waiting.remove(index)
    }

    /// A pair was found at `stamp`: older items have missed theirs.
    fn give_up_before(&mut self, stamp: Stamp) {
        let missed = self.waiting.partition_point(|(s, _)| *s <= stamp);
        self.waiting.drain(..missed);
        self.given_up += missed as u64;
    }

    fn keep(&mut self, stamp: Stamp, item: T, capacity: usize) {
        let place = self.waiting.partition_point(|(s, _)| *s <= stamp);
        self.waiting.insert(place, (stamp, item));
        if self.waiting.len() > capacity {
            self.waiting.pop_front();
            self.given_up += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_in_any_order_and_counts_losses() {
        let mut m = StampMatcher::new(0.005, 3);
        assert_eq!(m.left(Stamp(0), "a"), None);
        assert_eq!(m.right(Stamp(2_000_000), 1), Some((Stamp(0), "a", 1)));
        assert_eq!(m.right(Stamp(33_000_000), 2), None);
        assert_eq!(m.left(Stamp(66_000_000), "c"), None);
        assert_eq!(m.right(Stamp(66_000_000), 3), Some((Stamp(66_000_000), "c", 3)));
        assert_eq!(m.unpaired(), 1);
        for i in 0..5 {
            assert_eq!(m.left(Stamp(100_000_000 + i * 33_000_000), "x"), None);
        }
        assert_eq!(m.unpaired(), 3);
    }

    #[test]
    fn a_batch_of_one_stream_loses_nothing() {
        let mut m = StampMatcher::new(0.0, 8);
        // 2 came late, which is no new stream.
        for i in [1, 3, 2] {
            assert_eq!(m.left(Stamp(i), i), None);
        }
        for i in 1..=3 {
            assert_eq!(m.right(Stamp(i), i), Some((Stamp(i), i, i)));
        }
        assert_eq!(m.unpaired(), 0);
    }

    #[test]
    fn outside_of_the_tolerance_there_is_no_pair() {
        let mut m = StampMatcher::new(0.01, 8);
        m.left(Stamp::from_secs(1.0), ());
        assert!(m.right(Stamp::from_secs(1.02), ()).is_none());
        assert!(m.right(Stamp::from_secs(1.005), ()).is_some());
    }

    #[test]
    fn a_stream_that_steps_back_starts_over() {
        let mut m = StampMatcher::new(0.0, 8);
        let at = Stamp::from_secs;
        // A wrong stamp from the future, on both streams and on one of them.
        m.left(at(100.0), 'w');
        assert!(m.right(at(100.0), 'w').is_some());
        assert_eq!(m.left(at(1.0), 'a'), None);
        assert_eq!(m.right(at(1.0), 'A'), Some((at(1.0), 'a', 'A')));
        m.left(at(50.0), 'w');
        m.left(at(1.1), 'b');
        assert_eq!(m.unpaired(), 1);
        assert_eq!(m.right(at(1.1), 'B'), Some((at(1.1), 'b', 'B')));
        // The same recording once more.
        m.left(at(8.0), 'z');
        assert_eq!(m.left(at(1.0), 'c'), None);
        assert_eq!(m.right(at(1.0), 'C'), Some((at(1.0), 'c', 'C')));
        assert_eq!(m.unpaired(), 2);
    }
}
