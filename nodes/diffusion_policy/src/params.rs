use serde::{Deserialize, Serialize};
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PolicyParameters {
    pub model: String,
    pub untrained: bool,
    pub open_loop: bool,
    pub task: String,
    pub inference_steps: i64,
    pub max_gap: f64,
    pub seed: i64,
}

impl Default for PolicyParameters {
    fn default() -> Self {
        Self {
            model: String::new(),
            untrained: false,
            open_loop: false,
            task: String::new(),
            inference_steps: 10,
            max_gap: 0.5,
            seed: 1,
        }
    }
}

impl Parameters for PolicyParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.model.is_empty() {
            problems.push("'model' is empty: give the folder that `tdv teach` wrote".into());
        }
        if self.open_loop && self.task.is_empty() {
            problems.push(
                "'task' is empty: 'open_loop' bends the demonstration by the task file".into(),
            );
        }
        if self.inference_steps < 1 {
            problems.push(format!("'inference_steps' is {}: 1 or more", self.inference_steps));
        }
        if !(self.max_gap.is_finite() && self.max_gap > 0.0) {
            problems.push(format!("'max_gap' is {}: seconds above 0", self.max_gap));
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "model" => "folder with demonstration.json and policy.safetensors",
            "untrained" => "control experiment: a network of the same shape with random weights",
            "open_loop" => {
                "control experiment: play the demonstration, bent to the first look at the scene"
            }
            "task" => "task file; for open_loop only",
            "inference_steps" => "denoising steps of a plan",
            "max_gap" => "a longer silence of the tracker (s) starts a new history",
            "seed" => "seed of the sampler's noise",
            _ => "",
        }
    }
}
