//! The order of a task: prepare, follow, close, follow, open, back off, as its procedures want it.
//!
//! A procedure says whether something is held during it: the gripper closes before the first that does, and
//! opens, and the arm backs off, before the first that does not any more. What happens after the last one
//! is said by its end.

use super::controller::{ArmController, Motion};
use super::hold::Cause;
use super::planned::PlannedPath;
use super::types::{
    ControllerInput, GripperEnd, GripperFeedback, GripperRequest, Moving, ObjectPlace,
    ProcedureState, StatusCode,
};
use crate::gripper::gap_from_knuckle;
use crate::kinematics::Joints;
use crate::planner::{Goal, PlanError, PlanRequest, Planner, PlannerParams};
use tdv_geometry::{Pose, Stamp, pose_distance};

/// Peak speed of a minimum-jerk motion over its mean speed.
const PEAK: f64 = 1.875;
/// A scripted path that has not arrived this long after its time has failed (s).
const SCRIPT_PATIENCE: f64 = 3.0;
/// Duration of the shortest scripted path (s).
const LEAST_DURATION: f64 = 0.2;
/// The tracker knows of a grip this long (s) after it.
const NOTICED: f64 = 0.2;
/// The switch policy is asked again after this time (s).
const ASK_AGAIN: f64 = 1.0;

/// A path of the controller's own, in its own time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Script {
    /// Straight, minimum jerk, of the tool.
    Line { from: Pose, to: Pose, duration: f64, t: f64 },
    /// Straight in joint space.
    Joints { from: Joints, to: Joints, duration: f64, t: f64 },
    /// Along the planned path to `to`.
    Planned { to: Joints, duration: f64, t: f64 },
}

impl Script {
    fn advance(&mut self, dt: f64) {
        match self {
            Self::Line { t, .. } | Self::Joints { t, .. } | Self::Planned { t, .. } => *t += dt,
        }
    }

    /// Seconds past its end, negative before.
    fn over(&self) -> f64 {
        match self {
            Self::Line { t, duration, .. }
            | Self::Joints { t, duration, .. }
            | Self::Planned { t, duration, .. } => t - duration,
        }
    }
}

/// What follows once the gripper is open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// Begin with a procedure that needs the hand free.
    Prepare,
    /// What was held is where it belongs: back off, go on, or done after the last procedure.
    Release,
    /// Grip failed or object lost: back off, grasp again.
    Recover,
    /// Reset by the operator.
    Reset,
}

/// Where in the task the controller is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Phase {
    Start,
    Open {
        purpose: Purpose,
        sent: Option<(u32, Stamp)>,
    },
    Follow,
    Close {
        sent: Option<(u32, Stamp)>,
    },
    AwaitAttach {
        since: Stamp,
    },
    Dwell {
        since: Stamp,
    },
    Retreat {
        purpose: Purpose,
        script: Option<Script>,
    },
    /// The switch policy is to go back: to the first procedure, or to the one that grasps.
    AwaitReset {
        asked: Option<Stamp>,
        regrasp: bool,
    },
    Homing {
        script: Option<Script>,
    },
    Done,
}

impl Phase {
    pub fn reset() -> Self {
        Self::Open { purpose: Purpose::Reset, sent: None }
    }

    /// After a hold: commands are given again, scripts begin where the arm is.
    pub fn resumed(&mut self) {
        match self {
            Self::Open { sent, .. } | Self::Close { sent } => *sent = None,
            Self::Homing { script } => *script = None,
            _ => {}
        }
    }
}

/// What the gripper's feedback says about a command.
enum Answer {
    Pending,
    Contact,
    Empty(String),
}

impl ArmController {
    /// One step of the task; only called while nothing holds the arm.
    pub(super) fn advance(&mut self, now: Stamp, dt: f64, input: &ControllerInput) -> Motion {
        let Some(procedure) = input.procedure else { return self.advance_without_switch(now, dt) };
        match self.phase {
            Phase::Start => {
                self.start(input, procedure);
                Motion::Rest
            }
            Phase::Open { purpose, sent } => self.open(now, input, purpose, sent),
            Phase::Follow => self.follow(now, input, procedure),
            Phase::Close { sent } => self.close(now, input, sent),
            Phase::AwaitAttach { since } => {
                if self.object_lost(now, input) {
                    return Motion::Rest;
                }
                let grip = &self.params.grip;
                // The gripper's own path needs no object's pose in it.
                let known = procedure.moving == Moving::Tcp
                    || procedure.complete
                    || input.attach.is_some_and(|a| self.attach_usable(&a));
                if known && now.since(since) >= grip.dwell {
                    self.phase = Phase::Follow;
                }
                Motion::Rest
            }
            Phase::Dwell { since } => {
                if now.since(since) >= self.params.release_dwell {
                    self.phase = Phase::Open { purpose: Purpose::Release, sent: None };
                }
                Motion::Rest
            }
            Phase::Retreat { purpose, script } => {
                self.retreat(now, dt, purpose, script, procedure.complete)
            }
            Phase::AwaitReset { asked, regrasp } => {
                let back = if regrasp { !procedure.grip } else { procedure.procedure == 0 };
                if back && !procedure.complete {
                    self.phase = Phase::Start;
                } else if asked.is_none_or(|t| now.since(t) >= ASK_AGAIN) {
                    (self.reset_switch, self.regrasp) = (true, regrasp);
                    self.phase = Phase::AwaitReset { asked: Some(now), regrasp };
                }
                Motion::Rest
            }
            Phase::Homing { script } => self.go_home(now, dt, script),
            Phase::Done => {
                // What the task has left in the gripper is not dropped by a new beginning.
                let again = procedure.procedure == 0 && !procedure.complete && !self.held;
                if again && self.params.auto_resume {
                    self.phase = Phase::Start;
                }
                Motion::Rest
            }
        }
    }

    /// Homing needs no switch policy; everything else waits for it.
    fn advance_without_switch(&mut self, now: Stamp, dt: f64) -> Motion {
        match self.phase {
            Phase::Homing { script } => self.go_home(now, dt, script),
            _ => Motion::Rest,
        }
    }

    /// Also a restart in mid-task comes through here: the procedure and the fingers say where it was.
    fn start(&mut self, input: &ControllerInput, procedure: ProcedureState) {
        let Some(gripper) = input.gripper else { return };
        let open = self.is_open(&gripper);
        self.phase = match (procedure.complete, procedure.grip) {
            (true, _) if !open && procedure.end == GripperEnd::Open => {
                Phase::Open { purpose: Purpose::Release, sent: None }
            }
            (true, _) => Phase::Done,
            // Closing again on an object already held confirms it.
            (false, true) => Phase::Close { sent: None },
            (false, false) if open => Phase::Follow,
            (false, false) => Phase::Open { purpose: Purpose::Prepare, sent: None },
        };
    }

    fn follow(&mut self, now: Stamp, input: &ControllerInput, procedure: ProcedureState) -> Motion {
        if self.held && self.object_lost(now, input) {
            return Motion::Rest;
        }
        if procedure.complete {
            self.follower.clear();
            self.phase = match procedure.end {
                GripperEnd::Open if self.held => Phase::Dwell { since: now },
                GripperEnd::Close if !self.held => Phase::Close { sent: None },
                _ => Phase::Done,
            };
            return Motion::Rest;
        }
        if procedure.procedure != self.procedure {
            let text = format!(
                "the switch policy went back to procedure {} while an object is held",
                procedure.procedure
            );
            self.hold(now, Cause::Stale, text);
            return Motion::Rest;
        }
        if procedure.grip != self.held {
            self.follower.clear();
            self.phase = if procedure.grip {
                Phase::Close { sent: None }
            } else {
                Phase::Dwell { since: now }
            };
            return Motion::Rest;
        }
        if let Some(plan) = input.plan.as_ref().filter(|p| p.procedure == self.procedure) {
            let attach = input.attach.filter(|a| self.held && self.attach_usable(a));
            let tool = self.commanded_tool();
            let attach = attach.map(|a| a.pose);
            let result = self.follower.consider(plan, now, &tool, attach.as_ref(), &self.params);
            match result {
                Ok(true) => self.note.clear(),
                Ok(false) => {}
                Err(e) => self.note = e.to_string(),
            }
        }
        match self.follower.age(now) {
            Some(_) if now.since(procedure.stamp) > self.params.stale_after => {
                let text = format!(
                    "the switch policy's last word is {:.0} ms old, {:.0} ms is allowed",
                    now.since(procedure.stamp) * 1e3,
                    self.params.stale_after * 1e3
                );
                self.hold(now, Cause::Stale, text);
                Motion::Rest
            }
            Some(age) if age > self.params.stale_after => {
                let why =
                    if self.note.is_empty() { String::new() } else { format!("; {}", self.note) };
                let text = format!(
                    "newest usable plan is {:.0} ms old, {:.0} ms is allowed{why}",
                    age * 1e3,
                    self.params.stale_after * 1e3
                );
                self.hold(now, Cause::Stale, text);
                Motion::Rest
            }
            Some(_) => Motion::Follow,
            None => Motion::Rest, // `describe` says why
        }
    }

    fn open(
        &mut self,
        now: Stamp,
        input: &ControllerInput,
        purpose: Purpose,
        sent: Option<(u32, Stamp)>,
    ) -> Motion {
        let grip = self.params.grip.clone();
        let open = input.gripper.is_some_and(|g| self.is_open(&g));
        match sent {
            None if self.rested() >= grip.settle => {
                let id = self.command_gripper(grip.open_position);
                self.phase = Phase::Open { purpose, sent: Some((id, now)) };
            }
            Some(_) if open => {
                self.held = false;
                self.phase = match purpose {
                    Purpose::Prepare => Phase::Start,
                    Purpose::Reset => Phase::AwaitReset { asked: None, regrasp: false },
                    Purpose::Release | Purpose::Recover => Phase::Retreat { purpose, script: None },
                };
            }
            Some((_, at)) if now.since(at) > grip.open_timeout => {
                let seen = input
                    .gripper
                    .map_or("no feedback".into(), |g| format!("knuckle at {:.3} rad", g.knuckle));
                let text = format!(
                    "gripper not open {:.1} s after the command: {seen}",
                    grip.open_timeout
                );
                self.hold(now, Cause::Gripper, text);
            }
            _ => {}
        }
        Motion::Rest
    }

    fn close(&mut self, now: Stamp, input: &ControllerInput, sent: Option<(u32, Stamp)>) -> Motion {
        let grip = self.params.grip.clone();
        let Some((id, at)) = sent else {
            if self.rested() >= grip.settle {
                let id = self.command_gripper(grip.close_position);
                self.phase = Phase::Close { sent: Some((id, now)) };
            }
            return Motion::Rest;
        };
        let answer = match input.gripper.filter(|g| g.command == Some(id)) {
            Some(g) if g.stalled && gap_from_knuckle(g.knuckle) > grip.min_gap => Answer::Contact,
            Some(g) if g.stalled || g.reached => Answer::Empty(format!(
                "the fingers closed to {:.1} mm with nothing between them",
                gap_from_knuckle(g.knuckle) * 1e3
            )),
            _ if now.since(at) > grip.close_timeout => {
                Answer::Empty(format!("no contact within {:.1} s", grip.close_timeout))
            }
            _ => Answer::Pending,
        };
        match answer {
            Answer::Pending => {}
            Answer::Contact => {
                self.held = true;
                self.gripped = now;
                self.grip_gap = input.gripper.map_or(0.0, |g| gap_from_knuckle(g.knuckle));
                (self.empty_since, self.apart_since) = (None, None);
                self.phase = Phase::AwaitAttach { since: now };
            }
            Answer::Empty(why) => self.recover(format!("grip failed: {why}")),
        }
        Motion::Rest
    }

    fn retreat(
        &mut self,
        now: Stamp,
        dt: f64,
        purpose: Purpose,
        script: Option<Script>,
        complete: bool,
    ) -> Motion {
        let p = &self.params;
        let mut script = script.unwrap_or_else(|| {
            let from = self.commanded_tool();
            let to = from * Pose::translation(0.0, 0.0, -p.retreat_distance);
            let duration = (PEAK * p.retreat_distance / p.retreat_speed).max(LEAST_DURATION);
            Script::Line { from, to, duration, t: -dt }
        });
        script.advance(dt);
        self.phase = Phase::Retreat { purpose, script: Some(script) };
        if self.arrived(&script) {
            self.phase = match purpose {
                Purpose::Recover => Phase::AwaitReset { asked: None, regrasp: true },
                Purpose::Reset => Phase::AwaitReset { asked: None, regrasp: false },
                Purpose::Release | Purpose::Prepare if complete => Phase::Done,
                Purpose::Release | Purpose::Prepare => Phase::Start,
            };
            return Motion::Rest;
        }
        self.watch_script(now, &script);
        Motion::Script(script)
    }

    fn go_home(&mut self, now: Stamp, dt: f64, script: Option<Script>) -> Motion {
        let Some(state) = self.commanded_state() else { return Motion::Rest };
        let mut script = match script {
            Some(script) => script,
            // Planning takes its time: the arm rests meanwhile.
            None if self.rested() < 0.0 => return Motion::Rest,
            None => match self.way_home(&state.q, dt) {
                Ok(script) => script,
                Err(e) => {
                    self.hold(now, Cause::Refused, format!("no way home: {e}"));
                    return Motion::Rest;
                }
            },
        };
        script.advance(dt);
        self.phase = Phase::Homing { script: Some(script) };
        if self.arrived(&script) {
            self.phase = Phase::Start;
            return Motion::Rest;
        }
        self.watch_script(now, &script);
        Motion::Script(script)
    }

    /// A free path where the surroundings are known, else the straight joint line.
    fn way_home(&mut self, from: &Joints, dt: f64) -> Result<Script, PlanError> {
        let (to, t) = (self.params.home, -dt);
        let Some(world) = self.world.clone() else {
            let far = (0..6).map(|i| (to[i] - from[i]).abs()).fold(0.0, f64::max);
            let duration = (PEAK * far / self.params.home_speed).max(LEAST_DURATION);
            return Ok(Script::Joints { from: *from, to, duration, t });
        };
        let mut limits = self.params.limits.clone();
        limits.joint_velocity = self.params.home_speed;
        let planner = Planner {
            kinematics: &self.kinematics,
            world: &world,
            limits: &limits,
            params: PlannerParams::default(),
        };
        let goal = Goal::Joints(vec![to]);
        let request = PlanRequest { start: *from, goal, knuckle: self.knuckle, held: None };
        let motion = planner.plan(&request, &mut || false)?;
        self.planned = PlannedPath::new(*from, &motion.trajectory);
        Ok(Script::Planned { to, duration: self.planned.duration(), t })
    }

    fn arrived(&self, script: &Script) -> bool {
        let Some(s) = self.commanded_state() else { return false };
        let near = match script {
            Script::Line { to, .. } => {
                let (d, a) = pose_distance(&self.kinematics.fk_tcp(&s.q), to);
                d < 0.003 && a < 0.02
            }
            Script::Joints { to, .. } | Script::Planned { to, .. } => {
                (0..6).all(|i| (to[i] - s.q[i]).abs() < 0.003)
            }
        };
        near && script.over() > 0.0 && s.qd.iter().all(|v| v.abs() < 0.02)
    }

    fn watch_script(&mut self, now: Stamp, script: &Script) {
        if script.over() > SCRIPT_PATIENCE {
            let text = format!("path not finished {SCRIPT_PATIENCE:.0} s after its time");
            self.hold(now, Cause::Refused, text);
        }
    }

    fn recover(&mut self, why: String) {
        self.note = why;
        self.held = false;
        self.follower.clear();
        self.phase = Phase::Open { purpose: Purpose::Recover, sent: None };
    }

    /// True (and recovery begins) when the fingers or the camera have said for long enough that the
    /// object is held no more.
    fn object_lost(&mut self, now: Stamp, input: &ControllerInput) -> bool {
        let grip = &self.params.grip;
        let gap = input.gripper.map(|g| gap_from_knuckle(g.knuckle));
        let least = grip.min_gap.max(self.grip_gap - grip.slip_gap);
        let empty = gap.is_some_and(|gap| gap <= least);
        let word = input.object.filter(|o| o.stamp >= self.gripped.plus(NOTICED));
        let apart = word.is_some_and(|o| o.place == ObjectPlace::Apart);
        let since = |was: Option<Stamp>, is: bool| is.then(|| was.unwrap_or(now));
        self.empty_since = since(self.empty_since, empty);
        self.apart_since = since(self.apart_since, apart);
        let lasts = |since: Option<Stamp>, limit: f64| since.is_some_and(|t| now.since(t) >= limit);
        if lasts(self.empty_since, grip.lost_after) {
            let gap = gap.unwrap_or(0.0) * 1e3;
            self.recover(format!("object lost: the fingers are {gap:.1} mm apart"));
        } else if lasts(self.apart_since, grip.slip_after) {
            self.recover("object lost: the camera sees it apart from the gripper".into());
        } else {
            return false;
        }
        true
    }

    fn is_open(&self, g: &GripperFeedback) -> bool {
        g.knuckle <= self.params.grip.open_position + self.params.grip.open_tolerance
    }

    fn attach_usable(&self, a: &super::types::Attach) -> bool {
        let t = &a.pose.translation.vector;
        a.stamp >= self.gripped && t.iter().all(|v| v.is_finite()) && t.norm() < 0.4
    }

    fn command_gripper(&mut self, position: f64) -> u32 {
        self.gripper_id += 1;
        self.gripper_request = Some(GripperRequest {
            id: self.gripper_id,
            position,
            max_effort: self.params.grip.max_effort,
        });
        self.gripper_id
    }

    /// Code and sentence of the present phase.
    pub(super) fn describe(&self, now: Stamp) -> (StatusCode, String) {
        let s = self.procedure;
        match &self.phase {
            Phase::Start => {
                (StatusCode::Idle, "waiting for the switch policy and the gripper's state".into())
            }
            Phase::Open { purpose: Purpose::Prepare | Purpose::Reset, .. } => {
                (StatusCode::Preparing, "opening the gripper".into())
            }
            Phase::Open { purpose: Purpose::Release, .. } => {
                (StatusCode::Releasing, "opening the gripper at the target".into())
            }
            Phase::Dwell { .. } => (StatusCode::Releasing, "at the target".into()),
            Phase::Open { .. } => {
                (StatusCode::Recovering, format!("{}: opening the gripper", self.note))
            }
            Phase::Follow => match (self.follower.age(now), self.note.is_empty()) {
                (Some(age), true) => (
                    StatusCode::Following,
                    format!("following procedure {s}: plan {:.0} ms old", age * 1e3),
                ),
                (Some(_), false) => (
                    StatusCode::Following,
                    format!("following the last good plan of procedure {s}: {}", self.note),
                ),
                (None, true) => (StatusCode::Idle, format!("waiting for a plan of procedure {s}")),
                (None, false) => (StatusCode::HoldRefused, self.note.clone()),
            },
            Phase::Close { .. } => (StatusCode::Grasping, "closing the gripper".into()),
            Phase::AwaitAttach { since } => (
                StatusCode::AwaitingAttach,
                format!(
                    "object held for {:.1} s; waiting for its pose in the gripper",
                    now.since(*since)
                ),
            ),
            Phase::Retreat { purpose: Purpose::Recover, .. } => {
                (StatusCode::Recovering, format!("{}: backing off", self.note))
            }
            Phase::Retreat { .. } => (StatusCode::Retreating, "backing off".into()),
            Phase::AwaitReset { .. } => (
                StatusCode::Recovering,
                format!("waiting for the switch policy to go back from procedure {s}"),
            ),
            Phase::Homing { .. } => (StatusCode::Homing, "going to the home pose".into()),
            Phase::Done => (StatusCode::Done, "done".into()),
        }
    }
}
