use serde::{Deserialize, Serialize};
use tdv_bag::ReplayConfig;
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayParameters {
    pub bag: String,
    pub topics: Vec<String>,
    pub rate: f64,
    pub start_offset: f64,
    pub looped: bool,
    pub clock: bool,
    pub restamp: bool,
    pub startup_delay: f64,
    pub lockstep: bool,
    pub lockstep_answers: Vec<String>,
    pub lockstep_timeout: f64,
    pub sync_tolerance: f64,
}

impl Default for ReplayParameters {
    fn default() -> Self {
        Self {
            bag: String::new(),
            topics: Vec::new(),
            rate: 1.0,
            start_offset: 0.0,
            looped: false,
            clock: false,
            restamp: false,
            startup_delay: 1.0,
            lockstep: false,
            lockstep_answers: vec![
                "/pose_tracker/objects:tdv_msgs/msg/TrackedObjects".into(),
                "/diffusion_policy/prediction:tdv_msgs/msg/PoseTrajectory".into(),
            ],
            lockstep_timeout: 5.0,
            sync_tolerance: 0.0,
        }
    }
}

impl ReplayParameters {
    pub fn config(&self) -> ReplayConfig {
        ReplayConfig { rate: self.rate, start_offset: self.start_offset, looped: self.looped }
    }
}

impl Parameters for ReplayParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.bag.is_empty() {
            problems.push("'bag' is empty: give the folder or .mcap file to replay".into());
        }
        if let Err(e) = self.config().validate() {
            problems.push(e.to_string());
        }
        if !(self.startup_delay.is_finite() && self.startup_delay >= 0.0) {
            problems.push(format!("'startup_delay' is {}: seconds, 0 or more", self.startup_delay));
        }
        if !(self.lockstep_timeout.is_finite() && self.lockstep_timeout > 0.0) {
            problems
                .push(format!("'lockstep_timeout' is {}: seconds above 0", self.lockstep_timeout));
        }
        if !(self.sync_tolerance.is_finite() && self.sync_tolerance >= 0.0) {
            problems
                .push(format!("'sync_tolerance' is {}: seconds, 0 or more", self.sync_tolerance));
        }
        if self.lockstep && self.restamp {
            problems.push(
                "'lockstep' and 'restamp' exclude each other: lockstep keeps the recorded stamps"
                    .into(),
            );
        }
        if self.lockstep && self.lockstep_answers.is_empty() {
            problems.push(
                "'lockstep_answers' is empty: name at least one topic:type to wait for".into(),
            );
        }
        for answer in &self.lockstep_answers {
            if answer.split_once(':').is_none_or(|(t, ty)| t.is_empty() || ty.is_empty()) {
                problems.push(format!("'lockstep_answers' has {answer:?}: expected TOPIC:TYPE"));
            }
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "bag" => "rosbag2 folder or .mcap file",
            "topics" => {
                "topics to replay; empty: cameras (colour, depth, camera_info) and /tf_static"
            }
            "rate" => "speed, 1 = as recorded",
            "start_offset" => "seconds skipped at the start",
            "looped" => "start over at the end",
            "clock" => "publish the bag's time on /clock (other nodes: use_sim_time)",
            "restamp" => "give every header the present time instead of the recorded one",
            "startup_delay" => "seconds to wait before the first message, for discovery",
            "lockstep" => "send the next frame only when every answer to the last one has come",
            "lockstep_answers" => {
                "TOPIC:TYPE of the messages that answer a frame, matched by stamp"
            }
            "lockstep_timeout" => "seconds to wait for the answers before the frame is sent again",
            "sync_tolerance" => {
                "largest difference (s) of the stamps of one frame in lockstep, as of perception_bridge"
            }
            _ => "",
        }
    }
}
