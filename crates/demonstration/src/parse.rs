//! From what was seen, frame by frame, to a clean demonstration. Every repair is reported.

mod carry;
mod events;
mod grasp;
mod hand_grip;
mod hand_task;
mod input;
mod object_task;
mod recording;
mod report;
mod segments;

pub use report::{GraspChange, ParseReport, Repair, RepairKind};
pub use segments::{Segment, Segments};

use crate::filter::FilterConfig;
use crate::keyframe::KeyframeConfig;
use crate::remap::tool_track;
use crate::{Demonstration, DemonstrationError, FrameObservation, RemapConfig, Task};
use recording::Recording;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, PoseTrajectory, Stamp, TimedPose};

/// Settings of [`parse`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ParseConfig {
    /// Object poses below this confidence are dropped.
    pub min_confidence: f64,
    /// Least number of frames, and of frames that show each object.
    pub min_frames: usize,
    /// Longest stretch without the moving object, or without the hand before the grasp (s).
    pub max_gap: f64,
    /// An object that stands must not be seen tilted by more than this at its ends (deg).
    pub max_upright_deg: f64,
    /// A reference whose place changes by more than this during the recording is reported (m).
    pub reference_shift: f64,
    /// Hand to gripper.
    pub remap: RemapConfig,
    /// Events.
    pub keyframe: KeyframeConfig,
    /// Smoothing.
    pub filter: FilterConfig,
    /// Which frames belong to which procedure; none = found by parsing.
    pub segments: Option<Segments>,
}

impl Default for ParseConfig {
    fn default() -> Self {
        Self {
            min_confidence: 0.3,
            min_frames: 15,
            max_gap: 1.5,
            max_upright_deg: 40.0,
            reference_shift: 0.015,
            remap: RemapConfig::default(),
            keyframe: KeyframeConfig::default(),
            filter: FilterConfig::default(),
            segments: None,
        }
    }
}

/// Parses a recording of a task: object poses and hand joints in base_link, in order of time. Where one
/// procedure ends and the next begins is seen by what is carried, by the hand's opening and closing, and by
/// pauses, or said by [`ParseConfig::segments`]; the report has it either way.
///
/// # Errors
/// One of [`DemonstrationError`] naming what is missing: too few frames, stamps out of order, numbers
/// that are not finite, objects or hand not seen, an object that never moves or not with the hand, a gap
/// that is too long, a grasp that does not fit, a boundary that cannot be seen, a task with problems.
pub fn parse(
    frames: &[FrameObservation],
    task: &Task,
    config: &ParseConfig,
) -> Result<(Demonstration, ParseReport), DemonstrationError> {
    task.check(&format!("task '{}'", task.name))?;
    input::check(frames, config.min_frames)?;
    let mut report =
        ParseReport { task: task.name.clone(), frames: frames.len(), ..Default::default() };
    let times: Vec<f64> = frames.iter().map(|f| f.stamp.since(frames[0].stamp)).collect();
    note_stamps(&times, &mut report);
    let specs = match &config.segments {
        Some(s) => s.specs(task)?,
        None => task.sequence(),
    };
    let given = config.segments.as_ref().map(|s| s.bounds(frames)).transpose()?;
    let hands: Vec<_> = frames.iter().map(|f| f.hand).collect();
    let tools = tool_track(&hands, &config.remap);
    let recording = Recording { frames, times: &times, tools: &tools, specs: &specs, task, config };
    // Above all the reference must be there; it is looked at in each procedure.
    let reference = recording.reference(&task.reference_object, None, &mut report)?;
    let usable = tools.iter().flatten().filter(|t| t.valid).count();
    let need = (config.min_frames / 3).max(3);
    if usable < need {
        return Err(DemonstrationError::NoHand { usable, frames: frames.len(), need });
    }
    let weak: Vec<usize> =
        (0..tools.len()).filter(|i| tools[*i].is_some_and(|t| !t.valid)).collect();
    report.note_frames(
        RepairKind::HandOrientationHeld,
        "hand",
        &weak,
        weak.len() as f64,
        "frames",
        "thumb and index are nearly in line: the last orientation is carried on",
    );
    let parsed = recording.parse(&reference, given.as_deref(), &mut report)?;
    report.segments = Some(Segments::of(task, &specs, &parsed.bounds, frames));
    let demonstration = Demonstration {
        task: task.name.clone(),
        text: task.text.clone(),
        procedures: parsed.procedures,
        grasp: parsed.grasp,
        grasp_width: parsed.width,
        reference_pose: reference,
        object_start: parsed.start,
    };
    Ok((demonstration, report))
}

/// Steps between frames that are far from the usual one.
fn note_stamps(times: &[f64], report: &mut ParseReport) {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let uneven: Vec<usize>;
    {
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted[sorted.len() / 2];
        uneven = (0..steps.len()).filter(|i| (steps[*i] - usual).abs() > 0.5 * usual).collect();
        steps = sorted;
    }
    report.note_frames(
        RepairKind::UnevenStamps,
        "stamps",
        &uneven,
        steps[steps.len() - 1],
        "s",
        "steps between frames that differ by more than half from the usual one; everything is computed \
         with the stamps themselves. Magnitude is the longest",
    );
}

/// Poses with stamps counted from the first.
fn timed(poses: &[Pose], times: &[f64], what: &str) -> Result<PoseTrajectory, DemonstrationError> {
    let origin = times.first().copied().unwrap_or(0.0);
    PoseTrajectory::new(
        poses
            .iter()
            .zip(times)
            .map(|(p, t)| TimedPose { stamp: Stamp::from_secs(t - origin), pose: *p })
            .collect(),
    )
    .map_err(DemonstrationError::geometry(format!("procedure '{what}'")))
}

#[cfg(test)]
mod tests;
