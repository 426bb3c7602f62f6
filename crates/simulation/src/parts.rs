//! Convex pieces that an object is made of, for contact.

use crate::units;
use rapier3d::prelude::{ColliderBuilder, SharedShape};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_rendering::{CollisionPart, PartShape};

/// A convex solid, centred on its own origin. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// Half edges along x, y, z.
    Cuboid([f64; 3]),
    /// Axis along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Full height.
        height: f64,
    },
}

/// A solid and where it sits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// The solid.
    pub solid: Solid,
    /// `T_object_solid`.
    pub pose: Pose,
}

impl Part {
    /// Volume, m^3.
    pub fn volume(&self) -> f64 {
        match self.solid {
            Solid::Cuboid(h) => 8.0 * h[0] * h[1] * h[2],
            Solid::Cylinder { radius, height } => std::f64::consts::PI * radius * radius * height,
        }
    }

    /// Lowest z of the part in its object's frame, m.
    pub fn lowest(&self) -> f64 {
        let axes = self.pose.rotation.to_rotation_matrix();
        let down = axes.matrix().row(2).into_owned();
        let reach = match self.solid {
            Solid::Cuboid(h) => (0..3).map(|k| (down[k] * h[k]).abs()).sum(),
            Solid::Cylinder { radius, height } => {
                down[0].hypot(down[1]) * radius + 0.5 * height * down[2].abs()
            }
        };
        self.pose.translation.z - reach
    }

    /// Collider of this part, without mass, placed in its object's frame.
    pub(crate) fn collider(&self) -> ColliderBuilder {
        let (shape, pose) = match self.solid {
            Solid::Cuboid(h) => {
                (SharedShape::cuboid(h[0] as f32, h[1] as f32, h[2] as f32), self.pose)
            }
            Solid::Cylinder { radius, height } => {
                // The engine's cylinders stand along y.
                let quarter = std::f64::consts::FRAC_PI_2;
                let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), quarter);
                let shape = SharedShape::cylinder(0.5 * height as f32, radius as f32);
                (shape, self.pose * upright)
            }
        };
        ColliderBuilder::new(shape).position(units::pose(&pose)).density(0.0)
    }
}

impl From<&CollisionPart> for Part {
    fn from(part: &CollisionPart) -> Self {
        let solid = match part.shape {
            PartShape::Box { half_extents } => Solid::Cuboid(half_extents),
            PartShape::Cylinder { radius, height } => Solid::Cylinder { radius, height },
        };
        Self { solid, pose: part.pose() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn lowest_point_of_turned_parts() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let lying = pose_from_xyz_rpy([0.0, 0.0, 0.1], [quarter, 0.0, 0.3]);
        let solid = Solid::Cylinder { radius: 0.02, height: 0.2 };
        assert!((Part { solid, pose: lying }.lowest() - 0.08).abs() < 1e-9);
        let tilted = pose_from_xyz_rpy([0.0; 3], [0.5 * quarter, 0.0, 0.0]);
        let solid = Solid::Cuboid([0.5, 0.01, 0.01]);
        assert!((Part { solid, pose: tilted }.lowest() + 0.02_f64.sqrt() * 0.1).abs() < 1e-9);
    }
}
