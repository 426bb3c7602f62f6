use crate::metadata::{TopicSummary, metadata_yaml, qos_text};
use crate::{BagError, Durability};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};
use tdv_geometry::Stamp;

/// A topic to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Full name, `/camera/...`.
    pub name: String,
    /// Type, `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// Concatenated `ros2msg` text of the type and all it contains.
    pub schema: String,
    /// Recorded QoS durability.
    pub durability: Durability,
}

/// Handle of a topic within its [`BagWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TopicId(usize);

struct Channel {
    topic: Topic,
    id: u16,
    sequence: u32,
    count: u64,
}

/// Writes a rosbag2 folder. It is called `NAME.partial` until [`BagWriter::finish`]; a recorder that dies
/// leaves that folder behind with everything up to the last chunk.
pub struct BagWriter {
    target: PathBuf,
    partial: PathBuf,
    file_name: String,
    writer: mcap::Writer<BufWriter<File>>,
    channels: Vec<Channel>,
    span: Option<(u64, u64)>,
}

fn name_of(target: &Path) -> String {
    target.file_name().map_or_else(|| "bag".into(), |n| n.to_string_lossy().into_owned())
}

/// What the bag `target` is called until it is whole.
fn partial_of(target: &Path) -> PathBuf {
    target.with_file_name(format!("{}.partial", name_of(target)))
}

/// Removes the bag folder `target` and what an interrupted [`BagWriter`] left of it, if they are there.
///
/// # Errors
/// [`BagError::Io`].
pub fn remove_bag(target: &Path) -> Result<(), BagError> {
    for path in [target.to_owned(), partial_of(target)] {
        match fs::remove_dir_all(&path) {
            Err(source) if source.kind() != ErrorKind::NotFound => {
                return Err(BagError::Io { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}

impl BagWriter {
    /// Starts a bag at `target` (a folder that does not exist yet).
    ///
    /// # Errors
    /// [`BagError::Exists`], [`BagError::Io`], [`BagError::Mcap`].
    pub fn create(target: &Path) -> Result<Self, BagError> {
        if target.exists() {
            return Err(BagError::Exists(target.to_owned()));
        }
        let (name, partial) = (name_of(target), partial_of(target));
        let io = |source| BagError::Io { path: partial.clone(), source };
        if partial.exists() {
            return Err(BagError::Exists(partial));
        }
        fs::create_dir_all(&partial).map_err(io)?;
        let file_name = format!("{name}_0.mcap");
        let file = File::create(partial.join(&file_name)).map_err(io)?;
        let writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library("tdv")
            .compression(Some(mcap::Compression::Zstd))
            .chunk_size(Some(1 << 20))
            .create(BufWriter::new(file))
            .map_err(|source| BagError::Mcap { path: partial.clone(), source })?;
        Ok(Self {
            target: target.to_owned(),
            partial,
            file_name,
            writer,
            channels: Vec::new(),
            span: None,
        })
    }

    fn mcap_error(&self, source: mcap::McapError) -> BagError {
        BagError::Mcap { path: self.partial.join(&self.file_name), source }
    }

    /// Declares a topic; the same name twice gives the first handle.
    ///
    /// # Errors
    /// [`BagError::Mcap`].
    pub fn add_topic(&mut self, topic: Topic) -> Result<TopicId, BagError> {
        if let Some(i) = self.channels.iter().position(|c| c.topic.name == topic.name) {
            return Ok(TopicId(i));
        }
        let schema = self
            .writer
            .add_schema(&topic.type_name, "ros2msg", topic.schema.as_bytes())
            .map_err(|e| self.mcap_error(e))?;
        let metadata =
            BTreeMap::from([("offered_qos_profiles".to_owned(), qos_text(topic.durability, 0))]);
        let id = self
            .writer
            .add_channel(schema, &topic.name, "cdr", &metadata)
            .map_err(|e| self.mcap_error(e))?;
        self.channels.push(Channel { topic, id, sequence: 0, count: 0 });
        Ok(TopicId(self.channels.len() - 1))
    }

    /// Appends a message: CDR bytes with their four-byte encapsulation header.
    ///
    /// # Errors
    /// [`BagError::Mcap`].
    pub fn write(
        &mut self,
        topic: TopicId,
        log: Stamp,
        publish: Stamp,
        data: &[u8],
    ) -> Result<(), BagError> {
        let (log_time, publish_time) = (log.0.max(0) as u64, publish.0.max(0) as u64);
        let channel = &mut self.channels[topic.0];
        channel.sequence = channel.sequence.wrapping_add(1);
        channel.count += 1;
        let header = mcap::records::MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time,
            publish_time,
        };
        let (a, b) = self.span.unwrap_or((log_time, log_time));
        self.span = Some((a.min(log_time), b.max(log_time)));
        self.writer.write_to_known_channel(&header, data).map_err(|e| self.mcap_error(e))
    }

    /// Number of messages so far.
    pub fn message_count(&self) -> u64 {
        self.channels.iter().map(|c| c.count).sum()
    }

    /// Writes the summary and `metadata.yaml`, then gives the folder its final name.
    ///
    /// # Errors
    /// [`BagError::Mcap`], [`BagError::Io`]; the partial folder stays.
    pub fn finish(mut self) -> Result<PathBuf, BagError> {
        self.writer.finish().map_err(|e| self.mcap_error(e))?;
        let io = |source| BagError::Io { path: self.partial.clone(), source };
        let topics: Vec<TopicSummary> = self
            .channels
            .iter()
            .map(|c| TopicSummary {
                name: c.topic.name.clone(),
                type_name: c.topic.type_name.clone(),
                durability: c.topic.durability,
                count: c.count,
            })
            .collect();
        let (start, end) = self.span.unwrap_or((0, 0));
        let yaml = metadata_yaml(&self.file_name, start, end, &topics);
        fs::write(self.partial.join("metadata.yaml"), yaml).map_err(io)?;
        let file = self.writer.into_inner().into_inner().map_err(|e| io(e.into_error()))?;
        file.sync_all().map_err(io)?;
        fs::rename(&self.partial, &self.target).map_err(io)?;
        Ok(self.target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_bag_can_take_the_place_of_a_removed_one() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("run.1");
        remove_bag(&target).unwrap();
        drop(BagWriter::create(&target).unwrap());
        assert!(matches!(BagWriter::create(&target), Err(BagError::Exists(_))));
        remove_bag(&target).unwrap();
        BagWriter::create(&target).unwrap().finish().unwrap();
        drop(BagWriter::create(&dir.path().join("run.10")).unwrap());
        remove_bag(&target).unwrap();
        let left: Vec<_> = fs::read_dir(&dir).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["run.10.partial"], "only the bag itself goes");
    }
}
