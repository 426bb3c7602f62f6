use serde::{Deserialize, Serialize};
use tdv_perception::PerceiverConfig;
use tdv_perception::remote::RemoteConfig;
use tdv_runtime::Parameters;

/// Who finds the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// crates/perception, in this process.
    Classical,
    /// Nodes with the interface of Isaac ROS FoundationPose.
    Remote,
}

/// The words of the parameter `backend`.
const BACKENDS: [(&str, Backend); 2] =
    [("classical", Backend::Classical), ("remote", Backend::Remote)];

/// Where the remote estimators are, and how long they are waited for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RemoteParameters {
    pub namespace: String,
    pub patience: f64,
    pub belief: RemoteConfig,
}

impl Default for RemoteParameters {
    fn default() -> Self {
        Self { namespace: "/isaac".into(), patience: 0.3, belief: RemoteConfig::default() }
    }
}

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
    pub backend: String,
    pub remote: RemoteParameters,
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
            backend: "classical".into(),
            remote: RemoteParameters::default(),
            perceiver: PerceiverConfig::default(),
        }
    }
}

impl BridgeParameters {
    /// The backend that `backend` names; none for another word, which [`Parameters::validate`] refuses.
    pub fn backend(&self) -> Option<Backend> {
        BACKENDS.iter().find(|(word, _)| *word == self.backend).map(|(_, backend)| *backend)
    }

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
        if self.backend().is_none() {
            let words = BACKENDS.map(|(word, _)| word).join(", ");
            problems.push(format!("'backend' is {:?}: one of {words}", self.backend));
        }
        let patience = self.remote.patience;
        if !(patience > 0.0 && patience <= 60.0) {
            problems.push(format!("'remote.patience' is {patience}: seconds, above 0, at most 60"));
        }
        if !self.remote.namespace.starts_with('/') || self.remote.namespace.ends_with('/') {
            let namespace = &self.remote.namespace;
            problems.push(format!("'remote.namespace' is {namespace:?}: as /isaac"));
        }
        let least = self.remote.belief.min_confidence;
        // Every pose would do at 0, also one that nothing speaks for.
        if !(least > 0.0 && least <= 1.0) {
            problems.push(format!("'remote.belief.min_confidence' is {least}: above 0, at most 1"));
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
            "backend" => {
                "classical, or remote: nodes with the interface of Isaac ROS FoundationPose"
            }
            "remote.namespace" => {
                "images go to NS/pose_estimation, masks to NS/OBJECT/pose_estimation"
            }
            "remote.patience" => {
                "seconds that an answer is waited for; more for a first pose on a slow GPU"
            }
            "remote.belief.min_confidence" => {
                "agreement (0..1) with depth and mask below which an answer is no detection"
            }
            "remote.belief.hold" => {
                "age (s) up to which the last believed pose is the mask where none is found"
            }
            "perceiver.prompt" => "text that names the objects, such as the task's instruction",
            _ => "",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_backend_is_refused_with_the_list() {
        let mut p = BridgeParameters::default();
        assert_eq!((p.backend(), p.validate()), (Some(Backend::Classical), Vec::new()));
        p.backend = "remote".into();
        assert_eq!((p.backend(), p.validate()), (Some(Backend::Remote), Vec::new()));
        p.backend = "isaac".into();
        assert_eq!(p.validate(), ["'backend' is \"isaac\": one of classical, remote"]);
    }

    #[test]
    fn remote_settings_that_cannot_be_are_named() {
        let mut p = BridgeParameters::default();
        p.remote.patience = f64::NAN;
        p.remote.namespace = "isaac/".into();
        p.remote.belief.min_confidence = 0.0;
        let problems = p.validate();
        for (problem, name) in problems.iter().zip(["patience", "namespace", "min_confidence"]) {
            assert!(problem.contains(name), "{problem}");
        }
        assert_eq!(problems.len(), 3);
    }
}
