use super::Segments;
use crate::Keyframes;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, pose_distance};

/// What kind of repair was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RepairKind {
    /// Observations of too little confidence left out.
    LowConfidence,
    /// Missing frames bridged by smoothing.
    GapFilled,
    /// Orientation replaced by a symmetric equivalent.
    Deflipped,
    /// Noise taken out of a path.
    Smoothed,
    /// A reference seen many times reduced to one pose, set to its canonical orientation.
    ReferenceFixed,
    /// The reference changed place during the recording.
    ReferenceMoved,
    /// An object that stands set upright at an end of its path.
    SetUpright,
    /// An object that stands set onto the table or the reference at an end of its path.
    SetOnSurface,
    /// The yaw of the target set as the task says.
    YawFixed,
    /// The path raised so that it does not go through the table.
    Raised,
    /// The set-down made vertical.
    SetDown,
    /// Standing still cut off.
    DwellTrimmed,
    /// Hand frames without a trustworthy orientation.
    HandOrientationHeld,
    /// The grasp fitted to the gripper.
    GraspFitted,
    /// The approach before the grasp was not seen and is made up.
    ApproachAdded,
    /// Release and retreat were not seen and are added.
    ReleaseAdded,
    /// Something that is not in the recording was assumed.
    Assumed,
    /// Rotation matrices made orthonormal.
    Orthonormalised,
    /// Frames that do not come at an even rate.
    UnevenStamps,
    /// Quaternions of either sign brought to one.
    DoubleCover,
}

/// One repair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Repair {
    /// Its kind.
    pub kind: RepairKind,
    /// The object, or the hand.
    pub what: String,
    /// How many frames it concerns.
    pub frames: usize,
    /// First and last frame, where that means something.
    pub range: Option<[usize; 2]>,
    /// How much, in `unit`.
    pub magnitude: f64,
    /// m, deg, frames, ...
    pub unit: String,
    /// A sentence for the report page.
    pub text: String,
}

/// How the demonstrated grasp differs from the one that is used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GraspChange {
    /// Turn of the closing axis (deg).
    pub closing_deg: f64,
    /// Turn of the approach (deg).
    pub approach_deg: f64,
    /// Sideways shift (m).
    pub sideways: f64,
    /// Shift along the object's axis (m).
    pub height: f64,
}

/// What parsing found and changed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ParseReport {
    /// Name of the task.
    pub task: String,
    /// Frames given.
    pub frames: usize,
    /// Events of the first object that is carried.
    pub keyframes: Option<Keyframes>,
    /// Which frames belong to which procedure.
    #[serde(default)]
    pub segments: Option<Segments>,
    /// Length of the object's smoothed path (m).
    pub carried: f64,
    /// The grasp's change.
    pub grasp_change: GraspChange,
    /// Every repair.
    pub repairs: Vec<Repair>,
}

impl ParseReport {
    /// The repairs of a kind.
    pub fn of(&self, kind: RepairKind) -> impl Iterator<Item = &Repair> {
        self.repairs.iter().filter(move |r| r.kind == kind)
    }

    pub(crate) fn note(
        &mut self,
        kind: RepairKind,
        what: &str,
        frames: usize,
        magnitude: f64,
        unit: &str,
        text: impl Into<String>,
    ) {
        let (what, unit) = (what.to_string(), unit.to_string());
        self.repairs.push(Repair {
            kind,
            what,
            frames,
            range: None,
            magnitude,
            unit,
            text: text.into(),
        });
    }

    /// As [`Self::note`] for listed frames; nothing if there are none.
    pub(crate) fn note_frames(
        &mut self,
        kind: RepairKind,
        what: &str,
        frames: &[usize],
        magnitude: f64,
        unit: &str,
        text: impl Into<String>,
    ) {
        if let (Some(a), Some(b)) = (frames.first(), frames.last()) {
            self.note(kind, what, frames.len(), magnitude, unit, text);
            if let Some(r) = self.repairs.last_mut() {
                r.range = Some([*a, *b]);
            }
        }
    }

    /// What was changed in fitting a grasp to the gripper.
    pub(super) fn note_grasp(&mut self, change: &GraspChange) {
        for (v, unit, text) in [
            (
                change.closing_deg,
                "deg",
                "closing axis turned to the nearest the gripper can close along",
            ),
            (change.approach_deg, "deg", "approach turned towards straight down"),
            (
                change.sideways,
                "m",
                "moved sideways so that the object's axis is between the fingers",
            ),
            (change.height, "m", "height on the object moved into the allowed range"),
        ] {
            if v.abs() > 1e-6 {
                self.note(RepairKind::GraspFitted, "grasp", 1, v, unit, text);
            }
        }
    }

    pub(super) fn note_smoothing(&mut self, what: &str, seen: &[(usize, Pose, f64)], out: &[Pose]) {
        let mut change: Vec<f64> =
            seen.iter().map(|(i, p, _)| pose_distance(p, &out[*i]).0).collect();
        change.sort_by(f64::total_cmp);
        let p95 = change.get(change.len() * 95 / 100).copied().unwrap_or(0.0);
        self.note(
            RepairKind::Smoothed,
            what,
            seen.len(),
            p95,
            "m",
            "local quadratic smoothing, outliers held off; magnitude is the 95th percentile of the change",
        );
    }

    pub(super) fn trimmed(&mut self, contact: usize, onset: usize, settled: usize, last: usize) {
        for (a, b, text) in [
            (contact, onset, "the hand rests on the object before it lifts it: cut out"),
            (settled, last, "the object stands at its target before it is released: cut off"),
        ] {
            let frames: Vec<usize> = (a + 1..=b).collect();
            self.note_frames(
                RepairKind::DwellTrimmed,
                "dwell",
                &frames,
                frames.len() as f64,
                "frames",
                text,
            );
        }
    }
}
