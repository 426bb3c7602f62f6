//! Which backends could run here.

use std::path::Path;
use tdv_perception::availability::{Availability, availability as files};

/// Looks for every backend's files below `models`, unopened, and for the library that two of them run in.
pub fn availability(models: &Path) -> Vec<Availability> {
    let mut out = files(models);
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
