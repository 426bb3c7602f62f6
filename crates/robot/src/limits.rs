//! Every limit of the arm's motion in one place.

use crate::kinematics::{IkSelection, Joints};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::path::Path;
use thiserror::Error;

/// Limits of the demo; all may be tightened or widened in configuration, see [`Limits::validate`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Least joint angles (rad), UR order.
    pub joint_lower: Joints,
    /// Greatest joint angles (rad).
    pub joint_upper: Joints,
    /// Greatest speed of any joint (rad/s).
    pub joint_velocity: f64,
    /// Greatest acceleration of any joint while following (rad/s^2).
    pub joint_acceleration: f64,
    /// Greatest deceleration of any joint when stopping (rad/s^2).
    pub stop_acceleration: f64,
    /// Greatest rate of change of the acceleration while following (rad/s^3).
    pub joint_jerk: f64,
    /// Greatest speed of the tcp (m/s).
    pub tcp_speed: f64,
    /// Greatest angular speed of the tcp (rad/s).
    pub tcp_angular_speed: f64,
    /// The tcp stays within these metres of `base_link`: x.
    pub workspace_x: [f64; 2],
    /// As `workspace_x`: y.
    pub workspace_y: [f64; 2],
    /// As `workspace_x`: z.
    pub workspace_z: [f64; 2],
    /// Height of the table plane in `base_link` (m).
    pub table_z: f64,
    /// What the fingertips keep above the table (m).
    pub fingertip_clearance: f64,
    /// What palm, wrist and forearm keep above the table (m).
    pub link_clearance: f64,
    /// Condition number of the Jacobian (lengths in units of 0.5 m) from which the arm slows down on its
    /// way into a singularity.
    pub singular_slow: f64,
    /// Condition number beyond which it goes no further in.
    pub singular_stop: f64,
    /// Every trajectory is at rest this long after it was sent (s); a little under 0.2, so that a stale
    /// plan (150 ms) and this and the way to the driver are within 350 ms together.
    pub rest_within: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            joint_lower: [-TAU, -TAU, -PI, -TAU, -TAU, -TAU],
            joint_upper: [TAU, TAU, PI, TAU, TAU, TAU],
            joint_velocity: 1.0,
            joint_acceleration: 8.0,
            stop_acceleration: 14.0,
            joint_jerk: 400.0,
            tcp_speed: 0.25,
            tcp_angular_speed: 1.0,
            workspace_x: [0.10, 0.85],
            workspace_y: [-0.50, 0.50],
            workspace_z: [0.0, 0.75],
            table_z: 0.0,
            fingertip_clearance: 0.004,
            link_clearance: 0.02,
            singular_slow: 60.0,
            singular_stop: 250.0,
            rest_within: 0.18,
        }
    }
}

/// Limits that cannot be used.
#[derive(Debug, Error)]
pub enum LimitsError {
    /// The file cannot be read.
    #[error("limits file {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("limits file {path}: {reason}")]
    Parse {
        /// The file.
        path: String,
        /// Line and cause.
        reason: String,
    },
    /// Values that contradict each other or the arm.
    #[error("limits: {}", .0.join("; "))]
    Invalid(Vec<String>),
}

impl Limits {
    /// From a YAML file with any of the fields; the others keep their defaults.
    ///
    /// # Errors
    /// [`LimitsError`]: not readable, an unknown field or wrong type, or values that fail
    /// [`Self::validate`].
    pub fn load(path: &Path) -> Result<Self, LimitsError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| LimitsError::Io { path: name.clone(), source })?;
        let limits: Self = serde_saphyr::from_str(&text)
            .map_err(|e| LimitsError::Parse { path: name, reason: e.to_string() })?;
        limits.validate().map_err(LimitsError::Invalid)?;
        Ok(limits)
    }

    /// Checks every value against the arm and the others.
    ///
    /// # Errors
    /// One sentence for each problem.
    pub fn validate(&self) -> Result<(), Vec<String>> {
        let mut bad = Vec::new();
        for i in 0..6 {
            let (lo, hi) = (self.joint_lower[i], self.joint_upper[i]);
            if !(lo < hi && lo >= -TAU - 1e-9 && hi <= TAU + 1e-9) {
                bad.push(format!(
                    "joint_lower/joint_upper of joint {i} are {lo}..{hi}, expected a range within +-2 pi"
                ));
            }
        }
        let mut range = |name: &str, v: f64, lo: f64, hi: f64| {
            if !(v > lo && v <= hi) {
                bad.push(format!("{name} is {v}, expected above {lo} and at most {hi}"));
            }
        };
        range("joint_velocity", self.joint_velocity, 0.0, PI);
        range("joint_acceleration", self.joint_acceleration, 0.0, 40.0);
        range("stop_acceleration", self.stop_acceleration, 0.0, 40.0);
        range("joint_jerk", self.joint_jerk, 0.0, 1e5);
        range("tcp_speed", self.tcp_speed, 0.0, 1.0);
        range("tcp_angular_speed", self.tcp_angular_speed, 0.0, PI);
        range("rest_within", self.rest_within, 0.03, 1.0);
        range("fingertip_clearance", self.fingertip_clearance, -0.01, 0.5);
        range("link_clearance", self.link_clearance, -0.01, 0.5);
        range("singular_slow", self.singular_slow, 1.0, 1e6);
        range("singular_stop", self.singular_stop, self.singular_slow, 1e9);
        for (name, r) in [
            ("workspace_x", self.workspace_x),
            ("workspace_y", self.workspace_y),
            ("workspace_z", self.workspace_z),
        ] {
            if !(r[0] < r[1]) || !r.iter().all(|v| v.is_finite()) {
                bad.push(format!("{name} is {r:?}, expected [least, greatest]"));
            }
        }
        if !self.table_z.is_finite() {
            bad.push(format!("table_z is {}", self.table_z));
        }
        if bad.is_empty() { Ok(()) } else { Err(bad) }
    }

    /// The inverse kinematics' selection within these limits.
    pub fn selection(&self, max_step: f64) -> IkSelection {
        IkSelection {
            lower: self.joint_lower,
            upper: self.joint_upper,
            max_step,
            ..IkSelection::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_states_the_defaults() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot/limits.yaml");
        let l = Limits::load(Path::new(path)).unwrap();
        for i in 0..6 {
            assert!((l.joint_lower[i] - Limits::default().joint_lower[i]).abs() < 1e-12);
        }
        assert_eq!(l, Limits::default());
    }

    #[test]
    fn every_problem_is_listed() {
        let l = Limits {
            joint_velocity: -1.0,
            workspace_z: [1.0, 0.0],
            table_z: f64::NAN,
            ..Default::default()
        };
        let e = l.validate().unwrap_err();
        assert_eq!(e.len(), 3, "{e:?}");
        assert!(e[0].contains("joint_velocity is -1"));
        assert!(Limits::load(Path::new("/nonexistent.yaml")).is_err());
    }
}
