//! The deciding side of a trial: which procedure is on, and where the moving frame shall go. What the
//! nodes `switch_policy` and `diffusion_policy` do with a message is done here with a frame.

use super::straight::StraightLine;
use super::{Arm, Lesson, PolicyKind, Table2Error};
use std::collections::BTreeMap;
use std::sync::Arc;
use tdv_demonstration::{self as demonstration, Hold, Task};
use tdv_geometry::{Pose, Stamp, pose_distance};
use tdv_policy::{
    HistoryConfig, Observation, Observer, OpenLoop, Planner, PlannerConfig, SwitchConfig,
    SwitchCore, SwitchGuard, SwitchPolicy,
};
use tdv_robot::motion::{GripperEnd, Moving, Plan, ProcedureState};

/// As in config/switch_policy.yaml and config/diffusion_policy.yaml.
const GUARD: (f64, f64) = (0.015, 0.2);
const INFERENCE_STEPS: usize = 10;
const MAX_GAP: f64 = 0.5;
/// Seed of the sampler's noise, the same in every run as live.
const SAMPLER: u64 = 1;
/// Progress at which the progress head calls a procedure done.
const FINISHED: f32 = 0.97;
/// Controls without a switch policy: within this of the end (m, rad) for so many frames it is reached.
const ARRIVED: (f64, f64, u32) = (0.010, 0.10, 8);
/// Horizon and history of the controls, as those of the learned policy.
const CONTROL: (usize, usize) = (16, 8);

/// Where to go.
enum Mover {
    Learned(Box<Planner>),
    OpenLoop(Box<OpenLoop>),
    Straight(StraightLine),
}

/// Whether it is there.
enum Decider {
    Learned { policy: Box<SwitchPolicy>, core: SwitchCore },
    Arrival { ends: Vec<Pose>, streak: u32, state: (usize, bool) },
}

pub(super) struct Brain {
    lesson: Arc<Lesson>,
    mover: Mover,
    decider: Decider,
    /// Each node has a history of its own.
    seen_by_mover: Observer,
    seen_by_decider: Observer,
    /// What is held during each procedure.
    holds: Vec<Hold>,
    last: usize,
    /// Time spent on plans, s, and how many there were.
    pub planning: (f64, u32),
    /// Why there was no plan, if ever.
    pub note: String,
}

/// What goes to the arm controller after a frame.
pub(super) struct Decision {
    pub state: ProcedureState,
    pub plan: Option<Plan>,
}

impl Brain {
    pub fn new(
        lesson: &Arc<Lesson>,
        task: &Task,
        policy: PolicyKind,
        arm: &Arm,
    ) -> Result<Self, Table2Error> {
        let demonstration = &lesson.demonstration;
        let dt = task.generation.retime.dt;
        let ends = || -> Vec<Pose> { demonstration.procedures.iter().map(|p| p.goal()).collect() };
        let arrival = || Decider::Arrival { ends: ends(), streak: 0, state: (0, false) };
        let (mover, decider, length) = match (policy, &lesson.pupil) {
            (PolicyKind::Learned, Some(pupil)) => {
                let config = PlannerConfig {
                    inference_steps: Some(INFERENCE_STEPS),
                    ..PlannerConfig::default()
                };
                let mut planner = Planner::new(&pupil.policy, config)?;
                planner.set_encoder_cache(arm.encoder_cache);
                let config = if arm.progress {
                    SwitchConfig { threshold: FINISHED, ..SwitchConfig::default() }
                } else {
                    let guard = SwitchGuard {
                        end_poses: pupil.switch.end_poses.clone(),
                        position: GUARD.0,
                        rotation: GUARD.1,
                    };
                    SwitchConfig { guard: Some(guard), ..SwitchConfig::default() }
                };
                let core = SwitchCore::new(demonstration.procedures.len(), config)?;
                let length = planner.history_len();
                let decider = Decider::Learned { policy: Box::new(pupil.switch.clone()), core };
                (Mover::Learned(Box::new(planner)), decider, length)
            }
            (PolicyKind::Learned, None) => return Err(Table2Error::Untaught(task.name.clone())),
            (PolicyKind::StraightLine, _) => {
                let line = StraightLine::new(demonstration, CONTROL.0, dt);
                (Mover::Straight(line), arrival(), CONTROL.1)
            }
            (PolicyKind::OpenLoop, _) => {
                let play = OpenLoop::new(demonstration.clone(), task.clone(), CONTROL.0);
                (Mover::OpenLoop(Box::new(play)), arrival(), CONTROL.1)
            }
        };
        let observer =
            || Observer::new(demonstration, HistoryConfig { length, dt, max_gap: MAX_GAP });
        Ok(Self {
            lesson: lesson.clone(),
            mover,
            decider,
            seen_by_mover: observer()?,
            seen_by_decider: observer()?,
            holds: demonstration.holds(),
            last: 0,
            planning: (0.0, 0),
            note: String::new(),
        })
    }

    fn state(&self) -> (usize, bool) {
        match &self.decider {
            Decider::Learned { core, .. } => (core.procedure(), core.state().complete),
            Decider::Arrival { state, .. } => *state,
        }
    }

    /// The frame that moves in the present procedure when it is an object.
    pub fn carried(&self) -> Option<&str> {
        self.seen_by_mover.names(self.state().0).map(|n| n.1).filter(|name| *name != "tcp")
    }

    /// Procedures done so far, and whether all are.
    pub fn progress(&self) -> (usize, bool) {
        self.state()
    }

    /// Back to the first procedure, or with `regrasp` to the one that grasps what is to be held.
    pub fn reset(&mut self, regrasp: bool, now: Stamp) {
        let again = self.lesson.demonstration.retry_from(self.state().0);
        let first = if regrasp { again } else { 0 };
        match &mut self.decider {
            Decider::Learned { core, .. } => core.start_at(first, now),
            Decider::Arrival { streak, state, .. } => (*streak, *state) = (0, (first, false)),
        }
        self.seen_by_decider.reset();
    }

    /// What goes to the arm controller, as in the message of `switch_policy`.
    fn word(&self, stamp: Stamp, procedure: usize, complete: bool) -> ProcedureState {
        let tool = self.seen_by_mover.names(procedure).is_some_and(|n| n.1 == "tcp");
        let end = self.lesson.demonstration.procedures.get(procedure).map(|p| p.end);
        ProcedureState {
            stamp,
            procedure: procedure as u32,
            complete,
            grip: self.holds.get(procedure).is_some_and(|h| h.grip),
            moving: if tool { Moving::Tcp } else { Moving::Object },
            end: match end.unwrap_or_default() {
                demonstration::GripperEnd::None => GripperEnd::None,
                demonstration::GripperEnd::Close => GripperEnd::Close,
                demonstration::GripperEnd::Open => GripperEnd::Open,
            },
        }
    }

    /// One frame of poses `T_base_link_frame`; `held` as the arm controller says.
    pub fn frame(
        &mut self,
        stamp: Stamp,
        poses: &BTreeMap<String, Pose>,
        held: bool,
    ) -> Result<Decision, Table2Error> {
        let pose_of = |name: &str| poses.get(name).copied();
        if let Mover::OpenLoop(play) = &mut self.mover {
            play.look(pose_of).map_err(|e| Table2Error::Robot(e.to_string()))?;
        }
        self.decide(stamp, pose_of, held)?;
        let (procedure, complete) = self.state();
        if procedure < self.last {
            self.seen_by_mover.reset();
        }
        self.last = procedure;
        let state = self.word(stamp, procedure, complete);
        Ok(Decision { state, plan: self.plan(stamp, pose_of, procedure)? })
    }

    /// Until the gripper has closed or opened as the procedure wants it, nothing counts as its progress.
    fn decide(
        &mut self,
        stamp: Stamp,
        pose_of: impl Fn(&str) -> Option<Pose>,
        held: bool,
    ) -> Result<(), Table2Error> {
        let (procedure, complete) = self.state();
        let grip = self.holds.get(procedure).is_some_and(|h| h.grip);
        if grip != held && !complete {
            return Ok(());
        }
        let believed = |name: &str| match &self.mover {
            Mover::OpenLoop(play) => play.believed(procedure, name, pose_of(name)),
            _ => pose_of(name),
        };
        let seen = self.seen_by_decider.observe(stamp, procedure, believed)?;
        match &mut self.decider {
            Decider::Learned { policy, core } => {
                let probability = policy.probability(procedure, &seen.history)?;
                core.step(stamp, probability, &seen.canonical_pose());
            }
            Decider::Arrival { ends, streak, state } => {
                let Some(end) = ends.get(procedure) else { return Ok(()) };
                let (d, a) = pose_distance(&seen.canonical_pose(), end);
                *streak = if d < ARRIVED.0 && a < ARRIVED.1 { *streak + 1 } else { 0 };
                if *streak >= ARRIVED.2 {
                    *streak = 0;
                    *state = if procedure + 1 < ends.len() {
                        (procedure + 1, false)
                    } else {
                        (procedure, true)
                    };
                }
            }
        }
        Ok(())
    }

    fn plan(
        &mut self,
        stamp: Stamp,
        pose_of: impl Fn(&str) -> Option<Pose>,
        procedure: usize,
    ) -> Result<Option<Plan>, Table2Error> {
        let believed = |name: &str| match &self.mover {
            Mover::OpenLoop(play) => play.believed(procedure, name, pose_of(name)),
            _ => pose_of(name),
        };
        let seen = self.seen_by_mover.observe(stamp, procedure, believed)?;
        let began = std::time::Instant::now();
        let (poses, dt) = self.poses(&seen)?;
        self.planning.0 += began.elapsed().as_secs_f64();
        self.planning.1 += 1;
        if poses.is_empty() {
            return Ok(None);
        }
        let tool = self.seen_by_mover.names(procedure).is_some_and(|n| n.1 == "tcp");
        Ok(Some(Plan {
            stamp,
            procedure: procedure as u32,
            moving: if tool { Moving::Tcp } else { Moving::Object },
            reference_pose: seen.reference_pose,
            moving_pose: Some(seen.moving_pose),
            poses: seen.undo(&poses),
            dt,
        }))
    }

    fn poses(&mut self, seen: &Observation) -> Result<(Vec<Pose>, f64), Table2Error> {
        match &mut self.mover {
            Mover::Learned(planner) => {
                Ok((planner.plan(seen.procedure, &seen.history, SAMPLER)?, planner.dt()))
            }
            Mover::OpenLoop(play) => {
                let poses = play.plan(seen).unwrap_or_else(|e| {
                    // A start that the demonstration cannot be bent to: the arm stays.
                    self.note = e.to_string();
                    Vec::new()
                });
                Ok((poses, self.lesson.dt))
            }
            Mover::Straight(line) => Ok((line.plan(seen)?, self.lesson.dt)),
        }
    }
}
