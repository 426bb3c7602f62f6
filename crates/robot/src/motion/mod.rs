//! The arm controller's core: object path -> tool path -> joints -> short trajectories that end at
//! rest, the gripper, and the order of a task's procedures. Pure: time comes in as an argument.

mod controller;
mod guards;
mod hold;
mod law;
mod params;
mod plan;
mod planned;
mod projection;
mod sequence;
mod types;

pub use controller::ArmController;
pub use params::{ControllerParams, GripParams};
pub use plan::PlanError;
pub use projection::Refusal;
pub use types::{
    Attach, ControllerInput, ControllerOutput, GripperEnd, GripperFeedback, GripperRequest,
    JointPath, JointState, Moving, ObjectPlace, ObjectReport, PathPoint, Plan, ProcedureState,
    Requests, Status, StatusCode,
};
