//! A demonstration as a small table of phases: where the grasp goes and when the hand closes and opens.

use crate::avatar::{GraspFit, HandPose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, smooth_step};

/// What the fingers do in a phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Grip {
    /// They stay as they are.
    #[default]
    Keep,
    /// They close; at the end of the phase the object is held.
    Close,
    /// They open; from the beginning of the phase the object is let go.
    Open,
}

/// One phase: a minimum-jerk motion to a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    /// `T_base_grasp` at its end: the frame of the [`crate::avatar::GraspTarget`], whether it is held or
    /// not.
    pub to: Pose,
    /// How long it takes (s).
    pub seconds: f64,
    /// How long before the end of the phase before it begins (s): rounds the corner.
    pub overlap: f64,
    /// What the fingers do.
    pub grip: Grip,
}

/// The whole table.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// `T_base_grasp` at the beginning.
    pub from: Pose,
    /// The phases in their order.
    pub phases: Vec<Phase>,
    /// `T_object_grasp`: how the grasp's frame sits in the object that is held.
    pub hold: Pose,
    /// Something leads the object while it is held: no small motions of the hand are seen in it.
    pub guided: bool,
}

impl Script {
    /// An empty table.
    pub fn new(from: Pose, hold: Pose) -> Self {
        Self { from, phases: Vec::new(), hold, guided: false }
    }

    /// One more phase.
    #[must_use]
    pub fn then(mut self, to: Pose, seconds: f64, overlap: f64) -> Self {
        self.phases.push(Phase { to, seconds, overlap, grip: Grip::Keep });
        self
    }

    /// The fingers close or open where the hand is.
    #[must_use]
    pub fn grip(mut self, grip: Grip, seconds: f64) -> Self {
        let to = self.phases.last().map_or(self.from, |p| p.to);
        self.phases.push(Phase { to, seconds, overlap: 0.0, grip });
        self
    }

    /// The hand stays.
    #[must_use]
    pub fn dwell(self, seconds: f64) -> Self {
        self.grip(Grip::Keep, seconds)
    }

    /// What makes no sense about it, if anything.
    pub fn problem(&self) -> Option<String> {
        if !self.phases.iter().any(|p| p.grip == Grip::Close) {
            return Some("has no phase in which the hand closes".into());
        }
        let times_ok = |p: &Phase| {
            p.seconds > 0.05 && p.seconds < 60.0 && (0.0..p.seconds).contains(&p.overlap)
        };
        if let Some(k) = self.phases.iter().position(|p| !times_ok(p)) {
            return Some(format!(
                "phase {k} needs 0.05 to 60 s and an overlap shorter than itself"
            ));
        }
        let finite = |p: &Pose| p.translation.vector.iter().all(|v| v.is_finite() && v.abs() < 5.0);
        let all = self.phases.iter().map(|p| &p.to).chain([&self.from, &self.hold]);
        let bad = all.into_iter().position(|p| !finite(p));
        bad.map(|k| format!("pose {k} is not finite or beyond 5 m"))
    }

    /// When each phase begins and ends (s).
    fn spans(&self) -> Vec<[f64; 2]> {
        let mut end = 0.4;
        let mut out = Vec::with_capacity(self.phases.len());
        for p in &self.phases {
            let begin = end - p.overlap;
            end = begin + p.seconds;
            out.push([begin, end]);
        }
        out
    }

    /// How long it takes, with a moment of rest at the end (s).
    pub fn duration(&self) -> f64 {
        self.spans().last().map_or(0.0, |s| s[1]) + 0.4
    }

    /// When the object begins to be held and when it is let go (s; for ever if it is not).
    pub fn held(&self) -> [f64; 2] {
        let spans = self.spans();
        let at = |grip| self.phases.iter().position(|p| p.grip == grip);
        let begin = at(Grip::Close).map_or(f64::INFINITY, |k| spans[k][1]);
        let end = at(Grip::Open).map_or(f64::INFINITY, |k| spans[k][0]);
        [begin, end]
    }

    /// `T_base_grasp` at time `t` (s). `sway` (m, rad) is added while the object is held freely.
    fn grasp(&self, t: f64, sway: (Vector3<f64>, Vector3<f64>)) -> Pose {
        let mut at = self.from;
        let mut before = self.from;
        for (p, span) in self.phases.iter().zip(self.spans()) {
            let f = channel(t, span);
            let by = p.to.translation.vector - before.translation.vector;
            let turn = (before.rotation.inverse() * p.to.rotation).scaled_axis();
            at = Pose::from_parts(
                Translation3::from(at.translation.vector + by * f),
                at.rotation * UnitQuaternion::from_scaled_axis(turn * f),
            );
            before = p.to;
        }
        let [begin, end] = self.held();
        if self.guided || t <= begin || t >= end {
            return at;
        }
        // It fades out before the object is let go, so that nothing jumps.
        let share = smooth_step((t - begin) / 0.5) * smooth_step((end - t) / 0.5);
        Pose::from_parts(
            Translation3::from(at.translation.vector + sway.0 * share),
            UnitQuaternion::from_scaled_axis(sway.1 * share) * at.rotation,
        )
    }

    /// Hand, pose of the held object (that starts at `start`) and contact at time `t` (s).
    pub(super) fn state(
        &self,
        t: f64,
        start: &Pose,
        fit: &GraspFit,
        sway: (Vector3<f64>, Vector3<f64>),
    ) -> (HandPose, Pose, bool) {
        let [begin, end] = self.held();
        let at = self.grasp(t, sway);
        let object =
            if t < begin { *start } else { self.grasp(t.min(end), sway) * self.hold.inverse() };
        let spans = self.spans();
        let sum = |grip| -> f64 {
            let of = self.phases.iter().zip(&spans).filter(|(p, _)| p.grip == grip);
            of.map(|(_, s)| channel(t, *s)).sum()
        };
        let bend = (sum(Grip::Close) - sum(Grip::Open)).clamp(0.0, 1.0);
        let ready = spans.first().map_or(1.0, |s| channel(t, *s));
        let mut hand =
            HandPose::relaxed(Pose::identity()).blend(&fit.open, ready).blend(&fit.closed, bend);
        // At home the hand is turned and tilted as a resting arm would have it.
        let rest = UnitQuaternion::from_scaled_axis(Vector3::new(0.35, 0.1, 0.25) * (1.0 - ready));
        let palm = at * fit.closed.palm;
        hand.palm = Pose::from_parts(palm.translation, rest * palm.rotation);
        (hand, object, (begin..end).contains(&t))
    }
}

/// 0 before the span, 1 after it, minimum jerk between.
fn channel(t: f64, span: [f64; 2]) -> f64 {
    smooth_step((t - span[0]) / (span[1] - span[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_distance;

    #[test]
    fn phases_reach_their_poses_and_corners_are_rounded() {
        let p = |x: f64, z: f64| Pose::translation(x, 0.0, z);
        let tilted = p(0.2, 0.1) * Pose::rotation(Vector3::new(0.0, -1.8, 0.0));
        let s = Script::new(p(0.0, 0.3), Pose::identity())
            .then(p(0.0, 0.0), 1.0, 0.0)
            .grip(Grip::Close, 0.4)
            .then(p(0.0, 0.1), 1.0, 0.0)
            .then(tilted, 2.0, 0.3)
            .dwell(1.0);
        assert!(s.problem().is_none());
        let none = (Vector3::zeros(), Vector3::zeros());
        let (d, a) = pose_distance(&s.grasp(s.duration(), none), &tilted);
        assert!(d < 1e-9 && a < 1e-9, "{d} {a}");
        assert_eq!(s.held()[1], f64::INFINITY);
        let (d, _) = pose_distance(&s.grasp(s.held()[0], none), &p(0.0, 0.0));
        assert!(d < 1e-9);
        let speed = |t: f64| pose_distance(&s.grasp(t + 1e-3, none), &s.grasp(t, none)).0 / 1e-3;
        let fastest = (0..5000).map(|k| speed(f64::from(k) * 1e-3)).fold(0.0, f64::max);
        assert!(fastest < 0.6, "{fastest} m/s");
        let mut bad = s.clone();
        bad.phases[0].overlap = 3.0;
        assert!(bad.problem().unwrap().contains("phase 0"));
        bad.phases.clear();
        assert!(bad.problem().unwrap().contains("closes"));
    }
}
