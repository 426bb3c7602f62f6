use crate::executor::JointTrajectory;
use crate::kinematics::Joints;

/// A planned path in time.
#[derive(Debug, Clone, Default)]
pub(super) struct PlannedPath {
    /// Seconds and joints (rad); times increase.
    points: Vec<(f64, Joints)>,
}

impl PlannedPath {
    /// From `start` on along a planner's trajectory.
    pub fn new(start: Joints, trajectory: &JointTrajectory) -> Self {
        let joints = |v: &[f64]| <[f64; 6]>::try_from(v).ok();
        let rest = trajectory.points.iter();
        let rest = rest.filter_map(|p| Some((p.time_from_start, joints(&p.positions)?)));
        Self { points: std::iter::once((0.0, start)).chain(rest).collect() }
    }

    /// Seconds.
    pub fn duration(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.0)
    }

    /// Joints at a time; the ends before and after. `None` for a path without points.
    pub fn at(&self, t: f64) -> Option<Joints> {
        let i = self.points.partition_point(|p| p.0 <= t);
        let (Some(a), Some(b)) = (i.checked_sub(1).map(|i| self.points[i]), self.points.get(i))
        else {
            return self.points.get(i.saturating_sub(1)).map(|p| p.1);
        };
        let x = (t - a.0) / (b.0 - a.0);
        Some(std::array::from_fn(|j| a.1[j] + (b.1[j] - a.1[j]) * x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::TrajectoryPoint;

    #[test]
    fn reads_between_and_beyond_its_points() {
        let point = |t: f64, q: f64| TrajectoryPoint {
            positions: vec![q; 6],
            time_from_start: t,
            ..Default::default()
        };
        let t = JointTrajectory {
            names: Vec::new(),
            stamp: None,
            points: vec![point(1.0, 2.0), point(3.0, 4.0)],
        };
        let p = PlannedPath::new([0.0; 6], &t);
        for (time, q) in [(-1.0, 0.0), (0.5, 1.0), (1.0, 2.0), (2.0, 3.0), (3.0, 4.0), (9.0, 4.0)] {
            assert!((p.at(time).unwrap()[2] - q).abs() < 1e-12, "{time}");
        }
        assert_eq!(p.duration(), 3.0);
        assert_eq!(PlannedPath::default().at(1.0), None);
    }
}
