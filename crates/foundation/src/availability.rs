//! Which backends could run here: for `tdv doctor`.

use crate::pose;
use std::path::Path;

/// The folder of each backend below the models folder, its files, and how to get them.
const BACKENDS: [(&str, &str, &[&str], &str); 3] = [
    ("foundationpose", "foundationpose", &[pose::REFINER_FILE, pose::SCORER_FILE], pose::HINT),
    (
        "groundingdino",
        "groundingdino",
        &["groundingdino.onnx", "vocab.txt"],
        "Fetch IDEA-Research/grounding-dino-tiny (Apache-2.0) and run \
         launch_scripts/export_onnx.py --grounding",
    ),
    (
        "sam2",
        "sam2",
        &["sam2_encoder.onnx", "sam2_decoder.onnx"],
        "Fetch facebook/sam2.1-hiera-tiny (Apache-2.0) and run launch_scripts/export_onnx.py --sam2",
    ),
];

/// One backend: what is there, or what is missing and how to get it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Availability {
    /// Its name, as parameters use it.
    pub backend: &'static str,
    /// A sentence: what was found, or what is missing.
    pub state: Result<String, String>,
}

/// Looks for every backend's files below `models`. Files are not opened.
pub fn availability(models: &Path) -> Vec<Availability> {
    let mut out = Vec::new();
    for (backend, folder, files, hint) in BACKENDS {
        let folder = models.join(folder);
        let missing: Vec<&str> =
            files.iter().copied().filter(|f| !folder.join(f).is_file()).collect();
        let state = if missing.is_empty() {
            Ok(format!("files in {}", folder.display()))
        } else {
            Err(format!("no {} in {}. {hint}", missing.join(", "), folder.display()))
        };
        out.push(Availability { backend, state });
    }
    out.push(Availability { backend: "onnxruntime", state: runtime() });
    out
}

#[cfg(feature = "onnx")]
fn runtime() -> Result<String, String> {
    crate::onnx::library().map(|p| p.display().to_string()).map_err(|e| e.to_string())
}

#[cfg(not(feature = "onnx"))]
fn runtime() -> Result<String, String> {
    Err("built without the feature `onnx`: groundingdino and sam2 cannot run".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_named_with_its_licence() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("foundationpose");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(pose::REFINER_FILE), b"x").unwrap();
        let state = |name: &str| {
            let all = availability(dir.path());
            all.into_iter().find(|a| a.backend == name).unwrap().state
        };
        let e = state("foundationpose").unwrap_err();
        assert!(e.contains(pose::SCORER_FILE) && !e.contains(pose::REFINER_FILE), "{e}");
        assert!(e.contains("research and evaluation"), "{e}");
        std::fs::write(folder.join(pose::SCORER_FILE), b"x").unwrap();
        assert!(state("foundationpose").is_ok());
        assert!(state("sam2").unwrap_err().contains("Apache-2.0"));
        assert!(availability(dir.path()).len() == 4);
    }
}
