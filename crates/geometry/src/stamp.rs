use serde::{Deserialize, Serialize};

/// A point in time: nanoseconds since the epoch of whichever clock the graph runs on.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct Stamp(pub i64);

impl Stamp {
    /// From seconds. Not-a-number becomes zero.
    pub fn from_secs(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// From the two fields of `builtin_interfaces/Time`.
    pub fn from_ros(sec: i32, nanosec: u32) -> Self {
        Self(i64::from(sec) * 1_000_000_000 + i64::from(nanosec))
    }

    /// The two fields of `builtin_interfaces/Time`.
    pub fn to_ros(self) -> (i32, u32) {
        (self.0.div_euclid(1_000_000_000) as i32, self.0.rem_euclid(1_000_000_000) as u32)
    }

    /// Seconds as a float (loses nanoseconds for large values).
    pub fn as_secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// `self - earlier` in seconds, exact for differences below 100 days; negative if `earlier` is later.
    pub fn since(self, earlier: Self) -> f64 {
        (self.0 - earlier.0) as f64 * 1e-9
    }

    /// `self` plus seconds.
    #[must_use]
    pub fn plus(self, seconds: f64) -> Self {
        Self(self.0 + (seconds * 1e9).round() as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ros_round_trip_also_before_the_epoch() {
        for ns in [-1, 0, 1, 1_763_812_345_678_901_234_i64, -1_500_000_000] {
            let (s, n) = Stamp(ns).to_ros();
            assert_eq!(Stamp::from_ros(s, n), Stamp(ns));
        }
    }
}
