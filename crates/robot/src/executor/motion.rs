//! Everything between a command from the graph and the joint target of one control cycle: which
//! controller has the arm, trajectories in stretched time, streams that go stale, goals with
//! tolerances, the guard, and a fault that stays until it is reset.

use super::clocks::Clocks;
use super::stream::{self, Command, STALE};
use super::{
    Desired, ExecutorParams, GoalCode, GoalEndReport, GoalTolerances, JointTrajectory,
    JointTrajectoryExecutor, SpeedScale, TargetGuard, TrajectoryRejection,
};
use crate::kinematics::Joints;
use crate::limits::Limits;
use tdv_geometry::Stamp;
use thiserror::Error;

/// Share of the joint speed limit at which a trajectory may be entered.
const ENTRY: f64 = 1.3;

/// Who may command the arm; at most one at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionController {
    /// Joint trajectories, by topic or as goals.
    Trajectory,
    /// A stream of joint positions.
    Position,
    /// A stream of joint velocities.
    Velocity,
}

/// Why a command is not carried out.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum MotionRefusal {
    /// Before the first state of the robot, or after it was lost.
    #[error("no state of the robot yet")]
    NoState,
    /// The robot would not follow.
    #[error("the robot cannot be moved now: stopped, not powered, or no program of ours runs")]
    NotReady,
    /// Nobody holds the enabling switch.
    #[error("motion is not enabled: the enabling switch is released or silent")]
    NotEnabled,
    /// Another controller has the arm.
    #[error("this controller is not active; active is {0:?}")]
    Inactive(Option<MotionController>),
    /// A fault stands.
    #[error("fault: {0} (cleared by ~/reset or set_mode)")]
    Fault(String),
    /// The trajectory is refused.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryRejection),
    /// The trajectory begins too far from where the arm is.
    #[error(
        "the trajectory begins too far from the arm: {speed:.2} rad/s to its first point, {limit:.2} is allowed"
    )]
    Entry {
        /// Rad/s.
        speed: f64,
        /// Rad/s.
        limit: f64,
    },
    /// Not six finite numbers.
    #[error("a command of {0} values; six finite ones are needed")]
    Values(usize),
}

/// Parameters of [`Motion`].
#[derive(Debug, Clone, PartialEq)]
pub struct MotionParams {
    /// Limits of the motion.
    pub limits: Limits,
    /// Greatest distance between target and arm while moving (rad).
    pub following: f64,
}

/// One state of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotInput {
    /// The robot's own clock (s): only differences count.
    pub time: f64,
    /// The graph's clock when this state was looked at; it may come late.
    pub clock: Stamp,
    /// Measured joints (rad).
    pub q: Joints,
    /// Measured speeds (rad/s).
    pub qd: Joints,
    /// Powered, safe, and a program of ours follows.
    pub may_move: bool,
    /// The program on the robot has stopped because our commands were missing.
    pub watchdog: bool,
    /// Speed scaling times slider, 0..=1.
    pub factor: f64,
    /// False while an enabling switch is required and not held.
    pub enabled: bool,
}

/// What comes out of a cycle.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StepOutput {
    /// Joint target for the robot (rad); `None`: rest.
    pub target: Option<Joints>,
    /// A fault that has just been found.
    pub fault: Option<String>,
    /// Goals that have ended.
    pub ended: Vec<GoalEndReport>,
}

/// Desired, measured and their difference, for feedback.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Follow {
    /// Target of this cycle; the measured state when nothing is commanded.
    pub desired: Desired,
    /// Measured.
    pub actual: Desired,
    /// Number of the goal that is being followed.
    pub goal: Option<u64>,
    /// Factor by which trajectory time runs.
    pub scale: f64,
}

impl Follow {
    /// Desired less measured.
    pub fn error(&self) -> Desired {
        Desired {
            q: std::array::from_fn(|i| self.desired.q[i] - self.actual.q[i]),
            qd: std::array::from_fn(|i| self.desired.qd[i] - self.actual.qd[i]),
        }
    }
}

#[derive(Debug, Clone)]
struct Goal {
    id: u64,
    tolerances: GoalTolerances,
    /// End in executor time.
    due: Stamp,
    at: Joints,
}

/// The commanding side of the driver. [`Self::step`] once for each state of the robot.
#[derive(Debug, Clone)]
pub struct Motion {
    params: MotionParams,
    executor: JointTrajectoryExecutor,
    guard: TargetGuard,
    controller: Option<MotionController>,
    scale: SpeedScale,
    /// Trajectory time: the sum of all stretched cycles.
    time: Stamp,
    robot: Option<RobotInput>,
    clocks: Clocks,
    stream: Option<(Command, f64)>,
    desired: Option<Desired>,
    goal: Option<Goal>,
    next_goal: u64,
    ended: Vec<GoalEndReport>,
    fault: Option<String>,
}

impl Motion {
    /// At rest, the trajectory controller active.
    pub fn new(params: MotionParams) -> Self {
        let limits = &params.limits;
        let executor = JointTrajectoryExecutor::new(ExecutorParams {
            lower: limits.joint_lower,
            upper: limits.joint_upper,
            ..Default::default()
        });
        Self {
            executor,
            guard: TargetGuard::new(limits).with_following(params.following),
            controller: Some(MotionController::Trajectory),
            scale: SpeedScale::full(),
            time: Stamp::default(),
            robot: None,
            clocks: Clocks::default(),
            stream: None,
            desired: None,
            goal: None,
            next_goal: 1,
            ended: Vec::new(),
            fault: None,
            params,
        }
    }

    /// The fault that stands.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// The active controller.
    pub fn controller(&self) -> Option<MotionController> {
        self.controller
    }

    /// Clears a fault; nothing that was commanded before comes back.
    pub fn reset(&mut self) {
        self.fault = None;
        self.drop_commands("reset");
    }

    /// Makes another controller the active one, or none; the arm comes to rest first.
    pub fn select(&mut self, controller: Option<MotionController>) {
        if controller == self.controller {
            return;
        }
        self.end_goal(GoalCode::InvalidGoal, "the controller was deactivated");
        self.stream = None;
        self.controller = controller;
        self.rest();
    }

    /// The connection was lost: the next motion starts from a new measured state.
    pub fn forget(&mut self) {
        self.drop_commands("the connection to the robot was lost");
        self.robot = None;
    }

    /// A trajectory without a goal.
    ///
    /// # Errors
    /// [`MotionRefusal`]; what was active stays active.
    pub fn follow(&mut self, t: &JointTrajectory, now: Stamp) -> Result<(), MotionRefusal> {
        self.begin(t, now)?;
        self.end_goal(GoalCode::InvalidGoal, "replaced by a trajectory from the topic");
        Ok(())
    }

    /// A trajectory as a goal; its number appears in [`StepOutput::ended`].
    ///
    /// # Errors
    /// [`MotionRefusal`]; what was active stays active.
    pub fn follow_goal(
        &mut self,
        t: &JointTrajectory,
        tolerances: GoalTolerances,
        now: Stamp,
    ) -> Result<u64, MotionRefusal> {
        self.begin(t, now)?;
        self.end_goal(GoalCode::InvalidGoal, "replaced by a newer goal");
        let id = self.next_goal;
        self.next_goal += 1;
        if let Some((at, due)) = self.executor.goal() {
            self.goal = Some(Goal { id, tolerances, due, at });
        }
        Ok(id)
    }

    /// Whether a trajectory would be taken now, without taking it.
    ///
    /// # Errors
    /// [`MotionRefusal`].
    pub fn would_follow(&self, t: &JointTrajectory, now: Stamp) -> Result<(), MotionRefusal> {
        self.clone().begin(t, now)
    }

    /// The client takes goal `id` back: the arm comes to rest. Nothing happens to any other goal.
    pub fn cancel(&mut self, id: u64) {
        if self.goal.as_ref().is_some_and(|g| g.id == id) {
            self.goal = None;
            self.rest();
        }
    }

    /// A position of the stream (rad, UR order); counts until a fresh one or for 0.1 s.
    ///
    /// # Errors
    /// [`MotionRefusal`].
    pub fn stream_position(&mut self, values: &[f64]) -> Result<(), MotionRefusal> {
        self.stream_command(values, MotionController::Position, Command::Position)
    }

    /// A velocity of the stream (rad/s, UR order); counts until a fresh one or for 0.1 s.
    ///
    /// # Errors
    /// [`MotionRefusal`].
    pub fn stream_velocity(&mut self, values: &[f64]) -> Result<(), MotionRefusal> {
        self.stream_command(values, MotionController::Velocity, Command::Velocity)
    }

    /// Desired and measured state.
    pub fn state(&self) -> Option<Follow> {
        let robot = self.robot.as_ref()?;
        let actual = Desired { q: robot.q, qd: robot.qd };
        Some(Follow {
            desired: self.desired.unwrap_or(Desired { q: robot.q, qd: [0.0; 6] }),
            actual,
            goal: self.goal.as_ref().map(|g| g.id),
            scale: self.scale.factor(),
        })
    }

    /// Where the trajectory controller wants the arm at a time of the graph's clock, if no other
    /// trajectory replaces the one that runs; its end at rest from there on. None while that controller
    /// is not active, without a robot that may move, and for times long gone.
    pub fn planned(&self, at: Stamp) -> Option<Desired> {
        let robot = self.ready(MotionController::Trajectory).ok()?;
        let ahead = at.since(robot.clock) + self.clocks.late(robot);
        self.executor.known(self.time.plus(ahead * self.scale.factor()))
    }

    /// One cycle.
    pub fn step(&mut self, robot: &RobotInput) -> StepOutput {
        let dt = self.robot.map_or(0.0, |before| robot.time - before.time);
        let paused = self.robot.is_some_and(|before| !before.may_move);
        self.robot = Some(*robot);
        self.clocks.observe(robot);
        let mut fault = None;
        if !robot.may_move || robot.watchdog {
            // What was commanded is forgotten: it must not come back when the robot may move again.
            let why =
                if robot.watchdog { "commands came too late" } else { "the robot was stopped" };
            self.drop_commands(why);
        } else {
            if paused {
                self.scale = SpeedScale::standstill();
            }
            if !robot.enabled && self.is_commanded() {
                self.end_goal(GoalCode::InvalidGoal, "the enabling switch was released");
                self.stream = None;
                self.rest();
            }
            self.desired = self.next(robot, dt);
            fault = self.check(robot).err();
        }
        StepOutput {
            target: self.desired.map(|d| d.q),
            fault,
            ended: std::mem::take(&mut self.ended),
        }
    }

    /// Something other than a rest is under way.
    fn is_commanded(&self) -> bool {
        self.goal.is_some() || self.stream.is_some() || self.executor.is_moving(self.time)
    }

    fn next(&mut self, robot: &RobotInput, dt: f64) -> Option<Desired> {
        let stretched = self.scale.advance(dt, robot.factor);
        if let Some((command, at)) = self.stream {
            let from = self.desired.unwrap_or(Desired { q: robot.q, qd: [0.0; 6] });
            let fresh = robot.time - at <= STALE;
            let dt = dt.clamp(0.0, SpeedScale::LONGEST_STEP);
            let mut limits = self.params.limits.clone();
            limits.joint_velocity *= self.scale.factor();
            let next = stream::step(&from, fresh.then_some(&command), dt, &limits);
            if !fresh && next.qd == [0.0; 6] {
                // At rest: from here on this is a hold like any other.
                self.stream = None;
                self.executor.hold(self.time, next.q);
            }
            return Some(next);
        }
        self.time = self.time.plus(stretched);
        let mut desired = self.executor.sample(self.time)?;
        // In stretched time speeds are smaller too.
        desired.qd = desired.qd.map(|v| v * self.scale.factor());
        Some(desired)
    }

    fn check(&mut self, robot: &RobotInput) -> Result<(), String> {
        let Some(desired) = self.desired else { return Ok(()) };
        if let Err(error) = self.guard.check(Stamp::from_secs(robot.time), &desired.q, &robot.q) {
            // Stop where the arm is: the program on the controller decelerates by itself.
            let text = error.to_string();
            self.fault = Some(text.clone());
            self.end_goal(GoalCode::InvalidGoal, &text);
            self.drop_commands(&text);
            return Err(text);
        }
        let Some(goal) = &self.goal else { return Ok(()) };
        if self.time < goal.due {
            if let Some(text) = goal.tolerances.off_path(&desired, &robot.q, &robot.qd) {
                self.end_goal(GoalCode::PathTolerance, &text);
                self.rest();
            }
            return Ok(());
        }
        let late = self.time.since(goal.due);
        match goal.tolerances.off_goal(&goal.at, &robot.q, &robot.qd) {
            None => self.end_goal(GoalCode::Successful, "goal reached"),
            Some(text) if goal.tolerances.time.is_some_and(|most| late > most) => {
                self.end_goal(GoalCode::GoalTolerance, &text);
                self.executor.hold(self.time, desired.q);
            }
            Some(_) => {}
        }
        Ok(())
    }

    fn ready(&self, controller: MotionController) -> Result<&RobotInput, MotionRefusal> {
        if let Some(fault) = &self.fault {
            return Err(MotionRefusal::Fault(fault.clone()));
        }
        if self.controller != Some(controller) {
            return Err(MotionRefusal::Inactive(self.controller));
        }
        let robot = self.robot.as_ref().ok_or(MotionRefusal::NoState)?;
        if !robot.may_move {
            return Err(MotionRefusal::NotReady);
        }
        if !robot.enabled {
            return Err(MotionRefusal::NotEnabled);
        }
        Ok(robot)
    }

    fn begin(&mut self, t: &JointTrajectory, now: Stamp) -> Result<(), MotionRefusal> {
        let robot = self.ready(MotionController::Trajectory)?;
        let current = self.desired.unwrap_or(Desired { q: robot.q, qd: [0.0; 6] });
        // Between two states of the robot trajectory time goes on too.
        let since = now.since(robot.clock) + self.clocks.late(robot);
        let late = since.clamp(0.0, SpeedScale::LONGEST_STEP);
        let at = self.time.plus(late * self.scale.factor());
        let mut executor = self.executor.clone();
        executor.accept_at(t, now, at, &current)?;
        let limit = ENTRY * self.params.limits.joint_velocity;
        executor.join(limit);
        let speed = executor.entry_speed();
        if speed > limit {
            return Err(MotionRefusal::Entry { speed, limit });
        }
        self.executor = executor;
        Ok(())
    }

    fn stream_command(
        &mut self,
        values: &[f64],
        controller: MotionController,
        make: fn(Joints) -> Command,
    ) -> Result<(), MotionRefusal> {
        let time = self.ready(controller)?.time;
        let joints: Joints = values.try_into().map_err(|_| MotionRefusal::Values(values.len()))?;
        if !joints.iter().all(|v| v.is_finite()) {
            return Err(MotionRefusal::Values(values.iter().filter(|v| v.is_finite()).count()));
        }
        self.executor.clear();
        self.stream = Some((make(joints), time));
        Ok(())
    }

    /// Decelerates from the present target to rest.
    fn rest(&mut self) {
        match self.desired {
            Some(mut from) if self.executor.goal().is_some() || from.qd != [0.0; 6] => {
                // The executor's speeds are those of unstretched time.
                let factor = self.scale.factor().max(0.05);
                from.qd = from.qd.map(|v| v / factor);
                self.executor.stop(self.time, &from, self.params.limits.stop_acceleration);
            }
            _ => {}
        }
    }

    fn drop_commands(&mut self, why: &str) {
        self.end_goal(GoalCode::InvalidGoal, why);
        self.executor.clear();
        self.guard.reset();
        self.stream = None;
        self.desired = None;
    }

    fn end_goal(&mut self, code: GoalCode, text: &str) {
        if let Some(goal) = self.goal.take() {
            self.ended.push(GoalEndReport { id: goal.id, code, text: text.to_owned() });
        }
    }
}
