//! Generates the Rust types from the interface text, so that the two cannot drift.

#[path = "codegen/mod.rs"]
#[allow(clippy::unwrap_used)]
mod codegen;

use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), String> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR").map_err(|e| e.to_string())?);
    let out = PathBuf::from(env::var("OUT_DIR").map_err(|e| e.to_string())?);
    for path in ["build.rs", "codegen", "interfaces", "tdv_msgs/msg"] {
        println!("cargo::rerun-if-changed={}", root.join(path).display());
    }
    let mut interfaces = codegen::Interfaces::new();
    codegen::read_packages(&root.join("interfaces"), &mut interfaces)?;
    codegen::read_package("tdv_msgs", &root.join("tdv_msgs"), &mut interfaces)?;
    let source = codegen::emit::emit(&interfaces)?;
    fs::write(out.join("interfaces.rs"), source).map_err(|e| e.to_string())
}
