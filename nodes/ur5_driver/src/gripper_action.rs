//! The gripper's action, in either of the types that its ROS drivers have, and its activation.

use crate::gripper::{self, GripperEvent, GripperOrder, GripperState, Move};
use crate::gripper_link::GripperAddress;
use crate::io_services::answer;
use crate::params::{DriverParameters, GripperAction};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;
use tdv_msgs::RosAction;
use tdv_msgs::control_msgs::action::{
    GripperCommand, GripperCommandResult, ParallelGripperCommand, ParallelGripperCommandGoal,
    ParallelGripperCommandResult,
};
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_srvs::srv::Trigger;
use tdv_robot::gripper::{
    FORCE_RANGE, KNUCKLE_JOINT, knuckle_from_register, register_from_knuckle,
};
use tdv_runtime::{Goal, GoalEnd, Node, RuntimeError, tracked};
use tdv_ur_protocol::gripper::{ObjectStatus, fault_text};
use tokio::sync::{oneshot, watch};

/// Time for an activation with its two movements.
const ACTIVATION: Duration = Duration::from_secs(25);

/// How a move ended.
struct Ended {
    end: GoalEnd,
    state: Option<GripperState>,
    stalled: bool,
    reached: bool,
}

/// What the action's callbacks need.
#[derive(Clone)]
struct Mover {
    orders: mpsc::Sender<GripperOrder>,
    states: watch::Receiver<Option<GripperState>>,
    number: Arc<AtomicU32>,
    speed: u8,
    force: u8,
}

/// The thread that talks to the gripper.
pub fn start(
    node: &Node,
    address: GripperAddress,
    orders: mpsc::Receiver<GripperOrder>,
    states: watch::Sender<Option<GripperState>>,
) {
    let node = node.clone();
    std::thread::spawn(move || {
        let diagnostics = node.diagnostics().clone();
        let mut last_fault = 0;
        gripper::run(&node, &address, &orders, |event| match event {
            GripperEvent::Ready => {
                tracing::info!("gripper ready");
                diagnostics.set("gripper", "ready");
            }
            GripperEvent::State(state) => {
                diagnostics.set("gripper_position", state.position);
                if state.fault != last_fault {
                    last_fault = state.fault;
                    let text = fault_text(state.fault).unwrap_or("ready");
                    tracing::warn!("gripper: {text}");
                    diagnostics.set("gripper", text);
                }
                states.send_replace(Some(state));
            }
            GripperEvent::Lost(why) => {
                tracing::warn!("{why}");
                diagnostics.set("gripper", why);
                states.send_replace(None);
            }
        });
    });
}

/// Serves the action and the activation.
pub fn serve(
    node: &Node,
    p: &DriverParameters,
    orders: mpsc::Sender<GripperOrder>,
    states: watch::Receiver<Option<GripperState>>,
) -> Result<(), RuntimeError> {
    let mover = Mover {
        orders: orders.clone(),
        states,
        number: Arc::default(),
        speed: p.gripper_speed as u8,
        force: p.gripper_force as u8,
    };
    let name = format!("/{}/gripper_cmd", p.gripper_controller_name);
    match p.gripper_action {
        GripperAction::GripperCommand => serve_action::<GripperCommand>(
            node,
            &name,
            mover,
            |goal| Ok((goal.command.position, goal.command.max_effort)),
            |e| GripperCommandResult {
                position: angle(e.state),
                effort: 0.0,
                stalled: e.stalled,
                reached_goal: e.reached,
            },
        )?,
        GripperAction::ParallelGripperCommand => {
            let clock = node.clock().clone();
            serve_action::<ParallelGripperCommand>(node, &name, mover, parallel, move |e| {
                ParallelGripperCommandResult {
                    state: JointState {
                        header: tracked::header(clock.now()),
                        name: vec![KNUCKLE_JOINT.into()],
                        position: vec![angle(e.state)],
                        ..Default::default()
                    },
                    stalled: e.stalled,
                    reached_goal: e.reached,
                }
            })?;
        }
    }
    let reactivate = "/robotiq_activation_controller/reactivate_gripper";
    node.service::<Trigger, _, _>(reactivate, move |_| {
        let orders = orders.clone();
        async move {
            let (sender, done) = oneshot::channel();
            let sent = orders.send(GripperOrder::Reactivate(sender));
            let lost = || "the gripper is not connected".to_owned();
            let result = match (sent, tokio::time::timeout(ACTIVATION, done).await) {
                (Ok(()), Ok(Ok(result))) => result,
                _ => Err(lost()),
            };
            answer(result.map(|()| "activated".into()))
        }
    })
}

fn angle(state: Option<GripperState>) -> f64 {
    state.map_or(f64::NAN, |s| knuckle_from_register(s.position))
}

/// Position and effort of a goal that names our joint, or none.
fn parallel(goal: &ParallelGripperCommandGoal) -> Result<(f64, f64), String> {
    let c = &goal.command;
    let i = match &c.name[..] {
        [] => 0,
        names => names
            .iter()
            .position(|n| n == KNUCKLE_JOINT)
            .ok_or_else(|| format!("{names:?} does not name {KNUCKLE_JOINT}"))?,
    };
    let position = c.position.get(i).ok_or("the command has no position")?;
    Ok((*position, c.effort.get(i).copied().unwrap_or(0.0)))
}

fn serve_action<A: RosAction>(
    node: &Node,
    name: &str,
    mover: Mover,
    read: fn(&A::Goal) -> Result<(f64, f64), String>,
    result: impl Fn(&Ended) -> A::Result + Clone + Send + 'static,
) -> Result<(), RuntimeError> {
    let known = mover.states.clone();
    node.action_server::<A, _, _, _>(
        name,
        move |goal| {
            let (position, effort) = read(goal)?;
            if !position.is_finite() || effort.is_nan() {
                return Err("the position or the effort is not a number".into());
            }
            known.borrow().map(|_| ()).ok_or_else(|| "the gripper is not connected".into())
        },
        move |goal: Goal<A>| {
            let (mover, result) = (mover.clone(), result.clone());
            let order = read(&goal.goal).map(|(position, effort)| mover.order(position, effort));
            async move {
                let ended = match order {
                    Ok(order) => mover.carry_out(goal, order).await,
                    Err(_) => Ended::aborted(),
                };
                (ended.end, result(&ended))
            }
        },
    )
}

impl Ended {
    fn aborted() -> Self {
        Self { end: GoalEnd::Aborted, state: None, stalled: false, reached: false }
    }
}

impl Mover {
    /// Sends a move off at once: goals keep the order in which they came.
    fn order(&self, position: f64, effort: f64) -> Move {
        let (low, high) = FORCE_RANGE;
        let force = if effort > 0.0 {
            ((effort - low) / (high - low) * 255.0).clamp(0.0, 255.0) as u8
        } else {
            self.force
        };
        let order = Move {
            number: self.number.fetch_add(1, Ordering::SeqCst) + 1,
            position: register_from_knuckle(position),
            speed: self.speed,
            force,
        };
        // The receiver ends with the node; then nobody waits for the goal any more.
        let _ = self.orders.send(GripperOrder::Move(order));
        order
    }

    /// Waits until the fingers rest at the target or at an object.
    async fn carry_out<A: RosAction>(mut self, mut goal: Goal<A>, order: Move) -> Ended {
        let ended = |end, state, stalled, reached| Ended { end, state, stalled, reached };
        loop {
            tokio::select! {
                () = goal.canceled() => {
                    let state = *self.states.borrow();
                    return ended(GoalEnd::Canceled, state, false, false);
                }
                changed = self.states.changed() => {
                    if changed.is_err() {
                        return Ended::aborted();
                    }
                }
            }
            let Some(state) = *self.states.borrow_and_update() else { return Ended::aborted() };
            // The status belongs to this order only once the gripper echoes its position.
            if state.request < order.number || state.requested != order.position {
                continue;
            }
            match state.object {
                ObjectStatus::Moving => {}
                ObjectStatus::ContactClosing | ObjectStatus::ContactOpening => {
                    return ended(GoalEnd::Succeeded, Some(state), true, false);
                }
                ObjectStatus::AtPosition => {
                    return ended(GoalEnd::Succeeded, Some(state), false, true);
                }
            }
        }
    }
}
