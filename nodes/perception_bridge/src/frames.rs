//! Colour, depth and camera_info brought together by their stamps.

use std::collections::VecDeque;
use tdv_geometry::Stamp;

/// How many images of one kind wait for their partner.
const WAITING: usize = 8;

/// Pairs two streams by stamp; the older partnerless ones are dropped and counted.
pub struct Pairing<A, B> {
    tolerance: f64,
    a: VecDeque<(Stamp, A)>,
    b: VecDeque<(Stamp, B)>,
    last: Option<Stamp>,
    dropped: u64,
}

impl<A, B> Pairing<A, B> {
    /// Stamps may differ by `tolerance` seconds.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, a: VecDeque::new(), b: VecDeque::new(), last: None, dropped: 0 }
    }

    /// Images that never found a partner.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    pub fn push_a(&mut self, stamp: Stamp, value: A) -> Option<(Stamp, A, B)> {
        self.a.push_back((stamp, value));
        self.pair()
    }

    pub fn push_b(&mut self, stamp: Stamp, value: B) -> Option<(Stamp, A, B)> {
        self.b.push_back((stamp, value));
        self.pair()
    }

    /// The oldest pair that is newer than the last one; its stamp is that of `a`.
    fn pair(&mut self) -> Option<(Stamp, A, B)> {
        let near = |s: Stamp, t: Stamp| s.since(t).abs() <= self.tolerance;
        let found =
            self.a.iter().enumerate().find_map(|(i, (s, _))| {
                self.b.iter().position(|(t, _)| near(*s, *t)).map(|j| (i, j))
            });
        let Some((i, j)) = found else {
            for extra in
                [self.a.len().saturating_sub(WAITING), self.b.len().saturating_sub(WAITING)]
            {
                self.dropped += extra as u64;
            }
            self.a.drain(..self.a.len().saturating_sub(WAITING));
            self.b.drain(..self.b.len().saturating_sub(WAITING));
            return None;
        };
        self.dropped += (i + j) as u64;
        self.a.drain(..i);
        self.b.drain(..j);
        let ((stamp, a), (_, b)) = (self.a.pop_front()?, self.b.pop_front()?);
        // A frame that is shown twice (a replay that repeats itself) counts once.
        if self.last.is_some_and(|l| stamp <= l) && self.last.is_some_and(|l| l.since(stamp) < 10.0)
        {
            return None;
        }
        self.last = Some(stamp);
        Some((stamp, a, b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_stamps_pair_in_any_order_and_loners_are_counted() {
        let mut p = Pairing::new(0.0);
        assert!(p.push_a(Stamp(1), 'a').is_none());
        assert!(p.push_a(Stamp(2), 'b').is_none());
        assert_eq!(p.push_b(Stamp(2), 20), Some((Stamp(2), 'b', 20)));
        assert_eq!(p.dropped(), 1);
        assert!(p.push_b(Stamp(2), 20).is_none());
        assert!(p.push_a(Stamp(2), 'b').is_none(), "a repeated frame counts once");
        for i in 10..40 {
            assert!(p.push_b(Stamp(i), 0).is_none());
        }
        assert_eq!(p.dropped(), 1 + 30 - WAITING as u64);
    }

    #[test]
    fn tolerance() {
        let mut p = Pairing::new(0.01);
        p.push_a(Stamp::from_secs(1.0), ());
        assert!(p.push_b(Stamp::from_secs(1.02), ()).is_none());
        assert!(p.push_b(Stamp::from_secs(1.005), ()).is_some());
    }
}
