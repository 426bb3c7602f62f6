//! Where the held object sits in the gripper: a robust average over the first frames after the grasp.

use nalgebra::{Matrix4, SymmetricEigen, UnitQuaternion, Vector3, Vector4};
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, Stamp, Symmetry, pose_distance};

/// Settings of the grasp measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AttachConfig {
    /// Frames that are averaged.
    pub frames: usize,
    /// Distance (m) from the median beyond which a frame is left out.
    pub outlier: f64,
    /// Part of a later, agreeing observation that is taken in (the object may creep in the fingers).
    pub rate: f64,
    /// Distance (m) between carried and seen pose that counts as slipped.
    pub slip: f64,
    /// Angle (rad) beyond which an observation is ignored: half hidden in the gripper an object is
    /// likelier to be misread than to have turned.
    pub max_angle: f64,
    /// Frames in a row with such a difference before it counts.
    pub slip_frames: u32,
    /// Silence (s) after which the first observations do not count as a slip until one agrees again:
    /// found anew in the gripper an object is often misread.
    pub gap: f64,
}

impl Default for AttachConfig {
    fn default() -> Self {
        Self {
            frames: 8,
            outlier: 0.015,
            rate: 0.03,
            slip: 0.05,
            max_angle: 0.5,
            slip_frames: 10,
            gap: 0.5,
        }
    }
}

/// `T_tcp_object` of one grasp.
#[derive(Debug, Clone)]
pub struct Attachment {
    config: AttachConfig,
    samples: Vec<Pose>,
    pose: Option<Pose>,
    off: u32,
    /// Stamp of the last observation, and whether one has agreed since the last gap.
    last: Option<Stamp>,
    followed: bool,
}

impl Attachment {
    /// With a first guess from the object's last pose, where there is one.
    pub(crate) fn new(config: AttachConfig, guess: Option<Pose>) -> Self {
        Self { config, samples: Vec::new(), pose: guess, off: 0, last: None, followed: true }
    }

    /// The object seen at `object` while the tool is at `tcp` (both base frame).
    pub(crate) fn observe(&mut self, stamp: Stamp, tcp: &Pose, object: &Pose, symmetry: &Symmetry) {
        if self.last.is_some_and(|last| stamp.since(last) > self.config.gap) {
            self.followed = false;
            self.off = 0;
        }
        self.last = Some(stamp);
        let mut t = tcp.inverse() * object;
        if let Some(last) = &self.pose {
            t = symmetry.nearest(&t, &last.rotation);
            let (d, a) = pose_distance(&t, last);
            if d > self.config.slip {
                self.off += u32::from(self.followed);
                return;
            }
            if a > self.config.max_angle {
                return;
            }
        }
        (self.off, self.followed) = (0, true);
        if self.samples.len() < self.config.frames.max(1) {
            self.samples.push(t);
            self.pose = average(&self.samples, self.config.outlier).or(self.pose);
            return;
        }
        if let Some(last) = self.pose
            && pose_distance(&t, &last).0 < self.config.outlier
        {
            self.pose = Some(tdv_geometry::interpolate(&last, &t, self.config.rate));
        }
    }

    /// `T_tcp_object`; `None` when the object was never seen.
    pub fn pose(&self) -> Option<Pose> {
        self.pose
    }

    /// Whether all frames of the average are in.
    pub fn measured(&self) -> bool {
        self.samples.len() >= self.config.frames
    }

    /// Whether the object has been seen elsewhere for too long.
    pub(crate) fn slipped(&self) -> bool {
        self.off >= self.config.slip_frames
    }
}

/// Mean of the poses within `outlier` of the component-wise median position.
fn average(poses: &[Pose], outlier: f64) -> Option<Pose> {
    let median = Vector3::from_fn(|k, _| {
        let mut v: Vec<f64> = poses.iter().map(|p| p.translation.vector[k]).collect();
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(0.0)
    });
    let kept: Vec<&Pose> =
        poses.iter().filter(|p| (p.translation.vector - median).norm() <= outlier).collect();
    if kept.is_empty() {
        return None;
    }
    let t = kept.iter().fold(Vector3::zeros(), |s, p| s + p.translation.vector) / kept.len() as f64;
    // The mean rotation is the dominant eigenvector of the summed quaternion products.
    let mut m = Matrix4::zeros();
    for p in &kept {
        let q: Vector4<f64> = p.rotation.coords;
        m += q * q.transpose();
    }
    let e = SymmetricEigen::new(m);
    let q: Vector4<f64> = e.eigenvectors.column(e.eigenvalues.imax()).into_owned();
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::from(q));
    Some(Pose::from_parts(t.into(), rotation))
}
