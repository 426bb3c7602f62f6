//! Networks in ONNX files, run by onnxruntime. The library is loaded at run time: from
//! `ORT_DYLIB_PATH`, which `launch_scripts/fetch_onnxruntime.sh` prints.

mod grounding;
mod sam2;
#[cfg(test)]
mod tests;

pub use grounding::GroundingDino;
pub use sam2::{Sam2, Sam2Follower};

use crate::FoundationError;
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::{Tensor, ValueType};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The environment variable that names onnxruntime's shared library.
pub const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";

/// There is one for the whole process; it lives until the end.
static RUNTIME: Mutex<Option<Environment>> = Mutex::new(None);

/// onnxruntime's library, if [`LIBRARY_VARIABLE`] names one that exists.
///
/// # Errors
/// [`FoundationError::Missing`].
pub fn library() -> Result<PathBuf, FoundationError> {
    let path = std::env::var_os(LIBRARY_VARIABLE).map(PathBuf::from).unwrap_or_default();
    if path.is_file() {
        return Ok(path);
    }
    Err(FoundationError::Missing {
        path: if path.as_os_str().is_empty() { "$ORT_DYLIB_PATH".into() } else { path },
        what: "onnxruntime's shared library",
        hint: "Run launch_scripts/fetch_onnxruntime.sh and set ORT_DYLIB_PATH as it says (MIT licence)",
    })
}

fn environment() -> Result<Environment, FoundationError> {
    let fail = |reason: String| FoundationError::Onnx { what: "onnxruntime".into(), reason };
    let mut held = RUNTIME.lock().map_err(|e| fail(e.to_string()))?;
    if let Some(e) = held.as_ref() {
        return Ok(e.clone());
    }
    let path = library()?;
    let made = ort::init_from(&path)
        .map_err(|e| FoundationError::File { path, reason: e.to_string() })?
        .build()
        .map_err(|e| fail(e.to_string()))?;
    *held = Some(made.clone());
    Ok(made)
}

/// A tensor going in.
pub(crate) enum Input {
    F32(Vec<f32>),
    I64(Vec<i64>),
    Bool(Vec<bool>),
}

/// A tensor that came out: its shape and numbers.
pub(crate) type Output = (Vec<usize>, Vec<f32>);

/// One network.
#[derive(Debug)]
pub(crate) struct Net {
    session: Session,
    name: String,
}

impl Net {
    /// Loads a file; one without all of `inputs` and `outputs` is refused.
    pub fn load(
        path: &Path,
        (what, hint): (&'static str, &'static str),
        inputs: &[&str],
        outputs: &[&str],
    ) -> Result<Self, FoundationError> {
        if !path.is_file() {
            return Err(FoundationError::Missing { path: path.into(), what, hint });
        }
        let fail = |reason: String| FoundationError::File { path: path.into(), reason };
        let session = Session::builder(&environment()?)
            .and_then(|mut b| b.commit_from_file(path))
            .map_err(|e| fail(e.to_string()))?;
        for (kind, wanted, there) in
            [("input", inputs, session.inputs()), ("output", outputs, session.outputs())]
        {
            if let Some(name) = wanted.iter().find(|w| !there.iter().any(|t| t.name() == **w)) {
                let names: Vec<&str> = there.iter().map(|t| t.name()).collect();
                return Err(fail(format!(
                    "has no {kind} `{name}`, but {}; was it made by launch_scripts/export_onnx.py?",
                    names.join(", ")
                )));
            }
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { session, name })
    }

    /// The shape that an input is declared with; -1 where any size goes.
    pub fn input_shape(&self, name: &str) -> Vec<i64> {
        let outlet = self.session.inputs().iter().find(|i| i.name() == name);
        match outlet.map(|o| o.dtype()) {
            Some(ValueType::Tensor { shape, .. }) => shape.to_vec(),
            _ => Vec::new(),
        }
    }

    /// Runs it; outputs in the order of `outputs`.
    pub fn run(
        &mut self,
        inputs: Vec<(&str, Vec<usize>, Input)>,
        outputs: &[&str],
    ) -> Result<Vec<Output>, FoundationError> {
        let what = self.name.clone();
        let fail = move |e: ort::Error| FoundationError::Onnx {
            what: what.clone(),
            reason: e.to_string(),
        };
        let mut values: Vec<(String, SessionInputValue<'_>)> = Vec::new();
        for (name, shape, data) in inputs {
            let value = match data {
                Input::F32(v) => Tensor::from_array((shape, v)).map_err(&fail)?.into(),
                Input::I64(v) => Tensor::from_array((shape, v)).map_err(&fail)?.into(),
                Input::Bool(v) => Tensor::from_array((shape, v)).map_err(&fail)?.into(),
            };
            values.push((name.to_owned(), value));
        }
        let results = self.session.run(values).map_err(&fail)?;
        let mut out = Vec::new();
        for name in outputs {
            let Some(value) = results.get(*name) else {
                let reason = format!("gave no output `{name}`");
                return Err(FoundationError::Onnx { what: self.name.clone(), reason });
            };
            let (shape, data) = value.try_extract_tensor::<f32>().map_err(&fail)?;
            let shape = shape.iter().map(|d| usize::try_from(*d).unwrap_or(0)).collect();
            out.push((shape, data.to_vec()));
        }
        Ok(out)
    }
}
