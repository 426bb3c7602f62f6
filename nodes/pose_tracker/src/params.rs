use serde::{Deserialize, Serialize};
use tdv_perception::objects::ObjectsConfig;
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerParameters {
    pub task: String,
    pub objects: Vec<String>,
    pub objects_dir: String,
    pub camera_frame: String,
    pub tracking: ObjectsConfig,
}

impl Default for TrackerParameters {
    fn default() -> Self {
        Self {
            task: String::new(),
            objects: Vec::new(),
            objects_dir: "config/objects".into(),
            camera_frame: "camera_color_optical_frame".into(),
            tracking: ObjectsConfig::default(),
        }
    }
}

impl Parameters for TrackerParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.task.is_empty() && self.objects.is_empty() {
            problems.push(
                "'task' and 'objects' are empty: give a file of config/tasks or catalogue names"
                    .into(),
            );
        }
        if self.tracking.reject > self.tracking.accept {
            problems.push(format!(
                "'tracking.reject' ({}) is above 'tracking.accept' ({})",
                self.tracking.reject, self.tracking.accept
            ));
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "task" => "task file: which objects there are, which moves, which is the reference",
            "objects" => "without a task: catalogue names, the first is the reference",
            "objects_dir" => "folder of the object catalogue (for symmetries)",
            "camera_frame" => {
                "frame of the detections; its pose in base_link comes from /tf_static and /tf"
            }
            _ => "",
        }
    }
}
