//! `/ur_robot_state_helper/set_mode`: from any mode to the wanted one in one call.

use crate::dashboard::Dashboard;
use crate::program::Programs;
use crate::state::Shared;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tdv_msgs::ur_dashboard_msgs::action::{SetMode, SetModeFeedback, SetModeResult};
use tdv_runtime::{Goal, GoalEnd, Node, RuntimeError};
use tdv_ur_protocol::dashboard::{Recovery, Request, RobotStatus, Step};

/// Between two looks at the robot.
const PERIOD: Duration = Duration::from_millis(100);
/// The dashboard refuses to play right after the brakes were released.
const BEFORE_PLAY: Duration = Duration::from_secs(1);
/// Robot mode RUNNING.
const RUNNING: i8 = 7;
/// `runtime_state` values from which a program would go on: playing, pausing, paused, resuming.
const HAS_PROGRAM: std::ops::RangeInclusive<u32> = 2..=5;

/// What the action needs.
#[derive(Clone)]
pub struct Helper {
    pub dashboard: Dashboard,
    pub programs: Programs,
    pub shared: Arc<Shared>,
    pub headless: bool,
}

pub fn serve(node: &Node, helper: Helper) -> Result<(), RuntimeError> {
    let known = helper.shared.clone();
    node.action_server::<SetMode, _, _, _>(
        "/ur_robot_state_helper/set_mode",
        move |goal| {
            Recovery::new(i32::from(goal.target_robot_mode), goal.stop_program)?;
            known.arm().map(|_| ()).ok_or_else(|| "the robot's mode is not known yet".into())
        },
        move |goal: Goal<SetMode>| {
            let helper = helper.clone();
            async move {
                let outcome = helper.recover(&goal).await;
                let success = outcome.is_ok();
                let message = outcome.unwrap_or_else(|why| why);
                tracing::info!("set_mode: {message}");
                let end = match success {
                    true => GoalEnd::Succeeded,
                    false if goal.is_canceled() => GoalEnd::Canceled,
                    false => GoalEnd::Aborted,
                };
                (end, SetModeResult { success, message })
            }
        },
    )
}

impl Helper {
    async fn recover(&self, goal: &Goal<SetMode>) -> Result<String, String> {
        let g = &goal.goal;
        let mut plan = Recovery::new(i32::from(g.target_robot_mode), g.stop_program)?;
        let begun = Instant::now();
        let mut shown = None;
        loop {
            if goal.is_canceled() {
                return Err("canceled on the way".into());
            }
            let Some((arm, _)) = self.shared.arm() else {
                return Err("the connection to the robot was lost".into());
            };
            let modes = (arm.robot_mode as i8, arm.safety_mode as i8);
            if shown.replace(modes) != Some(modes) {
                goal.feedback(SetModeFeedback {
                    current_robot_mode: modes.0,
                    current_safety_mode: modes.1,
                });
            }
            let status = RobotStatus {
                robot_mode: arm.robot_mode,
                safety_mode: arm.safety_mode,
                program: HAS_PROGRAM.contains(&arm.runtime_state),
            };
            match plan.step(begun.elapsed().as_secs_f64(), &status) {
                Step::Wait(_) => {}
                Step::Failed(why) => return Err(why),
                Step::Done => break,
                Step::Send(request) => {
                    let said = self.dashboard.ask(&request).await;
                    let (answer, words) = said.map_err(|e| format!("{e:#}"))?;
                    tracing::info!("dashboard: {request:?}: {words}");
                    plan.answered(&answer, &words);
                }
            }
            tokio::time::sleep(PERIOD).await;
        }
        self.shared.reset();
        if g.target_robot_mode != RUNNING || !g.play_program {
            return Ok("mode reached".into());
        }
        self.play().await
    }

    async fn play(&self) -> Result<String, String> {
        if self.shared.arm().is_some_and(|(_, followed)| followed) {
            return Ok("mode reached, the servo program runs".into());
        }
        if self.headless {
            self.programs.send_servo().await.map_err(|e| format!("mode reached, but {e:#}"))?;
            return Ok("mode reached, servo program sent".into());
        }
        tokio::time::sleep(BEFORE_PLAY).await;
        let said = self.dashboard.ask(&Request::Play).await;
        match said.map_err(|e| format!("mode reached, but {e:#}"))? {
            (tdv_ur_protocol::dashboard::Answer::Done, _) => Ok("mode reached, playing".into()),
            (_, words) => Err(format!("mode reached, but play was refused: {words}")),
        }
    }
}
