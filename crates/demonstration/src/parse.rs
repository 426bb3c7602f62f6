//! From what was seen, frame by frame, to a clean demonstration. Every repair is reported.

mod carry;
mod grasp;
mod input;
mod report;

pub use report::{GraspChange, ParseReport, Repair, RepairKind};

use crate::filter::{FilterConfig, Sample, deflip, robust_mean, smooth};
use crate::keyframe::{self, KeyframeConfig};
use crate::remap::tool_track;
use crate::{
    Demonstration, DemonstrationError, FrameObservation, ProcedureDemo, RemapConfig, Remapped,
    Task, TaskKind, gripper_symmetry,
};
use serde::{Deserialize, Serialize};
use tdv_geometry::nalgebra::Point3;
use tdv_geometry::{Pose, PoseTrajectory, Stamp, Symmetry, TimedPose};

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
        }
    }
}

/// Parses a recording of a task: object poses and hand joints in base_link, in order of time.
///
/// # Errors
/// One of [`DemonstrationError`] naming what is missing: too few frames, stamps out of order, numbers
/// that are not finite, objects or hand not seen, an object that never moves or not with the hand, a gap
/// that is too long, a grasp that does not fit, a task with problems.
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
    let reference = input::reference(frames, task, config, &mut report)?;
    let hands: Vec<_> = frames.iter().map(|f| f.hand).collect();
    let tools = tool_track(&hands, &config.remap);
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
    let procedures = match task.kind {
        TaskKind::Hand => {
            return follow(&times, &tools, &reference, task, config, report);
        }
        TaskKind::Object => {
            object_task(frames, &times, &tools, &reference, task, config, &mut report)?
        }
    };
    let (procedures, grasp, width, object_start) = procedures;
    let demonstration = Demonstration {
        task: task.name.clone(),
        text: task.text.clone(),
        procedures,
        grasp: Some(grasp),
        grasp_width: width,
        reference_pose: reference,
        object_start: Some(object_start),
    };
    Ok((demonstration, report))
}

type ObjectParts = (Vec<ProcedureDemo>, Pose, Option<f64>, Pose);

fn object_task(
    frames: &[FrameObservation],
    times: &[f64],
    tools: &[Option<Remapped>],
    reference: &Pose,
    task: &Task,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<ObjectParts, DemonstrationError> {
    let missing = |name: &str| DemonstrationError::Invalid {
        what: format!("task '{}'", task.name),
        problems: vec![format!("objects has no entry for '{name}'")],
    };
    let name = &task.moving_object;
    let shape = task.moving_shape().ok_or_else(|| missing(name))?;
    let reference_shape = task.reference_shape().ok_or_else(|| missing(&task.reference_object))?;
    let mut seen = input::object(frames, name, config, report)?;

    // One orientation out of the equivalent ones.
    let mut poses: Vec<Pose> = seen.iter().map(|s| s.1).collect();
    let near = poses[0].rotation;
    let (flips, angle) = deflip(&mut poses, &shape.symmetry, &near);
    for (s, p) in seen.iter_mut().zip(&poses) {
        s.1 = *p;
    }
    if flips > 0 {
        report.note(
            RepairKind::Deflipped,
            name,
            flips,
            angle.to_degrees(),
            "deg",
            "orientations replaced by their symmetric equivalent nearest to the frame before",
        );
    }
    input::bridge(&seen, times, name, config, report)?;

    let positions = {
        let mut v: Vec<Option<Point3<f64>>> = vec![None; frames.len()];
        for (i, p, _) in &seen {
            v[*i] = Some(p.translation.vector.into());
        }
        v
    };
    let tips: Vec<Option<Point3<f64>>> = tools.iter().map(|t| t.map(|t| t.tips)).collect();
    let keys = keyframe::detect(name, times, &positions, &tips, &config.keyframe)?;
    report.keyframes = Some(keys);

    let samples: Vec<Sample> = seen
        .iter()
        .map(|(i, pose, weight)| Sample { time: times[*i], pose: *pose, weight: *weight })
        .collect();
    let smoothed = smooth(&samples, times, &config.filter);
    report.note_smoothing(name, &seen, &smoothed);

    // Where it rests: all frames before, all frames after the carry.
    let within = |range: std::ops::RangeInclusive<usize>| -> Vec<Pose> {
        seen.iter().filter(|(i, ..)| range.contains(i)).map(|s| s.1).collect()
    };
    let last = keys.release.unwrap_or(frames.len() - 1).max(keys.settled);
    let start = robust_mean(&within(0..=keys.onset)).map_or(smoothed[keys.onset], |m| m.0);
    let end = robust_mean(&within(keys.settled..=last)).map_or(smoothed[keys.settled], |m| m.0);
    let ends =
        carry::rest_ends(&start, &end, reference, task, shape, reference_shape, config, report)?;

    let place =
        carry::place(&smoothed, times, &keys, &ends, reference, shape, reference_shape, report)?;

    let (grasp, width) =
        grasp::grasp(&seen, &smoothed, tools, times, &keys, &ends.0, task, report)?;
    let reach = grasp::reach(tools, times, &keys, &ends.0, &grasp, config, report)?;

    if keys.release.is_none() {
        report.note(
            RepairKind::ReleaseAdded,
            name,
            0,
            0.0,
            "",
            "the recording ends before the hand lets go: release and retreat are added",
        );
    }
    report.trimmed(keys.contact, keys.onset, keys.settled, last);
    let procedures = vec![
        ProcedureDemo {
            name: "reach".into(),
            moving: "tcp".into(),
            reference: name.clone(),
            trajectory: reach,
            moving_symmetry: gripper_symmetry(),
            reference_symmetry: shape.symmetry.clone(),
        },
        ProcedureDemo {
            name: "place".into(),
            moving: name.clone(),
            reference: task.reference_object.clone(),
            trajectory: place,
            moving_symmetry: shape.symmetry.clone(),
            reference_symmetry: Symmetry::None,
        },
    ];
    Ok((procedures, grasp, width, ends.0))
}

/// A hand task: the gripper's path seen from the reference, standing still cut off at both ends.
fn follow(
    times: &[f64],
    tools: &[Option<Remapped>],
    reference: &Pose,
    task: &Task,
    config: &ParseConfig,
    mut report: ParseReport,
) -> Result<(Demonstration, ParseReport), DemonstrationError> {
    let samples = grasp::tool_samples(tools, times, 0, times.len() - 1);
    grasp::check_gap(&samples, config, "the hand")?;
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return Err(DemonstrationError::NoHand { usable: 0, frames: times.len(), need: 3 });
    };
    let span: Vec<f64> =
        times.iter().copied().filter(|t| (first.time..=last.time).contains(t)).collect();
    let path: Vec<Pose> =
        smooth(&samples, &span, &config.filter).iter().map(|p| reference.inverse() * p).collect();
    let still = |i: usize, end: &Pose| {
        let (d, a) = tdv_geometry::pose_distance(&path[i], end);
        d < 0.01 && a < 0.1
    };
    let n = path.len();
    let a = (0..n).take_while(|i| still(*i, &path[0])).last().unwrap_or(0);
    let b = (a..n).rev().take_while(|i| still(*i, &path[n - 1])).last().unwrap_or(n - 1);
    if b <= a + 1 {
        return Err(DemonstrationError::ObjectNeverMoves {
            name: "hand".into(),
            moved: (path[n - 1].translation.vector - path[0].translation.vector).norm(),
            need: 0.01,
        });
    }
    if a + (n - 1 - b) > 0 {
        report.note(
            RepairKind::DwellTrimmed,
            "hand",
            a + (n - 1 - b),
            0.0,
            "",
            "frames of standing still cut off at the ends",
        );
    }
    let trajectory = timed(&path[a..=b], &span[a..=b], "follow")?;
    let demonstration = Demonstration {
        task: task.name.clone(),
        text: task.text.clone(),
        procedures: vec![ProcedureDemo {
            name: "follow".into(),
            moving: "tcp".into(),
            reference: task.reference_object.clone(),
            trajectory,
            moving_symmetry: gripper_symmetry(),
            reference_symmetry: Symmetry::None,
        }],
        grasp: None,
        grasp_width: None,
        reference_pose: *reference,
        object_start: None,
    };
    Ok((demonstration, report))
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
