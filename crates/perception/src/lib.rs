//! From RGB-D frames to object poses and hand joints: table plane, masks, first pose, tracking, and
//! the pixel-free state machine that turns detections into one pose per object.
//!
//! Frames: camera poses are in the optical frame (x right, y down, z forward), metres.
//! `T_a_b` is the pose of b in a.

pub mod availability;
mod average;
pub mod backend;
pub mod candidates;
pub mod catalogue;
pub mod color;
pub mod entry;
mod frame;
pub mod hand_eye;
pub mod hands;
pub mod objects;
pub mod overlay;
pub mod perceiver;
mod points;
pub mod prompt;
pub mod reconstruct;
pub mod register;
pub mod remote;
pub mod scale;
pub mod segment;
pub mod table;
#[cfg(test)]
mod testing;
pub mod text_mask;
pub mod track;
mod view;
pub mod visp;

pub use average::average_frames;
pub use catalogue::{Catalogue, CatalogueError, ObjectModel, Resting};
pub use frame::{DepthStatus, FARTHEST_M, FrameError, NEAREST_M, RgbdFrame};
pub use perceiver::{Detection, Perceiver, PerceiverConfig, PerceptionOutput};
pub use points::PointMap;
pub use table::{TableConfig, TablePlane};
pub use track::{Tracker, TrackerConfig};
pub use visp::evaluate_visp;
