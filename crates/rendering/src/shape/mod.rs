//! What a mesh alone tells about its object: where it stands, its symmetry, convex parts, its mass.

mod parts;
mod symmetry;
mod voxels;

pub use parts::convex_parts;
pub use symmetry::{SymmetryReport, find_symmetry};

use crate::Mesh;
use nalgebra::Translation3;
use tdv_geometry::{Pose, Symmetry};

/// Density (kg/m^3) of the guess: between an empty and a full bottle, and that of wood.
const DENSITY: f64 = 600.0;

/// The mesh moved so that the origin is the middle of its underside, z up as it is.
#[must_use]
pub fn standing(mesh: &Mesh) -> Mesh {
    let (low, _) = mesh.bounds();
    let middle = mesh.center();
    mesh.transformed(&Pose::from_parts(
        Translation3::new(-middle.x, -middle.y, -low.z),
        nalgebra::UnitQuaternion::identity(),
    ))
}

/// The mesh moved so that the origin is the middle of its bounding box.
#[must_use]
pub fn centred(mesh: &Mesh) -> Mesh {
    let shift = Translation3::from(-mesh.center().coords);
    mesh.transformed(&Pose::from_parts(shift, nalgebra::UnitQuaternion::identity()))
}

/// The frame that the catalogue expects for an object of this symmetry: things that rest on any side
/// have their origin in the middle, all others at the middle of their underside.
#[must_use]
pub fn in_object_frame(mesh: &Mesh, symmetry: &Symmetry) -> Mesh {
    if *symmetry == Symmetry::Cube { centred(mesh) } else { standing(mesh) }
}

/// A guess (kg) from the volume that the surface encloses; to be replaced by whoever has a balance.
pub fn guess_mass(mesh: &Mesh) -> f64 {
    let mass = (mesh.volume().abs() * DENSITY).clamp(0.01, 10.0);
    // Two digits: more would claim to know.
    let unit = 10_f64.powf(mass.log10().floor() - 1.0);
    (mass / unit).round() * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitives;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn standing_and_centred() {
        let off = pose_from_xyz_rpy([3.0, -2.0, 1.0], [0.0; 3]);
        let m = primitives::cuboid([0.085; 3], [1; 3]).transformed(&off);
        let (low, high) = standing(&m).bounds();
        assert!(low.z.abs() < 1e-6 && (low.x + high.x).abs() < 1e-6, "{low} {high}");
        assert!(in_object_frame(&m, &Symmetry::Cube).center().coords.norm() < 1e-6);
        // A wooden cube of 85 mm.
        assert!((guess_mass(&m) - 0.37).abs() < 1e-9, "{}", guess_mass(&m));
    }
}
