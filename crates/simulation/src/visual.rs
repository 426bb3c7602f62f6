//! What the arm and the gripper look like. Plain shapes, told apart from objects by being grey, blue
//! and black.

use crate::arm::{ArmModel, Paint};
use crate::gripper::{FINGER_THICKNESS, PAD_LENGTH, PAD_THICKNESS, PAD_WIDTH};
use crate::parts::{Part, Solid};
use crate::world::{finger_parts, palm_parts};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_rendering::Mesh;
use tdv_rendering::mesh::primitives;

const TUBE: [u8; 3] = [176, 180, 184];
const CAP: [u8; 3] = [96, 158, 196];
const DARK: [u8; 3] = [66, 68, 72];
const PAD: [u8; 3] = [30, 30, 32];
const STEEL: [u8; 3] = [120, 122, 126];

/// Meshes of the robot, each in the frame that it moves with.
#[derive(Debug, Clone)]
pub struct RobotMeshes {
    /// One for each of [`ArmModel::link_frames`]; the last one is the flange with the palm.
    pub links: [Mesh; 7],
    /// The fingers, origin in the middle of the pad's face, +y side first.
    pub fingers: [Mesh; 2],
}

impl RobotMeshes {
    /// Builds them.
    pub fn new(arm: ArmModel) -> Self {
        let mut links: [Mesh; 7] = Default::default();
        for p in &arm.pieces() {
            let color = match p.paint {
                Paint::Tube => TUBE,
                Paint::Cap => CAP,
                Paint::Dark => DARK,
            };
            links[p.frame].append(&rod(&Vector3::from(p.a), &Vector3::from(p.b), p.radius, color));
        }
        for (part, color) in palm_parts().iter().zip([DARK, STEEL]) {
            links[6].append(&solid(part, color));
        }
        // The rail that the fingers slide in.
        let rail = primitives::rounded_cuboid([0.034, 0.122, 0.020], 0.004, DARK);
        links[6].append(&rail.transformed(&Pose::translation(0.0, 0.0, 0.068)));
        Self { links, fingers: [finger(1.0), finger(-1.0)] }
    }
}

fn finger(side: f64) -> Mesh {
    let [_, back] = finger_parts(side);
    let mut mesh = solid(&back, STEEL);
    let pad = primitives::cuboid([PAD_WIDTH, PAD_THICKNESS, PAD_LENGTH], PAD);
    mesh.append(&pad.transformed(&Pose::translation(0.0, side * 0.5 * PAD_THICKNESS, 0.0)));
    let knuckle = primitives::rounded_cuboid([0.026, FINGER_THICKNESS + 0.004, 0.030], 0.003, DARK);
    let at = Pose::translation(0.0, side * (PAD_THICKNESS + 0.5 * FINGER_THICKNESS), -0.062);
    mesh.append(&knuckle.transformed(&at));
    mesh
}

/// A cylinder from `a` to `b` (m).
fn rod(a: &Vector3<f64>, b: &Vector3<f64>, radius: f64, color: [u8; 3]) -> Mesh {
    let axis = b - a;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
    primitives::cylinder(radius, axis.norm(), 24, color)
        .transformed(&Pose::from_parts(Translation3::from(*a), turn))
}

fn solid(part: &Part, color: [u8; 3]) -> Mesh {
    let mesh = match &part.solid {
        Solid::Cuboid(h) => {
            let size = h.map(|v| 2.0 * v);
            primitives::rounded_cuboid(
                size,
                0.15 * size.iter().fold(f64::MAX, |a, b| a.min(*b)),
                color,
            )
        }
        Solid::Cylinder { radius, height } => primitives::cylinder(*radius, *height, 32, color)
            .transformed(&Pose::translation(0.0, 0.0, -0.5 * height)),
    };
    mesh.transformed(&part.pose)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_robot_has_a_sensible_size_and_few_triangles() {
        let r = RobotMeshes::new(ArmModel::Ur5);
        let all: usize = r.links.iter().chain(&r.fingers).map(|m| m.triangles.len()).sum();
        assert!((500..8000).contains(&all), "{all}");
        let (low, high) = r.links[2].bounds();
        assert!((high.x - low.x - 0.537).abs() < 0.03, "{low} {high}");
        let (low, high) = r.fingers[0].bounds();
        assert!(low.y.abs() < 1e-6 && high.y < 0.03 && (high.z - 0.019).abs() < 1e-6);
    }
}
