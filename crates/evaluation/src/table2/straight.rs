//! The baseline without learning: from where the moving frame is straight to where the procedure ends,
//! with the speed of a minimum-jerk motion.

use super::Table2Error;
use tdv_demonstration::Demonstration;
use tdv_geometry::{Pose, min_jerk, pose_distance};
use tdv_policy::Observation;

/// Mean speeds: m/s and rad/s. The highest of a minimum-jerk motion is 1.875 times the mean.
const SPEED: (f64, f64) = (0.11, 0.4);
/// Metres that a radian counts for.
const LEVER: f64 = 0.1;
/// Farther than this from the line (m) it starts anew from where it is.
const OFF: f64 = 0.03;
/// The motion is taken to have begun: at the very start a minimum-jerk motion stands still.
const BEGUN: f64 = 0.06;
/// Parts into which the line is cut to find how far the motion has come.
const PARTS: usize = 100;

struct Line {
    procedure: usize,
    from: Pose,
    /// s.
    duration: f64,
    at: f64,
}

pub(super) struct StraightLine {
    ends: Vec<Pose>,
    horizon: usize,
    dt: f64,
    line: Option<Line>,
}

impl StraightLine {
    pub fn new(demonstration: &Demonstration, horizon: usize, dt: f64) -> Self {
        let ends = demonstration.procedures.iter().map(|p| p.goal()).collect();
        Self { ends, horizon, dt, line: None }
    }

    /// The canonical poses that follow.
    pub fn plan(&mut self, seen: &Observation) -> Result<Vec<Pose>, Table2Error> {
        let now = seen.canonical_pose();
        let end = *self.ends.get(seen.procedure).ok_or(Table2Error::Procedure(seen.procedure))?;
        let from_line = |line: &Line, u: f64| {
            let (d, a) = pose_distance(&min_jerk(&line.from, &end, u), &now);
            d + LEVER * a
        };
        let nearest = self.line.as_ref().and_then(|line| {
            (0..=PARTS / 4)
                .map(|k| (line.at + k as f64 / PARTS as f64).min(1.0))
                .min_by(|a, b| from_line(line, *a).total_cmp(&from_line(line, *b)))
        });
        if let (Some(line), Some(nearest)) = (&mut self.line, nearest) {
            line.at = nearest;
        }
        let stray = |line: &Line| {
            let nearest = min_jerk(&line.from, &end, line.at);
            line.procedure != seen.procedure || pose_distance(&nearest, &now).0 > OFF
        };
        if self.line.as_ref().is_none_or(stray) {
            let (d, a) = pose_distance(&now, &end);
            let duration = (d / SPEED.0).max(a / SPEED.1).max(0.2);
            self.line = Some(Line { procedure: seen.procedure, from: now, duration, at: BEGUN });
        }
        let Some(line) = &self.line else { return Ok(Vec::new()) };
        let at = |k: usize| line.at + k as f64 * self.dt / line.duration;
        Ok((1..=self.horizon).map(|k| min_jerk(&line.from, &end, at(k))).collect())
    }
}
