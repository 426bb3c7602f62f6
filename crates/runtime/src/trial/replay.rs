//! A recording through the live graph: every answer of the pose tracker.

use super::{TrialError, TrialSetup, not_interrupted, start};
use crate::launch::NodeExit;
use crate::{Inbox, Qos, Shutdown, tracked};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::CompressedImage;
use tdv_msgs::tdv_msgs::msg::TrackedObjects;

/// The node that plays the recording.
const PLAYER: &str = "camera_replay";
/// Answers may still come for so long after the last frame.
const AFTER: Duration = Duration::from_millis(1500);

/// What a replay gave.
#[derive(Debug, Clone, Default)]
pub struct ReplayOutcome {
    /// Tracked objects by the stamp of their frame.
    pub objects: BTreeMap<Stamp, TrackedObjects>,
    /// Milliseconds from the receipt of a colour image to that of its poses.
    pub delay_ms: BTreeMap<Stamp, f64>,
    /// Nodes that ended by themselves, the player left out if it ended well.
    pub exits: Vec<NodeExit>,
}

/// Starts the graph, waits until the recording has been played and answered, and ends the graph.
///
/// # Errors
/// [`TrialError`]. Frames without an answer and nodes that ended are in the outcome; a replay that
/// `shutdown` ends early has none.
pub fn run_replay(setup: &TrialSetup, shutdown: &Shutdown) -> Result<ReplayOutcome, TrialError> {
    super::block_on(watch(setup, shutdown))
}

async fn watch(setup: &TrialSetup, shutdown: &Shutdown) -> Result<ReplayOutcome, TrialError> {
    not_interrupted(shutdown)?;
    let (node, mut launched) = start(setup)?;
    let mut objects: Inbox<TrackedObjects> =
        node.queue("/pose_tracker/objects", Qos::reliable(32), 256)?;
    let mut images: Inbox<CompressedImage> =
        node.queue("/camera/camera/color/image_raw/compressed", Qos::reliable(32), 256)?;
    let began = Instant::now();
    let mut shown: BTreeMap<Stamp, Instant> = BTreeMap::new();
    let mut outcome = ReplayOutcome::default();
    let mut over: Option<Instant> = None;
    loop {
        tokio::time::sleep(Duration::from_millis(2)).await;
        let now = Instant::now();
        while let Some(m) = images.try_recv() {
            shown.entry(tracked::stamp(&m.header)).or_insert(now);
        }
        while let Some(m) = objects.try_recv() {
            let stamp = tracked::stamp(&m.header);
            if let Some(at) = shown.get(&stamp) {
                outcome.delay_ms.entry(stamp).or_insert(1e3 * (now - *at).as_secs_f64());
            }
            outcome.objects.insert(stamp, m);
            over = over.map(|_| now);
        }
        for exit in launched.exited() {
            if exit.name == PLAYER && exit.code == Some(0) {
                over = Some(now);
            } else {
                outcome.exits.push(exit);
            }
        }
        let late = began.elapsed().as_secs_f64() > setup.patience;
        let over = over.is_some_and(|o| now - o > AFTER);
        if late || over || !outcome.exits.is_empty() || shutdown.is_requested() {
            break;
        }
    }
    launched.stop(Duration::from_secs(3));
    node.leave();
    not_interrupted(shutdown)?;
    Ok(outcome)
}
