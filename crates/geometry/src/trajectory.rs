use crate::{GeometryError, Pose, Stamp, interpolate, twist_arc};
use serde::{Deserialize, Serialize};

/// A pose and its time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimedPose {
    /// When.
    pub stamp: Stamp,
    /// Where.
    pub pose: Pose,
}

/// Poses with strictly increasing stamps and sign-continuous quaternions; never empty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseTrajectory {
    points: Vec<TimedPose>,
}

impl<'de> Deserialize<'de> for PoseTrajectory {
    fn deserialize<D: serde::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Raw {
            points: Vec<TimedPose>,
        }
        Self::new(Raw::deserialize(d)?.points).map_err(serde::de::Error::custom)
    }
}

impl PoseTrajectory {
    /// Checks the stamps and makes neighbouring quaternions have the same sign (double cover).
    ///
    /// # Errors
    /// [`GeometryError::TooShort`] for no point, [`GeometryError::NotIncreasing`],
    /// [`GeometryError::NotFinite`].
    pub fn new(mut points: Vec<TimedPose>) -> Result<Self, GeometryError> {
        if points.is_empty() {
            return Err(GeometryError::TooShort { have: 0, need: 1 });
        }
        for i in 0..points.len() {
            let p = &points[i].pose;
            if !p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite()) {
                return Err(GeometryError::NotFinite {
                    what: "trajectory sample",
                    value: format!("sample {i}"),
                });
            }
            if i > 0 {
                if points[i].stamp <= points[i - 1].stamp {
                    return Err(GeometryError::NotIncreasing { index: i });
                }
                let q = points[i].pose.rotation;
                if q.coords.dot(&points[i - 1].pose.rotation.coords) < 0.0 {
                    points[i].pose.rotation =
                        nalgebra::UnitQuaternion::new_unchecked(-q.into_inner());
                }
            }
        }
        Ok(Self { points })
    }

    /// Equally spaced samples starting at time zero, `dt` seconds apart.
    ///
    /// # Errors
    /// As [`PoseTrajectory::new`].
    pub fn from_poses(poses: &[Pose], dt: f64) -> Result<Self, GeometryError> {
        Self::new(
            poses
                .iter()
                .enumerate()
                .map(|(i, pose)| TimedPose { stamp: Stamp::from_secs(i as f64 * dt), pose: *pose })
                .collect(),
        )
    }

    /// The samples.
    pub fn points(&self) -> &[TimedPose] {
        &self.points
    }

    /// The poses without their stamps.
    pub fn poses(&self) -> impl Iterator<Item = &Pose> {
        self.points.iter().map(|p| &p.pose)
    }

    /// Number of samples, at least one.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// First sample.
    pub fn first(&self) -> &TimedPose {
        &self.points[0]
    }

    /// Last sample.
    pub fn last(&self) -> &TimedPose {
        &self.points[self.points.len() - 1]
    }

    /// Seconds from the first to the last sample.
    pub fn duration(&self) -> f64 {
        self.last().stamp.since(self.first().stamp)
    }

    /// Pose at a time, interpolated; the first or the last pose outside the span.
    pub fn at(&self, stamp: Stamp) -> Pose {
        let i = self.points.partition_point(|p| p.stamp <= stamp);
        if i == 0 {
            return self.points[0].pose;
        }
        if i == self.points.len() {
            return self.points[i - 1].pose;
        }
        let (a, b) = (&self.points[i - 1], &self.points[i]);
        interpolate(&a.pose, &b.pose, stamp.since(a.stamp) / b.stamp.since(a.stamp))
    }

    /// Samples every `dt` seconds from the first stamp on; the last pose is always included.
    ///
    /// # Errors
    /// [`GeometryError::NotFinite`] when `dt` is not a positive number.
    pub fn resampled(&self, dt: f64) -> Result<Self, GeometryError> {
        if !(dt.is_finite() && dt > 0.0) {
            return Err(GeometryError::NotFinite { what: "sampling step", value: dt.to_string() });
        }
        let start = self.first().stamp;
        let n = (self.duration() / dt - 1e-9).ceil().max(0.0) as usize;
        let points = (0..=n)
            .map(|i| {
                let stamp = start.plus(i as f64 * dt);
                TimedPose { stamp, pose: self.at(stamp) }
            })
            .collect();
        Self::new(points)
    }

    /// Every pose mapped: `f(pose)`.
    ///
    /// # Errors
    /// As [`PoseTrajectory::new`], if `f` gives numbers that are not finite.
    pub fn map(&self, mut f: impl FnMut(&Pose) -> Pose) -> Result<Self, GeometryError> {
        Self::new(
            self.points.iter().map(|p| TimedPose { stamp: p.stamp, pose: f(&p.pose) }).collect(),
        )
    }

    /// Cumulative SE(3) arc length (m) at every sample, see [`twist_arc`].
    pub fn arc_lengths(&self, rho: f64) -> Vec<f64> {
        let mut s = 0.0;
        let mut out = vec![0.0];
        for w in self.points.windows(2) {
            s += twist_arc(&w[0].pose, &w[1].pose, rho);
            out.push(s);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_from_xyz_rpy;

    fn line() -> PoseTrajectory {
        let poses: Vec<_> =
            (0..11).map(|i| pose_from_xyz_rpy([0.1 * i as f64, 0.0, 0.0], [0.0; 3])).collect();
        PoseTrajectory::from_poses(&poses, 0.1).unwrap()
    }

    #[test]
    fn interpolation_and_clamping() {
        let t = line();
        assert!((t.at(Stamp::from_secs(0.55)).translation.x - 0.55).abs() < 1e-9);
        assert_eq!(t.at(Stamp::from_secs(9.0)), t.last().pose);
        assert_eq!(t.at(Stamp(-5)), t.first().pose);
        assert!((t.arc_lengths(0.1)[10] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn resampling_keeps_the_end() {
        let r = line().resampled(0.3).unwrap();
        assert_eq!(r.len(), 5);
        assert_eq!(r.last().pose, line().last().pose);
        assert!(line().resampled(0.0).is_err());
    }

    #[test]
    fn disorder_and_double_cover() {
        let p = Pose::identity();
        let bad =
            vec![TimedPose { stamp: Stamp(1), pose: p }, TimedPose { stamp: Stamp(1), pose: p }];
        assert_eq!(PoseTrajectory::new(bad), Err(GeometryError::NotIncreasing { index: 1 }));
        let mut flipped = p;
        flipped.rotation = nalgebra::UnitQuaternion::new_unchecked(-p.rotation.into_inner());
        let t = PoseTrajectory::new(vec![
            TimedPose { stamp: Stamp(0), pose: p },
            TimedPose { stamp: Stamp(1), pose: flipped },
        ])
        .unwrap();
        assert!(t.last().pose.rotation.w > 0.0);
        let json = serde_json::to_string(&t).unwrap();
        assert_eq!(serde_json::from_str::<PoseTrajectory>(&json).unwrap(), t);
    }
}
