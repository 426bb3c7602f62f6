//! A recording cut into the procedures of its task.

use super::hand_task::hand_path;
use super::object_task::{self, Window, object_task};
use super::{ParseConfig, ParseReport, input};
use crate::sequence::{Role, Step, role};
use crate::{
    DemonstrationError, FrameObservation, Keyframes, ProcedureDemo, ProcedureSpec, Remapped, TCP,
    Task,
};
use std::ops::Range;
use tdv_geometry::{Pose, pose_distance};

pub(super) struct Recording<'a> {
    pub frames: &'a [FrameObservation],
    pub times: &'a [f64],
    pub tools: &'a [Option<Remapped>],
    pub specs: &'a [ProcedureSpec],
    pub task: &'a Task,
    pub config: &'a ParseConfig,
}

#[derive(Default)]
pub(super) struct Parsed {
    pub procedures: Vec<ProcedureDemo>,
    /// First and last frame of each.
    pub bounds: Vec<[usize; 2]>,
    pub grasp: Option<Pose>,
    pub width: Option<f64>,
    pub start: Option<Pose>,
}

/// Procedures that are found together.
struct Block {
    specs: Range<usize>,
    /// The object that is grasped and carried; none for the hand's own path.
    object: Option<String>,
}

impl Recording<'_> {
    fn blocks(&self) -> Vec<Block> {
        let steps: Vec<Step<'_>> = self.specs.iter().map(Step::from).collect();
        let mut blocks: Vec<Block> = Vec::new();
        for (i, s) in self.specs.iter().enumerate() {
            let reach = role(&steps, i) == Role::Reach;
            match blocks.last_mut() {
                Some(b) if !reach && (s.moving == TCP) == b.object.is_none() => {
                    b.specs.end = i + 1;
                }
                _ => {
                    let object = reach.then(|| s.reference.clone());
                    blocks.push(Block { specs: i..i + 1, object });
                }
            }
        }
        blocks
    }

    /// `T_base_reference`, from all frames, or only from some where the object is not always at one place.
    pub(super) fn reference(
        &self,
        name: &str,
        frames: Option<Range<usize>>,
        report: &mut ParseReport,
    ) -> Result<Pose, DemonstrationError> {
        let frames = &self.frames[frames.unwrap_or(0..self.frames.len())];
        let symmetry = self.task.objects.get(name).map(|s| s.symmetry.clone()).unwrap_or_default();
        input::reference(frames, name, &symmetry, self.config, report)
    }

    /// As [`Self::reference`] for a procedure of a task that lists its own: the frames of the procedure
    /// count where the object is moved elsewhere in the recording.
    fn reference_during(
        &self,
        spec: &ProcedureSpec,
        frames: Range<usize>,
        main: &Pose,
        report: &mut ParseReport,
    ) -> Result<Pose, DemonstrationError> {
        if self.task.procedures.is_empty() {
            return Ok(*main);
        }
        let name = &spec.reference;
        let carried = self.specs.iter().any(|s| s.moving == *name);
        let mut ignored = ParseReport::default();
        let all = self.reference(name, None, &mut ignored)?;
        let during = self.reference(name, Some(frames), &mut ignored);
        let moved = |p: &Pose| pose_distance(p, &all).0 > self.config.reference_shift;
        match during {
            Ok(p) if carried || moved(&p) => Ok(p),
            // Hidden by the hand: what all frames say.
            _ if *name == self.task.reference_object => Ok(*main),
            _ => {
                report.repairs.append(&mut ignored.repairs);
                Ok(all)
            }
        }
    }

    /// Events of every object that is carried, over the whole recording: roughly when.
    fn rough(&self, blocks: &[Block]) -> Result<Vec<Option<Keyframes>>, DemonstrationError> {
        let mut ignored = ParseReport::default();
        let mut names: Vec<&str> = Vec::new();
        let mut out = Vec::new();
        for b in blocks {
            let Some(name) = b.object.as_deref().filter(|_| blocks.len() > 1) else {
                out.push(None);
                continue;
            };
            if names.contains(&name) {
                return Err(DemonstrationError::NoBoundary {
                    procedure: self.specs[b.specs.start].name.clone(),
                    reason: format!("'{name}' is carried more than once"),
                });
            }
            names.push(name);
            let Some(shape) = self.task.objects.get(name) else {
                out.push(None);
                continue;
            };
            let seen = object_task::seen(self.frames, name, shape, self.config, &mut ignored)?;
            let keys = object_task::keyframes(name, &seen, self.times, self.tools, self.config)?;
            out.push(Some(keys));
        }
        let onsets: Vec<usize> = out.iter().flatten().map(|k| k.onset).collect();
        if let Some(i) = onsets.windows(2).position(|w| w[1] <= w[0]) {
            return Err(DemonstrationError::Invalid {
                what: "demonstration".into(),
                problems: vec![format!(
                    "'{}' is carried before '{}', the task has them the other way round",
                    names[i + 1],
                    names[i]
                )],
            });
        }
        Ok(out)
    }

    /// All procedures; `reference`: the task's reference object; `given`: first and last frame of each
    /// procedure.
    pub(super) fn parse(
        &self,
        reference: &Pose,
        given: Option<&[[usize; 2]]>,
        report: &mut ParseReport,
    ) -> Result<Parsed, DemonstrationError> {
        let blocks = self.blocks();
        let rough = if given.is_some() { vec![None; blocks.len()] } else { self.rough(&blocks)? };
        let n = self.frames.len();
        let mut out = Parsed::default();
        let mut begin = 0;
        for (b, block) in blocks.iter().enumerate() {
            let specs = &self.specs[block.specs.clone()];
            let after = given.and_then(|g| g.get(block.specs.end)).map_or(n, |b| b[0].max(1));
            let given = given.map(|g| &g[block.specs.clone()]);
            let next = rough.get(b + 1).copied().flatten();
            // Up to where the next object begins to move; a hand's path up to where it is touched.
            let end = match (given, next, &block.object) {
                (Some(g), ..) => after.max(g[g.len() - 1][1] + 1),
                (None, Some(k), Some(_)) => k.onset + 1,
                (None, Some(k), None) => k.contact + 1,
                (None, None, _) => n,
            };
            let begin_at =
                given.map_or(begin, |g| if block.object.is_some() { g[0][0] } else { 0 });
            let window = begin_at..end.max(begin_at + 1).min(n);
            let local = given.map(|g| g.iter().map(|b| b.map(|i| i - window.start)).collect());
            begin = match &block.object {
                Some(_) => self.carried(specs, window, local, reference, &mut out, report)?,
                None => self.hand(specs, window, local, reference, &mut out, report)?,
            };
        }
        Ok(out)
    }

    /// One object; gives the frame from which on the next procedures are looked for.
    fn carried(
        &self,
        specs: &[ProcedureSpec],
        window: Range<usize>,
        given: Option<Vec<[usize; 2]>>,
        main: &Pose,
        out: &mut Parsed,
        report: &mut ParseReport,
    ) -> Result<usize, DemonstrationError> {
        let mut references = vec![Pose::identity()];
        for s in &specs[1..] {
            references.push(self.reference_during(s, window.clone(), main, report)?);
        }
        let part = Window {
            frames: &self.frames[window.clone()],
            times: &self.times[window.clone()],
            tools: &self.tools[window.clone()],
            given,
        };
        let mut c = object_task(&part, specs, &references, self.task, self.config, report)?;
        let first = out.grasp.is_none();
        for (p, r) in c.procedures.iter_mut().zip(&references).skip(1) {
            p.reference_pose = Some(*r).filter(|r| r != main);
        }
        if first {
            (out.grasp, out.width, out.start) = (Some(c.grasp), c.width, Some(c.start));
            report.keyframes = Some(c.keys.moved(window.start));
        } else {
            c.procedures[0].reference_pose = Some(c.start);
        }
        out.procedures.append(&mut c.procedures);
        out.bounds.extend(c.bounds.iter().map(|b| b.map(|i| i + window.start)));
        Ok(window.start + c.keys.release.unwrap_or(c.keys.settled))
    }

    /// The hand's own path; gives the frame after it.
    fn hand(
        &self,
        specs: &[ProcedureSpec],
        window: Range<usize>,
        given: Option<Vec<[usize; 2]>>,
        main: &Pose,
        out: &mut Parsed,
        report: &mut ParseReport,
    ) -> Result<usize, DemonstrationError> {
        let (times, tools) = (&self.times[window.clone()], &self.tools[window.clone()]);
        let path = hand_path(times, tools, specs, given.as_deref(), self.config, report)?;
        let mut references = Vec::new();
        for (s, [a, b]) in specs.iter().zip(&path.bounds) {
            let frames = window.start + a..window.start + b + 1;
            references.push(self.reference_during(s, frames, main, report)?);
        }
        let mut procedures = path.procedures(specs, &references, tools, self.task, report)?;
        for (p, r) in procedures.iter_mut().zip(&references) {
            p.reference_pose = Some(*r).filter(|r| r != main);
        }
        out.procedures.append(&mut procedures);
        out.bounds.extend(path.bounds.iter().map(|b| b.map(|i| i + window.start)));
        Ok(path.bounds.last().map_or(window.start, |b| window.start + b[1]))
    }
}
