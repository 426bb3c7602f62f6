//! The gripper's own path: procedures that move the tcp.

use super::carry::pin_ends;
use super::hand_grip::Hand;
use super::{ParseConfig, ParseReport, RepairKind, events, grasp, timed};
use crate::filter::{robust_mean, smooth};
use crate::{DemonstrationError, ProcedureDemo, ProcedureSpec, Remapped, Task, gripper_symmetry};
use tdv_geometry::{Pose, Symmetry};

/// What comes of it: the hand's smoothed path in base_link and the procedures' first and last frame.
pub(super) struct HandPath {
    path: Vec<Pose>,
    times: Vec<f64>,
    /// Frame of the window that `path` starts at.
    offset: usize,
    /// In frames of the window.
    pub bounds: Vec<[usize; 2]>,
}

/// Finds the path and its parts. `given`: first and last frame of each, where a person has said them.
pub(super) fn hand_path(
    times: &[f64],
    tools: &[Option<Remapped>],
    specs: &[ProcedureSpec],
    given: Option<&[[usize; 2]]>,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<HandPath, DemonstrationError> {
    let samples = grasp::tool_samples(tools, times, 0, times.len() - 1);
    grasp::check_gap(&samples, config, "the hand")?;
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return Err(DemonstrationError::NoHand { usable: 0, frames: times.len(), need: 3 });
    };
    let offset = times.partition_point(|t| *t < first.time);
    let span: Vec<f64> =
        times.iter().copied().filter(|t| (first.time..=last.time).contains(t)).collect();
    let missing = span.len() - samples.len();
    if missing > 0 {
        let text = "frames without a hand bridged";
        report.note(RepairKind::GapFilled, "hand", missing, 0.0, "", text);
    }
    let mut path = smooth(&samples, &span, &config.filter);
    let n = path.len();
    if let Some(bounds) = given {
        let clip = |b: &[usize; 2]| b.map(|i| i.clamp(offset, offset + n - 1));
        let bounds = bounds.iter().map(clip).collect();
        return Ok(HandPath { path, times: span, offset, bounds });
    }
    let still = |i: usize, end: &Pose| {
        let (d, a) = tdv_geometry::pose_distance(&path[i], end);
        d < 0.01 && a < 0.1
    };
    let a = (0..n).take_while(|i| still(*i, &path[0])).last().unwrap_or(0);
    let b = (a..n).rev().take_while(|i| still(*i, &path[n - 1])).last().unwrap_or(n - 1);
    if b <= a + 1 {
        return Err(DemonstrationError::ObjectNeverMoves {
            name: "hand".into(),
            moved: (path[n - 1].translation.vector - path[0].translation.vector).norm(),
            need: 0.01,
        });
    }
    // What is cut off still says where the path begins and ends.
    let (begin, end) = (robust_mean(&path[..=a]), robust_mean(&path[b..]));
    if let (Some(begin), Some(end)) = (begin, end) {
        let pinned = pin_ends(&path[a..=b], &begin.0, &end.0);
        path[a..=b].copy_from_slice(&pinned);
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
    let bounds = events::hand_bounds(&tools[offset..offset + n], &path, &span, specs, [a, b])?;
    let bounds = bounds.iter().map(|b| b.map(|i| i + offset)).collect();
    Ok(HandPath { path, times: span, offset, bounds })
}

impl HandPath {
    /// The procedures; `references`: `T_base_reference` of each. Where the hand takes hold of something, the
    /// gripper does as the task's `grasp` says.
    pub(super) fn procedures(
        &self,
        specs: &[ProcedureSpec],
        references: &[Pose],
        tools: &[Option<Remapped>],
        task: &Task,
        report: &mut ParseReport,
    ) -> Result<Vec<ProcedureDemo>, DemonstrationError> {
        let bounds: Vec<_> = self.bounds.iter().map(|b| b.map(|i| i - self.offset)).collect();
        let tools = &tools[self.offset..self.offset + self.path.len()];
        let hand = Hand { path: &self.path, times: &self.times, tools };
        let parts = hand.as_gripper(specs, &bounds, references, task, report)?;
        specs
            .iter()
            .zip(references)
            .zip(parts.iter().zip(&bounds))
            .map(|((spec, reference), (part, [a, _]))| {
                let poses: Vec<Pose> = part.iter().map(|p| reference.inverse() * p).collect();
                // A part that was shortened keeps the times from its begin.
                let times = &self.times[*a..a + poses.len()];
                Ok(ProcedureDemo {
                    name: spec.name.clone(),
                    moving: crate::TCP.into(),
                    reference: spec.reference.clone(),
                    trajectory: timed(&poses, times, &spec.name)?,
                    moving_symmetry: gripper_symmetry(),
                    reference_symmetry: Symmetry::None,
                    end: spec.end,
                    reference_pose: None,
                })
            })
            .collect()
    }
}
