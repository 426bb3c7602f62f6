//! Rotation hypotheses: a general grid of view directions and in-plane turns, or yaws of an upright object.

use crate::catalogue::ObjectModel;
use crate::table::TablePlane;
use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_3, TAU};

/// The 42 corners of an icosahedron divided once, unit vectors.
pub(crate) fn view_directions() -> Vec<Vector3<f64>> {
    let g = (1.0 + 5.0f64.sqrt()) / 2.0;
    let mut corners: Vec<Vector3<f64>> = Vec::new();
    for a in [-1.0, 1.0] {
        for b in [-g, g] {
            corners.push(Vector3::new(0.0, a, b).normalize());
            corners.push(Vector3::new(a, b, 0.0).normalize());
            corners.push(Vector3::new(b, 0.0, a).normalize());
        }
    }
    let mut all = corners.clone();
    for (i, a) in corners.iter().enumerate() {
        for b in &corners[i + 1..] {
            // Neighbouring corners are 63.4 degrees apart, the next nearest 116.6.
            if a.dot(b) > 0.3 {
                all.push((a + b).normalize());
            }
        }
    }
    all
}

/// Up to 252 orientations of the object in the camera frame; those that the object's symmetry makes
/// equal (within 25 degrees) are listed once.
pub(crate) fn general(model: &ObjectModel) -> Vec<UnitQuaternion<f64>> {
    let mut out: Vec<UnitQuaternion<f64>> = Vec::new();
    let distinct = !matches!(model.symmetry, tdv_geometry::Symmetry::None);
    for v in view_directions() {
        // The camera stands at v and looks at the origin.
        let z = -v;
        let x = Vector3::z().cross(&z).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let camera = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        for turn in 0..6 {
            let roll =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_3 * f64::from(turn));
            let r = roll * camera.inverse();
            let pose = |r: &UnitQuaternion<f64>| {
                tdv_geometry::Pose::from_parts(nalgebra::Translation3::identity(), *r)
            };
            let new = !distinct
                || out.iter().all(|o| model.distance(&pose(&r), &pose(o)).1 > 25f64.to_radians());
            if new {
                out.push(r);
            }
        }
    }
    out
}

/// Orientations of the object standing upright on the table, `count` yaws (one for a round object).
pub(crate) fn upright(
    model: &ObjectModel,
    table: &TablePlane,
    count: usize,
) -> Vec<UnitQuaternion<f64>> {
    let count = if model.round_about_z() { 1 } else { count };
    let up = Unit::new_unchecked(Vector3::z());
    (0..count)
        .map(|i| {
            let yaw = TAU * i as f64 / count as f64;
            table.pose.rotation * UnitQuaternion::from_axis_angle(&up, yaw)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::Symmetry;
    use tdv_rendering::mesh::primitives;

    #[test]
    fn sizes_of_the_grids() {
        assert_eq!(view_directions().len(), 42);
        let cube = primitives::cuboid([0.1; 3], [9, 9, 9]);
        let plain = ObjectModel::new("cube", cube.clone(), Symmetry::None);
        assert_eq!(general(&plain).len(), 252);
        let symmetric = ObjectModel::new("cube", cube, Symmetry::Cube);
        let n = general(&symmetric).len();
        assert!((8..40).contains(&n), "{n}");
    }
}
