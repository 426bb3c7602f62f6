//! Listens to the robot's safety system: says what an operator has to do, and in the lab does it.

use crate::permissions::Permissions;
use std::time::Duration;
use tdv_msgs::ur_dashboard_msgs::action::{SetMode, SetModeGoal};
use tdv_msgs::ur_dashboard_msgs::msg::{RobotMode, SafetyMode};
use tdv_runtime::{ActionClient, Inbox, Node, Qos};

/// The controller unlocks nothing earlier than this after a protective stop (UR dashboard manual).
const BEFORE_UNLOCK: Duration = Duration::from_millis(5500);
/// Time that a recovery may take.
const PATIENCE: Duration = Duration::from_secs(30);

/// Watches `/io_and_status_controller/safety_mode`.
pub struct SafetyWatch {
    modes: Inbox<SafetyMode>,
    set_mode: ActionClient<SetMode>,
    permissions: Permissions,
    /// A protective stop is unlocked without an operator.
    unlock: bool,
}

impl SafetyWatch {
    /// Tells `permissions` what it hears; with `unlock` it also ends protective stops.
    ///
    /// # Errors
    /// When the subscription or the client cannot be made.
    pub fn new(node: &Node, permissions: Permissions, unlock: bool) -> anyhow::Result<Self> {
        Ok(Self {
            modes: node.newest("/io_and_status_controller/safety_mode", Qos::latched())?,
            set_mode: node.action_client("/ur_robot_state_helper/set_mode")?,
            permissions,
            unlock,
        })
    }

    /// For the life of the node.
    pub async fn watch(mut self) {
        while let Some(mut mode) = self.modes.recv().await.map(|m| m.mode) {
            loop {
                self.permissions.safety(problem(mode));
                if !self.unlock || mode != SafetyMode::PROTECTIVE_STOP {
                    break;
                }
                // Any news ends the waiting.
                match tokio::time::timeout(BEFORE_UNLOCK, self.modes.recv()).await {
                    Ok(Some(m)) => mode = m.mode,
                    Ok(None) => return,
                    Err(_) => {
                        self.recover().await;
                        break;
                    }
                }
            }
        }
    }

    async fn recover(&self) {
        let goal = SetModeGoal {
            target_robot_mode: RobotMode::RUNNING as i8,
            stop_program: true,
            play_program: true,
        };
        match self.set_mode.run(goal, PATIENCE).await {
            Ok((_, end)) if end.success => tracing::warn!("protective stop ended: {}", end.message),
            Ok((_, end)) => tracing::error!("protective stop not ended: {}", end.message),
            Err(e) => tracing::error!("protective stop not ended: {e}"),
        }
    }
}

/// What stands against motion, and what to do about it.
fn problem(mode: u8) -> Option<String> {
    let what = match mode {
        SafetyMode::NORMAL | SafetyMode::REDUCED => return None,
        0 => "the driver hears nothing from the robot",
        SafetyMode::PROTECTIVE_STOP => {
            "protective stop: clear the cause, then call set_mode RUNNING"
        }
        SafetyMode::RECOVERY => "safety recovery: move the arm back within its limits by hand",
        SafetyMode::SAFEGUARD_STOP | SafetyMode::AUTOMATIC_MODE_SAFEGUARD_STOP => {
            "safeguard stop: close the safeguard"
        }
        SafetyMode::SYSTEM_EMERGENCY_STOP | SafetyMode::ROBOT_EMERGENCY_STOP => {
            "emergency stop: release the button, then call set_mode RUNNING"
        }
        SafetyMode::VIOLATION | SafetyMode::FAULT => {
            "safety violation or fault: look at the teach pendant, then restart the safety system"
        }
        SafetyMode::SYSTEM_THREE_POSITION_ENABLING_STOP => "the enabling device is not pressed",
        _ => return Some(format!("safety mode {mode}: look at the teach pendant")),
    };
    Some(what.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_but_normal_and_reduced_stands_against_motion() {
        for mode in 0..=20 {
            let free = [SafetyMode::NORMAL, SafetyMode::REDUCED].contains(&mode);
            assert_eq!(problem(mode).is_none(), free, "{mode}");
        }
        assert!(problem(SafetyMode::PROTECTIVE_STOP).unwrap().contains("set_mode"));
    }
}
