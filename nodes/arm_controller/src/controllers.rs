//! Talks to ros2_control's controller manager: the official driver moves nothing before the right
//! controller is active.

use crate::permissions::Permissions;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tdv_msgs::controller_manager_msgs::msg::ControllerState;
use tdv_msgs::controller_manager_msgs::srv::{
    ListControllers, ListControllersRequest, SwitchController, SwitchControllerRequest,
};
use tdv_runtime::{Node, ServiceClient};

/// Time between two looks.
const PERIOD: Duration = Duration::from_secs(1);
const PATIENCE: Duration = Duration::from_secs(5);

/// Activates a controller and watches that it stays so.
pub struct ControllerWatch {
    name: String,
    list: ServiceClient<ListControllers>,
    switch: ServiceClient<SwitchController>,
    permissions: Permissions,
    /// The controller may be taken: at the start, and when the operator resumes.
    take: Arc<AtomicBool>,
    /// It may be taken at any time.
    always: bool,
}

impl ControllerWatch {
    /// Of the controller `name` at the manager node `manager`.
    ///
    /// # Errors
    /// When the service clients cannot be made.
    pub fn new(
        node: &Node,
        manager: &str,
        name: &str,
        permissions: Permissions,
        take: Arc<AtomicBool>,
        always: bool,
    ) -> anyhow::Result<Self> {
        take.store(true, Ordering::SeqCst);
        Ok(Self {
            name: name.into(),
            list: node.client(&format!("{manager}/list_controllers"))?,
            switch: node.client(&format!("{manager}/switch_controller"))?,
            permissions,
            take,
            always,
        })
    }

    /// For the life of the node.
    pub async fn watch(self) {
        loop {
            match self.list.call(ListControllersRequest::default(), PATIENCE).await {
                Ok(answer) => {
                    let problem = self.look(&answer.controller).await;
                    self.permissions.controllers(problem);
                }
                // A manager that is silent for a while changes nothing: joint states say more.
                Err(e) => tracing::debug!("{e}"),
            }
            tokio::time::sleep(PERIOD).await;
        }
    }

    /// What stands against motion, after an attempt to mend it where that is allowed.
    async fn look(&self, all: &[ControllerState]) -> Option<String> {
        let name = &self.name;
        let Some(ours) = all.iter().find(|c| c.name == *name) else {
            let names: Vec<&str> = all.iter().map(|c| c.name.as_str()).collect();
            return Some(format!(
                "controller {name} is not loaded; there are {}",
                names.join(", ")
            ));
        };
        if ours.state == "active" {
            self.take.store(false, Ordering::SeqCst);
            return None;
        }
        if !self.always && !self.take.load(Ordering::SeqCst) {
            return Some(format!("controller {name} was switched off; ~/resume takes it back"));
        }
        let request = SwitchControllerRequest {
            activate_controllers: vec![name.clone()],
            deactivate_controllers: rivals(ours, all),
            strictness: SwitchControllerRequest::STRICT,
            ..Default::default()
        };
        tracing::info!("activating {name} instead of {:?}", request.deactivate_controllers);
        match self.switch.call(request, PATIENCE).await {
            Ok(answer) if answer.ok => None,
            Ok(answer) => {
                Some(format!("controller {name} cannot be activated: {}", answer.message))
            }
            Err(e) => Some(format!("controller {name} cannot be activated: {e}")),
        }
    }
}

/// Active controllers that claim an interface that `ours` needs.
fn rivals(ours: &ControllerState, all: &[ControllerState]) -> Vec<String> {
    all.iter()
        .filter(|c| c.state == "active" && c.name != ours.name)
        .filter(|c| {
            c.claimed_interfaces.iter().any(|i| ours.required_command_interfaces.contains(i))
        })
        .map(|c| c.name.clone())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_active_controllers_with_the_same_interfaces_are_rivals() {
        let controller = |name: &str, state: &str, claims: &[&str]| ControllerState {
            name: name.into(),
            state: state.into(),
            claimed_interfaces: claims.iter().map(|s| (*s).into()).collect(),
            required_command_interfaces: vec!["elbow_joint/position".into()],
            ..Default::default()
        };
        let all = [
            controller("scaled", "inactive", &[]),
            controller("forward", "active", &["elbow_joint/position"]),
            controller("broadcaster", "active", &[]),
            controller("velocity", "inactive", &["elbow_joint/position"]),
        ];
        assert_eq!(rivals(&all[0], &all), ["forward"]);
    }
}
