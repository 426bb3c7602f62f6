//! Trouble while the arm moves: how long the arm goes on, what the operator is told, whether it goes on
//! afterwards.

use std::time::{Duration, Instant};
use tdv_geometry::Stamp;
use tdv_msgs::sensor_msgs::msg::JointState;

/// Joint speed (rad/s) above which the arm counts as moving well.
const MOVING: f64 = 0.15;
/// Joint speed (rad/s) below which it is at rest: a millimetre or two per second at the tool.
const REST: f64 = 0.01;
/// True joints farther apart than this (s) are no motion in between.
const GAP: f64 = 0.05;
/// An arm that stands for this long after the trouble needs the operator.
const STUCK: Duration = Duration::from_secs(6);
/// The operator tries so often.
const ATTEMPTS: u32 = 3;

/// What is done to the running graph.
#[derive(Debug, Clone, PartialEq)]
pub enum Trouble {
    /// A node dies (SIGKILL) and is started again.
    Kill(String),
    /// The connection between driver and robot is cut.
    CutRtde,
    /// The gripper's connection is cut.
    CutGripper,
    /// The robot is stopped for protection; the operator unlocks it.
    ProtectiveStop,
    /// The speed slider is moved to this fraction.
    SpeedSlider(f64),
}

impl Trouble {
    /// The killed node, or what was cut or moved.
    pub fn name(&self) -> &str {
        match self {
            Self::Kill(node) => node,
            Self::CutRtde => "rtde",
            Self::CutGripper => "gripper",
            Self::ProtectiveStop => "protective_stop",
            Self::SpeedSlider(_) => "speed_slider",
        }
    }
}

/// One trouble and when it comes.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultSetup {
    /// What it is.
    pub trouble: Trouble,
    /// It comes only while something is held.
    pub carrying: bool,
    /// The arm has to have moved well for so long (s); while it carries, where that is asked for.
    pub after: f64,
    /// It lasts for so long (s).
    pub lasts: f64,
}

impl FaultSetup {
    /// A node that dies once the arm has moved for 0.6 s, and stays dead for 1.2 s.
    pub fn kill(node: &str, carrying: bool) -> Self {
        Self { trouble: Trouble::Kill(node.into()), carrying, after: 0.6, lasts: 1.2 }
    }
}

/// What the trouble did.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultFigures {
    /// The killed node, or the name of the trouble.
    pub node: String,
    /// Fastest true joint (rad/s) when it began.
    pub speed: f64,
    /// Milliseconds from its beginning until the true joints were at rest and stayed so while it lasted;
    /// none: they did not.
    pub rest_ms: Option<f64>,
    /// How long it lasted, s.
    pub lasted: f64,
    /// Whether something was held when it began.
    pub carrying: bool,
    /// What the arm controller said meanwhile, or the driver if it was the controller that died.
    pub sentence: String,
    /// The arm moved again afterwards.
    pub went_on: bool,
    /// How often the operator had to help.
    pub helped: u32,
}

/// What is to be done to the graph.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Step {
    Wait,
    Begin,
    End,
    /// The operator helps, for the given time.
    Help(u32),
}

struct Begun {
    at: Instant,
    stamp: Stamp,
    carrying: bool,
}

/// Watches the true joints and picks the moments.
pub(super) struct FaultWatch {
    setup: FaultSetup,
    held: bool,
    done: bool,
    /// Seconds of good motion so far, and the last stamp.
    moved: f64,
    last: Option<Stamp>,
    speed: f64,
    begun: Option<Begun>,
    rest_since: Option<Stamp>,
    sentence: String,
    /// When it ended, or when the arm moved or was helped after that.
    over: Option<Instant>,
    lasted: f64,
    went_on: bool,
    helped: u32,
}

impl FaultWatch {
    pub fn new(setup: FaultSetup) -> Self {
        Self {
            setup,
            held: false,
            done: false,
            moved: 0.0,
            last: None,
            speed: 0.0,
            begun: None,
            rest_since: None,
            sentence: String::new(),
            over: None,
            lasted: 0.0,
            went_on: false,
            helped: 0,
        }
    }

    fn ready(&self) -> bool {
        self.held || !self.setup.carrying
    }

    /// The true joints, with the stamp of the graph's clock.
    pub fn joints(&mut self, message: &JointState, stamp: Stamp) {
        let fastest = message.velocity.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let step = self.last.replace(stamp).map_or(0.0, |last| stamp.since(last));
        match &self.begun {
            None => {
                self.speed = fastest;
                if fastest > MOVING && self.ready() && step < GAP {
                    self.moved += step.max(0.0);
                }
            }
            Some(_) if self.over.is_some() => {
                if fastest > MOVING {
                    self.went_on = true;
                    self.over = Some(Instant::now());
                }
            }
            Some(b) if fastest < REST && stamp >= b.stamp => {
                self.rest_since.get_or_insert(stamp);
            }
            Some(_) => self.rest_since = None,
        }
    }

    /// What the controller holds and whether it is done.
    pub fn status(&mut self, held: bool, done: bool) {
        (self.held, self.done) = (held, done);
    }

    /// A sentence that an operator could read now.
    pub fn sentence(&mut self, from: &str, sentence: &str) {
        let speaker = match &self.setup.trouble {
            Trouble::Kill(node) if node == "arm_controller" => "ur5_driver",
            _ => "arm_controller",
        };
        if self.begun.is_some() && self.over.is_none() && from == speaker {
            self.sentence = sentence.to_owned();
        }
    }

    /// What is due; `now` is the graph's clock.
    pub fn step(&mut self, now: Stamp) -> Step {
        match (&self.begun, self.over) {
            (None, _) => {
                if !self.ready() || self.moved <= self.setup.after || self.speed < MOVING {
                    return Step::Wait;
                }
                self.begun = Some(Begun { at: Instant::now(), stamp: now, carrying: self.held });
                Step::Begin
            }
            (Some(begun), None) if begun.at.elapsed().as_secs_f64() > self.setup.lasts => {
                self.lasted = begun.at.elapsed().as_secs_f64();
                self.over = Some(Instant::now());
                Step::End
            }
            (Some(_), Some(over)) => {
                if self.done || self.helped >= ATTEMPTS || over.elapsed() < STUCK {
                    return Step::Wait;
                }
                self.over = Some(Instant::now());
                self.helped += 1;
                Step::Help(self.helped)
            }
            _ => Step::Wait,
        }
    }

    /// What is done.
    pub fn trouble(&self) -> &Trouble {
        &self.setup.trouble
    }

    /// The figures; none when the arm never moved long enough.
    pub fn figures(&self) -> Option<FaultFigures> {
        let begun = self.begun.as_ref()?;
        Some(FaultFigures {
            node: self.setup.trouble.name().to_owned(),
            speed: self.speed,
            rest_ms: self.rest_since.map(|r| 1e3 * r.since(begun.stamp)),
            lasted: self.lasted,
            carrying: begun.carrying,
            sentence: self.sentence.clone(),
            went_on: self.went_on,
            helped: self.helped,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(speed: f64) -> JointState {
        JointState { velocity: vec![0.0, -speed], ..Default::default() }
    }

    fn moving(watch: &mut FaultWatch, from: f64, to: f64) -> f64 {
        let mut t = from;
        while t < to {
            watch.joints(&joints(0.5), Stamp::from_secs(t));
            t += 0.008;
        }
        t
    }

    #[test]
    fn rest_counts_from_the_beginning_and_only_if_it_lasts() {
        let mut watch = FaultWatch::new(FaultSetup::kill("pose_tracker", false));
        moving(&mut watch, 0.0, 0.5);
        assert_eq!(watch.step(Stamp::from_secs(0.5)), Step::Wait);
        moving(&mut watch, 0.5, 1.0);
        assert_eq!(watch.step(Stamp::from_secs(1.0)), Step::Begin);
        for (t, speed) in [(1.1, 0.4), (1.2, 0.001), (1.21, 0.2), (1.3, 0.002), (1.4, 0.0)] {
            watch.joints(&joints(speed), Stamp::from_secs(t));
        }
        watch.sentence("arm_controller", "poses are stale");
        watch.sentence("ur5_driver", "not the one to ask");
        let f = watch.figures().unwrap();
        assert!((f.rest_ms.unwrap() - 300.0).abs() < 1e-6);
        assert_eq!((f.sentence.as_str(), f.speed, f.went_on), ("poses are stale", 0.5, false));
    }

    #[test]
    fn an_arm_at_rest_or_with_empty_fingers_is_left_alone() {
        let mut watch = FaultWatch::new(FaultSetup::kill("ur5_driver", false));
        let t = moving(&mut watch, 0.0, 1.0);
        watch.joints(&joints(0.0), Stamp::from_secs(t));
        assert_eq!(watch.step(Stamp::from_secs(t)), Step::Wait);
        assert!(watch.figures().is_none());
        let mut watch = FaultWatch::new(FaultSetup::kill("ur5_driver", true));
        let t = moving(&mut watch, 0.0, 2.0);
        assert_eq!(watch.step(Stamp::from_secs(t)), Step::Wait);
        // Only the motion with something in hand counts.
        watch.status(true, false);
        let t = moving(&mut watch, t, t + 0.5);
        assert_eq!(watch.step(Stamp::from_secs(t)), Step::Wait);
        let t = moving(&mut watch, t, t + 0.2);
        assert_eq!(watch.step(Stamp::from_secs(t)), Step::Begin);
        assert!(watch.figures().unwrap().carrying);
    }

    #[test]
    fn the_operator_helps_an_arm_that_stands_and_no_other() {
        let setup = FaultSetup { lasts: 0.0, ..FaultSetup::kill("switch_policy", false) };
        let mut watch = FaultWatch::new(setup);
        let t = Stamp::from_secs(moving(&mut watch, 0.0, 1.0));
        assert_eq!(watch.step(t), Step::Begin);
        std::thread::sleep(Duration::from_millis(1));
        assert_eq!(watch.step(t), Step::End);
        assert_eq!(watch.step(t), Step::Wait);
        let long_ago = || Instant::now().checked_sub(STUCK + Duration::from_secs(1));
        for n in 1..=ATTEMPTS {
            watch.over = long_ago();
            assert_eq!(watch.step(t), Step::Help(n));
            assert_eq!(watch.step(t), Step::Wait);
        }
        watch.over = long_ago();
        assert_eq!(watch.step(t), Step::Wait);
        watch.joints(&joints(0.5), t);
        assert!(watch.figures().unwrap().went_on);
    }
}
