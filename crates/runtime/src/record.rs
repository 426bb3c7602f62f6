//! Topics of the running graph into a bag.

use crate::graph::GraphObserver;
use crate::{Inbox, Node, Qos, RuntimeError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
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

/// Messages of one topic that are written in one go: where they come faster than they can be written,
/// [`Recorder::drain`] must end all the same.
const AT_ONCE: usize = 32;

type Inputs = BTreeMap<String, (TopicId, Inbox<RawMessage>)>;

/// A finished recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recording {
    /// The bag.
    pub path: PathBuf,
    /// Messages that came faster than they could be written and are not in the bag, by topic; topics
    /// without such messages are left out. What the middleware itself lost on the way is not known here.
    pub dropped: BTreeMap<String, u64>,
}

/// Takes up to `count` messages of each topic, stamped with their receipt; `now` is the same moment by
/// both clocks. All topics are emptied before anything is written, which takes time in which others come.
fn take(
    inputs: &mut Inputs,
    count: usize,
    now: (Instant, Stamp),
) -> Vec<(TopicId, Stamp, RawMessage)> {
    let mut out = Vec::new();
    for (id, inbox) in inputs.values_mut() {
        for (at, message) in inbox.take(count) {
            let before = now.0.saturating_duration_since(at).as_secs_f64();
            let after = at.saturating_duration_since(now.0).as_secs_f64();
            out.push((*id, now.1.plus(after - before), message));
        }
    }
    out
}

fn dropped(inputs: &Inputs) -> BTreeMap<String, u64> {
    let counts = inputs.iter().map(|(name, (_, inbox))| (name.clone(), inbox.dropped()));
    counts.filter(|(_, count)| *count > 0).collect()
}

/// Subscribes topics as they appear and writes what comes.
pub struct Recorder {
    node: Node,
    writer: BagWriter,
    /// None: every topic whose type is known.
    wanted: Option<Vec<String>>,
    unwanted: Vec<String>,
    observer: GraphObserver,
    inputs: Inputs,
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

    /// Writes what has come since the last call, as far as it is not more than a few messages of each
    /// topic.
    ///
    /// # Errors
    /// [`RecordError::Bag`].
    pub fn drain(&mut self) -> Result<(), RecordError> {
        let taken = self.take(AT_ONCE);
        self.write_taken(taken)
    }

    fn take(&mut self, count: usize) -> Vec<(TopicId, Stamp, RawMessage)> {
        take(&mut self.inputs, count, (Instant::now(), self.node.now()))
    }

    fn write_taken(&mut self, taken: Vec<(TopicId, Stamp, RawMessage)>) -> Result<(), RecordError> {
        for (id, stamp, message) in taken {
            self.writer.write(id, stamp, stamp, &message.to_bag())?;
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
    pub async fn run(mut self, mut end: impl FnMut() -> bool) -> Result<Recording, RecordError> {
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

    /// Writes all that waits at this moment and ends the bag.
    ///
    /// # Errors
    /// [`RecordError::Bag`].
    pub fn finish(mut self) -> Result<Recording, RecordError> {
        let taken = self.take(WAITING);
        let dropped = dropped(&self.inputs);
        self.write_taken(taken)?;
        for (topic, count) in &dropped {
            tracing::warn!("{topic}: {count} messages came too fast and are not in the bag");
        }
        Ok(Recording { path: self.writer.finish()?, dropped })
    }

    /// Messages so far.
    pub fn message_count(&self) -> u64 {
        self.writer.message_count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inbox;

    #[test]
    fn everything_that_waits_is_taken_in_its_order_and_losses_are_counted() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = BagWriter::create(&dir.path().join("bag")).unwrap();
        let (mut inputs, mut senders) = (Inputs::new(), Vec::new());
        for name in ["/a", "/b"] {
            let topic = Topic {
                name: name.into(),
                type_name: "std_msgs/msg/Empty".into(),
                schema: String::new(),
                durability: Durability::Volatile,
            };
            let (sender, receiver) = inbox(WAITING);
            inputs.insert(name.into(), (writer.add_topic(topic).unwrap(), receiver));
            senders.push(sender);
        }
        let before = Instant::now();
        senders[1].send(RawMessage::from_bag(&[0, 1, 0, 0, 7]).unwrap());
        std::thread::sleep(Duration::from_millis(2));
        for _ in 0..WAITING + 3 {
            senders[0].send(RawMessage::from_bag(&[0, 1, 0, 0, 8]).unwrap());
        }
        let now = Stamp::from_secs(1000.0);
        let taken = take(&mut inputs, WAITING, (before, now));
        assert_eq!(taken.len(), WAITING + 1);
        let (b, a) = (taken[WAITING].1, taken[0].1);
        assert!(now <= b && a.since(b) >= 0.002, "/b came before /a: {b:?} {a:?}");
        assert_eq!(dropped(&inputs), BTreeMap::from([("/a".to_owned(), 3)]));
        assert!(take(&mut inputs, WAITING, (before, now)).is_empty());
        // Most messages were received before the clocks are read.
        senders[1].send(RawMessage::from_bag(&[0, 1, 0, 0, 9]).unwrap());
        let later = Instant::now() + Duration::from_secs(1);
        assert!(take(&mut inputs, 1, (later, now))[0].1.since(now) <= -1.0);
    }
}
