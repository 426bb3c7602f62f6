use crate::BagError;
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use tdv_geometry::Stamp;

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicInfo {
    /// Name.
    pub name: String,
    /// Type, `sensor_msgs/msg/Image`.
    pub type_name: String,
    /// Schema text.
    pub schema: String,
    /// Whether it was recorded as latched (transient local).
    pub latched: bool,
    /// Messages on it.
    pub count: u64,
}

/// One recorded message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BagMessage {
    /// Topic name.
    pub topic: String,
    /// When it was received by the recorder.
    pub log_time: Stamp,
    /// When it was sent.
    pub publish_time: Stamp,
    /// CDR bytes with the encapsulation header.
    pub data: Vec<u8>,
}

/// Reads one bag in log-time order, a chunk at a time.
pub struct BagReader {
    path: PathBuf,
    file: File,
    summary: mcap::Summary,
    reader: IndexedReader,
    chunk: Vec<u8>,
}

/// The MCAP file of a bag path.
fn locate(path: &Path) -> Result<PathBuf, BagError> {
    let extension = |p: &Path| p.extension().map(|e| e.to_string_lossy().to_lowercase());
    if path.is_dir() {
        let io = |source| BagError::Io { path: path.to_owned(), source };
        let mut files: Vec<PathBuf> = std::fs::read_dir(path)
            .map_err(io)?
            .collect::<Result<Vec<_>, _>>()
            .map_err(io)?
            .into_iter()
            .map(|e| e.path())
            .collect();
        files.sort();
        if let Some(f) = files.iter().find(|f| extension(f).as_deref() == Some("mcap")) {
            return Ok(f.clone());
        }
        if files.iter().any(|f| extension(f).as_deref() == Some("db3")) {
            return Err(BagError::Sqlite { path: path.to_owned() });
        }
        return Err(BagError::NotFound(path.to_owned()));
    }
    match extension(path).as_deref() {
        _ if !path.exists() => Err(BagError::NotFound(path.to_owned())),
        Some("db3") => Err(BagError::Sqlite { path: path.to_owned() }),
        _ => Ok(path.to_owned()),
    }
}

fn read_summary(path: &Path, file: &mut File) -> Result<mcap::Summary, BagError> {
    let damaged = |detail: String| BagError::Damaged { path: path.to_owned(), detail };
    let mut reader = SummaryReader::new();
    while let Some(event) = reader.next_event() {
        match event.map_err(|e| damaged(e.to_string()))? {
            SummaryReadEvent::ReadRequest(n) => {
                let got = file.read(reader.insert(n)).map_err(|e| damaged(e.to_string()))?;
                reader.notify_read(got);
            }
            SummaryReadEvent::SeekRequest(to) => {
                let at = file.seek(to).map_err(|e| damaged(e.to_string()))?;
                reader.notify_seeked(at);
            }
        }
    }
    reader.finish().ok_or_else(|| damaged("it has no summary section".into()))
}

impl BagReader {
    /// Opens a rosbag2 folder or a bare `.mcap` file.
    ///
    /// # Errors
    /// [`BagError::NotFound`], [`BagError::Sqlite`], [`BagError::Damaged`], [`BagError::Io`].
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let path = locate(path)?;
        let mut file =
            File::open(&path).map_err(|source| BagError::Io { path: path.clone(), source })?;
        let summary = read_summary(&path, &mut file)?;
        let reader = IndexedReader::new(&summary)
            .map_err(|e| BagError::Damaged { path: path.clone(), detail: e.to_string() })?;
        Ok(Self { path, file, summary, reader, chunk: Vec::new() })
    }

    /// The MCAP file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Topics, by name.
    pub fn topics(&self) -> Vec<TopicInfo> {
        let counts = self.summary.stats.as_ref().map(|s| &s.channel_message_counts);
        let mut topics: Vec<TopicInfo> =
            self.summary
                .channels
                .values()
                .map(|c| TopicInfo {
                    name: c.topic.clone(),
                    type_name: c.schema.as_ref().map(|s| s.name.clone()).unwrap_or_default(),
                    schema: c
                        .schema
                        .as_ref()
                        .map(|s| String::from_utf8_lossy(&s.data).into_owned())
                        .unwrap_or_default(),
                    latched: c.metadata.get("offered_qos_profiles").is_some_and(|q| {
                        q.contains("transient_local") || q.contains("durability: 1")
                    }),
                    count: counts.and_then(|n| n.get(&c.id)).copied().unwrap_or(0),
                })
                .collect();
        topics.sort_by(|a, b| a.name.cmp(&b.name));
        topics
    }

    /// First and last log time; `None` for an empty bag.
    pub fn span(&self) -> Option<(Stamp, Stamp)> {
        let s = self.summary.stats.as_ref()?;
        (s.message_count > 0)
            .then_some((Stamp(s.message_start_time as i64), Stamp(s.message_end_time as i64)))
    }

    /// Starts over, yielding only these topics from `start` on.
    ///
    /// # Errors
    /// [`BagError::NoTopic`] naming the first one that is missing, [`BagError::Damaged`].
    pub fn select(&mut self, topics: &[&str], start: Option<Stamp>) -> Result<(), BagError> {
        let have = self.topics();
        for t in topics {
            if !have.iter().any(|h| h.name == *t) {
                let names: Vec<&str> = have.iter().map(|h| h.name.as_str()).collect();
                return Err(BagError::NoTopic {
                    path: self.path.clone(),
                    topic: (*t).to_owned(),
                    have: if names.is_empty() { "nothing".into() } else { names.join(", ") },
                });
            }
        }
        let mut options = IndexedReaderOptions::new().include_topics(topics.iter().copied());
        if let Some(s) = start {
            options = options.starting_at(s.0.max(0) as u64);
        }
        self.reader = IndexedReader::new_with_options(&self.summary, options)
            .map_err(|e| BagError::Damaged { path: self.path.clone(), detail: e.to_string() })?;
        Ok(())
    }

    /// The next message in log-time order, `None` at the end.
    ///
    /// # Errors
    /// [`BagError::Damaged`].
    pub fn next_message(&mut self) -> Result<Option<BagMessage>, BagError> {
        let path = &self.path;
        let damaged = |detail: String| BagError::Damaged { path: path.clone(), detail };
        loop {
            let request = match self.reader.next_event() {
                None => return Ok(None),
                Some(Err(e)) => return Err(damaged(e.to_string())),
                Some(Ok(IndexedReadEvent::Message { header, data })) => {
                    let Some(channel) = self.summary.channels.get(&header.channel_id) else {
                        return Err(damaged(format!("channel {} is unknown", header.channel_id)));
                    };
                    return Ok(Some(BagMessage {
                        topic: channel.topic.clone(),
                        log_time: Stamp(header.log_time as i64),
                        publish_time: Stamp(header.publish_time as i64),
                        data: data.to_vec(),
                    }));
                }
                Some(Ok(IndexedReadEvent::ReadChunkRequest { offset, length })) => (offset, length),
            };
            let size = self.file.metadata().map(|m| m.len()).unwrap_or(0);
            if request.1 as u64 > size {
                return Err(damaged(format!("a chunk of {} bytes in a file of {size}", request.1)));
            }
            self.file.seek(SeekFrom::Start(request.0)).map_err(|e| damaged(e.to_string()))?;
            self.chunk.resize(request.1, 0);
            self.file.read_exact(&mut self.chunk).map_err(|e| damaged(e.to_string()))?;
            self.reader
                .insert_chunk_record_data(request.0, &self.chunk)
                .map_err(|e| damaged(e.to_string()))?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BagWriter, Durability, Topic};

    fn sample(dir: &Path) -> PathBuf {
        let mut w = BagWriter::create(&dir.join("demo")).unwrap();
        let topic = |name: &str, durability| Topic {
            name: name.into(),
            type_name: "std_msgs/msg/String".into(),
            schema: "string data".into(),
            durability,
        };
        let a = w.add_topic(topic("/a", Durability::Volatile)).unwrap();
        let b = w.add_topic(topic("/b", Durability::TransientLocal)).unwrap();
        assert_eq!(w.add_topic(topic("/a", Durability::Volatile)).unwrap(), a);
        // Out of order on purpose: the reader sorts by log time.
        for (id, t) in [(a, 30), (b, 10), (a, 20)] {
            w.write(id, Stamp(t), Stamp(t), &[0, 1, 0, 0, t as u8]).unwrap();
        }
        assert!(!dir.join("demo").exists(), "nothing under the final name before finish");
        w.finish().unwrap()
    }

    #[test]
    fn what_is_written_is_read_in_time_order() {
        let dir = tempfile::tempdir().unwrap();
        let bag = sample(dir.path());
        let mut r = BagReader::open(&bag).unwrap();
        let topics = r.topics();
        assert_eq!(topics.len(), 2);
        assert_eq!((topics[0].count, topics[0].latched), (2, false));
        assert!(topics[1].latched);
        assert_eq!(r.span(), Some((Stamp(10), Stamp(30))));
        let mut times = Vec::new();
        while let Some(m) = r.next_message().unwrap() {
            assert_eq!(m.data[4], m.log_time.0 as u8);
            times.push(m.log_time.0);
        }
        assert_eq!(times, [10, 20, 30]);
        r.select(&["/a"], Some(Stamp(25))).unwrap();
        assert_eq!(r.next_message().unwrap().unwrap().log_time, Stamp(30));
        assert_eq!(r.next_message().unwrap(), None);
        assert!(matches!(r.select(&["/c"], None), Err(BagError::NoTopic { .. })));
        assert!(matches!(BagWriter::create(&bag), Err(BagError::Exists(_))));
    }

    #[test]
    fn bad_bags_say_what_is_wrong() {
        let dir = tempfile::tempdir().unwrap();
        let open = |p: &Path| BagReader::open(p).err().unwrap();
        assert!(matches!(open(&dir.path().join("none")), BagError::NotFound(_)));
        assert!(matches!(open(dir.path()), BagError::NotFound(_)));
        std::fs::write(dir.path().join("x.db3"), b"SQLite format 3").unwrap();
        assert!(open(dir.path()).to_string().contains("convert"));
        let bag = sample(dir.path());
        let file = bag.join("demo_0.mcap");
        let bytes = std::fs::read(&file).unwrap();
        for cut in [0, 5, 50, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&file, &bytes[..cut]).unwrap();
            assert!(matches!(open(&bag), BagError::Damaged { .. }), "cut at {cut}");
        }
        std::fs::write(&file, vec![b'x'; 4096]).unwrap();
        assert!(matches!(open(&bag), BagError::Damaged { .. }));
    }
}
