//! Correction of the camera's pose by the table it sees: the table is horizontal at z = 0.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;

/// Bounds of the correction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LevellingConfig {
    /// Off: the nominal camera pose is used as it is.
    pub enabled: bool,
    /// Largest roll and pitch (rad) that is corrected; a table tilted more is not the table.
    pub max_angle: f64,
    /// Largest height (m) that is corrected.
    pub max_height: f64,
    /// Part of a new observation that is taken in, once the mean of the first ones stands.
    pub rate: f64,
}

impl Default for LevellingConfig {
    fn default() -> Self {
        Self { enabled: true, max_angle: 2.0f64.to_radians(), max_height: 0.015, rate: 0.05 }
    }
}

/// Low-passed roll, pitch and height.
#[derive(Debug, Clone, Default)]
pub struct Levelling {
    config: LevellingConfig,
    /// Small rotation vector (rad, base axes, z = 0) and height (m).
    tilt: Vector3<f64>,
    height: f64,
    seen: u32,
    refused: u32,
}

impl Levelling {
    /// No correction yet.
    pub fn new(config: LevellingConfig) -> Self {
        Self { config, ..Self::default() }
    }

    /// Takes in an observed table plane (`T_camera_table`, z = normal, origin on the plane) under the
    /// nominal camera pose. Out of bounds it is ignored and counted.
    pub fn observe(&mut self, t_base_camera: &Pose, t_camera_table: &Pose) {
        if !self.config.enabled {
            return;
        }
        let table = t_base_camera * t_camera_table;
        let normal = table.rotation * Vector3::z();
        let Some(turn) = UnitQuaternion::rotation_between(&normal, &Vector3::z()) else { return };
        let tilt = turn.scaled_axis();
        let height = lift(t_base_camera, &turn, &table);
        if !tilt.iter().all(|v| v.is_finite())
            || tilt.norm() > self.config.max_angle
            || height.abs() > self.config.max_height
        {
            self.refused = self.refused.saturating_add(1);
            return;
        }
        self.seen = self.seen.saturating_add(1);
        let rate = (1.0 / f64::from(self.seen)).max(self.config.rate);
        self.tilt += (tilt - self.tilt) * rate;
        self.height += (height - self.height) * rate;
    }

    /// The corrected `T_base_camera`.
    pub fn correct(&self, t_base_camera: &Pose) -> Pose {
        let turn = UnitQuaternion::from_scaled_axis(self.tilt);
        // Turned on the spot: a camera on a stand is known by its place better than by its angles.
        let mut t = *t_base_camera;
        t.rotation = turn * t.rotation;
        t.translation.vector.z += self.height;
        t
    }

    /// Roll and pitch together (rad) and height (m) of the present correction.
    pub fn correction(&self) -> (f64, f64) {
        (self.tilt.norm(), self.height)
    }

    /// Observations out of bounds so far: a wrong camera pose or not the table.
    pub fn refused(&self) -> u32 {
        self.refused
    }
}

/// Height by which the camera must rise, after turning on the spot, for the table to lie at z = 0.
fn lift(t_base_camera: &Pose, turn: &UnitQuaternion<f64>, table: &Pose) -> f64 {
    let eye = Point3::from(t_base_camera.translation.vector);
    let on_table = eye + turn * (Point3::from(table.translation.vector) - eye);
    -on_table.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::{pose_distance, pose_from_xyz_rpy};
    use tdv_rendering::look_at;

    #[test]
    fn recovers_tilt_and_height_but_not_a_wrong_plane() {
        let truth = look_at(&Point3::new(0.95, 0.0, 0.7), &Point3::new(0.475, 0.0, 0.02));
        let off = pose_from_xyz_rpy([0.0, 0.0, 0.003], [0.0; 3]);
        let mut nominal = off * truth;
        nominal.rotation =
            UnitQuaternion::from_scaled_axis(Vector3::new(0.006, -0.005, 0.0)) * nominal.rotation;
        let t_camera_table = truth.inverse() * pose_from_xyz_rpy([0.5, 0.1, 0.0], [0.0, 0.0, 0.7]);
        let mut l = Levelling::new(LevellingConfig::default());
        for _ in 0..20 {
            l.observe(&nominal, &t_camera_table);
        }
        let (d, a) = pose_distance(&l.correct(&nominal), &truth);
        assert!(d < 1e-4 && a < 1e-4, "{d} {a}");
        let tilted = truth.inverse() * pose_from_xyz_rpy([0.5, 0.0, 0.0], [0.1, 0.0, 0.0]);
        let before = l.correction();
        l.observe(&nominal, &tilted);
        assert_eq!(l.correction(), before);
        assert_eq!(l.refused(), 1);
    }
}
