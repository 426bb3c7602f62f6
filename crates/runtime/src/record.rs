//! Topics of the running graph into a bag.

use crate::{Inbox, Node, Qos, RuntimeError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tdv_bag::{BagError, BagWriter, Durability, Topic, TopicId};
use tdv_msgs::{RawMessage, schema_of};

/// Why nothing is recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The graph.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}

/// Topics whose last message late subscribers get.
const LATCHED: [&str; 7] = [
    "/tf_static",
    "/switch_policy/procedure",
    "/arm_controller/status",
    "/virtual_lab/ground_truth/verdict",
    "/io_and_status_controller/robot_mode",
    "/io_and_status_controller/safety_mode",
    "/io_and_status_controller/robot_program_running",
];

/// Messages of one topic that wait to be written.
const WAITING: usize = 256;

/// Subscribes topics as they appear and writes what comes.
pub struct Recorder {
    node: Node,
    writer: BagWriter,
    /// None: every topic whose type is known.
    wanted: Option<Vec<String>>,
    inputs: BTreeMap<String, (TopicId, Inbox<RawMessage>)>,
    unknown: Vec<String>,
}

impl Recorder {
    /// A recorder that writes to `output`, a folder that does not exist yet.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn create(
        node: &Node,
        output: &Path,
        wanted: Option<Vec<String>>,
    ) -> Result<Self, RecordError> {
        Ok(Self {
            node: node.clone(),
            writer: BagWriter::create(output)?,
            wanted,
            inputs: BTreeMap::new(),
            unknown: Vec::new(),
        })
    }

    /// Topics that are recorded.
    pub fn topics(&self) -> Vec<&str> {
        self.inputs.keys().map(String::as_str).collect()
    }

    /// Topics whose type is not known here and that are left out.
    pub fn unknown(&self) -> &[String] {
        &self.unknown
    }

    /// Subscribes a topic.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn add(&mut self, name: &str, type_name: &str) -> Result<(), RecordError> {
        if self.inputs.contains_key(name) || self.unknown.iter().any(|u| u == name) {
            return Ok(());
        }
        if self.wanted.as_ref().is_some_and(|w| !w.iter().any(|t| t == name)) {
            return Ok(());
        }
        let Some(schema) = schema_of(type_name) else {
            self.unknown.push(name.to_owned());
            return Ok(());
        };
        let latched = LATCHED.contains(&name);
        let qos = if latched { Qos::latched_depth(10) } else { Qos::best_effort(10) };
        let inbox = self.node.raw_queue(name, type_name, qos, WAITING)?;
        let id = self.writer.add_topic(Topic {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            schema: schema.to_owned(),
            durability: if latched { Durability::TransientLocal } else { Durability::Volatile },
        })?;
        self.inputs.insert(name.to_owned(), (id, inbox));
        Ok(())
    }

    /// Writes what has come since the last call.
    ///
    /// # Errors
    /// [`RecordError::Bag`].
    pub fn drain(&mut self) -> Result<(), RecordError> {
        let now = self.node.now();
        for (id, inbox) in self.inputs.values_mut() {
            while let Some(message) = inbox.try_recv() {
                self.writer.write(*id, now, now, &message.to_bag())?;
            }
        }
        Ok(())
    }

    /// Records until `end` is true, looking for new topics once a second; then ends the bag.
    ///
    /// # Errors
    /// [`RecordError`].
    pub async fn run(mut self, mut end: impl FnMut() -> bool) -> Result<PathBuf, RecordError> {
        let observer = self.node.observe_graph()?;
        let mut round = 0_u32;
        while !end() {
            if round % 100 == 0 {
                for (name, info) in observer.snapshot().topics {
                    if let Some(type_name) = info.types.first() {
                        self.add(&name, type_name)?;
                    }
                }
            }
            round = round.wrapping_add(1);
            self.drain()?;
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        self.finish()
    }

    /// Writes what is left and ends the bag.
    ///
    /// # Errors
    /// [`RecordError::Bag`].
    pub fn finish(mut self) -> Result<PathBuf, RecordError> {
        self.drain()?;
        Ok(self.writer.finish()?)
    }

    /// Messages so far.
    pub fn message_count(&self) -> u64 {
        self.writer.message_count()
    }
}
