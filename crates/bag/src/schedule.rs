use crate::BagError;
use tdv_geometry::Stamp;

/// How a bag is replayed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayConfig {
    /// Speed; 2 plays twice as fast.
    pub rate: f64,
    /// Seconds skipped at the start.
    pub start_offset: f64,
    /// Starts over at the end.
    pub looped: bool,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self { rate: 1.0, start_offset: 0.0, looped: false }
    }
}

impl ReplayConfig {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`BagError::Replay`].
    pub fn validate(&self) -> Result<(), BagError> {
        let bad = |field, value, expected| Err(BagError::Replay { field, value, expected });
        if !(self.rate.is_finite() && self.rate > 0.0) {
            return bad("rate", self.rate, "a number above 0 is needed");
        }
        if !(self.start_offset.is_finite() && self.start_offset >= 0.0) {
            return bad("start_offset", self.start_offset, "seconds of 0 or more are needed");
        }
        Ok(())
    }
}

/// Maps recorded time to replay time; no clock in it.
///
/// Bag time runs on from round to round when looped, so that stamps never step back.
#[derive(Debug, Clone)]
pub struct ReplaySchedule {
    config: ReplayConfig,
    first: Stamp,
    last: Stamp,
    /// The replaying clock's time of the first message.
    origin: Stamp,
    round: u32,
}

/// Pause between two rounds of a looped replay, seconds.
const GAP: f64 = 0.5;

impl ReplaySchedule {
    /// A bag that spans `first..last`, started at `origin` on the replaying clock.
    ///
    /// # Errors
    /// [`BagError::Replay`], also when the offset leaves nothing to play.
    pub fn new(
        config: ReplayConfig,
        first: Stamp,
        last: Stamp,
        origin: Stamp,
    ) -> Result<Self, BagError> {
        config.validate()?;
        if config.start_offset > last.since(first) {
            return Err(BagError::Replay {
                field: "start_offset",
                value: config.start_offset,
                expected: "it lies beyond the end of the bag",
            });
        }
        Ok(Self { config, first, last, origin, round: 0 })
    }

    /// Log time from which messages are wanted.
    pub fn start(&self) -> Stamp {
        self.first.plus(self.config.start_offset)
    }

    fn round_length(&self) -> f64 {
        self.last.since(self.start()) + GAP
    }

    /// When a message recorded at `log` is due on the replaying clock.
    pub fn due(&self, log: Stamp) -> Stamp {
        let elapsed = log.since(self.start()) + f64::from(self.round) * self.round_length();
        self.origin.plus(elapsed / self.config.rate)
    }

    /// The bag-time shift (s) that the stamps of this round need to keep increasing.
    pub fn shift(&self) -> f64 {
        f64::from(self.round) * self.round_length()
    }

    /// Called at the end of the bag: true if another round begins.
    pub fn next_round(&mut self) -> bool {
        self.round += 1;
        self.config.looped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_offset_and_rounds() {
        let config = ReplayConfig { rate: 2.0, start_offset: 1.0, looped: true };
        let (first, last) = (Stamp::from_secs(100.0), Stamp::from_secs(105.0));
        let mut s = ReplaySchedule::new(config, first, last, Stamp::from_secs(1000.0)).unwrap();
        assert_eq!(s.start(), Stamp::from_secs(101.0));
        assert!((s.due(Stamp::from_secs(103.0)).as_secs() - 1001.0).abs() < 1e-6);
        let end = s.due(last);
        assert!(s.next_round());
        assert!(s.due(s.start()) > end);
        assert!((s.shift() - 4.5).abs() < 1e-9);
    }

    #[test]
    fn impossible_values_are_named() {
        let (a, b) = (Stamp(0), Stamp(1_000_000_000));
        for (rate, offset) in [(0.0, 0.0), (f64::NAN, 0.0), (1.0, -1.0), (1.0, 2.0)] {
            let config = ReplayConfig { rate, start_offset: offset, looped: false };
            assert!(ReplaySchedule::new(config, a, b, a).is_err(), "{rate} {offset}");
        }
    }
}
