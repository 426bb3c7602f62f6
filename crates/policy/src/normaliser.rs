//! Poses to the network's numbers and back.

use crate::PolicyError;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, rotation_6d, rotation_from_6d};

/// Numbers per pose: xyz and the first two columns of the rotation matrix.
pub const POSE_DIM: usize = 9;

/// Half a range is taken as at least this (m), so that a constant axis does not amplify noise.
const MIN_HALF_RANGE: f64 = 0.02;

/// Per-axis min-max scaling of positions to -1..1; the 6D rotation is left as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normaliser {
    /// Smallest position (m) per axis.
    pub min: [f64; 3],
    /// Largest position (m) per axis.
    pub max: [f64; 3],
}

impl Normaliser {
    /// The range of the given poses.
    ///
    /// # Errors
    /// [`PolicyError::Data`] without poses, [`PolicyError::NotFinite`].
    pub fn fit<'a>(poses: impl IntoIterator<Item = &'a Pose>) -> Result<Self, PolicyError> {
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (n, pose) in poses.into_iter().enumerate() {
            finite(pose, || format!("pose {n} of the training set"))?;
            for i in 0..3 {
                min[i] = min[i].min(pose.translation.vector[i]);
                max[i] = max[i].max(pose.translation.vector[i]);
            }
        }
        if min[0] > max[0] {
            return Err(PolicyError::Data { reason: "no poses to fit the normaliser to".into() });
        }
        Ok(Self { min, max })
    }

    fn axis(&self, i: usize) -> (f64, f64) {
        let half = ((self.max[i] - self.min[i]) / 2.0).max(MIN_HALF_RANGE);
        ((self.max[i] + self.min[i]) / 2.0, half)
    }

    /// The nine numbers of a pose.
    pub fn encode(&self, pose: &Pose) -> [f32; POSE_DIM] {
        let mut out = [0.0; POSE_DIM];
        for i in 0..3 {
            let (centre, half) = self.axis(i);
            out[i] = ((pose.translation.vector[i] - centre) / half) as f32;
        }
        for (o, r) in out[3..].iter_mut().zip(rotation_6d(&pose.rotation)) {
            *o = r as f32;
        }
        out
    }

    /// The pose of nine numbers; the rotation by Gram-Schmidt, so any finite numbers give a pose.
    pub fn decode(&self, v: &[f32; POSE_DIM]) -> Pose {
        let mut p = [0.0; 3];
        for i in 0..3 {
            let (centre, half) = self.axis(i);
            p[i] = f64::from(v[i]) * half + centre;
        }
        let r = std::array::from_fn(|i| f64::from(v[3 + i]));
        Pose::from_parts(p.into(), rotation_from_6d(&r))
    }

    /// True when limits are finite and ordered.
    pub fn is_valid(&self) -> bool {
        (0..3).all(|i| {
            self.min[i].is_finite() && self.max[i].is_finite() && self.min[i] <= self.max[i]
        })
    }
}

/// Refuses a pose that holds NaN or infinity.
pub(crate) fn finite(pose: &Pose, what: impl FnOnce() -> String) -> Result<(), PolicyError> {
    let ok =
        pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
    if ok { Ok(()) } else { Err(PolicyError::NotFinite { what: what() }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};

    #[test]
    fn round_trip_and_range_guard() {
        let poses: Vec<_> = (0..20)
            .map(|i| {
                pose_from_xyz_rpy(
                    [0.02 * i as f64, -0.01 * i as f64, 0.1],
                    [0.1, 0.2, 0.3 * i as f64],
                )
            })
            .collect();
        let n = Normaliser::fit(&poses).unwrap();
        assert!((n.encode(&poses[0])[0] + 1.0).abs() < 1e-6);
        assert!((n.encode(&poses[19])[0] - 1.0).abs() < 1e-6);
        // The constant axis: 2 mm of noise stay 0.1.
        let off = pose_from_xyz_rpy([0.0, 0.0, 0.102], [0.0; 3]);
        assert!((n.encode(&off)[2] - 0.1).abs() < 1e-5);
        for p in &poses {
            let (d, a) = pose_distance(&n.decode(&n.encode(p)), p);
            assert!(d < 1e-7 && a < 1e-6, "{d} {a}");
        }
        assert!(Normaliser::fit(&[]).is_err());
        assert!(Normaliser::fit(&[pose_from_xyz_rpy([f64::NAN, 0.0, 0.0], [0.0; 3])]).is_err());
    }
}
