//! State, hysteresis and light filtering of one object.

use super::ObjectsConfig;
use nalgebra::Matrix6;
use tdv_geometry::{Pose, Stamp, interpolate, pose_distance};

/// State of an object; the numbers are those of `tdv_msgs/TrackedObject`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum ObjectState {
    /// Not yet seen consistently.
    #[default]
    Init = 0,
    /// Seen now.
    Tracking = 1,
    /// Not seen now; the last pose stands.
    Occluded = 2,
    /// In the gripper: the pose follows the tool.
    Held = 3,
    /// Not seen for too long.
    Lost = 4,
}

impl ObjectState {
    /// A sentence for the operator.
    pub fn sentence(self) -> &'static str {
        match self {
            Self::Init => "waiting for a first consistent pose",
            Self::Tracking => "tracked",
            Self::Occluded => "not seen now, holding its last pose",
            Self::Held => "held by the gripper, moving with it",
            Self::Lost => "lost: its pose is not valid",
        }
    }
}

/// A detection in the base frame.
#[derive(Debug, Clone)]
pub(crate) struct Observation {
    pub pose: Pose,
    pub confidence: f64,
    pub covariance: Matrix6<f64>,
}

#[derive(Debug, Clone)]
pub(crate) struct Track {
    pub state: ObjectState,
    pub covariance: Matrix6<f64>,
    pub note: String,
    pose: Option<Pose>,
    confidence: f64,
    last_seen: Option<Stamp>,
    /// A pose that is not believed yet, and how often it was confirmed.
    candidate: Option<(Pose, u32)>,
}

impl Default for Track {
    fn default() -> Self {
        Self {
            state: ObjectState::Init,
            covariance: Matrix6::identity(),
            note: String::new(),
            pose: None,
            confidence: 0.0,
            last_seen: None,
            candidate: None,
        }
    }
}

impl Track {
    /// The pose (base frame); none before the end of INIT.
    pub fn pose(&self) -> Option<Pose> {
        self.pose
    }

    pub fn confidence(&self) -> f64 {
        if matches!(self.state, ObjectState::Init | ObjectState::Lost) {
            0.0
        } else {
            self.confidence
        }
    }

    /// A frame in which the object is not held.
    pub fn observe(&mut self, stamp: Stamp, seen: Option<&Observation>, config: &ObjectsConfig) {
        self.note.clear();
        let threshold =
            if self.state == ObjectState::Tracking { config.reject } else { config.accept };
        match seen.filter(|s| s.confidence >= threshold) {
            Some(s) => self.believe(stamp, s, config),
            None => self.miss(stamp, config),
        }
    }

    fn believe(&mut self, stamp: Stamp, seen: &Observation, config: &ObjectsConfig) {
        let near = |a: &Pose, b: &Pose| {
            let (d, r) = pose_distance(a, b);
            d < config.jump && r < config.turn
        };
        let settled = matches!(self.state, ObjectState::Tracking | ObjectState::Occluded);
        match self.pose.filter(|p| settled && near(p, &seen.pose)) {
            Some(last) => {
                let (d, r) = pose_distance(&last, &seen.pose);
                // Small differences are noise and are averaged; a moving object is followed at once.
                let part = (config.smoothing + d / 0.012 + r / 0.15).min(1.0);
                self.pose = Some(interpolate(&last, &seen.pose, part));
                self.candidate = None;
            }
            None => {
                let count = match &self.candidate {
                    Some((p, n)) if near(p, &seen.pose) => n + 1,
                    _ => 1,
                };
                self.candidate = Some((seen.pose, count));
                if count < config.init_frames {
                    if settled {
                        self.note = "jumped: waiting for confirmation".into();
                    }
                    self.age(stamp, config);
                    return;
                }
                self.pose = Some(seen.pose);
                self.candidate = None;
            }
        }
        self.state = ObjectState::Tracking;
        self.confidence = seen.confidence;
        self.covariance = seen.covariance;
        self.last_seen = Some(stamp);
    }

    fn miss(&mut self, stamp: Stamp, config: &ObjectsConfig) {
        if self.state == ObjectState::Init {
            self.candidate = None;
        }
        self.age(stamp, config);
    }

    fn age(&mut self, stamp: Stamp, config: &ObjectsConfig) {
        let Some(last) = self.last_seen else { return };
        let gap = stamp.since(last);
        match self.state {
            ObjectState::Tracking | ObjectState::Held if gap > config.occluded_after => {
                self.state = ObjectState::Occluded;
            }
            ObjectState::Occluded if gap > config.lost_after => {
                self.state = ObjectState::Lost;
                self.candidate = None;
            }
            _ => {}
        }
        if self.state == ObjectState::Occluded {
            // Fades to nothing by the time it counts as lost.
            self.confidence = (0.5 * (1.0 - gap / config.lost_after)).clamp(0.0, self.confidence);
            self.note = format!("not seen for {gap:.1} s");
        } else if self.state == ObjectState::Lost {
            self.note = format!("lost for {gap:.1} s");
        }
    }

    /// A frame in which the object is in the gripper, at `pose`.
    pub fn hold(&mut self, stamp: Stamp, pose: &Pose, seen: Option<&Observation>) {
        self.note.clear();
        self.state = ObjectState::Held;
        self.pose = Some(*pose);
        self.candidate = None;
        self.last_seen = Some(stamp);
        self.confidence = seen.map_or(0.8, |s| s.confidence.max(0.8));
        if let Some(s) = seen {
            self.covariance = s.covariance;
        }
    }

    /// The gripper let go: the last pose stands until the object is seen again.
    pub fn release(&mut self, stamp: Stamp) {
        if self.pose.is_some() {
            self.state = ObjectState::Occluded;
            self.last_seen = Some(stamp);
        }
        self.candidate = None;
    }
}
