//! Visual domains: a scene that looks different, and is the same to the arm.

use crate::backdrop::TableTop;
use crate::error::SimulationError;
use crate::scene::Scene;
use serde::Deserialize;
use std::path::Path;

/// What is seen differently; what is not given stays as the scene has it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// Its name.
    pub name: String,
    /// What the table looks like.
    #[serde(default)]
    pub table_top: Option<TableTop>,
    /// Things on the table that are no objects of the task.
    #[serde(default)]
    pub distractors: Option<usize>,
    /// Where the camera hangs in `base_link`, m.
    #[serde(default)]
    pub eye: Option<[f64; 3]>,
    /// The point that it looks at, m.
    #[serde(default)]
    pub target: Option<[f64; 3]>,
}

impl Domain {
    /// Reads a list of domains.
    ///
    /// # Errors
    /// [`SimulationError::Io`], [`SimulationError::Parse`].
    pub fn load_all(path: &Path) -> Result<Vec<Self>, SimulationError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| SimulationError::Io { path: path.into(), source })?;
        serde_saphyr::from_str(&text)
            .map_err(|e| SimulationError::Parse { path: path.into(), reason: e.to_string() })
    }

    /// The scene as this domain shows it.
    pub fn of(&self, scene: &Scene) -> Scene {
        let mut out = scene.clone();
        out.table_top = self.table_top.unwrap_or(scene.table_top);
        out.distractors = self.distractors.unwrap_or(scene.distractors);
        out.camera.eye = self.eye.unwrap_or(scene.camera.eye);
        out.camera.target = self.target.unwrap_or(scene.camera.target);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    #[test]
    fn domains_change_what_is_seen_and_nothing_else() {
        let config = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../config");
        let scene = Scene::load(&config.join("scenes/cup_on_coaster.yaml")).unwrap();
        let all = Domain::load_all(&config.join("domains.yaml")).unwrap();
        assert_eq!(all.len(), 7);
        let folder = tempfile::tempdir().unwrap();
        for domain in all {
            let other = domain.of(&scene);
            assert_ne!(other, scene, "{}", domain.name);
            let path = folder.path().join("scene.yaml");
            other.save(&path).unwrap();
            let back = Scene::load(&path).unwrap();
            assert!(back.object_dir("mug").join("object.yaml").is_file());
            assert_eq!((&back.objects, &back.robot), (&scene.objects, &scene.robot));
            assert_eq!((back.camera.eye, back.table_top), (other.camera.eye, other.table_top));
        }
    }
}
