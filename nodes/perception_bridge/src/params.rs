use serde::{Deserialize, Serialize};
use tdv_perception::PerceiverConfig;
use tdv_runtime::Parameters;

/// Parameters of the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BridgeParameters {
    pub objects_dir: String,
    pub objects: Vec<String>,
    pub mesh_scales: Vec<String>,
    pub color_topic: String,
    pub depth_topic: String,
    pub camera_info_topic: String,
    pub depth_info_topic: String,
    pub compressed: bool,
    pub sync_tolerance: f64,
    pub every_frame: bool,
    pub freeze_after_first: bool,
    pub publish_segmentation: bool,
    pub perceiver: PerceiverConfig,
}

impl Default for BridgeParameters {
    fn default() -> Self {
        Self {
            objects_dir: "config/objects".into(),
            objects: Vec::new(),
            mesh_scales: Vec::new(),
            color_topic: "/camera/camera/color/image_raw".into(),
            depth_topic: "/camera/camera/aligned_depth_to_color/image_raw".into(),
            camera_info_topic: "/camera/camera/color/camera_info".into(),
            depth_info_topic: String::new(),
            compressed: false,
            sync_tolerance: 0.0,
            every_frame: false,
            freeze_after_first: false,
            publish_segmentation: true,
            perceiver: PerceiverConfig::default(),
        }
    }
}

impl BridgeParameters {
    /// Factor by which an object's mesh is scaled, 1 unless `mesh_scales` says otherwise.
    pub fn mesh_scale(&self, object: &str) -> f64 {
        self.mesh_scales
            .iter()
            .filter_map(|s| s.split_once(':'))
            .find(|(name, _)| *name == object)
            .and_then(|(_, scale)| scale.parse().ok())
            .unwrap_or(1.0)
    }
}

impl Parameters for BridgeParameters {
    fn validate(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if !(self.sync_tolerance.is_finite() && self.sync_tolerance >= 0.0) {
            problems
                .push(format!("'sync_tolerance' is {}: seconds, 0 or more", self.sync_tolerance));
        }
        for entry in &self.mesh_scales {
            let scale = entry.split_once(':').and_then(|(_, s)| s.parse::<f64>().ok());
            if scale.is_none_or(|s| !(s > 0.01 && s < 100.0)) {
                problems.push(format!("'mesh_scales' has {entry:?}: expected NAME:FACTOR"));
            }
        }
        problems
    }

    fn describe(name: &str) -> &'static str {
        match name {
            "objects_dir" => "folder of the object catalogue",
            "objects" => "catalogue names to look for; empty: those that the prompt names",
            "mesh_scales" => "NAME:FACTOR for meshes whose size is known better than the file says",
            "camera_info_topic" => {
                "calibration of the raw colour images; its distortion is taken out of colour and depth"
            }
            "depth_info_topic" => {
                "calibration of a depth camera of its own, whose images are registered to colour by \
                 /tf_static; empty: depth is aligned already"
            }
            "compressed" => "subscribe to COLOR/compressed and DEPTH/compressedDepth",
            "sync_tolerance" => {
                "largest difference (s) of the stamps of colour and depth; 0: equal"
            }
            "every_frame" => "process every frame in order (replay) instead of the newest (live)",
            "freeze_after_first" => "control experiment: repeat the first complete result for ever",
            "publish_segmentation" => "publish the label image on ~/segmentation",
            "perceiver.prompt" => "text that names the objects, such as the task's instruction",
            _ => "",
        }
    }
}
