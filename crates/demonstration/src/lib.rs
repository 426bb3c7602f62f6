//! From one observed demonstration to a training set.
//!
//! ```text
//! FrameObservation (object poses, 21 hand joints, in base_link)
//!   -> parse     hand -> gripper (remap), keyframes, smoothing, repairs      Demonstration + ParseReport
//!   -> generate  warped trajectories from unseen starts                      Dataset + GenerationReport
//! ```
//! Unless its file lists others, an object task has two procedures: 0 `reach` (frame `tcp` seen from the
//! moving object, ends at the grasp pose, where the gripper closes) and 1 `place` (moving object seen from
//! the reference object, ends at the placed pose, where it opens). A hand task has one, `follow` (frame
//! `tcp` seen from the reference object). Listed procedures are chained: where one ends, the next begins.
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
mod sequence;
mod task;
mod warp;

pub use canonical::{Canonical, Variant, canonical_reference, canonical_tool, gripper_symmetry};
pub use dataset::{Dataset, HistoryNoise, ProcedureSet};
pub use demonstration::{Demonstration, FrameObservation, ProcedureDemo};
pub use error::DemonstrationError;
pub use filter::{FilterConfig, Sample, deflip, robust_mean, smooth};
pub use generate::{
    Collides, GenerateOptions, GenerationReport, ProcedureReport, Reachable, ToolPose, bend_to,
    generate, generate_with,
};
pub use keyframe::{KeyframeConfig, Keyframes, detect as detect_keyframes};
pub use parse::{
    GraspChange, ParseConfig, ParseReport, Repair, RepairKind, Segment, Segments, parse,
};
pub use path::{Limits, densify, retime, round_corners};
pub use remap::{JointOrder, RemapConfig, RemapMethod, Remapped, remap, tool_track};
pub use sequence::{GripperEnd, Hold, ProcedureSpec, TCP};
pub use task::{
    ClosingAxis, GenerationConfig, GenerationMode, GraspConfig, HomeRegion, ObjectShape,
    RecoveryConfig, RetimeConfig, TargetYaw, Task, TaskKind, Workspace,
};
pub use warp::{Warp, WarpConfig, WarpRule, warp_dmp, warp_paper, warp_repaired, warp_rigid};
