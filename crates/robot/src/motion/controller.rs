use super::hold::{Cause, Hold};
use super::law::{self, MotionState};
use super::params::ControllerParams;
use super::plan::PlanFollower;
use super::planned::PlannedPath;
use super::projection::{Around, Projection, Target, project};
use super::sequence::{Phase, Script};
use super::types::{
    ControllerInput, ControllerOutput, GripperRequest, JointPath, JointState, Status, StatusCode,
};
use crate::collision::{CollisionWorld, fingertip_height};
use crate::gripper::KNUCKLE_CLOSED;
use crate::kinematics::{Joints, Kinematics};
use std::f64::consts::TAU;
use std::sync::Arc;
use tdv_geometry::{Pose, Stamp};

/// A hold for a passing cause is not ended by `auto_resume` before this time (s).
const LEAST_HOLD: f64 = 0.25;
/// A speed scaling below this counts as a stopped robot.
pub(super) const STOPPED: f64 = 0.01;

/// The arm controller; call [`ArmController::step`] at the period `tick`.
///
/// What it commands is always a point of the last trajectory that it sent: between trajectories, and
/// when none goes out any more, it assumes what a driver does, which is to carry on to that
/// trajectory's end, where the arm is at rest.
#[derive(Debug, Clone)]
pub struct ArmController {
    pub(super) params: ControllerParams,
    pub(super) kinematics: Kinematics,
    pub(super) phase: Phase,
    pub(super) follower: PlanFollower,
    pub(super) held: bool,
    pub(super) procedure: u32,
    pub(super) gripper_id: u32,
    /// When the grip was confirmed.
    pub(super) gripped: Stamp,
    /// Since when the pads are closed on nothing while holding.
    pub(super) empty_since: Option<Stamp>,
    /// Gap of the pads (m) at the grip.
    pub(super) grip_gap: f64,
    /// Since when the camera sees the object apart from the gripper while it should be held.
    pub(super) apart_since: Option<Stamp>,
    pub(super) note: String,
    pub(super) reset_switch: bool,
    pub(super) regrasp: bool,
    pub(super) gripper_request: Option<GripperRequest>,
    pub(super) hold: Option<Hold>,
    /// What the arm may run into, besides the table.
    pub(super) world: Option<Arc<CollisionWorld>>,
    /// Newest knuckle angle (rad); closed until it is known.
    pub(super) knuckle: f64,
    pub(super) planned: PlannedPath,
    held_since: Stamp,
    pub(super) commanded: Option<Commanded>,
    refused: Option<(Stamp, String)>,
    pub(super) stuck_since: Option<Stamp>,
    ticks: u64,
    last: Option<Stamp>,
}

/// The last trajectory sent and how far the driver is along it.
#[derive(Debug, Clone)]
pub(super) struct Commanded {
    path: Projection,
    elapsed: f64,
}

/// What a phase wants of the arm in this step.
pub(super) enum Motion {
    /// Nothing new: the last trajectory runs out.
    Rest,
    /// The plan in use.
    Follow,
    /// A path of its own.
    Script(Script),
}

impl ArmController {
    /// A controller for an arm; nothing moves before the first joint state.
    ///
    /// # Errors
    /// What [`ControllerParams::validate`] finds.
    pub fn new(kinematics: Kinematics, params: ControllerParams) -> Result<Self, Vec<String>> {
        params.validate()?;
        let hold = (!params.auto_resume).then(|| Hold {
            cause: Cause::Ready,
            sentence: "ready: call ~/resume to start".into(),
        });
        Ok(Self {
            params,
            kinematics,
            phase: Phase::Start,
            follower: PlanFollower::default(),
            held: false,
            procedure: 0,
            gripper_id: 0,
            gripped: Stamp::default(),
            empty_since: None,
            grip_gap: 0.0,
            apart_since: None,
            note: String::new(),
            reset_switch: false,
            regrasp: false,
            gripper_request: None,
            hold,
            world: None,
            knuckle: KNUCKLE_CLOSED,
            planned: PlannedPath::default(),
            held_since: Stamp::default(),
            commanded: None,
            refused: None,
            stuck_since: None,
            ticks: 0,
            last: None,
        })
    }

    /// The same arm among what it may run into: every path is checked against it, and the way home leads
    /// around it.
    #[must_use]
    pub fn with_world(mut self, world: CollisionWorld) -> Self {
        self.world = Some(Arc::new(world));
        self
    }

    /// The parameters in use.
    pub fn params(&self) -> &ControllerParams {
        &self.params
    }

    /// Commanded joints (rad) and their velocities (rad/s); `None` before the first joint state.
    pub fn commanded(&self) -> Option<(Joints, Joints)> {
        self.commanded_state().map(|s| (s.q, s.qd))
    }

    /// One tick.
    pub fn step(&mut self, now: Stamp, input: &ControllerInput) -> ControllerOutput {
        let dt = self.last.map_or(0.0, |t| now.since(t));
        if dt < 0.0 {
            self.follower.clear(); // the clock was set back: nothing from before can be compared
        }
        let scaling = if input.speed_scaling.is_finite() { input.speed_scaling } else { 0.0 };
        let dt = dt.max(0.0) * scaling.clamp(0.0, 1.0);
        self.last = Some(now);
        self.ticks += 1;
        (self.reset_switch, self.regrasp) = (false, false);
        self.gripper_request = None;
        // A switch policy that was started again begins with the first procedure until it has read here
        // that something is held: nothing is dropped for that.
        if let Some(p) = input.procedure
            && !(self.held && p.procedure < self.procedure)
        {
            self.procedure = p.procedure;
        }
        if let Some(c) = &mut self.commanded {
            c.elapsed += dt;
        }
        if let Some(g) = input.gripper {
            self.knuckle = g.knuckle;
        }
        let joints = input.joints.filter(|j| self.joints_usable(j, now));
        if let (true, Some(j)) = (self.commanded.is_none() || self.params.dry_run, &joints) {
            self.seed(j.q);
        }
        if self.commanded.is_none() {
            return self.output(now, None, Some(self.waiting_sentence(input, now)));
        }
        let held = self.hold.is_some();
        self.requests(now, input);
        self.guards(now, input, joints.as_ref(), scaling);
        self.try_resume(now, input, joints.as_ref());
        let mut path = None;
        if self.hold.is_none() {
            let motion = self.advance(now, dt, input);
            path = self.emit(now, motion);
        }
        if self.hold.is_some() && !held {
            path = self.brake(now);
        }
        self.output(now, path, None)
    }

    fn joints_usable(&self, j: &JointState, now: Stamp) -> bool {
        let age = now.since(j.stamp);
        j.q.iter().all(|v| v.is_finite() && v.abs() < TAU + 0.5)
            && age <= self.params.joint_state_timeout
            && age >= -self.params.future_tolerance
    }

    fn waiting_sentence(&self, input: &ControllerInput, now: Stamp) -> (StatusCode, String) {
        let text = match &input.joints {
            None => "waiting for the first joint state".into(),
            Some(j) if !j.q.iter().all(|v| v.is_finite()) => {
                format!("joint state refused: positions {:?}", j.q)
            }
            Some(j) => format!(
                "joint state refused: stamped {:.2} s before now, positions {:.2?}",
                now.since(j.stamp),
                j.q
            ),
        };
        (StatusCode::WaitingForJoints, text)
    }

    fn seed(&mut self, q: Joints) {
        self.commanded =
            Some(Commanded { path: Projection::rest(q, &self.params), elapsed: f64::INFINITY });
    }

    pub(super) fn commanded_state(&self) -> Option<MotionState> {
        self.commanded.as_ref().map(|c| c.path.sample(c.elapsed))
    }

    /// The commanded `T_base_link_tcp`.
    pub(super) fn commanded_tool(&self) -> Pose {
        self.commanded_state().map_or_else(Pose::identity, |s| self.kinematics.fk_tcp(&s.q))
    }

    /// Seconds since the commanded state came to rest, negative while it moves.
    pub(super) fn rested(&self) -> f64 {
        self.commanded.as_ref().map_or(0.0, |c| c.elapsed - c.path.duration())
    }

    /// Stops and stays. A hold already in force is replaced only by a sterner one.
    pub(super) fn hold(&mut self, now: Stamp, cause: Cause, sentence: String) {
        if self.hold.as_ref().is_some_and(|h| !h.cause.ends_by_itself() && cause != Cause::Aborted)
        {
            return;
        }
        self.follower.clear();
        self.refused = None;
        self.held_since = now;
        self.hold = Some(Hold { cause, sentence });
    }

    fn requests(&mut self, now: Stamp, input: &ControllerInput) {
        let r = &input.requests;
        if r.abort {
            self.hold(now, Cause::Aborted, "aborted: call ~/reset to begin again".into());
        }
        if r.pause {
            self.hold(now, Cause::Paused, "paused: call ~/resume to go on".into());
        }
        if r.reset {
            self.follower.clear();
            self.refused = None;
            self.held = false;
            self.note = String::new();
            self.phase = Phase::reset();
            // Through a hold, so that the motion begins from where the arm is.
            self.held_since = now;
            self.hold = Some(if self.params.auto_resume {
                Hold { cause: Cause::Joints, sentence: "reset".into() }
            } else {
                Hold { cause: Cause::Ready, sentence: "reset: call ~/resume to start".into() }
            });
        }
        if r.home && !self.held && self.hold.is_none() {
            self.phase = Phase::Homing { script: None };
        }
    }

    /// Ends a hold on request, or by itself when that is allowed and the cause is gone.
    fn try_resume(&mut self, now: Stamp, input: &ControllerInput, joints: Option<&JointState>) {
        let Some(h) = &self.hold else { return };
        let asked = input.requests.resume && h.cause != Cause::Aborted;
        let fresh = || {
            let recent = |stamp: Stamp| now.since(stamp) <= self.params.stale_after;
            let here = |procedure: u32| procedure == self.procedure;
            input.plan.as_ref().is_some_and(|p| here(p.procedure) && recent(p.stamp))
                && input.procedure.is_some_and(|p| here(p.procedure) && recent(p.stamp))
        };
        let by_itself = self.params.auto_resume
            && h.cause.ends_by_itself()
            && match h.cause {
                // The motion goes on from wherever the stop has come to.
                Cause::Stale => fresh(),
                _ => now.since(self.held_since) >= LEAST_HOLD,
            };
        let may = input.disabled.is_none()
            && input.speed_scaling >= STOPPED
            && self.gripper_silence(now, input).is_none();
        if !(asked || by_itself) || !may {
            return;
        }
        let Some(j) = joints else { return };
        if self.rested() >= 0.0 {
            // At rest: go on from the command, or from the arm where the two have parted.
            let Some(c) = self.commanded_state() else { return };
            let apart: Joints = std::array::from_fn(|i| c.q[i] - j.q[i]);
            if law::max_abs(&apart) > self.params.reseed_threshold {
                if law::max_abs(&j.qd) > 0.05 {
                    return; // not at rest yet
                }
                self.seed(j.q);
            }
        } else if h.cause == Cause::Joints {
            return; // the command must have come to rest before it is compared again
        }
        self.hold = None;
        self.follower.clear();
        self.refused = None;
        self.phase.resumed();
    }

    /// Begins the deceleration at once instead of at the end of the last trajectory; none when it has begun.
    fn brake(&mut self, now: Stamp) -> Option<JointPath> {
        let c = self.commanded.as_ref()?;
        if c.elapsed >= c.path.law_time() {
            return None;
        }
        let path = Projection::stop(c.path.sample(c.elapsed), &self.params);
        let out = path.path(now, 0.0);
        self.commanded = Some(Commanded { path, elapsed: 0.0 });
        Some(out)
    }

    fn emit(&mut self, now: Stamp, motion: Motion) -> Option<JointPath> {
        if !self.ticks.is_multiple_of(u64::from(self.params.publish_every)) {
            return None;
        }
        let start = self.commanded_state()?;
        let (k, p) = (&self.kinematics, &self.params);
        let around = Around { world: self.world.as_deref(), knuckle: self.knuckle };
        let result = match motion {
            Motion::Rest => {
                self.refused = None;
                return None;
            }
            Motion::Follow => {
                let first = self.follower.desired(now, p)?;
                let tool = |s: f64| {
                    let pose = self.follower.desired(now.plus(s), p).unwrap_or(first);
                    lift(&pose, k, p)
                };
                project(k, p, &around, &start, &Target::Tool(&tool))
            }
            Motion::Script(Script::Line { from, to, duration, t }) => {
                let tool = |s: f64| tdv_geometry::min_jerk(&from, &to, (t + s) / duration);
                project(k, p, &around, &start, &Target::Tool(&tool))
            }
            Motion::Script(Script::Planned { to, t, .. }) => {
                let joints = |s: f64| self.planned.at(t + s).unwrap_or(to);
                project(k, p, &around, &start, &Target::Joints(&joints))
            }
            Motion::Script(Script::Joints { from, to, duration, t }) => {
                let joints = |s: f64| -> Joints {
                    let x = tdv_geometry::smooth_step((t + s) / duration);
                    std::array::from_fn(|i| from[i] + (to[i] - from[i]) * x)
                };
                project(k, p, &around, &start, &Target::Joints(&joints))
            }
        };
        match result {
            Ok(path) => {
                self.refused = None;
                let out = path.path(now, self.params.first_point);
                self.commanded = Some(Commanded { path, elapsed: 0.0 });
                Some(out)
            }
            Err(e) => {
                let since = self.refused.as_ref().map_or(now, |r| r.0);
                self.refused = Some((since, e.to_string()));
                if now.since(since) > self.params.stale_after {
                    self.hold(now, Cause::Refused, format!("target refused: {e}"));
                }
                None
            }
        }
    }

    fn output(
        &mut self,
        now: Stamp,
        trajectory: Option<JointPath>,
        said: Option<(StatusCode, String)>,
    ) -> ControllerOutput {
        let (code, sentence) = match (said, &self.hold, &self.refused) {
            (Some(s), ..) => s,
            (None, Some(h), _) => {
                let waits = h.cause.ends_by_itself() && h.cause != Cause::Ready;
                let then = if !waits {
                    ""
                } else if self.params.auto_resume {
                    " (goes on by itself)"
                } else {
                    " (holding; call ~/resume)"
                };
                (h.cause.code(), format!("{}{then}", h.sentence))
            }
            (None, None, Some((_, text))) => {
                (StatusCode::HoldRefused, format!("target refused: {text}"))
            }
            (None, None, None) => self.describe(now),
        };
        let moving = self.commanded_state().is_some_and(|s| law::max_abs(&s.qd) > 1e-3);
        let gripper = self.gripper_request.take();
        let (gripper, sentence) = match self.params.dry_run {
            true => (None, format!("dry run: {sentence}")),
            false => (gripper, sentence),
        };
        ControllerOutput {
            trajectory,
            gripper,
            reset_switch: self.reset_switch,
            regrasp: self.regrasp,
            status: Status {
                code,
                sentence,
                procedure: self.procedure,
                object_held: self.held,
                moving,
                done: self.phase == Phase::Done,
            },
        }
    }
}

/// A tool pose whose fingertips would come a little under the table's clearance is lifted onto it;
/// one that is deeper stays and is refused by the clearance check.
fn lift(tool: &Pose, k: &Kinematics, p: &ControllerParams) -> Pose {
    /// Room (m) for the joints' deviation from the desired tool path.
    const ROOM: f64 = 0.001;
    let flange = tool * k.tool().inverse();
    let floor = p.limits.table_z + p.limits.fingertip_clearance + ROOM;
    let under = floor - fingertip_height(&flange, KNUCKLE_CLOSED);
    let mut out = *tool;
    if under > 0.0 && under <= p.table_slide {
        out.translation.z += under;
    }
    out
}
