//! Quality of service by name.

use ros2_client::qos::{Durability, History, QosProfile, Reliability, WhenFull};
use std::fmt;
use std::str::FromStr;

/// A quality-of-service profile. Publishing never blocks under any of them: when a reliable send
/// window is full, the new message is dropped and counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Lost messages are sent again.
    pub reliable: bool,
    /// Late subscribers get the last `depth` messages.
    pub latched: bool,
    /// How many messages are kept.
    pub depth: usize,
}

impl Qos {
    /// Best effort, depth 5: for subscriptions to cameras and other sensors.
    pub const fn sensor_data() -> Self {
        Self { reliable: false, latched: false, depth: 5 }
    }

    /// Best effort with a depth.
    pub const fn best_effort(depth: usize) -> Self {
        Self { reliable: false, latched: false, depth }
    }

    /// Reliable and volatile with a depth.
    pub const fn reliable(depth: usize) -> Self {
        Self { reliable: true, latched: false, depth }
    }

    /// Reliable and transient local, depth 1: for state that late subscribers need.
    pub const fn latched() -> Self {
        Self { reliable: true, latched: true, depth: 1 }
    }

    /// Reliable and transient local with a depth.
    pub const fn latched_depth(depth: usize) -> Self {
        Self { reliable: true, latched: true, depth }
    }

    /// What ROS uses for services.
    pub(crate) const fn services() -> Self {
        Self::reliable(10)
    }

    pub(crate) fn profile(self) -> QosProfile {
        QosProfile::subscription_default()
            .reliability(if self.reliable {
                Reliability::Reliable { when_full: WhenFull::Fail }
            } else {
                Reliability::BestEffort
            })
            .durability(if self.latched {
                Durability::TransientLocal
            } else {
                Durability::Volatile
            })
            .history(History::KeepLast { depth: self.depth.max(1) })
    }
}

/// A profile text that is not understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "quality of service {0:?} is unknown: use sensor_data, best_effort(N), reliable(N), latched or latched(N)"
)]
pub struct QosError(String);

impl FromStr for Qos {
    type Err = QosError;

    fn from_str(text: &str) -> Result<Self, QosError> {
        let error = || QosError(text.to_string());
        let (name, depth) = match text.split_once('(') {
            None => (text, None),
            Some((name, rest)) => {
                let depth = rest.strip_suffix(')').and_then(|n| n.trim().parse::<usize>().ok());
                (name, Some(depth.filter(|d| *d > 0).ok_or_else(error)?))
            }
        };
        match (name.trim(), depth) {
            ("sensor_data", None) => Ok(Self::sensor_data()),
            ("latched", depth) => Ok(Self::latched_depth(depth.unwrap_or(1))),
            ("best_effort", Some(depth)) => Ok(Self::best_effort(depth)),
            ("reliable", Some(depth)) => Ok(Self::reliable(depth)),
            _ => Err(error()),
        }
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self { reliable: true, latched: true, depth: 1 } => write!(f, "latched"),
            Self { latched: true, depth, .. } => write!(f, "latched({depth})"),
            Self { reliable: true, depth, .. } => write!(f, "reliable({depth})"),
            Self { reliable: false, depth, .. } => write!(f, "best_effort({depth})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for text in ["best_effort(5)", "reliable(10)", "latched", "latched(4)"] {
            assert_eq!(text.parse::<Qos>().map(|q| q.to_string()).as_deref(), Ok(text));
        }
        assert_eq!("sensor_data".parse(), Ok(Qos::sensor_data()));
        for text in ["reliable", "reliable(0)", "reliable(x)", "fast", "latched(1"] {
            assert!(text.parse::<Qos>().is_err(), "{text}");
        }
    }
}
