//! Latency of each stage, measured by one observer's clock.

use std::collections::{BTreeMap, HashMap};
use std::time::{Instant, SystemTime, UNIX_EPOCH};
use tdv_geometry::Stamp;

/// Arrival times of poses, plans and commands at the observer.
#[derive(Default)]
pub struct StageClock {
    poses: HashMap<Stamp, Instant>,
    /// A plan that no command has followed yet.
    waiting: Option<Instant>,
    samples: BTreeMap<String, Vec<f64>>,
}

/// Poses that wait for their plan at most.
const REMEMBERED: usize = 256;

fn now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp(since.as_nanos() as i64)
}

impl StageClock {
    fn add(&mut self, stage: &str, seconds: f64) {
        self.samples.entry(stage.to_owned()).or_default().push(1e3 * seconds);
    }

    /// Poses of the image with this stamp have come.
    pub fn pose(&mut self, stamp: Stamp, at: Instant) {
        self.add("image_to_pose", now().since(stamp));
        if self.poses.len() >= REMEMBERED {
            self.poses.clear();
        }
        self.poses.insert(stamp, at);
    }

    /// A plan made from the poses with this stamp has come.
    pub fn plan(&mut self, stamp: Stamp, at: Instant) {
        if let Some(pose) = self.poses.remove(&stamp) {
            self.add("pose_to_plan", (at - pose).as_secs_f64());
        }
        self.waiting.get_or_insert(at);
    }

    /// A joint command has come. Commands flow at twice the rate of the plans; the first one after a plan
    /// counts, and none when the arm was at rest for so long that it cannot be the answer.
    pub fn command(&mut self, at: Instant) {
        if let Some(plan) = self.waiting.take() {
            let seconds = (at - plan).as_secs_f64();
            if seconds < 0.1 {
                self.add("plan_to_command", seconds);
            }
        }
    }

    /// Milliseconds by stage.
    pub fn into_samples(self) -> BTreeMap<String, Vec<f64>> {
        self.samples
    }
}
