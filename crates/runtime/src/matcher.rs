//! Pairs messages of two topics by their stamps.

use std::collections::VecDeque;
use tdv_geometry::Stamp;

/// Pairs two streams whose stamps agree within a tolerance, such as colour and aligned depth. Keeps
/// at most `capacity` unpaired items of each.
#[derive(Debug)]
pub struct StampMatcher<A, B> {
    left: VecDeque<(Stamp, A)>,
    right: VecDeque<(Stamp, B)>,
    tolerance: f64,
    capacity: usize,
    unpaired: u64,
}

impl<A, B> StampMatcher<A, B> {
    /// `tolerance` in seconds (0 for equal stamps).
    pub fn new(tolerance: f64, capacity: usize) -> Self {
        Self {
            left: VecDeque::new(),
            right: VecDeque::new(),
            tolerance,
            capacity: capacity.max(1),
            unpaired: 0,
        }
    }

    /// Takes an item of the first stream; the pair if its partner is there.
    pub fn left(&mut self, stamp: Stamp, item: A) -> Option<(Stamp, A, B)> {
        if let Some(partner) = take(&mut self.right, stamp, self.tolerance, &mut self.unpaired) {
            self.unpaired += clear_until(&mut self.left, stamp);
            return Some((stamp, item, partner));
        }
        self.unpaired += keep(&mut self.left, stamp, item, self.capacity);
        None
    }

    /// Takes an item of the second stream; the pair, with the stamp of the first one, if its partner
    /// is there.
    pub fn right(&mut self, stamp: Stamp, item: B) -> Option<(Stamp, A, B)> {
        let nearest = self
            .left
            .iter()
            .map(|(s, _)| *s)
            .min_by(|a, b| a.since(stamp).abs().total_cmp(&b.since(stamp).abs()));
        if let Some(partner) = take(&mut self.left, stamp, self.tolerance, &mut self.unpaired) {
            self.unpaired += clear_until(&mut self.right, stamp);
            return Some((nearest.unwrap_or(stamp), partner, item));
        }
        self.unpaired += keep(&mut self.right, stamp, item, self.capacity);
        None
    }

    /// Items that were given up without a partner.
    pub fn unpaired(&self) -> u64 {
        self.unpaired
    }
}

/// The item nearest to `stamp` within the tolerance; older ones are given up.
fn take<T>(
    queue: &mut VecDeque<(Stamp, T)>,
    stamp: Stamp,
    tolerance: f64,
    unpaired: &mut u64,
) -> Option<T> {
    let (index, distance) = queue
        .iter()
        .enumerate()
        .map(|(i, (s, _))| (i, s.since(stamp).abs()))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    if distance > tolerance {
        return None;
    }
    *unpaired += index as u64;
    queue.drain(..index);
    queue.pop_front().map(|(_, item)| item)
}

fn clear_until<T>(queue: &mut VecDeque<(Stamp, T)>, stamp: Stamp) -> u64 {
    let before = queue.len();
    queue.retain(|(s, _)| *s > stamp);
    (before - queue.len()) as u64
}

fn keep<T>(queue: &mut VecDeque<(Stamp, T)>, stamp: Stamp, item: T, capacity: usize) -> u64 {
    let mut dropped = 0;
    // A stamp from the past means that the source started over: what waits will never be paired.
    if queue.back().is_some_and(|(last, _)| *last > stamp) {
        dropped += queue.len() as u64;
        queue.clear();
    }
    queue.push_back((stamp, item));
    if queue.len() > capacity {
        queue.pop_front();
        dropped += 1;
    }
    dropped
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
        // The source starts over.
        assert_eq!(m.left(Stamp(0), "new"), None);
        assert_eq!(m.unpaired(), 6);
        assert_eq!(m.right(Stamp(0), 9), Some((Stamp(0), "new", 9)));
    }
}
