//! The trajectory controller: goals as an action, and the streaming form by topic.

use crate::state::Shared;
use std::sync::Arc;
use std::time::Duration;
use tdv_geometry::Stamp;
use tdv_msgs::control_msgs::action::{
    FollowJointTrajectory, FollowJointTrajectoryFeedback, FollowJointTrajectoryGoal,
    FollowJointTrajectoryResult,
};
use tdv_msgs::control_msgs::msg::JointTolerance as ToleranceMessage;
use tdv_msgs::control_msgs::srv::{QueryTrajectoryState, QueryTrajectoryStateResponse};
use tdv_msgs::trajectory_msgs::msg::{JointTrajectory as TrajectoryMessage, JointTrajectoryPoint};
use tdv_robot::executor::{Follow, JointTolerance};
use tdv_robot::{
    Desired, ExecutorParams, GoalCode, GoalTolerances, JOINT_NAMES, JointTrajectory, MotionRefusal,
    TrajectoryPoint,
};
use tdv_runtime::{Goal, GoalEnd, Node, Qos, RuntimeError, tracked};

/// Between two feedbacks.
const FEEDBACK: Duration = Duration::from_millis(50);

/// Takes trajectories from the topic.
pub fn subscribe(node: &Node, shared: &Arc<Shared>, controller: &str) -> Result<(), RuntimeError> {
    let topic = format!("/{controller}/joint_trajectory");
    let (clock, diagnostics) = (node.clock().clone(), node.diagnostics().clone());
    let shared = shared.clone();
    let mut last = String::new();
    node.subscribe(&topic, Qos::reliable(1), move |m: TrajectoryMessage| {
        let now = clock.now();
        let stamp = tracked::stamp(&m.header);
        let why = shared.follow(&trajectory(m), now).err().map_or(String::new(), |e| e.to_string());
        if why.is_empty() {
            if stamp != Stamp(0) {
                diagnostics.latency("command_age", now.since(stamp));
            }
        } else if why != last {
            tracing::warn!("trajectory refused: {why}");
            diagnostics.set("last_refusal", &why);
        }
        last = why;
    })
}

/// Serves `query_state`: where the trajectory has the arm at a time.
pub fn answer(node: &Node, shared: &Arc<Shared>, controller: &str) -> Result<(), RuntimeError> {
    let shared = shared.clone();
    node.service::<QueryTrajectoryState, _, _>(&format!("/{controller}/query_state"), move |r| {
        let at = Stamp::from_ros(r.time.sec, r.time.nanosec);
        let answer = match shared.planned(at) {
            Some(state) => QueryTrajectoryStateResponse {
                success: true,
                name: JOINT_NAMES.map(String::from).to_vec(),
                position: state.q.to_vec(),
                velocity: state.qd.to_vec(),
                ..Default::default()
            },
            None => QueryTrajectoryStateResponse {
                message: "no trajectory is active at that time".into(),
                ..Default::default()
            },
        };
        async { answer }
    })
}

/// Serves `follow_joint_trajectory`.
pub fn serve(node: &Node, shared: &Arc<Shared>, controller: &str) -> Result<(), RuntimeError> {
    let name = format!("/{controller}/follow_joint_trajectory");
    let (clock, judge) = (node.clock().clone(), shared.clone());
    let (node_clock, shared) = (node.clone(), shared.clone());
    node.action_server::<FollowJointTrajectory, _, _, _>(
        &name,
        move |goal| {
            if !goal.multi_dof_trajectory.points.is_empty() {
                return Err("there are no multi-dof joints".into());
            }
            tolerances(goal)?;
            let refused = judge.would_follow(&trajectory(goal.trajectory.clone()), clock.now());
            refused.map_err(|e| format!("{e} (code {})", code(&e)))
        },
        move |goal: Goal<FollowJointTrajectory>| {
            carry_out(goal, shared.clone(), node_clock.clone())
        },
    )
}

/// Result code of a refusal.
fn code(refusal: &MotionRefusal) -> i32 {
    if let MotionRefusal::Trajectory(t) = refusal { t.code() } else { GoalCode::InvalidGoal as i32 }
}

async fn carry_out(
    mut goal: Goal<FollowJointTrajectory>,
    shared: Arc<Shared>,
    node: Node,
) -> (GoalEnd, FollowJointTrajectoryResult) {
    let end = |end, error_code, error_string: String| {
        (end, FollowJointTrajectoryResult { error_code, error_string })
    };
    let wanted = trajectory(goal.goal.trajectory.clone());
    let tolerances = match tolerances(&goal.goal) {
        Ok(t) => t,
        Err(why) => return end(GoalEnd::Aborted, GoalCode::InvalidGoal as i32, why),
    };
    let (id, mut ended) = match shared.follow_goal(&wanted, tolerances, node.now()) {
        Ok(started) => started,
        Err(why) => return end(GoalEnd::Aborted, code(&why), why.to_string()),
    };
    let mut tick = tokio::time::interval(FEEDBACK);
    loop {
        tokio::select! {
            report = &mut ended => {
                return match report {
                    Ok(r) if r.code == GoalCode::Successful => {
                        end(GoalEnd::Succeeded, 0, r.text)
                    }
                    Ok(r) => end(GoalEnd::Aborted, r.code as i32, r.text),
                    Err(_) => end(
                        GoalEnd::Aborted,
                        GoalCode::InvalidGoal as i32,
                        "the connection to the robot was lost".into(),
                    ),
                };
            }
            () = goal.canceled() => {
                shared.cancel(id);
                if goal.is_replaced() {
                    // The code that the official controller gives.
                    let why = "replaced by a newer goal".into();
                    return end(GoalEnd::Aborted, GoalCode::InvalidGoal as i32, why);
                }
                return end(GoalEnd::Canceled, 0, "canceled: the arm comes to rest".into());
            }
            _ = tick.tick() => {
                if let Some(follow) = shared.follow_state() {
                    goal.feedback(feedback(&follow, node.now()));
                }
            }
        }
    }
}

fn feedback(follow: &Follow, now: Stamp) -> FollowJointTrajectoryFeedback {
    let point = |d: &Desired| JointTrajectoryPoint {
        positions: d.q.to_vec(),
        velocities: d.qd.to_vec(),
        ..Default::default()
    };
    FollowJointTrajectoryFeedback {
        header: tracked::header(now),
        joint_names: JOINT_NAMES.map(String::from).to_vec(),
        desired: point(&follow.desired),
        actual: point(&follow.actual),
        error: point(&follow.error()),
        ..Default::default()
    }
}

fn tolerances(goal: &FollowJointTrajectoryGoal) -> Result<GoalTolerances, String> {
    let list = |l: &[ToleranceMessage]| -> Vec<JointTolerance> {
        l.iter()
            .map(|t| JointTolerance {
                name: t.name.clone(),
                position: t.position,
                velocity: t.velocity,
            })
            .collect()
    };
    let (path, end) = (list(&goal.path_tolerance), list(&goal.goal_tolerance));
    let time = seconds(goal.goal_time_tolerance.sec, goal.goal_time_tolerance.nanosec);
    GoalTolerances::from_goal(&path, &end, time, &ExecutorParams::default())
        .map_err(|e| e.to_string())
}

fn seconds(sec: i32, nanosec: u32) -> f64 {
    f64::from(sec) + f64::from(nanosec) * 1e-9
}

fn trajectory(m: TrajectoryMessage) -> JointTrajectory {
    let stamp = tracked::stamp(&m.header);
    let points = m.points.into_iter().map(|p| TrajectoryPoint {
        positions: p.positions,
        velocities: p.velocities,
        accelerations: p.accelerations,
        effort: p.effort,
        time_from_start: seconds(p.time_from_start.sec, p.time_from_start.nanosec),
    });
    JointTrajectory {
        names: m.joint_names,
        stamp: (stamp != Stamp(0)).then_some(stamp),
        points: points.collect(),
    }
}
