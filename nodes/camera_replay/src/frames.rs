//! Stamps inside encoded messages, and messages grouped by the frame they belong to.

use tdv_bag::BagMessage;
use tdv_geometry::Stamp;

/// Types whose first field is a `std_msgs/Header`, so that their stamp lies at a fixed place.
pub fn has_header(type_name: &str) -> bool {
    matches!(
        type_name,
        "sensor_msgs/msg/Image"
            | "sensor_msgs/msg/CompressedImage"
            | "sensor_msgs/msg/CameraInfo"
            | "sensor_msgs/msg/JointState"
            | "geometry_msgs/msg/PoseStamped"
            | "vision_msgs/msg/Detection3DArray"
            | "tdv_msgs/msg/TrackedObjects"
            | "tdv_msgs/msg/PoseTrajectory"
            | "tdv_msgs/msg/HandJoints"
    )
}

/// Stamp of a message that starts with a header; `payload` is little-endian CDR without encapsulation.
pub fn stamp_of(payload: &[u8]) -> Option<Stamp> {
    let sec = i32::from_le_bytes(payload.get(0..4)?.try_into().ok()?);
    let nanosec = u32::from_le_bytes(payload.get(4..8)?.try_into().ok()?);
    Some(Stamp::from_ros(sec, nanosec))
}

/// Replaces the stamp of a message that starts with a header.
pub fn set_stamp(payload: &mut [u8], stamp: Stamp) {
    let (sec, nanosec) = stamp.to_ros();
    if let Some(field) = payload.get_mut(0..4) {
        field.copy_from_slice(&sec.to_le_bytes());
    }
    if let Some(field) = payload.get_mut(4..8) {
        field.copy_from_slice(&nanosec.to_le_bytes());
    }
}

/// What a late subscriber would still get of latched topics: the last `depth` messages of each.
pub struct Latched {
    depth: usize,
    messages: Vec<BagMessage>,
}

impl Latched {
    /// Nothing yet.
    pub fn new(depth: usize) -> Self {
        Self { depth, messages: Vec::new() }
    }

    /// Adds the next message, in the order of the bag.
    pub fn push(&mut self, message: BagMessage) {
        let same = |m: &BagMessage| m.topic == message.topic;
        if self.messages.iter().filter(|m| same(m)).count() >= self.depth
            && let Some(oldest) = self.messages.iter().position(same)
        {
            self.messages.remove(oldest);
        }
        self.messages.push(message);
    }

    /// All of them, in the order of the bag.
    pub fn messages(&self) -> &[BagMessage] {
        &self.messages
    }
}

/// Cuts a stream of messages into frames: runs of headed messages with one stamp, give or take a
/// tolerance. Messages without a header travel with the frame that follows them.
pub struct FrameGrouper {
    tolerance: f64,
    pending: Vec<BagMessage>,
    stamps: Option<Stamps>,
}

/// The oldest and the newest stamp of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    pub oldest: Stamp,
    pub newest: Stamp,
}

/// Messages that belong together.
pub struct Frame {
    /// Stamps of the images; `None` for a run without any.
    pub stamps: Option<Stamps>,
    pub messages: Vec<BagMessage>,
}

impl Stamps {
    /// With another message; `None` when that one is more than `tolerance` seconds away from any.
    fn with(self, stamp: Stamp, tolerance: f64) -> Option<Self> {
        let (oldest, newest) = (self.oldest.min(stamp), self.newest.max(stamp));
        (newest.since(oldest) <= tolerance).then_some(Self { oldest, newest })
    }

    /// Whether a message with this stamp answers the frame.
    pub fn hold(self, stamp: Stamp) -> bool {
        (self.oldest..=self.newest).contains(&stamp)
    }

    /// Moved by `shift` seconds.
    pub fn plus(self, shift: f64) -> Self {
        Self { oldest: self.oldest.plus(shift), newest: self.newest.plus(shift) }
    }
}

impl FrameGrouper {
    /// The stamps of a frame differ by at most `tolerance` seconds.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, pending: Vec::new(), stamps: None }
    }

    /// Adds a message with its header stamp; gives the frame that it completes.
    pub fn push(&mut self, message: BagMessage, stamp: Option<Stamp>) -> Option<Frame> {
        let mut complete = None;
        if let Some(stamp) = stamp {
            let joined = self.stamps.map(|s| s.with(stamp, self.tolerance));
            if joined == Some(None) {
                complete = self.finish();
            }
            self.stamps = joined.flatten().or(Some(Stamps { oldest: stamp, newest: stamp }));
        }
        self.pending.push(message);
        complete
    }

    /// What is left at the end.
    pub fn finish(&mut self) -> Option<Frame> {
        let stamps = self.stamps.take();
        let messages = std::mem::take(&mut self.pending);
        (!messages.is_empty()).then_some(Frame { stamps, messages })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(topic: &str) -> BagMessage {
        BagMessage {
            topic: topic.into(),
            log_time: Stamp(0),
            publish_time: Stamp(0),
            data: Vec::new(),
        }
    }

    #[test]
    fn stamps_in_place() {
        let mut bytes = vec![0; 12];
        set_stamp(&mut bytes, Stamp(1_500_000_000));
        assert_eq!(stamp_of(&bytes), Some(Stamp(1_500_000_000)));
        assert_eq!(stamp_of(&bytes[..7]), None);
        set_stamp(&mut bytes[..3], Stamp(1));
    }

    #[test]
    fn frames_are_runs_of_one_stamp() {
        let mut g = FrameGrouper::new(0.0);
        let s = |n| Some(Stamp(n));
        let both = |n| Some(Stamps { oldest: Stamp(n), newest: Stamp(n) });
        assert!(g.push(message("/tf_static"), None).is_none());
        assert!(g.push(message("color"), s(1)).is_none());
        assert!(g.push(message("depth"), s(1)).is_none());
        let first = g.push(message("color"), s(2)).unwrap();
        assert_eq!((first.stamps, first.messages.len()), (both(1), 3));
        assert_eq!(g.finish().unwrap().messages.len(), 1);
        assert!(g.finish().is_none());
    }

    #[test]
    fn slightly_different_stamps_are_one_frame() {
        let mut g = FrameGrouper::new(0.005);
        let s = |ms: i64| Some(Stamp(ms * 1_000_000));
        assert!(g.push(message("depth"), s(103)).is_none());
        assert!(g.push(message("color"), s(100)).is_none());
        // Near to the depth image, but not to the colour image.
        let first = g.push(message("color"), s(107)).unwrap();
        assert_eq!(first.messages.len(), 2);
        let stamps = first.stamps.unwrap();
        assert!(stamps.hold(Stamp(100_000_000)) && stamps.hold(Stamp(103_000_000)));
        assert!(!stamps.hold(Stamp(107_000_000)));
        assert!(stamps.plus(1.0).hold(Stamp(1_100_000_000)));
        assert_eq!(g.finish().unwrap().stamps.unwrap().oldest, Stamp(107_000_000));
    }

    #[test]
    fn the_last_latched_messages_of_each_topic_stay_in_order() {
        let mut kept = Latched::new(2);
        for topic in ["/tf_static", "/info", "/tf_static", "/tf_static"] {
            kept.push(message(topic));
        }
        let mut third = message("/tf_static");
        third.log_time = Stamp(9);
        kept.push(third);
        let topics: Vec<_> =
            kept.messages().iter().map(|m| (m.topic.as_str(), m.log_time.0)).collect();
        assert_eq!(topics, [("/info", 0), ("/tf_static", 0), ("/tf_static", 9)]);
    }
}
