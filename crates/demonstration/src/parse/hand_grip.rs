//! The gripper in place of a hand that takes hold of something: where it closes is fitted as the task's
//! `grasp` says, and while it holds it moves with what the hand has taken.

use super::ParseReport;
use super::grasp::fit;
use crate::filter::robust_mean;
use crate::{
    DemonstrationError, GraspConfig, GripperEnd, ProcedureSpec, Remapped, Task, canonical_tool,
};
use tdv_geometry::nalgebra::Vector3;
use tdv_geometry::{Pose, pose_distance};

/// A hand this near (m, rad) to a pose stands still there.
const STILL: (f64, f64) = (0.003, 0.1);
/// At most so much of the time after closing (s) is averaged.
const WINDOW: f64 = 0.4;
/// The span of thumb and index that counts as unchanged (m).
const SAME_SPAN: f64 = 0.003;

/// A hand's path in base_link and what the hand does on it, frame by frame.
pub(super) struct Hand<'a> {
    pub path: &'a [Pose],
    pub times: &'a [f64],
    pub tools: &'a [Option<Remapped>],
}

impl Hand<'_> {
    fn span(&self, i: usize) -> Option<f64> {
        self.tools.get(i)?.as_ref().map(|t| t.span)
    }

    /// Median span over some frames.
    fn usual(&self, from: usize, to: usize) -> Option<f64> {
        let mut spans: Vec<f64> = (from..=to).filter_map(|i| self.span(i)).collect();
        spans.sort_by(f64::total_cmp);
        spans.get(spans.len() / 2).copied()
    }

    /// First of these frames with about that span.
    fn reaches(&self, mut frames: impl Iterator<Item = usize>, span: f64) -> Option<usize> {
        frames.find(|i| self.span(*i).is_some_and(|s| (s - span).abs() < SAME_SPAN))
    }

    /// Mean over the frames from `at` on, at most to `last`, that stand still.
    fn rest(&self, [at, last]: [usize; 2]) -> Pose {
        let here = self.path[at];
        let still = (at..=last)
            .take_while(|i| {
                let (d, a) = pose_distance(&self.path[*i], &here);
                d < STILL.0 && a < STILL.1 && (self.times[*i] - self.times[at]).abs() <= WINDOW
            })
            .map(|i| self.path[i]);
        robust_mean(&still.collect::<Vec<_>>()).map_or(here, |m| m.0)
    }

    /// The hand's path as the gripper's, one for each procedure: first and last frame as `bounds` say, and
    /// `references` are `T_base_reference`.
    ///
    /// The fingers move in closing, and the frame that follows from their tips with them. So the way to
    /// a grip is led by the open hand, as it was before it began to close, and what is held by the closed one:
    /// each is taken as rigidly joined to the gripper.
    pub(super) fn as_gripper(
        &self,
        specs: &[ProcedureSpec],
        bounds: &[[usize; 2]],
        references: &[Pose],
        task: &Task,
        report: &mut ParseReport,
    ) -> Result<Vec<Vec<Pose>>, DemonstrationError> {
        let mut out: Vec<Vec<Pose>> =
            bounds.iter().map(|[a, b]| self.path[*a..=*b].to_vec()).collect();
        let mut k = 0;
        while k < specs.len() {
            let config = specs[k].grasp.as_ref().unwrap_or(&task.grasp);
            if specs[k].end != GripperEnd::Close || leaves_as_shown(config) {
                k += 1;
                continue;
            }
            // All procedures until it opens.
            let until = (k + 1..specs.len()).find(|j| specs[*j].end == GripperEnd::Open);
            let held = k + 1..until.map_or(specs.len(), |j| j + 1);
            let (close, end) =
                (bounds[k][1], held.clone().last().map_or(bounds[k][1], |j| bounds[j][1]));
            let closed = self.closed(close, end);
            let shown = self.rest(closed);
            let grip = references[k] * fitted(&(references[k].inverse() * shown), config, report)?;

            let open = self.still_open(bounds[k]);
            let ahead = self.path[open].inverse() * grip;
            out[k] = self.path[bounds[k][0]..=open].iter().map(|p| p * ahead).collect();
            end_at(&mut out[k], grip);

            let carry = shown.inverse() * grip;
            for j in held.clone() {
                let (a, b) = (bounds[j][0].max(closed[0]), bounds[j][1].min(closed[1]));
                if a >= b {
                    continue;
                }
                out[j] = self.path[a..=b].iter().map(|p| p * carry).collect();
                if j == k + 1 {
                    out[j][0] = grip;
                }
                if Some(j) == until {
                    end_at(&mut out[j], self.path[b] * carry);
                }
            }
            k = held.end.max(k + 1);
        }
        Ok(out)
    }

    /// First and last frame with the fingers closed, between the frames in which they have just closed and
    /// just opened (or the last).
    fn closed(&self, close: usize, open: usize) -> [usize; 2] {
        let Some(usual) = self.usual(close, open) else { return [close, open] };
        let first = self.reaches(close..=open, usual).unwrap_or(close);
        let last = self.reaches((first..=open).rev(), usual).unwrap_or(open);
        [first, last.max(first)]
    }

    /// Last frame before the fingers begin to close: the last that has the span of most of them.
    fn still_open(&self, [first, close]: [usize; 2]) -> usize {
        let late = first + (close - first) / 2;
        let Some(usual) = self.usual(late, close) else { return close };
        let last = self.reaches((first..=close).rev(), usual).unwrap_or(close);
        last.max(first + 1)
    }
}

/// Nothing is asked of the grasp but the demonstrated one.
fn leaves_as_shown(g: &GraspConfig) -> bool {
    g.closing.is_empty() && !g.centre && g.height.is_none() && g.max_tilt_deg >= 180.0
}

/// `T_reference_tcp` as the gripper can close.
fn fitted(
    shown: &Pose,
    config: &GraspConfig,
    report: &mut ParseReport,
) -> Result<Pose, DemonstrationError> {
    // The task says where in the reference's frame the axis of what is held stands.
    let [x, y] = config.middle.unwrap_or_default();
    let middle = Pose::translation(x, y, 0.0);
    let (pose, _, change) = fit(&(middle.inverse() * shown), config)?;
    report.grasp_change = change;
    report.note_grasp(&change);
    Ok(canonical_tool(&(middle * pose), shown).0)
}

/// The way up to the last pose that is not yet [`STILL`] at the end, then the end itself.
fn end_at(path: &mut Vec<Pose>, end: Pose) {
    let near = |p: &Pose| {
        let off: Vector3<f64> = p.translation.vector - end.translation.vector;
        off.norm() < STILL.0 && p.rotation.angle_to(&end.rotation) < STILL.1
    };
    let keep = path.iter().rposition(|p| !near(p)).map_or(1, |i| i + 1);
    path.truncate(keep.max(1));
    path.push(end);
}
