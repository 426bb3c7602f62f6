//! Meshes, the pinhole camera and a CPU rasteriser: colour, metric depth, instance ids, normals.
//!
//! Frames: the camera frame is the optical frame of REP-103 (x right, y down, z forward), metres.
//! Pixel centres lie at integer coordinates. Nothing here needs a GPU or a window system.

mod camera;
pub mod codec;
mod depth;
pub mod lens;
mod lighting;
pub mod mesh;
pub mod object;
mod raster;
pub mod shape;

pub use camera::{Intrinsics, look_at};
pub use depth::{DepthError, DepthImage};
pub use image::{Rgb, RgbImage};
pub use lens::{AlignError, DepthAligner, Lens, LensError, Undistorter};
pub use lighting::{Light, Lighting};
pub use mesh::{Mesh, MeshError};
pub use object::{CollisionPart, ObjectError, ObjectFile, PartShape};
pub use raster::{DepthOnly, Instance, Rendered, Renderer};
