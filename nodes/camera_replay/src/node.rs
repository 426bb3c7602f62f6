use crate::frames::{Frame, FrameGrouper, Latched, Stamps, has_header, set_stamp, stamp_of};
use crate::params::ReplayParameters;
use anyhow::{Context as _, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};
use tdv_bag::{BagMessage, BagReader, ReplaySchedule};
use tdv_geometry::Stamp;
use tdv_msgs::RawMessage;
use tdv_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
use tdv_runtime::{Inbox, Level, Node, Params, Publisher, Qos, convert};

/// Types that a camera driver publishes; the default selection.
const CAMERA_TYPES: [&str; 3] =
    ["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"];

/// Messages of a latched topic that a late subscriber still gets.
const LATCHED: usize = 10;

struct Output {
    publisher: Publisher<RawMessage>,
    headed: bool,
    latched: bool,
}

struct Replay {
    node: Node,
    params: ReplayParameters,
    reader: BagReader,
    topics: Vec<String>,
    outputs: BTreeMap<String, Output>,
    clock: Option<Publisher<ClockMessage>>,
    /// One inbox per answer topic of the lockstep mode.
    answers: Vec<(String, Inbox<RawMessage>)>,
}

/// The node's life: one bag, once or looped.
pub async fn replay(node: Node, params: Params<ReplayParameters>) -> anyhow::Result<()> {
    let mut replay = Replay::new(node, params.get().as_ref().clone())?;
    tokio::time::sleep(Duration::from_secs_f64(replay.params.startup_delay)).await;
    let Some((first, last)) = replay.reader.span() else {
        bail!("{} holds no message", replay.reader.path().display());
    };
    let config = replay.params.config();
    let mut schedule = ReplaySchedule::new(config, first, last, Stamp(0))?;
    replay.send_latched(&schedule, first)?;
    // The wall clock paces the replay: with `clock` on, the graph's own clock is what we publish.
    let origin = Instant::now();
    loop {
        let sent = replay.round(&schedule, origin).await?;
        if !schedule.next_round() {
            let sentence = format!("end of the bag: {sent} messages sent");
            tracing::info!("{sentence}");
            replay.node.diagnostics().level(Level::Ok, sentence);
            // Subscribers still read the last messages; a reliable writer has to be there for them.
            tokio::time::sleep(Duration::from_millis(500)).await;
            return Ok(());
        }
    }
}

impl Replay {
    fn new(node: Node, params: ReplayParameters) -> anyhow::Result<Self> {
        let mut reader = BagReader::open(Path::new(&params.bag))?;
        let known = reader.topics();
        let topics: Vec<String> = if params.topics.is_empty() {
            known
                .iter()
                .filter(|t| CAMERA_TYPES.contains(&t.type_name.as_str()) || t.name == "/tf_static")
                .map(|t| t.name.clone())
                .collect()
        } else {
            params.topics.clone()
        };
        if topics.is_empty() {
            let names: Vec<&str> = known.iter().map(|t| t.name.as_str()).collect();
            bail!("{} has no camera topic; it has: {}", params.bag, names.join(", "));
        }
        let names: Vec<&str> = topics.iter().map(String::as_str).collect();
        reader.select(&names, None)?;
        let mut outputs = BTreeMap::new();
        for topic in known.iter().filter(|t| topics.contains(&t.name)) {
            // A bag that does not tell the quality of service: subscribers of /tf_static want it latched.
            let latched = topic.latched || topic.name == "/tf_static";
            let qos = if latched { Qos::latched_depth(LATCHED) } else { Qos::reliable(5) };
            let publisher = node
                .raw_publisher(&topic.name, &topic.type_name, qos)
                .with_context(|| format!("topic {} of {}", topic.name, params.bag))?;
            let headed = has_header(&topic.type_name);
            outputs.insert(topic.name.clone(), Output { publisher, headed, latched });
        }
        let clock =
            params.clock.then(|| node.publisher("/clock", Qos::best_effort(10))).transpose()?;
        let mut answers = Vec::new();
        if params.lockstep {
            for answer in &params.lockstep_answers {
                let (topic, type_name) = answer.split_once(':').unwrap_or((answer, ""));
                answers.push((
                    topic.to_owned(),
                    node.raw_queue(topic, type_name, Qos::reliable(10), 64)?,
                ));
            }
        }
        node.diagnostics().level(Level::Ok, format!("replaying {}", params.bag));
        Ok(Self { node, params, reader, topics, outputs, clock, answers })
    }

    /// Sends what latched topics said before the start, such as where the camera stands.
    fn send_latched(&mut self, schedule: &ReplaySchedule, first: Stamp) -> anyhow::Result<()> {
        let latched = self.outputs.iter().filter(|(_, output)| output.latched);
        let names: Vec<&str> = latched.map(|(name, _)| name.as_str()).collect();
        // No names would select every topic.
        if names.is_empty() || schedule.start() <= first {
            return Ok(());
        }
        self.reader.select(&names, None)?;
        let mut kept = Latched::new(LATCHED);
        while let Some(mut message) = self.reader.next_message()?
            && message.log_time < schedule.start()
        {
            // As if it had just been sent: /clock begins at the start.
            message.log_time = schedule.start();
            kept.push(message);
        }
        kept.messages().iter().try_for_each(|message| self.send(message, schedule))
    }

    /// Plays the bag once.
    async fn round(&mut self, schedule: &ReplaySchedule, origin: Instant) -> anyhow::Result<u64> {
        let names: Vec<&str> = self.topics.iter().map(String::as_str).collect();
        self.reader.select(&names, Some(schedule.start()))?;
        let mut grouper = FrameGrouper::new(self.params.sync_tolerance);
        let mut sent = 0;
        while let Some(message) = self.reader.next_message()? {
            let headed = self.outputs.get(&message.topic).is_some_and(|o| o.headed);
            let stamp = if headed { message.data.get(4..).and_then(stamp_of) } else { None };
            if let Some(frame) = grouper.push(message, stamp) {
                sent += self.play(frame, schedule, origin).await?;
            }
        }
        if let Some(frame) = grouper.finish() {
            sent += self.play(frame, schedule, origin).await?;
        }
        Ok(sent)
    }

    async fn play(
        &mut self,
        frame: Frame,
        schedule: &ReplaySchedule,
        origin: Instant,
    ) -> anyhow::Result<u64> {
        if !self.params.lockstep {
            for message in &frame.messages {
                let due = Duration::from_nanos(schedule.due(message.log_time).0.max(0) as u64);
                tokio::time::sleep_until((origin + due).into()).await;
                self.send(message, schedule)?;
            }
            return Ok(frame.messages.len() as u64);
        }
        for attempt in 1..=5 {
            for message in &frame.messages {
                self.send(message, schedule)?;
            }
            let Some(stamps) = frame.stamps else { return Ok(frame.messages.len() as u64) };
            let missing = self.wait_for_answers(stamps.plus(schedule.shift())).await;
            if missing.is_empty() {
                return Ok(frame.messages.len() as u64);
            }
            let sentence = format!(
                "no answer to the frame of {:.3} s on {} (attempt {attempt})",
                stamps.oldest.as_secs(),
                missing.join(", ")
            );
            tracing::warn!("{sentence}");
            self.node.diagnostics().level(Level::Warn, sentence);
        }
        bail!("lockstep: a frame got no answer five times; is the graph complete?")
    }

    fn send(&self, message: &BagMessage, schedule: &ReplaySchedule) -> anyhow::Result<()> {
        let Some(output) = self.outputs.get(&message.topic) else { return Ok(()) };
        let mut raw = RawMessage::from_bag(&message.data)
            .with_context(|| format!("a message on {}", message.topic))?;
        let bag_time = message.log_time.plus(schedule.shift());
        if output.headed {
            if self.params.restamp {
                set_stamp(&mut raw.0, self.node.now());
            } else if let Some(stamp) = stamp_of(&raw.0) {
                set_stamp(&mut raw.0, stamp.plus(schedule.shift()));
            }
        }
        if let Some(clock) = &self.clock {
            clock.publish(ClockMessage { clock: convert::time_from_stamp(bag_time) });
        }
        output.publisher.publish(raw);
        Ok(())
    }

    /// The topics on which no message with a stamp of the frame came in time.
    async fn wait_for_answers(&mut self, frame: Stamps) -> Vec<String> {
        let end =
            tokio::time::Instant::now() + Duration::from_secs_f64(self.params.lockstep_timeout);
        let mut missing: BTreeSet<String> = BTreeSet::new();
        for (topic, inbox) in &mut self.answers {
            loop {
                match tokio::time::timeout_at(end, inbox.recv()).await {
                    Ok(Some(m)) if stamp_of(&m.0).is_some_and(|s| frame.hold(s)) => break,
                    Ok(Some(_)) => {}
                    Ok(None) | Err(_) => {
                        missing.insert(topic.clone());
                        break;
                    }
                }
            }
        }
        missing.into_iter().collect()
    }
}
