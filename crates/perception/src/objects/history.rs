//! Stamped poses of the tool centre point, looked up at the time of an image.

use std::collections::VecDeque;
use tdv_geometry::{Pose, Stamp, interpolate};

/// Seconds that are kept.
const KEPT_S: f64 = 3.0;
/// Seconds beyond the newest (or before the oldest) pose for which it still counts.
const SLACK_S: f64 = 0.06;

/// A few seconds of `T_base_tcp`.
#[derive(Debug, Clone, Default)]
pub struct TcpHistory {
    poses: VecDeque<(Stamp, Pose)>,
}

impl TcpHistory {
    /// Adds a pose. One that is not later than the last replaces everything after it (a restarted
    /// clock empties the history); numbers that are not finite are ignored.
    pub fn push(&mut self, stamp: Stamp, pose: Pose) {
        let finite = |p: &Pose| {
            p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite())
        };
        if !finite(&pose) {
            return;
        }
        while self.poses.back().is_some_and(|(s, _)| *s >= stamp) {
            self.poses.pop_back();
        }
        self.poses.push_back((stamp, pose));
        while self.poses.front().is_some_and(|(s, _)| stamp.since(*s) > KEPT_S) {
            self.poses.pop_front();
        }
    }

    /// The pose at `stamp`, interpolated; the nearest one within 60 ms outside the span, else `None`.
    pub fn at(&self, stamp: Stamp) -> Option<Pose> {
        let i = self.poses.partition_point(|(s, _)| *s <= stamp);
        let before = i.checked_sub(1).and_then(|i| self.poses.get(i));
        match (before, self.poses.get(i)) {
            (Some((s0, a)), Some((s1, b))) => {
                Some(interpolate(a, b, stamp.since(*s0) / s1.since(*s0)))
            }
            (Some((s, p)), None) => (stamp.since(*s) <= SLACK_S).then_some(*p),
            (None, Some((s, p))) => (s.since(stamp) <= SLACK_S).then_some(*p),
            (None, None) => None,
        }
    }

    /// The newest stamp.
    pub fn newest(&self) -> Option<Stamp> {
        self.poses.back().map(|p| p.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn interpolates_and_expires() {
        let mut h = TcpHistory::default();
        for i in 0..1000 {
            let t = f64::from(i) * 0.008;
            h.push(Stamp::from_secs(t), pose_from_xyz_rpy([t, 0.0, 0.0], [0.0; 3]));
        }
        let x = |h: &TcpHistory, t: f64| h.at(Stamp::from_secs(t)).map(|p| p.translation.x);
        assert!((x(&h, 6.003).unwrap() - 6.003).abs() < 1e-9);
        assert!((x(&h, 8.03).unwrap() - 7.992).abs() < 1e-9);
        assert_eq!(x(&h, 8.2), None);
        assert_eq!(x(&h, 1.0), None);
        h.push(Stamp::from_secs(1.0), pose_from_xyz_rpy([f64::NAN, 0.0, 0.0], [0.0; 3]));
        assert!(x(&h, 6.003).is_some());
    }
}
