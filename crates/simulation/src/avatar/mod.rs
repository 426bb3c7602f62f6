//! A human-like right hand: 21 joints that can be posed, a grasp that fits an object, and a skin.
//!
//! Palm frame: origin at the wrist, x towards the middle knuckle, y towards the thumb's side, z out
//! of the back of the hand. Joints in the OpenPose / MediaPipe order: 0 wrist; 1-4 thumb CMC, MCP,
//! IP, tip; 5-8 index MCP, PIP, DIP, tip; 9-12 middle; 13-16 ring; 17-20 little.
//!
//! The hand is a puppet: it moves along scripted paths and carries things rigidly, nothing in it
//! obeys physics. It serves to render demonstrations, never to judge a policy.

mod grasp;
mod kinematics;
mod skin;

pub use grasp::{GraspFit, GraspTarget, fit_grasp, tool_from_hand};
pub use kinematics::{FingerPose, HandPose, HandShape, ThumbPose};
pub use skin::Skin;

#[cfg(test)]
mod tests;
