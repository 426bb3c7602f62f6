//! Success rates by task, number of demonstrations and level of generalisation, in one process on
//! simulated time: the layout of the paper's Table 2, in another simulator.
//!
//! A cell is (task, demonstrations 1/15/50 made of one, level, policy, disturbed or not, ablation arm).
//! Its trials differ in their start only, and cells share their starts: trial 17 of seed 1 begins the
//! same in all of them. Physics, servo program, driver, arm controller and policies are those of the live
//! graph; instead of camera and tracker there are true poses with a stated noise ([`PoseNoise`]), one
//! frame late. Starts are drawn before anybody asks what the arm can reach.

mod arm;
mod brain;
mod demonstrator;
mod eyes;
mod layout;
mod lesson;
mod markdown;
mod plant;
mod record;
mod report;
mod run;
mod straight;
mod surroundings;
mod trial;

pub use arm::Arm;
pub use demonstrator::demonstrate;
pub use eyes::PoseNoise;
pub use layout::{Start, fixed_points};
pub use lesson::{Certificate, Course, Lesson, Pupil};
pub use record::{Cause, TrialRecord, append_record, read_records};
pub use report::{CellResult, Points13, Table2Report};
pub use run::{Cell, Job, POINTS, Stage, run_jobs};
pub use surroundings::Surroundings;
pub use trial::{Setting, run_trial};

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What varies between the starts of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Level {
    /// Positions; the yaw is the demonstrated one.
    PG,
    /// Positions and yaws.
    PoG,
}

/// Who drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// The trained trajectory policy and the trained switch.
    Learned,
    /// Straight to the end pose; switches where it has arrived.
    StraightLine,
    /// The demonstration bent to the first look, then played; switches where it believes to have arrived.
    OpenLoop,
}

impl PolicyKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Learned, Self::StraightLine, Self::OpenLoop];

    /// As on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::StraightLine => "straight_line",
            Self::OpenLoop => "open_loop",
        }
    }
}

impl Level {
    /// As on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::PG => "PG",
            Self::PoG => "PoG",
        }
    }
}

/// Why a table cannot be made.
#[derive(Debug, Error)]
pub enum Table2Error {
    /// A task that does not fit.
    #[error("task '{name}': {reason}")]
    Task {
        /// The task.
        name: String,
        /// Why not.
        reason: String,
    },
    /// A trial of the learned policy without a policy.
    #[error("task '{0}': the learned policy is to be tried, but none was taught")]
    Untaught(String),
    /// A procedure that the demonstration does not have.
    #[error("the demonstration has no procedure {0}")]
    Procedure(usize),
    /// The robot's side was refused by its own parts.
    #[error("robot: {0}")]
    Robot(String),
    /// The lab.
    #[error(transparent)]
    Simulation(#[from] tdv_simulation::SimulationError),
    /// The scripted demonstrator.
    #[error(transparent)]
    Recording(#[from] tdv_simulation::record::RecordError),
    /// Parsing and generation.
    #[error(transparent)]
    Demonstration(#[from] tdv_demonstration::DemonstrationError),
    /// Training and planning.
    #[error(transparent)]
    Policy(#[from] tdv_policy::PolicyError),
    /// The policies' view of the scene.
    #[error(transparent)]
    Observer(#[from] tdv_policy::ObserverError),
    /// A history that cannot be kept.
    #[error(transparent)]
    History(#[from] tdv_policy::HistoryError),
    /// A file.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system or the parser said.
        reason: String,
    },
}

impl Table2Error {
    pub(crate) fn io(path: &Path, error: impl std::fmt::Display) -> Self {
        Self::File { path: path.to_path_buf(), reason: error.to_string() }
    }
}

/// FNV-1a over texts, 16 hexadecimal digits.
pub(crate) fn fnv<'a>(texts: impl Iterator<Item = &'a str>) -> String {
    format!("{:016x}", fnv64(texts))
}

pub(crate) fn fnv64<'a>(texts: impl Iterator<Item = &'a str>) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for text in texts {
        // The zero keeps ("ab", "c") and ("a", "bc") apart.
        for byte in text.as_bytes().iter().chain(&[0]) {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    hash
}

/// Writes JSON, whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Table2Error> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Table2Error::io(path, e))?;
    let partial = path.with_extension(format!("partial{}", std::process::id()));
    std::fs::write(&partial, text).map_err(|e| Table2Error::io(&partial, e))?;
    std::fs::rename(&partial, path).map_err(|e| Table2Error::io(path, e))
}
