//! Which frames are worked on: each stamp once, in order, and from the start when a stream starts over.

use std::time::Instant;
use tdv_geometry::Stamp;

/// Stamps that step back farther (s) belong to another stream: a recording that starts over, or one
/// wrong stamp from the future before them.
const STEP_BACK: f64 = 0.5;

/// Images stamped farther (s) ahead of the clock are refused: their camera's clock is wrong.
const AHEAD: f64 = 0.5;

/// True for a stamp that cannot be at `now`.
pub fn from_the_future(stamp: Stamp, now: Stamp) -> bool {
    stamp.since(now) > AHEAD
}

/// What is to be done with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// It is worked on.
    Next,
    /// It is the first one of a stream that starts over.
    StartsOver,
    /// Its answer went out before it came again: whoever sent it missed the answer.
    Missed,
    /// It is older than the last one, or came twice before it was answered.
    Late,
}

/// The frame that was answered last. A frame without an answer may come again.
#[derive(Debug, Default)]
pub struct Order {
    last: Option<(Stamp, Instant)>,
}

impl Order {
    /// Says what to do with the frame of `stamp` that came in at `came`.
    pub fn turn(&self, stamp: Stamp, came: Instant) -> Turn {
        match self.last {
            None => Turn::Next,
            Some((last, _)) if stamp > last => Turn::Next,
            Some((last, _)) if last.since(stamp) > STEP_BACK => Turn::StartsOver,
            Some((last, answered)) if stamp == last && came > answered => Turn::Missed,
            Some(_) => Turn::Late,
        }
    }

    /// The answer to the frame of `stamp` went out at `now`.
    pub fn answered(&mut self, stamp: Stamp, now: Instant) {
        self.last = Some((stamp, now));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn each_frame_once_until_the_stream_starts_over() {
        let mut order = Order::default();
        let (at, t0) = (Stamp::from_secs, Instant::now());
        let t = |s| t0 + Duration::from_secs(s);
        assert_eq!(order.turn(at(8.0), t(0)), Turn::Next);
        // Not answered, for example for want of a camera_info: it may come again.
        assert_eq!(order.turn(at(8.0), t(1)), Turn::Next);
        order.answered(at(8.0), t(5));
        assert_eq!(order.turn(at(8.0), t(4)), Turn::Late, "sent again while it was worked on");
        assert_eq!(order.turn(at(8.0), t(6)), Turn::Missed, "sent again after the answer");
        assert_eq!(order.turn(at(7.9), t(6)), Turn::Late);
        assert_eq!(order.turn(at(8.1), t(6)), Turn::Next);
        assert_eq!(order.turn(at(0.0), t(6)), Turn::StartsOver, "the bag played once more");
        order.answered(at(0.0), t(7));
        assert_eq!(order.turn(at(0.1), t(7)), Turn::Next);
    }

    #[test]
    fn images_ahead_of_the_clock() {
        let now = Stamp::from_secs(10.0);
        assert!(from_the_future(Stamp::from_secs(10.6), now));
        assert!(!from_the_future(Stamp::from_secs(10.4), now));
        assert!(!from_the_future(Stamp::from_secs(1.0), now));
    }
}
