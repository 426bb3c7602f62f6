//! One object grasped and carried: a reach and the procedures that move the object.

use super::input::{self, Seen};
use super::{ParseConfig, ParseReport, RepairKind, carry, events, grasp, timed};
use crate::filter::{Sample, deflip, robust_mean, smooth};
use crate::keyframe::{self, Keyframes};
use crate::{
    DemonstrationError, FrameObservation, GripperEnd, ObjectShape, ProcedureDemo, ProcedureSpec,
    Remapped, Task, gripper_symmetry,
};
use tdv_geometry::nalgebra::Point3;
use tdv_geometry::{Pose, Symmetry};

/// Turn (rad) from the last orientation within which what is held to the end has come to rest.
const SETTLED_TURN: f64 = 0.1;

/// The frames of one object's procedures.
pub(super) struct Window<'a> {
    pub frames: &'a [FrameObservation],
    pub times: &'a [f64],
    pub tools: &'a [Option<Remapped>],
    /// First and last frame of each procedure, where a person has said them.
    pub given: Option<Vec<[usize; 2]>>,
}

/// What comes of it.
pub(super) struct Carried {
    pub procedures: Vec<ProcedureDemo>,
    pub grasp: Pose,
    pub width: Option<f64>,
    /// `T_base_object` before the grasp.
    pub start: Pose,
    pub keys: Keyframes,
    /// First and last frame of each procedure, in the window.
    pub bounds: Vec<[usize; 2]>,
}

fn shape_of<'a>(task: &'a Task, name: &str) -> Result<&'a ObjectShape, DemonstrationError> {
    task.objects.get(name).ok_or_else(|| DemonstrationError::Invalid {
        what: format!("task '{}'", task.name),
        problems: vec![format!("objects has no entry for '{name}'")],
    })
}

/// The object's usable poses, one orientation out of the equivalent ones.
pub(super) fn seen(
    frames: &[FrameObservation],
    name: &str,
    shape: &ObjectShape,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<Vec<Seen>, DemonstrationError> {
    let mut seen = input::object(frames, name, config, report)?;
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
    Ok(seen)
}

/// The events of an object that is carried somewhere in these frames.
pub(super) fn keyframes(
    name: &str,
    seen: &[Seen],
    times: &[f64],
    tools: &[Option<Remapped>],
    config: &ParseConfig,
) -> Result<Keyframes, DemonstrationError> {
    let mut positions: Vec<Option<Point3<f64>>> = vec![None; times.len()];
    for (i, p, _) in seen {
        positions[*i] = Some(p.translation.vector.into());
    }
    let tips: Vec<Option<Point3<f64>>> = tools.iter().map(|t| t.map(|t| t.tips)).collect();
    keyframe::detect(name, times, &positions, &tips, &config.keyframe)
}

/// The events as a person has set them.
fn given_keyframes(bounds: &[[usize; 2]], frames: usize, lands: bool) -> Keyframes {
    let settled = bounds.last().map_or(frames - 1, |b| b[1]);
    Keyframes {
        contact: bounds[0][1],
        onset: bounds.get(1).map_or(bounds[0][1], |b| b[0]),
        settled,
        // What was set down rests until the next procedure.
        release: (!lands).then_some(settled),
        jitter: 0.0,
        hold_distance: 0.0,
        evidence: 1.0,
    }
}

/// Parses the reach `specs[0]` and the procedures after it, which move the object. `references`:
/// `T_base_reference` of each.
pub(super) fn object_task(
    window: &Window<'_>,
    specs: &[ProcedureSpec],
    references: &[Pose],
    task: &Task,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<Carried, DemonstrationError> {
    let (frames, times, tools) = (window.frames, window.times, window.tools);
    let (reach_spec, moves) = (&specs[0], &specs[1..]);
    let name = &reach_spec.reference;
    let (Some(last_spec), Some(last_reference)) = (moves.last(), references.last()) else {
        return Err(DemonstrationError::NoBoundary {
            procedure: reach_spec.name.clone(),
            reason: "nothing is carried after it".into(),
        });
    };
    let shape = shape_of(task, name)?;
    let reference_shape = shape_of(task, &last_spec.reference)?;
    let lands = last_spec.end == GripperEnd::Open;
    let seen = seen(frames, name, shape, config, report)?;
    input::bridge(&seen, times, name, config, report)?;
    let mut keys = match &window.given {
        Some(bounds) => given_keyframes(bounds, frames.len(), lands),
        None => keyframes(name, &seen, times, tools, config)?,
    };
    let samples: Vec<Sample> = seen
        .iter()
        .map(|(i, pose, weight)| Sample { time: times[*i], pose: *pose, weight: *weight })
        .collect();
    let smoothed = smooth(&samples, times, &config.filter);
    report.note_smoothing(name, &seen, &smoothed);
    if !lands && window.given.is_none() {
        // What is not set down may still turn where it has come to.
        let end = smoothed[smoothed.len() - 1].rotation;
        let turning = (keys.onset..smoothed.len())
            .rev()
            .find(|i| smoothed[*i].rotation.angle_to(&end) > SETTLED_TURN);
        keys.settled = keys.settled.max(turning.map_or(0, |i| i + 1)).min(smoothed.len() - 1);
        keys.release = keys.release.filter(|r| *r > keys.settled);
    }

    // Where it rests: all frames before, all frames after the carry.
    let within = |range: std::ops::RangeInclusive<usize>| -> Vec<Pose> {
        seen.iter().filter(|(i, ..)| range.contains(i)).map(|s| s.1).collect()
    };
    let last = keys.release.unwrap_or(frames.len() - 1).max(keys.settled);
    let start = robust_mean(&within(0..=keys.onset)).map_or(smoothed[keys.onset], |m| m.0);
    let rests = lands || window.given.is_none();
    let end = robust_mean(&within(keys.settled..=last)).filter(|_| rests);
    let end = end.map_or(smoothed[keys.settled], |m| m.0);
    let carry = carry::Carry {
        name,
        shape,
        reference: last_reference,
        reference_shape,
        target_yaw: last_spec.target_yaw.unwrap_or(task.target_yaw),
        lands,
    };
    let ends = carry.rest_ends(&start, &end, config, report)?;
    let path = carry.path(&smoothed, times, &keys, &ends, report);
    let carry_times = &times[keys.onset..=keys.settled];
    let cuts: Vec<usize> = match &window.given {
        Some(bounds) => bounds[2..].iter().map(|b| b[0] - keys.onset).collect(),
        None => events::pauses(&path, carry_times, moves.len() - 1, &moves[0].name)?,
    };

    let fit = reach_spec.grasp.as_ref().unwrap_or(&task.grasp);
    let (grasp, width) = grasp::grasp(&seen, &smoothed, tools, times, &keys, &ends.0, fit, report)?;
    let reach = grasp::reach(tools, times, &keys, &ends.0, &grasp, config, report)?;
    if lands && keys.release.is_none() && window.given.is_none() {
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

    let first = tools[..=keys.contact].iter().position(|t| t.is_some_and(|t| t.valid));
    let first = first.unwrap_or(0).min(keys.contact.saturating_sub(1));
    let mut bounds = vec![[first, keys.contact.max(1)]];
    let mut procedures = vec![ProcedureDemo {
        name: reach_spec.name.clone(),
        moving: crate::TCP.into(),
        reference: name.clone(),
        trajectory: reach,
        moving_symmetry: gripper_symmetry(),
        reference_symmetry: shape.symmetry.clone(),
        end: reach_spec.end,
        reference_pose: None,
    }];
    let mut from = 0;
    let ends_at = cuts.iter().copied().chain([path.len() - 1]);
    for ((spec, reference), to) in moves.iter().zip(&references[1..]).zip(ends_at) {
        let turn = reference.inverse() * last_reference;
        let piece: Vec<Pose> = path[from..=to].iter().map(|p| turn * p).collect();
        procedures.push(ProcedureDemo {
            name: spec.name.clone(),
            moving: name.clone(),
            reference: spec.reference.clone(),
            trajectory: timed(&piece, &carry_times[from..=to], &spec.name)?,
            moving_symmetry: shape.symmetry.clone(),
            reference_symmetry: Symmetry::None,
            end: spec.end,
            reference_pose: None,
        });
        bounds.push([keys.onset + from, keys.onset + to]);
        from = to;
    }
    Ok(Carried { procedures, grasp, width, start: ends.0, keys, bounds })
}
