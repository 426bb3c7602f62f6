//! `/controller_manager`, and the commands of the controllers that take streams.

use crate::state::Shared;
use crate::switching::{BROADCASTERS, Controllers};
use std::sync::Arc;
use tdv_msgs::controller_manager_msgs::msg::ControllerState;
use tdv_msgs::controller_manager_msgs::srv::{
    ListControllers, ListControllersResponse, SwitchController, SwitchControllerResponse,
};
use tdv_msgs::std_msgs::msg::{Bool, Float64MultiArray};
use tdv_robot::{JOINT_NAMES, MotionController};
use tdv_runtime::{Node, Qos, RuntimeError};

fn class(kind: MotionController) -> (&'static str, &'static str) {
    match kind {
        MotionController::Trajectory => {
            ("ur_controllers/ScaledJointTrajectoryController", "position")
        }
        MotionController::Position => {
            ("position_controllers/JointGroupPositionController", "position")
        }
        MotionController::Velocity => {
            ("velocity_controllers/JointGroupVelocityController", "velocity")
        }
    }
}

fn list(
    controllers: &Controllers,
    active: Option<MotionController>,
    rate: u16,
) -> Vec<ControllerState> {
    let motion = controllers.motion().map(|(name, kind)| {
        let (class, interface) = class(kind);
        let interfaces: Vec<_> = JOINT_NAMES.iter().map(|j| format!("{j}/{interface}")).collect();
        let is_active = active == Some(kind);
        ControllerState {
            name: name.into(),
            state: if is_active { "active" } else { "inactive" }.into(),
            r#type: class.into(),
            update_rate: rate,
            claimed_interfaces: if is_active { interfaces.clone() } else { Vec::new() },
            required_command_interfaces: interfaces,
            ..Default::default()
        }
    });
    let others = BROADCASTERS.iter().map(|(name, class)| ControllerState {
        name: (*name).into(),
        state: "active".into(),
        r#type: (*class).into(),
        update_rate: rate,
        ..Default::default()
    });
    motion.chain(others).collect()
}

pub fn serve(
    node: &Node,
    shared: &Arc<Shared>,
    trajectory: &str,
    rate: u16,
) -> Result<(), RuntimeError> {
    let controllers = Arc::new(Controllers::new(trajectory));
    let (c, s) = (controllers.clone(), shared.clone());
    node.service::<ListControllers, _, _>("/controller_manager/list_controllers", move |_| {
        let controller = list(&c, s.controller(), rate);
        async { ListControllersResponse { controller } }
    })?;
    let (c, s) = (controllers, shared.clone());
    node.service::<SwitchController, _, _>("/controller_manager/switch_controller", move |r| {
        let on = &r.activate_controllers;
        let next = c.switch(s.controller(), on, &r.deactivate_controllers, r.strictness);
        let (ok, message) = match next {
            Ok(next) => {
                s.select(next);
                (true, String::new())
            }
            Err(why) => {
                tracing::warn!("switch_controller: {why}");
                (false, why)
            }
        };
        async move { SwitchControllerResponse { ok, message } }
    })?;
    stream(node, shared, "/forward_position_controller/commands", MotionController::Position)?;
    stream(node, shared, "/forward_velocity_controller/commands", MotionController::Velocity)
}

fn stream(
    node: &Node,
    shared: &Arc<Shared>,
    topic: &str,
    kind: MotionController,
) -> Result<(), RuntimeError> {
    let (shared, diagnostics, name) =
        (shared.clone(), node.diagnostics().clone(), topic.to_owned());
    let mut last = String::new();
    node.subscribe(topic, Qos::best_effort(1), move |m: Float64MultiArray| {
        let why = shared.stream(kind, &m.data).err().map_or(String::new(), |e| e.to_string());
        // Streams are fast: each reason is said once.
        if !why.is_empty() && why != last {
            tracing::warn!("{name}: {why}");
            diagnostics.set("last_refusal", &why);
        }
        last = why;
    })
}

/// The enabling switch.
pub fn take_switch(node: &Node, shared: &Arc<Shared>) -> Result<(), RuntimeError> {
    let shared = shared.clone();
    node.subscribe("~/enable", Qos::best_effort(1), move |m: Bool| shared.switch(m.data))
}
