//! Errors of a pose against the truth, and the figures of a sequence.

use super::scene::Kind;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;
use tdv_perception::ObjectModel;
use tdv_perception::objects::ObjectState;

/// Points of the surface that are compared.
const POINTS: usize = 250;
/// Error (m) at which a frame is worth nothing.
const WORTHLESS_M: f64 = 0.10;
/// Part hidden from which on a frame counts as occluded.
pub const OCCLUDED_FROM: f64 = 0.10;
/// Part hidden beyond which nothing is asked of a tracker.
pub const HIDDEN_FROM: f64 = 0.72;
/// Errors (m, rad) beyond which a pose is wrong.
const WRONG: (f64, f64) = (0.020, 15.0);

/// One frame of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Part (0..1) of the object that something hides.
    pub hidden: f64,
    /// Whether the pose is given as seen now.
    pub tracking: bool,
    /// Whether there is a pose at all.
    pub valid: bool,
    /// The tracker's own figure, 0..1.
    pub confidence: f64,
    /// Mean distance (mm) of surface points to the nearest one of the true surface; `None` without pose.
    pub add_s_mm: Option<f64>,
    /// Position error (mm).
    pub translation_mm: Option<f64>,
    /// Rotation error (deg), symmetry considered.
    pub rotation_deg: Option<f64>,
    /// Computing time (ms).
    pub ms: f64,
}

impl Frame {
    /// Whether the pose is off by more than 2 cm or 15 degrees.
    pub fn wrong(&self) -> bool {
        self.translation_mm.is_some_and(|t| t > 1000.0 * WRONG.0)
            || self.rotation_deg.is_some_and(|r| r > WRONG.1)
    }

    /// 1 for a perfect pose, 0 from 10 cm on and without a pose: the mean over frames is the area under
    /// the curve of accuracy over the threshold 0..10 cm.
    fn worth(&self) -> f64 {
        self.add_s_mm.map_or(0.0, |e| (1.0 - e / (1000.0 * WORTHLESS_M)).max(0.0))
    }
}

/// Compares poses of one object with the truth.
#[derive(Debug)]
pub struct Judge<'a> {
    model: &'a ObjectModel,
    points: Vec<Point3<f64>>,
}

impl<'a> Judge<'a> {
    /// For an object.
    pub fn new(model: &'a ObjectModel) -> Self {
        let all = &model.mesh.triangles;
        // Middles of triangles, evenly taken from the list: repeatable without a random number.
        let step = (all.len() as f64 / POINTS as f64).max(1.0);
        let points = (0..all.len().min(POINTS))
            .filter_map(|i| all.get((i as f64 * step) as usize))
            .filter_map(|t| {
                let corner = |k: usize| {
                    let p = model.mesh.positions.get(t[k] as usize)?;
                    Some(Point3::from(p.map(f64::from)).coords)
                };
                Some(Point3::from((corner(0)? + corner(1)? + corner(2)?) / 3.0))
            })
            .collect();
        Self { model, points }
    }

    /// ADD-S (m).
    pub fn add_s(&self, pose: &Pose, truth: &Pose) -> f64 {
        // Distances are the same in the true object's frame.
        let relative = truth.inverse() * pose;
        let sum: f64 = self
            .points
            .iter()
            .map(|p| {
                let q = relative * p;
                self.points
                    .iter()
                    .map(|r| (r - q).norm_squared())
                    .fold(f64::INFINITY, f64::min)
                    .sqrt()
            })
            .sum();
        sum / self.points.len().max(1) as f64
    }

    /// One frame.
    pub fn frame(
        &self,
        pose: Option<&Pose>,
        truth: &Pose,
        state: ObjectState,
        confidence: f64,
        hidden: f64,
        ms: f64,
    ) -> Frame {
        let valid = pose.is_some()
            && matches!(state, ObjectState::Tracking | ObjectState::Occluded | ObjectState::Held);
        let error = pose.filter(|_| valid).map(|p| {
            let (d, a) = self.model.distance(p, truth);
            (1000.0 * self.add_s(p, truth), 1000.0 * d, a.to_degrees())
        });
        Frame {
            hidden,
            tracking: state == ObjectState::Tracking,
            valid,
            confidence,
            add_s_mm: error.map(|e| e.0),
            translation_mm: error.map(|e| e.1),
            rotation_deg: error.map(|e| e.2),
            ms,
        }
    }
}

/// A sequence, frame by frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SequenceResult {
    /// Object.
    pub object: String,
    /// Number of the sequence of this object.
    pub index: usize,
    /// What happened.
    pub kind: Kind,
    /// Seed it was made from.
    pub seed: u64,
    /// Frames.
    pub frames: Vec<Frame>,
}

/// Figures over any number of sequences.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Figures {
    /// Frames.
    pub frames: usize,
    /// Frames of which less than 10 % of the object is hidden.
    pub unoccluded: usize,
    /// Of those, the share in state TRACKING, percent.
    pub confident_percent: f64,
    /// Area under the ADD-S curve over 0..10 cm, unoccluded frames, percent.
    pub auc_unoccluded: Option<f64>,
    /// The same over frames hidden by 10 to 72 %.
    pub auc_occluded: Option<f64>,
    /// Frames in state TRACKING whose pose is wrong (over 2 cm or 15 deg).
    pub wrong_confident: usize,
    /// Those, percent of all frames.
    pub wrong_confident_percent: f64,
    /// Times a correct pose was lost: a right frame followed by wrong or missing ones for over 0.3 s.
    pub losses: usize,
    /// Losses after which it became right again.
    pub recoveries: usize,
    /// Median translation error (mm) in state TRACKING.
    pub median_translation_mm: Option<f64>,
    /// Median rotation error (deg) in state TRACKING.
    pub median_rotation_deg: Option<f64>,
    /// Median computing time (ms).
    pub ms_per_frame: Option<f64>,
}

/// Frames of wrong or missing poses that make a loss.
const LOSS_FRAMES: usize = 10;

impl Figures {
    /// Sums up.
    pub fn of<'a>(sequences: impl IntoIterator<Item = &'a SequenceResult>) -> Self {
        let mut out = Self::default();
        let (mut free, mut occluded) = (Vec::new(), Vec::new());
        let (mut translation, mut rotation, mut ms) = (Vec::new(), Vec::new(), Vec::new());
        let mut confident = 0;
        for sequence in sequences {
            let (losses, recoveries) = losses(&sequence.frames);
            out.losses += losses;
            out.recoveries += recoveries;
            for f in &sequence.frames {
                out.frames += 1;
                ms.push(f.ms);
                out.wrong_confident += usize::from(f.tracking && f.wrong());
                if f.hidden < OCCLUDED_FROM {
                    free.push(f.worth());
                    confident += usize::from(f.tracking);
                } else if f.hidden < HIDDEN_FROM {
                    occluded.push(f.worth());
                }
                if f.tracking {
                    translation.extend(f.translation_mm);
                    rotation.extend(f.rotation_deg);
                }
            }
        }
        let mean =
            |v: &[f64]| (!v.is_empty()).then(|| 100.0 * v.iter().sum::<f64>() / v.len() as f64);
        out.unoccluded = free.len();
        out.confident_percent = 100.0 * confident as f64 / free.len().max(1) as f64;
        out.auc_unoccluded = mean(&free);
        out.auc_occluded = mean(&occluded);
        out.wrong_confident_percent = 100.0 * out.wrong_confident as f64 / out.frames.max(1) as f64;
        out.median_translation_mm = crate::percentile(&translation, 0.5);
        out.median_rotation_deg = crate::percentile(&rotation, 0.5);
        out.ms_per_frame = crate::percentile(&ms, 0.5);
        out
    }
}

fn losses(frames: &[Frame]) -> (usize, usize) {
    let (mut lost, mut recovered, mut bad, mut away) = (0, 0, 0, false);
    for f in frames {
        let right = f.valid && !f.wrong();
        if right {
            recovered += usize::from(away);
            (bad, away) = (0, false);
        } else {
            bad += 1;
            if bad == LOSS_FRAMES {
                lost += 1;
                away = true;
            }
        }
    }
    (lost, recovered)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{Symmetry, pose_from_xyz_rpy};
    use tdv_rendering::mesh::primitives::cylinder;

    fn frame(hidden: f64, tracking: bool, error: Option<(f64, f64)>) -> Frame {
        Frame {
            hidden,
            tracking,
            valid: error.is_some(),
            confidence: 0.9,
            add_s_mm: error.map(|e| e.0),
            translation_mm: error.map(|e| e.0),
            rotation_deg: error.map(|e| e.1),
            ms: 2.0,
        }
    }

    fn sequence(frames: Vec<Frame>) -> SequenceResult {
        SequenceResult { object: "x".into(), index: 0, kind: Kind::Free, seed: 1, frames }
    }

    #[test]
    fn figures_tell_occluded_lost_and_wrong_frames_apart() {
        let mut frames = vec![frame(0.0, true, Some((1.0, 1.0))); 10];
        frames.extend(vec![frame(0.5, true, Some((30.0, 1.0))); 5]);
        frames.extend(vec![frame(0.0, false, None); 10]);
        frames.extend(vec![frame(0.9, true, Some((1.0, 20.0))); 2]);
        frames.push(frame(0.0, true, Some((1.0, 1.0))));
        let f = Figures::of(&[sequence(frames)]);
        assert_eq!((f.frames, f.unoccluded, f.wrong_confident), (28, 21, 7));
        assert_eq!((f.losses, f.recoveries), (1, 1));
        assert!((f.confident_percent - 1100.0 / 21.0).abs() < 1e-9);
        assert!((f.auc_unoccluded.unwrap() - 99.0 * 11.0 / 21.0).abs() < 1e-9);
        assert!((f.auc_occluded.unwrap() - 70.0).abs() < 1e-9);
    }

    #[test]
    fn distance_to_the_nearest_point_ignores_what_symmetry_hides() {
        let axis = [0.0, 0.0, 1.0];
        let can = cylinder(0.03, 0.1, 48, [9; 3]);
        let model = ObjectModel::new("can", can, Symmetry::Continuous { axis });
        let judge = Judge::new(&model);
        let turned = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, std::f64::consts::TAU / 48.0 * 7.0]);
        assert!(judge.add_s(&turned, &Pose::identity()) < 1.5e-3);
        let moved = Pose::translation(0.0, 0.0, 0.05);
        let e = judge.add_s(&moved, &Pose::identity());
        assert!((0.01..0.05).contains(&e), "{e}");
    }
}
