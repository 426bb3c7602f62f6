//! What a person does to the robot in a trial: pull a plug, push the arm, press the buttons afterwards.

use super::fault::Trouble;
use crate::{ActionClient, Node, RuntimeError, ServiceClient};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tdv_msgs::std_srvs::srv::{SetBool, SetBoolRequest, Trigger, TriggerRequest};
use tdv_msgs::ur_dashboard_msgs::action::{SetMode, SetModeGoal};
use tdv_msgs::ur_msgs::srv::{SetSpeedSliderFraction, SetSpeedSliderFractionRequest};

/// A service answers within this time.
const PATIENCE: Duration = Duration::from_secs(6);
/// Unlocking, releasing brakes and playing take their time.
const MODE_PATIENCE: Duration = Duration::from_secs(25);
/// Robot mode RUNNING.
const RUNNING: i8 = 7;

/// The buttons. Pressing one does not wait for what comes of it: [`notes`](Self::notes) tells.
#[derive(Clone)]
pub(super) struct Operator {
    node: Node,
    cut_rtde: ServiceClient<SetBool>,
    cut_gripper: ServiceClient<SetBool>,
    protect: ServiceClient<Trigger>,
    slider: ServiceClient<SetSpeedSliderFraction>,
    set_mode: ActionClient<SetMode>,
    reset: ServiceClient<Trigger>,
    resume: ServiceClient<Trigger>,
    notes: Arc<Mutex<Vec<String>>>,
}

impl Operator {
    pub fn new(node: &Node) -> Result<Self, RuntimeError> {
        Ok(Self {
            node: node.clone(),
            cut_rtde: node.client("/virtual_lab/cut_rtde")?,
            cut_gripper: node.client("/virtual_lab/cut_gripper")?,
            protect: node.client("/virtual_lab/protective_stop")?,
            slider: node.client("/io_and_status_controller/set_speed_slider")?,
            set_mode: node.action_client("/ur_robot_state_helper/set_mode")?,
            reset: node.client("/ur5_driver/reset")?,
            resume: node.client("/arm_controller/resume")?,
            notes: Arc::default(),
        })
    }

    /// What has been done since the last call.
    pub fn notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn note(&self, what: &str, outcome: Result<String, String>) {
        let said = outcome.unwrap_or_else(|why| format!("FAILED: {why}"));
        self.notes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(format!("operator: {what}: {said}"));
    }

    /// Begins (or ends) a trouble; that of a node is the caller's.
    pub fn act(&self, trouble: &Trouble, begin: bool) {
        let (this, trouble) = (self.clone(), trouble.clone());
        self.node.spawn("operator", async move {
            match trouble {
                Trouble::Kill(_) => {}
                Trouble::CutRtde => this.cut(&this.cut_rtde, begin).await,
                Trouble::CutGripper => this.cut(&this.cut_gripper, begin).await,
                Trouble::ProtectiveStop if begin => this.press(&this.protect).await,
                Trouble::ProtectiveStop => this.bring_up().await,
                Trouble::SpeedSlider(fraction) => {
                    this.slide(if begin { fraction } else { 1.0 }).await;
                }
            }
        });
    }

    /// What `docs/hazards.md` tells an operator to do with an arm that stands; at the second time the
    /// robot's program is started anew as well.
    pub fn help(&self, time: u32) {
        let this = self.clone();
        self.node.spawn("operator", async move {
            if time > 1 {
                this.bring_up().await;
            }
            this.press(&this.reset).await;
            this.press(&this.resume).await;
        });
    }

    async fn cut(&self, client: &ServiceClient<SetBool>, cut: bool) {
        let answer = client.call(SetBoolRequest { data: cut }, PATIENCE).await;
        self.note(client.name(), answer.map(|a| a.message).map_err(|e| e.to_string()));
    }

    async fn press(&self, client: &ServiceClient<Trigger>) {
        let answer = client.call(TriggerRequest::default(), PATIENCE).await;
        self.note(client.name(), answer.map(|a| a.message).map_err(|e| e.to_string()));
    }

    async fn slide(&self, fraction: f64) {
        let request = SetSpeedSliderFractionRequest { speed_slider_fraction: fraction };
        let outcome = match self.slider.call(request, PATIENCE).await {
            Ok(answer) if answer.success => Ok(format!("{:.0} %", 100.0 * fraction)),
            Ok(_) => Err("refused".into()),
            Err(e) => Err(e.to_string()),
        };
        self.note(self.slider.name(), outcome);
    }

    async fn bring_up(&self) {
        let goal =
            SetModeGoal { target_robot_mode: RUNNING, stop_program: true, play_program: true };
        let outcome = async {
            let ticket = self.set_mode.send(goal, PATIENCE).await?;
            self.set_mode.result(ticket, MODE_PATIENCE).await
        };
        let outcome = outcome.await.map_err(|e| e.to_string());
        let outcome =
            outcome.and_then(|(_, r)| if r.success { Ok(r.message) } else { Err(r.message) });
        self.note(self.set_mode.name(), outcome);
    }
}
