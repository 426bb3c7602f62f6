//! The campaign on the running graph: which trouble comes when, and whether the true motion broke a
//! limit. What is done to the processes is the caller's.

use super::FaultKind;
use crate::MotionSample;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_robot::{Kinematics, Limits};

/// Share of a limit by which the robot's own motion may exceed it: the servo's filter.
const ROOM: f64 = 1.15;
/// Joint acceleration (rad/s^2) over a sample that counts as a jolt; the robot's servo allows 20.
const JOLT: f64 = 25.0;
/// Samples farther apart than this (s) are not compared.
const GAP: f64 = 0.012;
/// The servo program's patience with a silent driver, s.
const SILENCE: f64 = 0.1;
/// Deceleration of the robot's stops, rad/s^2.
const DECELERATION: f64 = 10.0;
/// What a stop of the robot takes besides, s: the lag of its servo (34 ms), two cycles of 8 ms.
const SERVO: f64 = 0.05;
/// From the request to the lab until it acts (s), one service call on a loaded machine.
const CALL: f64 = 0.05;

/// One trouble of the live campaign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LiveFault {
    /// Its kind, one of [`FaultKind::LIVE`].
    pub kind: FaultKind,
    /// While the object is carried, or on the way to it.
    pub carrying: bool,
    /// The arm has to have moved well for this long before, in that phase, s.
    pub after: f64,
    /// How long it lasts, s.
    pub lasts: f64,
}

impl LiveFault {
    /// The trouble of case `index` with its `seed`. The kinds take turns, first all on the way to the
    /// object, then all while it is carried; the rest is drawn.
    pub fn draw(index: u64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x11fe_fa17);
        let kinds = FaultKind::LIVE.len() as u64;
        let kind = FaultKind::LIVE[(index % kinds) as usize];
        let after = rng.random_range(0.2..1.4);
        let lasts = match kind {
            // As long as the robot insists on before it can be unlocked.
            FaultKind::ProtectiveStop => 5.5,
            _ => rng.random_range(0.9..2.5),
        };
        Self { kind, carrying: index / kinds % 2 == 1, after, lasts }
    }

    /// The time (s) within which an arm at `speed` (rad/s) has to rest; none where it may go on.
    ///
    /// What only the servo program notices acts within its patience and the way to stop; a protective
    /// stop at once; all else within 350 ms of the last good observation, which is no later than the
    /// beginning of the trouble.
    pub fn rest_due(&self, speed: f64) -> Option<f64> {
        let stop = speed / DECELERATION + SERVO;
        match self.kind {
            FaultKind::DriverKilled => Some(SILENCE + stop),
            FaultKind::RtdeCut => Some(CALL + SILENCE + stop),
            FaultKind::ProtectiveStop => Some(CALL + stop),
            kind => kind.rest_due(),
        }
    }
}

/// Limits that the true motion broke, each once. A sample that was lost hides at most 12 ms.
pub fn judge_motion(samples: &[MotionSample], limits: &Limits, arm: &Kinematics) -> Vec<String> {
    let mut broken: Vec<String> = Vec::new();
    let mut say = |what: String| {
        let words = |s: &str| s.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
        if broken.iter().all(|b| words(b) != words(&what)) {
            broken.push(what);
        }
    };
    for s in samples {
        for i in 0..6 {
            if s.qd[i].abs() > ROOM * limits.joint_velocity {
                say(format!("joint at {:.2} rad/s", s.qd[i].abs()));
            }
            if s.q[i] < limits.joint_lower[i] || s.q[i] > limits.joint_upper[i] {
                say(format!("joint out of range: {:.2} rad", s.q[i]));
            }
        }
        let (speed, _) = arm.tcp_speed(&s.q, &s.qd);
        if speed > ROOM * limits.tcp_speed {
            say(format!("tcp at {speed:.3} m/s"));
        }
    }
    for w in samples.windows(2) {
        let dt = w[1].stamp.since(w[0].stamp);
        if dt <= 0.0 || dt > GAP {
            continue;
        }
        let jolt = (0..6).map(|i| (w[1].qd[i] - w[0].qd[i]).abs() / dt).fold(0.0, f64::max);
        if jolt > JOLT {
            say(format!("joint accelerates by {jolt:.0} rad/s^2"));
        }
    }
    broken
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use tdv_geometry::Stamp;

    #[test]
    fn forty_cases_have_every_kind_in_both_phases_and_the_same_again() {
        let all: Vec<LiveFault> = (0..40).map(|i| LiveFault::draw(i, 1 + i)).collect();
        let kinds: BTreeSet<(FaultKind, bool)> = all.iter().map(|f| (f.kind, f.carrying)).collect();
        assert_eq!(kinds.len(), 2 * FaultKind::LIVE.len());
        assert!(all.iter().enumerate().all(|(i, f)| *f == LiveFault::draw(i as u64, 1 + i as u64)));
        // Long enough that the arm has to rest meanwhile.
        for f in &all {
            assert!(f.rest_due(1.0).is_none_or(|due| due + 0.04 < f.lasts), "{f:?}");
        }
        let due = |kind| LiveFault { kind, ..all[0] }.rest_due(0.5);
        assert_eq!(due(FaultKind::TrackerKilled), Some(0.35));
        assert!((due(FaultKind::DriverKilled).unwrap() - 0.2).abs() < 1e-9);
        assert_eq!(due(FaultKind::SpeedSlider), None);
    }

    #[test]
    fn broken_limits_are_said_once_and_good_motion_is_not() {
        let limits = Limits::default();
        let arm = Kinematics::ur5();
        let home = [-0.28, -1.79, 1.59, -1.37, -1.57, -1.85];
        let sample = |k: i64, speed: f64| {
            let mut q = home;
            q[5] += 0.008 * speed * k as f64;
            let stamp = Stamp(k * 8_000_000);
            MotionSample { stamp, q, qd: [0.0, 0.0, 0.0, 0.0, 0.0, speed] }
        };
        let good: Vec<_> = (0..50).map(|k| sample(k, 0.9)).collect();
        assert!(judge_motion(&good, &limits, &arm).is_empty());
        let fast: Vec<_> = (0..50).map(|k| sample(k, 1.2 * limits.joint_velocity)).collect();
        assert_eq!(judge_motion(&fast, &limits, &arm).len(), 1);
        let mut jolt = good.clone();
        jolt[20].qd[5] = 0.6;
        assert!(judge_motion(&jolt, &limits, &arm)[0].contains("accelerates"));
        // The same step over a gap in the recording is none.
        jolt.drain(21..25);
        jolt.drain(16..20);
        assert!(judge_motion(&jolt, &limits, &arm).is_empty());
        let mut far = good;
        far[3].q[2] = 1.01 * limits.joint_upper[2];
        assert!(judge_motion(&far, &limits, &arm)[0].contains("out of range"));
    }
}
