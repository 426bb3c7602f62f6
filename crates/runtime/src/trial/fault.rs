//! A node is killed while the arm moves: how long the arm goes on, what the operator is told.

use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::JointState;

/// Joint speed (rad/s) above which the arm counts as moving well.
const MOVING: f64 = 0.15;
/// Joint speed (rad/s) below which it is at rest: a millimetre or two per second at the tool.
const REST: f64 = 0.01;
/// The arm has moved for so long when the node is killed.
const SETTLED: Duration = Duration::from_millis(600);
/// The node stays dead for so long.
const DEAD: Duration = Duration::from_millis(1200);

/// What a kill did.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultFigures {
    /// The killed node.
    pub node: String,
    /// Fastest true joint (rad/s) when it was killed.
    pub speed: f64,
    /// Milliseconds from the kill until the true joints were at rest and stayed so; none: they did not.
    pub rest_ms: Option<f64>,
    /// What the arm controller said while the node was dead, or the driver if it was the controller.
    pub sentence: String,
}

/// What is to be done to the graph.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Step {
    Wait,
    Kill,
    Restart,
}

/// Watches the true joints and picks the moments.
pub(super) struct FaultWatch {
    node: String,
    /// Kill only while something is held.
    carrying: bool,
    held: bool,
    moving_since: Option<Instant>,
    speed: f64,
    killed: Option<(Instant, Stamp)>,
    rest_since: Option<Stamp>,
    sentence: String,
    over: bool,
}

impl FaultWatch {
    pub fn new(node: String, carrying: bool) -> Self {
        Self {
            node,
            carrying,
            held: false,
            moving_since: None,
            speed: 0.0,
            killed: None,
            rest_since: None,
            sentence: String::new(),
            over: false,
        }
    }

    /// The true joints, with the stamp of the graph's clock.
    pub fn joints(&mut self, message: &JointState, stamp: Stamp) {
        let fastest = message.velocity.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        match self.killed {
            None => {
                self.speed = fastest;
                if fastest < MOVING {
                    self.moving_since = None;
                } else {
                    self.moving_since.get_or_insert_with(Instant::now);
                }
            }
            Some(_) if self.over => {}
            Some((_, killed)) if fastest < REST && stamp >= killed => {
                self.rest_since.get_or_insert(stamp);
            }
            Some(_) => self.rest_since = None,
        }
    }

    /// Whether the controller holds something.
    pub fn held(&mut self, held: bool) {
        self.held = held;
    }

    /// A sentence that an operator could read now.
    pub fn sentence(&mut self, from: &str, sentence: &str) {
        let speaker = if self.node == "arm_controller" { "ur5_driver" } else { "arm_controller" };
        if self.killed.is_some() && !self.over && from == speaker {
            self.sentence = sentence.to_owned();
        }
    }

    /// What is due; `now` is the graph's clock.
    pub fn step(&mut self, now: Stamp) -> Step {
        match self.killed {
            None if self.carrying && !self.held => Step::Wait,
            None if self.moving_since.is_some_and(|t| t.elapsed() > SETTLED) => {
                self.killed = Some((Instant::now(), now));
                Step::Kill
            }
            Some((at, _)) if !self.over && at.elapsed() > DEAD => {
                self.over = true;
                Step::Restart
            }
            _ => Step::Wait,
        }
    }

    /// The name of the node.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// The figures; none when the arm never moved long enough.
    pub fn figures(&self) -> Option<FaultFigures> {
        let (_, killed) = self.killed?;
        Some(FaultFigures {
            node: self.node.clone(),
            speed: self.speed,
            rest_ms: self.rest_since.map(|r| 1e3 * r.since(killed)),
            sentence: self.sentence.clone(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(speed: f64) -> JointState {
        JointState { velocity: vec![0.0, -speed], ..Default::default() }
    }

    #[test]
    fn rest_counts_from_the_kill_and_only_if_it_lasts() {
        let mut watch = FaultWatch::new("pose_tracker".into(), false);
        watch.joints(&joints(0.5), Stamp::from_secs(1.0));
        watch.moving_since = Instant::now().checked_sub(Duration::from_secs(1));
        assert_eq!(watch.step(Stamp::from_secs(1.0)), Step::Kill);
        for (t, speed) in [(1.1, 0.4), (1.2, 0.001), (1.21, 0.2), (1.3, 0.002), (1.4, 0.0)] {
            watch.joints(&joints(speed), Stamp::from_secs(t));
        }
        watch.sentence("arm_controller", "poses are stale");
        watch.sentence("ur5_driver", "not the one to ask");
        let f = watch.figures().unwrap();
        assert!((f.rest_ms.unwrap() - 300.0).abs() < 1e-6);
        assert_eq!(f.sentence, "poses are stale");
        assert_eq!(f.speed, 0.5);
    }

    #[test]
    fn an_arm_at_rest_is_not_killed() {
        let mut watch = FaultWatch::new("ur5_driver".into(), false);
        watch.joints(&joints(0.5), Stamp::from_secs(1.0));
        watch.joints(&joints(0.0), Stamp::from_secs(1.1));
        assert_eq!(watch.step(Stamp::from_secs(1.1)), Step::Wait);
        assert!(watch.figures().is_none());
    }
}
