use serde::{Deserialize, Serialize};
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SwitchParameters {
    pub model: String,
    pub first_procedure: i64,
    pub threshold: f64,
    pub consecutive: i64,
    pub guard_position: f64,
    pub guard_rotation: f64,
    pub timeout: f64,
    pub max_gap: f64,
}

impl Default for SwitchParameters {
    fn default() -> Self {
        Self {
            model: String::new(),
            first_procedure: 0,
            threshold: 0.8,
            consecutive: 3,
            guard_position: 0.03,
            guard_rotation: 0.35,
            timeout: 60.0,
            max_gap: 0.5,
        }
    }
}

impl Parameters for SwitchParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.model.is_empty() {
            problems.push("'model' is empty: give the folder that `tdv teach` wrote".into());
        }
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            problems.push(format!("'threshold' is {}: between 0 and 1", self.threshold));
        }
        if self.first_procedure < 0 {
            problems.push(format!("'first_procedure' is {}: 0 or more", self.first_procedure));
        }
        if self.consecutive < 1 {
            problems.push(format!("'consecutive' is {}: 1 or more", self.consecutive));
        }
        for (name, value) in [
            ("guard_position", self.guard_position),
            ("guard_rotation", self.guard_rotation),
            ("timeout", self.timeout),
            ("max_gap", self.max_gap),
        ] {
            if !(value.is_finite() && value > 0.0) {
                problems.push(format!("'{name}' is {value}: a number above 0"));
            }
        }
        problems
    }

    fn live() -> &'static [&'static str] {
        &["threshold", "consecutive", "guard_position", "guard_rotation", "timeout"]
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "model" => "folder with demonstration.json and switch.safetensors",
            "first_procedure" => {
                "procedure to begin with; 1 to replay a recording that shows no gripper"
            }
            "threshold" => "probability above which the end of a procedure counts",
            "consecutive" => "observations in a row above the threshold that switch",
            "guard_position" => "farther (m) from the demonstrated end there is no switch",
            "guard_rotation" => "turned further (rad) from the demonstrated end there is no switch",
            "timeout" => "seconds in one procedure after which a warning goes out",
            "max_gap" => "a longer silence of the tracker (s) starts a new history",
            _ => "",
        }
    }
}
