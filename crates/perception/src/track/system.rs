//! The six normal equations of one update, in the object frame: rotation first, then translation.

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use tdv_geometry::Pose;

/// Gradient and (negative) Hessian about the current pose.
#[derive(Debug, Clone)]
pub(crate) struct System {
    pub gradient: Vector6<f64>,
    pub hessian: Matrix6<f64>,
}

impl System {
    pub fn new() -> Self {
        Self { gradient: Vector6::zeros(), hessian: Matrix6::zeros() }
    }

    /// One measurement with Jacobian `[rotation, translation]`.
    #[inline]
    pub fn add(
        &mut self,
        rotation: &Vector3<f64>,
        translation: &Vector3<f64>,
        pull: f64,
        weight: f64,
    ) {
        let j = Vector6::new(
            rotation.x,
            rotation.y,
            rotation.z,
            translation.x,
            translation.y,
            translation.z,
        );
        self.gradient += j * pull;
        self.hessian += (j * weight) * j.transpose();
    }

    /// The pose after one regularised Newton step; `None` when the system cannot be solved.
    pub fn step(
        &self,
        pose: &Pose,
        rotation_damping: f64,
        translation_damping: f64,
    ) -> Option<Pose> {
        let mut h = self.hessian;
        for i in 0..3 {
            h[(i, i)] += rotation_damping;
            h[(i + 3, i + 3)] += translation_damping;
        }
        let d = h.cholesky()?.solve(&self.gradient);
        if !d.iter().all(|v| v.is_finite()) {
            return None;
        }
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(d[0], d[1], d[2]));
        Some(pose * Pose::from_parts(Vector3::new(d[3], d[4], d[5]).into(), turn))
    }
}
