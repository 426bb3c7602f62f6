//! What the threads of the driver share.

use crate::arm_state::ArmState;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_robot::executor::Follow;
use tdv_robot::{
    Desired, GoalEndReport, GoalTolerances, JointTrajectory, Joints, Motion, MotionController,
    MotionParams, MotionRefusal, RobotInput,
};
use tdv_ur_protocol::servo::ProgramState;
use tokio::sync::oneshot;

/// An enabling switch that was not heard of for this long counts as released.
const SWITCH_SILENT: Duration = Duration::from_millis(500);

struct Inner {
    motion: Motion,
    waiting: BTreeMap<u64, oneshot::Sender<GoalEndReport>>,
    /// When the enabling switch was last seen held; `None` while it is released.
    held: Option<Instant>,
    switch_required: bool,
    arm: Option<(ArmState, bool)>,
    /// The servo program is to end.
    hand_back: bool,
}

/// What goes to the robot in one cycle.
#[derive(Debug, Clone, PartialEq)]
pub enum Order {
    /// Rest.
    Idle,
    /// Joint targets, rad.
    Servo(Joints),
    /// The program is to end.
    Stop,
}

/// Shared between the ROS tasks and the RTDE thread.
pub struct Shared(Mutex<Inner>);

impl Shared {
    pub fn new(params: MotionParams, switch_required: bool) -> Self {
        Self(Mutex::new(Inner {
            motion: Motion::new(params),
            waiting: BTreeMap::new(),
            held: None,
            switch_required,
            arm: None,
            hand_back: false,
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Each change below is complete before the lock is released.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One state of the robot in, at `clock`; the order for it and a fault that was just found out. `followed`: a
    /// program of ours runs on the robot.
    pub fn step(&self, state: &ArmState, followed: bool, clock: Stamp) -> (Order, Option<String>) {
        let mut guard = self.lock();
        let c = &mut *guard;
        c.hand_back &= followed;
        let held = c.held.is_some_and(|at| at.elapsed() < SWITCH_SILENT);
        let out = c.motion.step(&RobotInput {
            time: state.time,
            clock,
            q: state.q,
            qd: state.qd,
            may_move: followed && state.is_safe() && !c.hand_back,
            watchdog: state.program == Some(ProgramState::WatchdogStop),
            factor: state.factor(),
            enabled: held || !c.switch_required,
        });
        c.arm = Some((state.clone(), followed));
        for end in out.ended {
            if let Some(waiting) = c.waiting.remove(&end.id) {
                // A client that has gone needs no result.
                let _ = waiting.send(end);
            }
        }
        let order = match out.target {
            _ if c.hand_back => Order::Stop,
            Some(target) => Order::Servo(target),
            None => Order::Idle,
        };
        (order, out.fault)
    }

    /// Ends the servo program, so that the program on the pendant goes on.
    pub fn hand_back(&self) {
        self.lock().hand_back = true;
    }

    /// The last state of the robot and whether our program follows; none without a connection.
    pub fn arm(&self) -> Option<(ArmState, bool)> {
        self.lock().arm.clone()
    }

    /// Desired and measured joints.
    pub fn follow_state(&self) -> Option<Follow> {
        self.lock().motion.state()
    }

    pub fn planned(&self, at: Stamp) -> Option<Desired> {
        self.lock().motion.planned(at)
    }

    pub fn fault(&self) -> Option<String> {
        self.lock().motion.fault().map(str::to_owned)
    }

    pub fn controller(&self) -> Option<MotionController> {
        self.lock().motion.controller()
    }

    pub fn select(&self, controller: Option<MotionController>) {
        self.lock().motion.select(controller);
    }

    pub fn reset(&self) {
        self.lock().motion.reset();
    }

    /// The enabling switch is held or released.
    pub fn switch(&self, held: bool) {
        self.lock().held = held.then(Instant::now);
    }

    pub fn follow(&self, t: &JointTrajectory, now: Stamp) -> Result<(), MotionRefusal> {
        self.lock().motion.follow(t, now)
    }

    pub fn would_follow(&self, t: &JointTrajectory, now: Stamp) -> Result<(), MotionRefusal> {
        self.lock().motion.would_follow(t, now)
    }

    /// Starts a goal; its end comes through the receiver.
    pub fn follow_goal(
        &self,
        t: &JointTrajectory,
        tolerances: GoalTolerances,
        now: Stamp,
    ) -> Result<(u64, oneshot::Receiver<GoalEndReport>), MotionRefusal> {
        let mut c = self.lock();
        let id = c.motion.follow_goal(t, tolerances, now)?;
        let (sender, receiver) = oneshot::channel();
        c.waiting.insert(id, sender);
        Ok((id, receiver))
    }

    pub fn cancel(&self, id: u64) {
        let mut c = self.lock();
        c.waiting.remove(&id);
        c.motion.cancel(id);
    }

    pub fn stream(&self, kind: MotionController, values: &[f64]) -> Result<(), MotionRefusal> {
        let mut c = self.lock();
        match kind {
            MotionController::Velocity => c.motion.stream_velocity(values),
            _ => c.motion.stream_position(values),
        }
    }

    /// The connection was lost: the next motion starts from a new measured state.
    pub fn forget(&self) {
        let mut c = self.lock();
        c.motion.forget();
        c.arm = None;
        // The next step would report these ends; without a robot there is none.
        c.waiting.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm_state::OUTPUTS;
    use tdv_robot::{GoalCode, JOINT_NAMES, Limits, TrajectoryPoint};
    use tdv_ur_protocol::rtde::{Value, output_field};

    const CLOCK: Stamp = Stamp(1_000_000_000);

    fn running() -> ArmState {
        let values: Vec<Value> =
            OUTPUTS.iter().map(|n| Value::zero(output_field(n).unwrap())).collect();
        let mut s = ArmState::from_values(&values).unwrap();
        (s.robot_mode, s.safety_mode, s.speed_scaling, s.speed_fraction) = (7, 1, 1.0, 1.0);
        s
    }

    fn to(q: f64) -> JointTrajectory {
        JointTrajectory {
            names: JOINT_NAMES.map(String::from).to_vec(),
            stamp: None,
            points: vec![TrajectoryPoint {
                positions: vec![q; 6],
                velocities: vec![0.0; 6],
                time_from_start: 0.2,
                ..Default::default()
            }],
        }
    }

    fn shared(switch: bool) -> Shared {
        Shared::new(MotionParams { limits: Limits::default(), following: 0.25 }, switch)
    }

    #[test]
    fn only_a_running_program_on_a_safe_robot_gets_targets() {
        let s = shared(false);
        let now = Stamp::from_secs(1.0);
        assert_eq!(s.follow(&to(0.05), now), Err(MotionRefusal::NoState));
        let mut arm = running();
        assert_eq!(s.step(&arm, true, CLOCK), (Order::Idle, None));
        s.follow(&to(0.05), now).unwrap();
        assert!(matches!(s.step(&arm, true, CLOCK).0, Order::Servo(_)));
        for (followed, safety) in [(false, 1), (true, 3)] {
            arm.safety_mode = safety;
            assert_eq!(s.step(&arm, followed, CLOCK).0, Order::Idle);
            arm.safety_mode = 1;
            assert_eq!(s.step(&arm, true, CLOCK).0, Order::Idle, "nothing comes back");
        }
    }

    #[test]
    fn a_goals_end_reaches_its_waiter() {
        let s = shared(false);
        let arm = running();
        s.step(&arm, true, CLOCK);
        let now = Stamp::from_secs(1.0);
        let (_, mut end) = s.follow_goal(&to(0.05), GoalTolerances::default(), now).unwrap();
        assert!(end.try_recv().is_err());
        s.step(&arm, false, CLOCK);
        assert_eq!(end.try_recv().unwrap().code, GoalCode::InvalidGoal);
        s.step(&arm, true, CLOCK);
        let (_, mut end) = s.follow_goal(&to(0.05), GoalTolerances::default(), now).unwrap();
        s.forget();
        assert!(matches!(end.try_recv(), Err(oneshot::error::TryRecvError::Closed)));
    }

    #[test]
    fn control_is_handed_back_until_the_program_has_ended() {
        let s = shared(false);
        let arm = running();
        s.step(&arm, true, CLOCK);
        s.follow(&to(0.05), Stamp::from_secs(1.0)).unwrap();
        s.hand_back();
        assert_eq!(s.step(&arm, true, CLOCK).0, Order::Stop);
        assert_eq!(s.step(&arm, true, CLOCK).0, Order::Stop);
        assert_eq!(s.step(&arm, false, CLOCK).0, Order::Idle);
        assert_eq!(s.step(&arm, true, CLOCK).0, Order::Idle);
    }

    #[test]
    fn the_switch_has_to_be_held_and_heard() {
        let s = shared(true);
        let arm = running();
        let now = Stamp::from_secs(1.0);
        s.step(&arm, true, CLOCK);
        assert_eq!(s.follow(&to(0.05), now), Err(MotionRefusal::NotEnabled));
        s.switch(true);
        s.step(&arm, true, CLOCK);
        s.follow(&to(0.05), now).unwrap();
        s.switch(false);
        s.step(&arm, true, CLOCK);
        assert_eq!(s.follow(&to(0.05), now), Err(MotionRefusal::NotEnabled));
    }
}
