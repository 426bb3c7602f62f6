//! The virtual lab: physics with friction grasps, a simulated UR controller and gripper on real
//! sockets, scenes, and the judge of a trial. No ROS in it.
//!
//! [`lab::Lab`] ties it together; [`ur_server::UrServer`] puts its controller on the network.

pub mod arm;
pub mod avatar;
pub mod backdrop;
pub mod contacts;
pub mod controller;
pub mod disturbance;
mod domain;
mod draw;
mod error;
pub mod gripper;
pub mod lab;
pub mod mount;
pub mod pacing;
pub mod parts;
pub mod record;
pub mod scene;
pub mod sensor;
pub mod trial;
mod units;
pub mod ur_server;
pub mod visual;
pub mod world;

pub use domain::Domain;
pub use error::SimulationError;
pub use lab::{Lab, LabAssets, LabInstance};
pub use pacing::Pacer;
pub use scene::Scene;
