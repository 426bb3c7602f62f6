//! From one observed demonstration to a training set.
//!
//! ```text
//! FrameObservation (object poses, 21 hand joints, in base_link)
//!   -> parse     hand -> gripper (remap), keyframes, smoothing, repairs      Demonstration + ParseReport
//!   -> generate  warped trajectories from unseen starts                      Dataset + GenerationReport
//! ```
//! An object task has two procedures: 0 `reach` (frame `tcp` seen from the moving object, ends at the
//! grasp pose) and 1 `place` (moving object seen from the reference object, ends at the placed pose).
//! A hand task has one, `follow` (frame `tcp` seen from the reference object).
//!
//! Frames: `base_link` with the table as its plane z = 0; `tcp` with z = approach and y = closing axis.

mod canonical;
mod dataset;
mod demonstration;
mod error;
mod file;
mod filter;
mod generate;
mod keyframe;
pub mod mustard;
mod parse;
mod path;
mod remap;
mod task;
mod warp;

pub use canonical::{Canonical, Variant, canonical_reference, canonical_tool, gripper_symmetry};
pub use dataset::{Dataset, HistoryNoise, ProcedureSet};
pub use demonstration::{Demonstration, FrameObservation, ProcedureDemo};
pub use error::DemonstrationError;
pub use filter::{FilterConfig, Sample, deflip, robust_mean, smooth};
pub use generate::{
    GenerateOptions, GenerationReport, ProcedureReport, Reachable, bend_to, generate, generate_with,
};
pub use keyframe::{KeyframeConfig, Keyframes, detect as detect_keyframes};
pub use parse::{GraspChange, ParseConfig, ParseReport, Repair, RepairKind, parse};
pub use path::{Limits, densify, retime, round_corners};
pub use remap::{JointOrder, RemapConfig, RemapMethod, Remapped, remap, tool_track};
pub use task::{
    ClosingAxis, GenerationConfig, GenerationMode, GraspConfig, HomeRegion, ObjectShape,
    RecoveryConfig, RetimeConfig, TargetYaw, Task, TaskKind, Workspace,
};
pub use warp::{Warp, WarpConfig, WarpRule, warp_paper, warp_repaired};
