//! What a closed loop has to survive: an object displaced in the middle of a run, or lost on the way.

use crate::draw::{Stream, rng};
use crate::{Lab, SimulationError};
use rand::Rng;
use tdv_geometry::pose_distance;

/// Which object is displaced, and when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Victim {
    /// The moving object, while the gripper approaches it.
    Moving,
    /// The reference object, while the moving object is carried.
    Reference,
}

/// One displacement of 5 to 10 cm (see [`Lab::disturb`]).
#[derive(Debug, Clone)]
pub struct Disturbance {
    victim: Victim,
    seed: u64,
    done: bool,
}

/// The approach counts as on its way when the tool is this near to the object (m) ...
const NEAR: f64 = 0.22;
/// ... but not yet so near that the fingers are about it.
const TOO_NEAR: f64 = 0.12;
/// The object counts as carried when it is this high above its start (m).
const LIFTED: f64 = 0.05;

impl Disturbance {
    /// Even seeds displace the moving object, odd ones the reference.
    pub fn new(seed: u64) -> Self {
        let victim = if seed.is_multiple_of(2) { Victim::Moving } else { Victim::Reference };
        Self { victim, seed, done: false }
    }

    /// Which object it will be or was.
    pub fn victim(&self) -> Victim {
        self.victim
    }

    /// Whether it has happened.
    pub fn is_done(&self) -> bool {
        self.done
    }

    /// Call after every tick. Returns what was displaced and by how much (dx, dy in m) when it happens.
    ///
    /// # Errors
    /// [`SimulationError::NoPlace`] when there is no room; it is tried again at the next call.
    pub fn step(&mut self, lab: &mut Lab) -> Result<Option<(String, [f64; 2])>, SimulationError> {
        if self.done {
            return Ok(None);
        }
        let task = &lab.scene().task;
        let (moving, reference) = (task.moving.clone(), task.reference.clone());
        let object = lab.object_pose(&moving)?;
        let ready = match self.victim {
            Victim::Moving => {
                let tcp = lab.tcp_pose();
                let (d, _) = pose_distance(&tcp, &object);
                (TOO_NEAR..NEAR).contains(&d) && !lab.held(&moving)?
            }
            Victim::Reference => object.translation.z > LIFTED && lab.held(&moving)?,
        };
        if !ready {
            return Ok(None);
        }
        let name = if self.victim == Victim::Moving { moving } else { reference };
        let by = lab.disturb(&name, self.seed)?;
        self.done = true;
        Ok(Some((name, by)))
    }
}

/// Lets the moving object slip out of the gripper once, soon after it was lifted.
#[derive(Debug, Clone)]
pub struct ForcedDrop {
    height: f64,
    done: bool,
}

/// Heights above the table (m) at which the grip fails.
const DROP_HEIGHTS: std::ops::Range<f64> = 0.02..0.06;
/// How long the pads do not grip (s).
const SLIPPERY: f64 = 0.5;

impl ForcedDrop {
    /// At a height drawn from the seed.
    pub fn new(seed: u64) -> Self {
        Self { height: rng(seed, Stream::Disturbance).random_range(DROP_HEIGHTS), done: false }
    }

    /// Whether it has happened.
    pub fn is_done(&self) -> bool {
        self.done
    }

    /// Call after every tick. True when the grip fails now.
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`] when the scene's task names an object that it does not have.
    pub fn step(&mut self, lab: &mut Lab) -> Result<bool, SimulationError> {
        if self.done {
            return Ok(false);
        }
        let moving = lab.scene().task.moving.clone();
        if !lab.held(&moving)? || lab.object_pose(&moving)?.translation.z < self.height {
            return Ok(false);
        }
        lab.make_slippery(SLIPPERY);
        self.done = true;
        Ok(true)
    }
}
