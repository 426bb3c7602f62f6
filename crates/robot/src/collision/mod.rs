//! What the arm may run into: the plane check that needs no files ([`check_clearance`]), and the whole
//! robot among fixtures with what it holds ([`CollisionWorld`]).
//!
//! Shapes are convex: capsules about the arm's links, convex parts for the gripper's links, which move
//! with the knuckle angle, and for objects and fixtures. Distances come from parry (GJK), which is glam
//! inside; [`convert`] is the one place that changes between its types and nalgebra's.

mod convert;
mod model;
mod plane;
mod shapes;
mod workcell;
mod world;

pub use plane::{CAPSULES, ClearanceError, LinkCapsule, check_clearance, fingertip_height};
pub use shapes::{ConvexPart, ShapeError, convex_parts};
pub use workcell::{Fixture, FixtureShape, Workcell, WorkcellError};
pub(crate) use world::Advance;
pub use world::{Clearance, CollisionError, CollisionWorld, HeldObject, Margins};

#[cfg(test)]
mod tests;
