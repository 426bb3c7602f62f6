//! rosbag2 bags in MCAP: writing, reading in time order with bounded memory, and the replay schedule.
//!
//! Messages are raw CDR bytes here; types are known by name and by their `ros2msg` schema text only.

mod metadata;
mod reader;
mod schedule;
mod writer;

pub use metadata::Durability;
pub use reader::{BagMessage, BagReader, TopicInfo};
pub use schedule::{ReplayConfig, ReplaySchedule};
pub use writer::{BagWriter, Topic, TopicId, remove_bag};

use std::path::PathBuf;
use thiserror::Error;

/// What can go wrong with a bag.
#[derive(Debug, Error)]
pub enum BagError {
    /// Nothing there.
    #[error(
        "no bag at {0}: expected a rosbag2 folder (metadata.yaml and an .mcap file) or an .mcap file"
    )]
    NotFound(PathBuf),
    /// An SQLite bag.
    #[error(
        "{path} is an SQLite bag (.db3); convert it to MCAP first: \
         `rosbags-convert --src {path} --dst {path}_mcap --dst-storage mcap` (PyPI rosbags) or `ros2 bag convert`"
    )]
    Sqlite {
        /// The file.
        path: PathBuf,
    },
    /// Cut off or damaged.
    #[error("{path} is truncated or damaged ({detail}); `mcap recover {path}` saves what is there")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What the reader found.
        detail: String,
    },
    /// A topic that the bag does not have.
    #[error("{path} has no topic {topic}; it has: {have}")]
    NoTopic {
        /// The file.
        path: PathBuf,
        /// The topic asked for.
        topic: String,
        /// The topics there.
        have: String,
    },
    /// The target exists.
    #[error("{0} exists already; give another name or remove it")]
    Exists(PathBuf),
    /// Reading or writing failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The MCAP library refuses.
    #[error("{path}: {source}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// Why.
        source: mcap::McapError,
    },
    /// A value of the replay configuration.
    #[error("replay {field} is {value}: {expected}")]
    Replay {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
}
