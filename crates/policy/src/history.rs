use std::collections::VecDeque;
use tdv_geometry::{Pose, Stamp, interpolate};
use thiserror::Error;

/// Stamps that step back farther (s) belong to another stream: a recording that starts over, or one wrong
/// stamp from the future before them.
pub(crate) const STEP_BACK: f64 = 0.5;

/// Settings of a [`HistoryBuffer`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HistoryConfig {
    /// Poses of a history.
    pub length: usize,
    /// Seconds between them.
    pub dt: f64,
    /// A longer silence (s) between two poses starts the history anew.
    pub max_gap: f64,
}

impl Default for HistoryConfig {
    fn default() -> Self {
        Self { length: 8, dt: 0.05, max_gap: 0.5 }
    }
}

/// Why a pose was not taken.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum HistoryError {
    /// NaN or infinity in it.
    #[error("the pose at {stamp:?} is not finite; it was left out of the history")]
    NotFinite {
        /// Its stamp.
        stamp: Stamp,
    },
    /// Not later than the last one, yet too near to it for a stream that starts over.
    #[error("a pose {late:.3} s older than the newest came in; it was left out of the history")]
    OutOfOrder {
        /// By how much (s), zero for equal stamps.
        late: f64,
    },
    /// The buffer's settings make no history.
    #[error("history of {length} poses, {dt} s apart, gap limit {max_gap} s: all must be positive")]
    Config {
        /// As given.
        length: usize,
        /// As given.
        dt: f64,
        /// As given.
        max_gap: f64,
    },
}

/// What a new pose did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pushed {
    /// It continued the history.
    Continued,
    /// It is the first one.
    Started,
    /// The silence before it was too long, or its stamp is more than half a second older than the newest:
    /// what was known is forgotten and it is the first one.
    Restarted {
        /// The silence (s); negative when the stamps stepped back.
        gap: f64,
    },
}

/// Stamped poses as they come in, read as a fixed number of poses equally spaced in time.
#[derive(Debug, Clone)]
pub struct HistoryBuffer {
    config: HistoryConfig,
    poses: VecDeque<(Stamp, Pose)>,
}

impl HistoryBuffer {
    /// An empty buffer.
    ///
    /// # Errors
    /// [`HistoryError::Config`].
    pub fn new(config: HistoryConfig) -> Result<Self, HistoryError> {
        let HistoryConfig { length, dt, max_gap } = config;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        if length == 0 || !positive(dt) || !positive(max_gap) {
            return Err(HistoryError::Config { length, dt, max_gap });
        }
        Ok(Self { config, poses: VecDeque::new() })
    }

    /// Takes in a pose.
    ///
    /// # Errors
    /// [`HistoryError::NotFinite`], [`HistoryError::OutOfOrder`]; the buffer is as before.
    pub fn push(&mut self, stamp: Stamp, pose: &Pose) -> Result<Pushed, HistoryError> {
        let mut numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
        if !numbers.all(|v| v.is_finite()) {
            return Err(HistoryError::NotFinite { stamp });
        }
        let pushed = match self.poses.back() {
            None => Pushed::Started,
            Some((last, _)) => {
                let gap = stamp.since(*last);
                if gap > self.config.max_gap || gap < -STEP_BACK {
                    Pushed::Restarted { gap }
                } else if gap <= 0.0 {
                    return Err(HistoryError::OutOfOrder { late: -gap });
                } else {
                    Pushed::Continued
                }
            }
        };
        if matches!(pushed, Pushed::Restarted { .. }) {
            self.poses.clear();
        }
        self.poses.push_back((stamp, *pose));
        // One pose at or before the oldest time needed is enough.
        let oldest = stamp.plus(-self.span());
        while self.poses.len() > 2 && self.poses[1].0 <= oldest {
            self.poses.pop_front();
        }
        Ok(pushed)
    }

    fn span(&self) -> f64 {
        (self.config.length - 1) as f64 * self.config.dt
    }

    /// Stamp of the newest pose.
    pub fn stamp(&self) -> Option<Stamp> {
        self.poses.back().map(|(s, _)| *s)
    }

    /// The history that ends at the newest pose, oldest first. Before the first pose that one is
    /// repeated: an object at rest. None while empty.
    pub fn poses(&self) -> Option<Vec<Pose>> {
        let (first, last) = (self.poses.front()?, self.poses.back()?);
        let n = self.config.length;
        let mut out = Vec::with_capacity(n);
        let mut i = 0;
        for j in 0..n {
            let at = last.0.plus(-((n - 1 - j) as f64 * self.config.dt));
            if at <= first.0 {
                out.push(first.1);
                continue;
            }
            while i + 1 < self.poses.len() && self.poses[i + 1].0 < at {
                i += 1;
            }
            let (a, b) = (&self.poses[i], &self.poses[(i + 1).min(self.poses.len() - 1)]);
            let span = b.0.since(a.0);
            let t = if span > 0.0 { at.since(a.0) / span } else { 1.0 };
            out.push(interpolate(&a.1, &b.1, t));
        }
        Some(out)
    }

    /// Forgets everything: another procedure, another frame, an object lost.
    pub fn reset(&mut self) {
        self.poses.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tdv_geometry::pose_from_xyz_rpy;

    fn at(x: f64) -> Pose {
        pose_from_xyz_rpy([x, 0.0, 0.0], [0.0, 0.0, x])
    }

    #[test]
    fn warm_up_interpolation_and_refusals() {
        let mut b = HistoryBuffer::new(HistoryConfig::default()).unwrap();
        assert_eq!(b.poses(), None);
        let t0 = Stamp::from_secs(1e9);
        assert_eq!(b.push(t0, &at(0.0)), Ok(Pushed::Started));
        assert_eq!(b.poses().unwrap(), vec![at(0.0); 8]);
        for i in 1..30 {
            let t = i as f64 / 30.0;
            assert_eq!(b.push(t0.plus(t), &at(t)), Ok(Pushed::Continued));
        }
        let last = 29.0 / 30.0;
        for (j, p) in b.poses().unwrap().iter().enumerate() {
            assert!((p.translation.x - (last - (7 - j) as f64 * 0.05)).abs() < 1e-7);
        }
        let before = b.poses();
        let late = t0.plus(last - 0.4);
        assert!(matches!(b.push(late, &at(5.0)), Err(HistoryError::OutOfOrder { .. })));
        let same = b.stamp().unwrap();
        assert_eq!(b.push(same, &at(5.0)), Err(HistoryError::OutOfOrder { late: 0.0 }));
        assert!(matches!(b.push(t0.plus(1.0), &at(f64::NAN)), Err(HistoryError::NotFinite { .. })));
        assert_eq!(b.poses(), before);
        assert!(
            matches!(b.push(t0.plus(3.0), &at(3.0)), Ok(Pushed::Restarted { gap }) if gap > 2.0)
        );
        assert_eq!(b.poses().unwrap(), vec![at(3.0); 8]);
        b.reset();
        assert_eq!(b.stamp(), None);
        assert!(HistoryBuffer::new(HistoryConfig { length: 0, ..Default::default() }).is_err());
    }

    #[test]
    fn one_stamp_from_the_future_or_a_second_showing_starts_anew() {
        let mut b = HistoryBuffer::new(HistoryConfig::default()).unwrap();
        let t0 = Stamp::from_secs(1e9);
        b.push(t0, &at(0.0)).unwrap();
        b.push(t0.plus(100.0), &at(9.0)).unwrap();
        assert!(
            matches!(b.push(t0.plus(0.1), &at(0.1)), Ok(Pushed::Restarted { gap }) if gap < -99.0)
        );
        assert_eq!(b.poses().unwrap(), vec![at(0.1); 8], "nothing of the future is left");
        assert_eq!(b.push(t0.plus(0.2), &at(0.2)), Ok(Pushed::Continued));
    }

    proptest! {
        /// On a line every history is on the line, whatever the arrival times.
        #[test]
        fn always_on_the_line(steps in proptest::collection::vec(0.001f64..0.4, 1..40)) {
            let mut b = HistoryBuffer::new(HistoryConfig::default()).unwrap();
            let (mut t, start) = (0.0, Stamp(7));
            for s in steps {
                t += s;
                b.push(start.plus(t), &at(t)).unwrap();
                let h = b.poses().unwrap();
                prop_assert_eq!(h.len(), 8);
                prop_assert!((h[7].translation.x - t).abs() < 1e-6);
                for w in h.windows(2) {
                    let d = w[1].translation.x - w[0].translation.x;
                    prop_assert!((-1e-7..=0.05 + 1e-6).contains(&d));
                }
            }
        }
    }
}
