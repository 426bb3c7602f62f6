//! Topics of the running graph into a bag.

use crate::graph::GraphObserver;
use crate::{Inbox, Node, Qos, RuntimeError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tdv_bag::{BagError, BagWriter, Durability, Topic, TopicId};
use tdv_geometry::Stamp;
use tdv_msgs::{CdrError, RawMessage, RosMessage, schema_of, to_cdr_bytes};

/// Why nothing is recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The graph.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A message that cannot be encoded.
    #[error("{topic}: {source}")]
    Message {
        /// Its topic.
        topic: String,
        /// Why.
        source: CdrError,
    },
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
    unwanted: Vec<String>,
    observer: GraphObserver,
    inputs: BTreeMap<String, (TopicId, Inbox<RawMessage>)>,
    own: BTreeMap<String, TopicId>,
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
            unwanted: Vec::new(),
            observer: node.observe_graph()?,
            inputs: BTreeMap::new(),
            own: BTreeMap::new(),
            unknown: Vec::new(),
        })
    }

    /// Leaves out these topics.
    #[must_use]
    pub fn without(mut self, topics: &[&str]) -> Self {
        self.unwanted.extend(topics.iter().map(|t| (*t).to_owned()));
        self
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
        if self.unwanted.iter().any(|u| u == name) {
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

    /// Writes what has come since the last call, a few messages of each topic: where they come faster
    /// than they can be written, this must end all the same.
    ///
    /// # Errors
    /// [`RecordError::Bag`].
    pub fn drain(&mut self) -> Result<(), RecordError> {
        self.drain_up_to(8)
    }

    fn drain_up_to(&mut self, count: usize) -> Result<(), RecordError> {
        let now = self.node.now();
        for (id, inbox) in self.inputs.values_mut() {
            for _ in 0..count {
                let Some(message) = inbox.try_recv() else { break };
                self.writer.write(*id, now, now, &message.to_bag())?;
            }
        }
        Ok(())
    }

    /// Subscribes what has appeared since the last look.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn look(&mut self) -> Result<(), RecordError> {
        for (name, info) in self.observer.snapshot().topics {
            if let Some(type_name) = info.types.first() {
                self.add(&name, type_name)?;
            }
        }
        Ok(())
    }

    /// Writes a message of the recorder's own.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn write<M: RosMessage + serde::Serialize>(
        &mut self,
        topic: &str,
        stamp: Stamp,
        message: &M,
    ) -> Result<(), RecordError> {
        let id = match self.own.get(topic) {
            Some(id) => *id,
            None => {
                let id = self.writer.add_topic(Topic {
                    name: topic.to_owned(),
                    type_name: M::FULL_NAME.into(),
                    schema: M::schema().into(),
                    durability: Durability::Volatile,
                })?;
                self.own.insert(topic.to_owned(), id);
                id
            }
        };
        let data = to_cdr_bytes(message)
            .map_err(|source| RecordError::Message { topic: topic.to_owned(), source })?;
        Ok(self.writer.write(id, self.node.now(), stamp, &data)?)
    }

    /// Records until `end` is true, looking for new topics once a second; then ends the bag.
    ///
    /// # Errors
    /// [`RecordError`].
    pub async fn run(mut self, mut end: impl FnMut() -> bool) -> Result<PathBuf, RecordError> {
        let mut round = 0_u32;
        while !end() {
            if round % 100 == 0 {
                self.look()?;
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
        self.drain_up_to(32)?;
        Ok(self.writer.finish()?)
    }

    /// Messages so far.
    pub fn message_count(&self) -> u64 {
        self.writer.message_count()
    }
}
