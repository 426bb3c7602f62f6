//! Which learned backends have their files here: for `tdv doctor`, which does not need the networks to say
//! so. `tdv-foundation` loads the same files.

use std::path::Path;

/// FoundationPose's refiner.
pub const REFINER_FILE: &str = "foundationpose_refiner.safetensors";
/// FoundationPose's scorer.
pub const SCORER_FILE: &str = "foundationpose_scorer.safetensors";
/// How to get FoundationPose's weights, and the licence that they are under.
pub const POSE_HINT: &str = "Fetch the released FoundationPose checkpoints (NVIDIA Source Code License: \
    research and evaluation only) and run launch_scripts/convert_foundationpose.py";

/// The folder of each backend below the models folder, its files, and how to get them.
const BACKENDS: [(&str, &[&str], &str); 3] = [
    ("foundationpose", &[REFINER_FILE, SCORER_FILE], POSE_HINT),
    (
        "groundingdino",
        &["groundingdino.onnx", "vocab.txt"],
        "Fetch IDEA-Research/grounding-dino-tiny (Apache-2.0) and run \
         launch_scripts/export_onnx.py --grounding",
    ),
    (
        "sam2",
        &["sam2_encoder.onnx", "sam2_decoder.onnx"],
        "Fetch facebook/sam2.1-hiera-tiny (Apache-2.0) and run launch_scripts/export_onnx.py --sam2",
    ),
];

/// One backend: what is there, or what is missing and how to get it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Availability {
    /// Its name, which is its folder's too.
    pub backend: &'static str,
    /// A sentence: what was found, or what is missing.
    pub state: Result<String, String>,
}

/// Looks for every backend's files below `models`. Files are not opened.
pub fn availability(models: &Path) -> Vec<Availability> {
    let look = |(backend, files, hint): (&'static str, &[&str], &str)| {
        let folder = models.join(backend);
        let missing: Vec<&str> =
            files.iter().copied().filter(|f| !folder.join(f).is_file()).collect();
        let state = if missing.is_empty() {
            Ok(format!("files in {}", folder.display()))
        } else {
            Err(format!("no {} in {}. {hint}", missing.join(", "), folder.display()))
        };
        Availability { backend, state }
    };
    BACKENDS.into_iter().map(look).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_named_with_its_licence() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("foundationpose");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(REFINER_FILE), b"x").unwrap();
        let state = |name: &str| {
            let all = availability(dir.path());
            all.into_iter().find(|a| a.backend == name).unwrap().state
        };
        let e = state("foundationpose").unwrap_err();
        assert!(e.contains(SCORER_FILE) && !e.contains(REFINER_FILE), "{e}");
        assert!(e.contains("research and evaluation"), "{e}");
        std::fs::write(folder.join(SCORER_FILE), b"x").unwrap();
        assert!(state("foundationpose").is_ok());
        assert!(state("sam2").unwrap_err().contains("Apache-2.0"));
    }
}
