//! Convex pieces that an object is made of, for contact.

use crate::units;
use rapier3d::prelude::{ColliderBuilder, SharedShape};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
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

/// A hollow cylinder along z standing on z = `bottom`, as `count` flat staves whose outer faces touch
/// the outer radius. Metres.
pub fn staves(
    outer_radius: f64,
    wall: f64,
    bottom: f64,
    top: f64,
    count: usize,
) -> impl Iterator<Item = Part> {
    let step = std::f64::consts::TAU / count as f64;
    (0..count).map(move |i| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), step * (i as f64 + 0.5));
        let at = turn * Vector3::new(outer_radius - 0.5 * wall, 0.0, 0.5 * (top + bottom));
        Part {
            solid: Solid::Cuboid([
                0.5 * wall,
                outer_radius * (0.5 * step).tan(),
                0.5 * (top - bottom),
            ]),
            pose: Pose::from_parts(Translation3::from(at), turn),
        }
    })
}
