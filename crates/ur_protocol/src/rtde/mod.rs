//! RTDE version 2: framing, packages, typed fields, recipes. All numbers are big-endian.

mod client;
mod fields;
mod frame;
mod package;
mod value;

pub use client::{Client, ClientConfig, ClientEvent};
pub use fields::{DRIVER_INPUTS, DRIVER_OUTPUTS, FieldKind, input_field, output_field};
pub use frame::{Frame, FrameReader, MAX_PACKAGE};
pub use package::{ClientPackage, ServerPackage, TextLevel};
pub use value::{FieldType, Recipe, Value};

/// The protocol version this crate speaks.
pub const PROTOCOL_VERSION: u16 = 2;
/// Highest output rate of a CB3 controller, Hz.
pub const CB3_RATE: f64 = 125.0;
/// Highest output rate of an e-Series controller, Hz.
pub const E_SERIES_RATE: f64 = 500.0;
