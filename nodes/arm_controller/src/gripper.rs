//! The gripper's action, in either of the two types that drivers offer under one name.

use crate::params::GripperAction;
use std::time::Duration;
use tdv_msgs::control_msgs::action::{
    GripperCommand, GripperCommandGoal, ParallelGripperCommand, ParallelGripperCommandGoal,
};
use tdv_robot::gripper::KNUCKLE_JOINT;
use tdv_robot::motion::GripperRequest;
use tdv_runtime::{ActionClient, ActionError, Node, RuntimeError};

const PATIENCE: Duration = Duration::from_secs(8);

/// Sends the gripper somewhere. Cloning is cheap.
#[derive(Clone)]
pub enum Gripper {
    /// `control_msgs/action/GripperCommand` (gripper_controllers).
    Single(ActionClient<GripperCommand>),
    /// `control_msgs/action/ParallelGripperCommand` (parallel_gripper_controller).
    Parallel(ActionClient<ParallelGripperCommand>),
}

/// Where a motion of the gripper ended.
pub struct GripperEnd {
    /// Knuckle angle (rad); none when the driver does not say.
    pub knuckle: Option<f64>,
    /// Stopped by an object.
    pub stalled: bool,
    /// Where it was sent.
    pub reached: bool,
}

impl Gripper {
    /// Of the controller `name`.
    ///
    /// # Errors
    /// When the client cannot be made.
    pub fn new(node: &Node, kind: GripperAction, name: &str) -> Result<Self, RuntimeError> {
        let action = format!("/{name}/gripper_cmd");
        Ok(match kind {
            GripperAction::GripperCommand => Self::Single(node.action_client(&action)?),
            GripperAction::ParallelGripperCommand => Self::Parallel(node.action_client(&action)?),
        })
    }

    /// Carries out a request.
    ///
    /// # Errors
    /// [`ActionError`]: no server, goal rejected, no result in time.
    pub async fn run(&self, request: GripperRequest) -> Result<GripperEnd, ActionError> {
        match self {
            Self::Single(client) => {
                let mut goal = GripperCommandGoal::default();
                goal.command.position = request.position;
                goal.command.max_effort = request.max_effort;
                let (_, r) = client.run(goal, PATIENCE).await?;
                let (stalled, reached) = (r.stalled, r.reached_goal);
                Ok(GripperEnd { knuckle: Some(r.position), stalled, reached })
            }
            Self::Parallel(client) => {
                let mut goal = ParallelGripperCommandGoal::default();
                goal.command.name = vec![KNUCKLE_JOINT.into()];
                goal.command.position = vec![request.position];
                goal.command.effort = vec![request.max_effort];
                let (_, r) = client.run(goal, PATIENCE).await?;
                let knuckle = r.state.position.first().copied().filter(|p| p.is_finite());
                Ok(GripperEnd { knuckle, stalled: r.stalled, reached: r.reached_goal })
            }
        }
    }
}
