//! A safetensors file, read by tensor name; what is missing or misshapen is named.

use crate::FoundationError;
use candle_core::{DType, Device, Tensor};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Tensors by name, with the file that they came from.
#[derive(Debug)]
pub struct Weights {
    path: PathBuf,
    tensors: HashMap<String, Tensor>,
}

impl Weights {
    /// Reads a file. `what` and `hint` go into the error when there is none.
    ///
    /// # Errors
    /// [`FoundationError::Missing`] or [`FoundationError::File`].
    pub fn load(
        path: &Path,
        device: &Device,
        what: &'static str,
        hint: &'static str,
    ) -> Result<Self, FoundationError> {
        if !path.is_file() {
            return Err(FoundationError::Missing { path: path.into(), what, hint });
        }
        // Pickles run code when they are read; only the converter, in the user's hands, opens one.
        if path.extension().is_none_or(|e| e != "safetensors") {
            let reason = "is not a .safetensors file; convert it first".into();
            return Err(FoundationError::File { path: path.into(), reason });
        }
        let tensors = candle_core::safetensors::load(path, device)
            .map_err(|e| FoundationError::File { path: path.into(), reason: e.to_string() })?;
        Ok(Self { path: path.into(), tensors })
    }

    /// From tensors in memory; `path` only names them in errors.
    pub fn from_tensors(path: &Path, tensors: HashMap<String, Tensor>) -> Self {
        Self { path: path.into(), tensors }
    }

    /// The tensor of this name as f32.
    ///
    /// # Errors
    /// [`FoundationError::Tensor`] when there is none.
    pub fn get(&self, name: &str) -> Result<Tensor, FoundationError> {
        let Some(t) = self.tensors.get(name) else {
            return Err(self.wrong(name, "is missing; was the file made by the converter?".into()));
        };
        Ok(t.to_dtype(DType::F32)?)
    }

    /// The tensor of this name, which has to have this shape.
    ///
    /// # Errors
    /// [`FoundationError::Tensor`].
    pub fn shaped(&self, name: &str, shape: &[usize]) -> Result<Tensor, FoundationError> {
        let t = self.get(name)?;
        if t.dims() != shape {
            return Err(self.wrong(name, format!("has shape {:?}, not {shape:?}", t.dims())));
        }
        Ok(t)
    }

    pub(crate) fn wrong(&self, name: &str, reason: String) -> FoundationError {
        FoundationError::Tensor { path: self.path.clone(), name: name.to_owned(), reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_file_and_the_tensor() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("net.safetensors");
        let e = Weights::load(&path, &Device::Cpu, "refiner", "get it").unwrap_err().to_string();
        assert!(e.contains("net.safetensors") && e.contains("refiner") && e.contains("get it"));
        std::fs::write(&path, b"rubbish").unwrap();
        let e = Weights::load(&path, &Device::Cpu, "", "").unwrap_err();
        assert!(matches!(e, FoundationError::File { .. }), "{e}");
        let pickle = dir.path().join("model_best.pth");
        std::fs::write(&pickle, b"x").unwrap();
        let e = Weights::load(&pickle, &Device::Cpu, "", "").unwrap_err().to_string();
        assert!(e.contains("convert"), "{e}");
        let t = Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap();
        let w = Weights::from_tensors(&path, HashMap::from([("a.weight".into(), t)]));
        let e = w.shaped("a.weight", &[3, 2]).unwrap_err().to_string();
        assert!(e.contains("a.weight") && e.contains("[2, 3]"), "{e}");
        assert!(w.get("b").is_err());
    }
}
