use crate::percentile;
use serde::{Deserialize, Serialize};

/// One frame of a tracking evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackingFrame {
    /// Frame number of the data set.
    pub frame: usize,
    /// False when the tracker said that it had lost the object.
    pub tracked: bool,
    /// Distance to the reference, millimetres; `None` on frames without a usable reference.
    pub translation_mm: Option<f64>,
    /// Symmetry-aware rotation error, degrees.
    pub rotation_deg: Option<f64>,
    /// Stamp of the image to receipt of the pose, or computing time in process, milliseconds.
    pub ms: f64,
}

/// Summary of a tracking evaluation; the fields of `tdv eval tracking --json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackingSummary {
    /// Frames shown to the tracker.
    pub frames: usize,
    /// Frames at the beginning before it was sure of its first pose.
    pub initialising: usize,
    /// Frames after that on which it had no pose; all, if it never had one.
    pub lost: usize,
    /// Frames with a usable reference.
    pub compared: usize,
    /// Median translation error, millimetres.
    pub median_translation_mm: Option<f64>,
    /// 95th percentile of the translation error, millimetres.
    pub p95_translation_mm: Option<f64>,
    /// Median rotation error, degrees.
    pub median_rotation_deg: Option<f64>,
    /// 95th percentile of the rotation error, degrees.
    pub p95_rotation_deg: Option<f64>,
    /// Changes of the symmetry branch after the first pose.
    pub symmetry_jumps: usize,
    /// Median time per frame, milliseconds.
    pub ms_per_frame: Option<f64>,
}

/// Summary and frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackingReport {
    /// Figures.
    pub summary: TrackingSummary,
    /// Frame by frame.
    pub frames: Vec<TrackingFrame>,
}

impl TrackingReport {
    /// Sums up.
    pub fn new(frames: Vec<TrackingFrame>, symmetry_jumps: usize) -> Self {
        let t: Vec<f64> = frames.iter().filter_map(|f| f.translation_mm).collect();
        let r: Vec<f64> = frames.iter().filter_map(|f| f.rotation_deg).collect();
        let ms: Vec<f64> = frames.iter().map(|f| f.ms).collect();
        let found = frames.iter().position(|f| f.tracked);
        let summary = TrackingSummary {
            frames: frames.len(),
            initialising: found.unwrap_or(0),
            lost: frames[found.unwrap_or(0)..].iter().filter(|f| !f.tracked).count(),
            compared: t.len(),
            median_translation_mm: percentile(&t, 0.5),
            p95_translation_mm: percentile(&t, 0.95),
            median_rotation_deg: percentile(&r, 0.5),
            p95_rotation_deg: percentile(&r, 0.95),
            symmetry_jumps,
            ms_per_frame: percentile(&ms, 0.5),
        };
        Self { summary, frames }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_and_unusable_frames_are_counted_apart() {
        let frame = |tracked, t| TrackingFrame {
            frame: 0,
            tracked,
            translation_mm: t,
            rotation_deg: t,
            ms: 5.0,
        };
        let r = TrackingReport::new(
            vec![
                frame(false, None),
                frame(true, Some(1.0)),
                frame(true, None),
                frame(false, None),
                frame(true, Some(3.0)),
            ],
            0,
        );
        assert_eq!((r.summary.frames, r.summary.lost, r.summary.compared), (5, 1, 2));
        assert_eq!((r.summary.initialising, r.summary.median_translation_mm), (1, Some(2.0)));
        let never = TrackingReport::new(vec![frame(false, None); 3], 0);
        assert_eq!((never.summary.initialising, never.summary.lost), (0, 3));
    }
}
