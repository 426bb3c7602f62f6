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

/// Cuts a stream of messages into frames: runs of headed messages with one stamp. Messages without a
/// header travel with the frame that follows them.
#[derive(Default)]
pub struct FrameGrouper {
    pending: Vec<BagMessage>,
    stamp: Option<Stamp>,
}

/// Messages that belong together.
pub struct Frame {
    /// Stamp of the images; `None` for a run without any.
    pub stamp: Option<Stamp>,
    pub messages: Vec<BagMessage>,
}

impl FrameGrouper {
    /// Adds a message with its header stamp; gives the frame that it completes.
    pub fn push(&mut self, message: BagMessage, stamp: Option<Stamp>) -> Option<Frame> {
        let complete = match (self.stamp, stamp) {
            (Some(a), Some(b)) if a != b => self.finish(),
            _ => None,
        };
        self.stamp = stamp.or(self.stamp);
        self.pending.push(message);
        complete
    }

    /// What is left at the end.
    pub fn finish(&mut self) -> Option<Frame> {
        let stamp = self.stamp.take();
        let messages = std::mem::take(&mut self.pending);
        (!messages.is_empty()).then_some(Frame { stamp, messages })
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
        let mut g = FrameGrouper::default();
        let s = |n| Some(Stamp(n));
        assert!(g.push(message("/tf_static"), None).is_none());
        assert!(g.push(message("color"), s(1)).is_none());
        assert!(g.push(message("depth"), s(1)).is_none());
        let first = g.push(message("color"), s(2)).unwrap();
        assert_eq!((first.stamp, first.messages.len()), (s(1), 3));
        assert_eq!(g.finish().unwrap().messages.len(), 1);
        assert!(g.finish().is_none());
    }
}
