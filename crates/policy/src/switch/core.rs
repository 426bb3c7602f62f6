//! The machine that owns the procedure number.

use crate::PolicyError;
use crate::history::STEP_BACK;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, Stamp, pose_distance};

/// A switch is only believed near the place where the demonstrations end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwitchGuard {
    /// End pose of every procedure, `T_reference_moving`.
    pub end_poses: Vec<Pose>,
    /// Largest distance (m).
    pub position: f64,
    /// Largest rotation (rad); at least pi for objects whose rotation does not matter.
    pub rotation: f64,
}

/// Settings of a [`SwitchCore`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwitchConfig {
    /// Probability above which an observation counts.
    pub threshold: f32,
    /// Observations in a row that must count.
    pub consecutive: usize,
    /// Geometric condition, if any.
    pub guard: Option<SwitchGuard>,
    /// A procedure that takes longer (s) is reported.
    pub timeout: Option<f64>,
}

impl Default for SwitchConfig {
    fn default() -> Self {
        Self { threshold: 0.8, consecutive: 3, guard: None, timeout: None }
    }
}

/// What the machine says after an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SwitchState {
    /// The procedure that is on; the last one stays when the task is complete.
    pub procedure: usize,
    /// Procedures of the task.
    pub count: usize,
    /// Probability of the last observation.
    pub probability: f32,
    /// This observation ended a procedure.
    pub switched: bool,
    /// The last procedure is done.
    pub complete: bool,
    /// The procedure takes longer than allowed.
    pub timed_out: bool,
    /// The classifier says done, the guard says the pose is too far from the end.
    pub guarded: bool,
}

/// Hysteresis, guard and time-out around the classifier's probabilities.
#[derive(Debug, Clone)]
pub struct SwitchCore {
    config: SwitchConfig,
    state: SwitchState,
    streak: usize,
    began: Option<Stamp>,
    last: Option<Stamp>,
}

impl SwitchCore {
    /// Starts at procedure 0 of `count`.
    ///
    /// # Errors
    /// [`PolicyError::Config`] naming every bad setting.
    pub fn new(count: usize, config: SwitchConfig) -> Result<Self, PolicyError> {
        let mut problems = Vec::new();
        if count == 0 {
            problems.push("a task needs at least one procedure".to_string());
        }
        if !(config.threshold > 0.0 && config.threshold < 1.0) {
            problems.push(format!("threshold is {}, must be within 0..1", config.threshold));
        }
        if config.consecutive == 0 {
            problems.push("consecutive is 0, must be at least 1".into());
        }
        if let Some(t) = config.timeout
            && !(t.is_finite() && t > 0.0)
        {
            problems.push(format!("timeout is {t} s, must be positive"));
        }
        if let Some(g) = &config.guard {
            if g.end_poses.len() != count {
                let n = g.end_poses.len();
                problems.push(format!("the guard has {n} end poses for {count} procedures"));
            }
            if !(g.position > 0.0 && g.rotation > 0.0) {
                problems.push(format!(
                    "guard limits {} m and {} rad must be positive",
                    g.position, g.rotation
                ));
            }
        }
        if !problems.is_empty() {
            return Err(PolicyError::Config { problems });
        }
        let state = SwitchState {
            procedure: 0,
            count,
            probability: 0.0,
            switched: false,
            complete: false,
            timed_out: false,
            guarded: false,
        };
        Ok(Self { config, state, streak: 0, began: None, last: None })
    }

    /// The state after the last observation.
    pub fn state(&self) -> SwitchState {
        self.state
    }

    /// The procedure that is on.
    pub fn procedure(&self) -> usize {
        self.state.procedure
    }

    /// Takes the probability for the current procedure and the pose that it was computed from. An
    /// observation that is not newer than the last one, or not a number, counts for nothing. Stamps that
    /// step back by more than half a second are a stream that starts over: the procedure stays, its
    /// time-out and the observations in a row start anew.
    pub fn step(&mut self, now: Stamp, probability: f32, pose: &Pose) -> SwitchState {
        self.state.switched = false;
        if !probability.is_finite() {
            return self.state;
        }
        if let Some(last) = self.last.filter(|last| now <= *last) {
            if last.since(now) <= STEP_BACK {
                return self.state;
            }
            self.streak = 0;
            self.began = None;
        }
        self.last = Some(now);
        let began = *self.began.get_or_insert(now);
        self.state.probability = probability;
        if self.state.complete {
            return self.state;
        }
        self.state.timed_out = self.config.timeout.is_some_and(|t| now.since(began) > t);
        let likely = probability > self.config.threshold;
        self.state.guarded = likely && !self.near_end(pose);
        self.streak = if likely && !self.state.guarded { self.streak + 1 } else { 0 };
        if self.streak >= self.config.consecutive {
            self.streak = 0;
            self.began = Some(now);
            self.state.switched = true;
            self.state.timed_out = false;
            if self.state.procedure + 1 < self.state.count {
                self.state.procedure += 1;
            } else {
                self.state.complete = true;
            }
        }
        self.state
    }

    fn near_end(&self, pose: &Pose) -> bool {
        self.config.guard.as_ref().is_none_or(|g| {
            let (d, a) = pose_distance(pose, &g.end_poses[self.state.procedure]);
            // Angles are at most pi; a limit of pi shall not fail by rounding.
            d <= g.position && a <= g.rotation + 1e-9
        })
    }

    /// Back to the first procedure, as after a failed grasp; the time-out starts anew with the next
    /// observation.
    pub fn reset(&mut self) {
        self.state.procedure = 0;
        self.state.probability = 0.0;
        self.state.switched = false;
        self.state.complete = false;
        self.state.timed_out = false;
        self.state.guarded = false;
        self.streak = 0;
        self.began = None;
        self.last = None;
    }

    /// Other settings from now on; the procedure stays.
    ///
    /// # Errors
    /// As [`SwitchCore::new`]; nothing is changed then.
    pub fn configure(&mut self, config: SwitchConfig) -> Result<(), PolicyError> {
        self.config = Self::new(self.state.count, config)?.config;
        Ok(())
    }

    /// Starts at a given procedure (the last one if there are fewer).
    pub fn start_at(&mut self, procedure: usize, now: Stamp) {
        self.reset();
        self.state.procedure = procedure.min(self.state.count - 1);
        self.began = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    fn at(x: f64) -> Pose {
        pose_from_xyz_rpy([x, 0.0, 0.0], [0.0; 3])
    }

    fn feed(core: &mut SwitchCore, t: &mut i64, p: f32, pose: &Pose) -> SwitchState {
        *t += 33_000_000;
        core.step(Stamp(*t), p, pose)
    }

    #[test]
    fn three_in_a_row_advance_and_the_last_completes() {
        let mut core = SwitchCore::new(2, SwitchConfig::default()).unwrap();
        let (mut t, pose) = (0, at(0.0));
        for p in [0.9, 0.9, 0.7, 0.9, 0.9] {
            assert!(!feed(&mut core, &mut t, p, &pose).switched);
        }
        // Neither an old stamp nor a NaN counts.
        assert!(!core.step(Stamp(t), 0.99, &pose).switched);
        assert!(!feed(&mut core, &mut t, f32::NAN, &pose).switched);
        let s = feed(&mut core, &mut t, 0.9, &pose);
        assert!(s.switched && s.procedure == 1 && !s.complete);
        for _ in 0..2 {
            assert!(!feed(&mut core, &mut t, 0.9, &pose).switched);
        }
        let s = feed(&mut core, &mut t, 0.9, &pose);
        assert!(s.switched && s.complete && s.procedure == 1);
        assert!(!feed(&mut core, &mut t, 0.9, &pose).switched);
        core.reset();
        assert_eq!((core.procedure(), core.state().complete), (0, false));
        assert!(!feed(&mut core, &mut t, 0.9, &pose).switched);
    }

    #[test]
    fn a_step_back_of_the_stamps_starts_the_count_anew() {
        let config = SwitchConfig { timeout: Some(10.0), ..Default::default() };
        let mut core = SwitchCore::new(2, config).unwrap();
        let (pose, second) = (at(0.0), 1_000_000_000);
        let mut t = 100 * second;
        feed(&mut core, &mut t, 0.9, &pose);
        feed(&mut core, &mut t, 0.9, &pose);
        // A little late counts for nothing; one from the future is followed by a step back.
        assert!(!core.step(Stamp(t - second / 2), 0.9, &pose).switched);
        core.step(Stamp(t + 500 * second), 0.1, &pose);
        for _ in 0..2 {
            let s = feed(&mut core, &mut t, 0.9, &pose);
            assert!(!s.switched && !s.timed_out);
        }
        assert!(feed(&mut core, &mut t, 0.9, &pose).switched);
        // The count of before the step back is worth nothing, the procedure stays.
        feed(&mut core, &mut t, 0.9, &pose);
        feed(&mut core, &mut t, 0.9, &pose);
        let mut t = second;
        assert!(!feed(&mut core, &mut t, 0.9, &pose).switched);
        assert_eq!(core.procedure(), 1);
        // After a reset any stamp is the first one.
        core.reset();
        let mut t = second * 3 / 4;
        for i in 0..3 {
            assert_eq!(feed(&mut core, &mut t, 0.9, &pose).switched, i == 2);
        }
    }

    #[test]
    fn guard_and_timeout() {
        let guard = SwitchGuard {
            end_poses: vec![at(0.0)],
            position: 0.02,
            rotation: std::f64::consts::PI,
        };
        let config = SwitchConfig {
            guard: Some(guard),
            timeout: Some(1.0),
            consecutive: 2,
            ..Default::default()
        };
        let mut core = SwitchCore::new(1, config.clone()).unwrap();
        let mut t = 0;
        for i in 0..40 {
            let s = feed(&mut core, &mut t, 0.99, &at(0.03));
            assert!(s.guarded && !s.switched);
            assert_eq!(s.timed_out, i > 30, "tick {i}");
        }
        feed(&mut core, &mut t, 0.99, &at(0.01));
        let s = feed(&mut core, &mut t, 0.99, &at(0.01));
        assert!(s.complete && !s.timed_out);
        let error = SwitchCore::new(2, config).unwrap_err().to_string();
        assert!(error.contains("1 end poses for 2"), "{error}");
        let bad = SwitchConfig { threshold: 1.5, consecutive: 0, ..Default::default() };
        let error = SwitchCore::new(1, bad).unwrap_err().to_string();
        assert!(error.contains("threshold") && error.contains("consecutive"));
    }
}
