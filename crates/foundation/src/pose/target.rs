//! The object as the networks want it, and its picture at a hypothesis.

use super::crop::{Normal, Window};
use crate::FoundationError;
use nalgebra::{Point3, Translation3, Vector3};
use tdv_geometry::{Pose, Symmetry};
use tdv_rendering::{Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer};

/// Vertices among which the largest distance is searched.
const SAMPLE: usize = 3000;
/// Light from everywhere, and from the camera; factors on the surface's sRGB value.
const AMBIENT: f32 = 0.8;
const FRONTAL: f32 = 0.5;

/// A mesh with the middle of its bounding box at the origin.
#[derive(Debug, Clone)]
pub struct Target {
    mesh: Mesh,
    /// The middle of the box in the object frame (m).
    centre: Vector3<f64>,
    /// Largest distance (m) of two vertices.
    diameter: f64,
    symmetry: Symmetry,
}

impl Target {
    /// Prepares a mesh (metres).
    ///
    /// # Errors
    /// [`FoundationError::Input`] for an empty mesh or one of a size that no tabletop object has.
    pub fn new(mesh: &Mesh, symmetry: &Symmetry) -> Result<Self, FoundationError> {
        let diameter = diameter(&mesh.positions);
        if mesh.triangles.is_empty() || !(0.005..=2.0).contains(&diameter) {
            return Err(FoundationError::input(
                "mesh",
                format!(
                    "has {} triangles and is {diameter:.4} m across; expected 5 mm to 2 m, in metres",
                    mesh.triangles.len()
                ),
            ));
        }
        let centre = mesh.center().coords;
        let moved = mesh.transformed(&Pose::from_parts((-centre).into(), nalgebra::one()));
        Ok(Self { mesh: moved, centre, diameter, symmetry: symmetry.clone() })
    }

    /// Largest distance (m) of two vertices.
    pub fn diameter(&self) -> f64 {
        self.diameter
    }

    /// The object's symmetry.
    pub fn symmetry(&self) -> &Symmetry {
        &self.symmetry
    }

    /// `T_camera_centred` from `T_camera_object`.
    pub(super) fn centred(&self, pose: &Pose) -> Pose {
        pose * Translation3::from(self.centre)
    }

    /// `T_camera_object` from `T_camera_centred`.
    pub(super) fn original(&self, pose: &Pose) -> Pose {
        pose * Translation3::from(-self.centre)
    }
}

fn diameter(vertices: &[[f32; 3]]) -> f64 {
    let step = vertices.len().div_ceil(SAMPLE).max(1);
    let some: Vec<Point3<f64>> =
        vertices.iter().step_by(step).map(|p| Point3::from(p.map(f64::from))).collect();
    let mut square = 0.0f64;
    for (i, a) in some.iter().enumerate() {
        for b in &some[..i] {
            square = square.max((a - b).norm_squared());
        }
    }
    square.sqrt()
}

/// Draws hypotheses; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Artist {
    renderer: Renderer,
    out: Rendered,
}

impl Artist {
    /// The target at a pose (`T_camera_centred`) through a window: 6 planes as in [`super::crop::observed`].
    pub fn draw(
        &mut self,
        target: &Target,
        pose: &Pose,
        k: &Intrinsics,
        (window, size): (&Window, u32),
        normal: &Normal,
    ) -> Vec<f32> {
        let camera = window.camera(k, size);
        let scene = [Instance { mesh: &target.mesh, pose: *pose, id: 1 }];
        // Plain surface colours; the networks' lighting works on sRGB values, the renderer's does not.
        let plain = Lighting {
            ambient: [1.0; 3],
            lights: Vec::new(),
            specular: 0.0,
            ..Lighting::default()
        };
        self.renderer.render(&camera, &scene, &plain, &mut self.out);
        let plane = size as usize * size as usize;
        let mut out = vec![0.0; 6 * plane];
        for i in (0..plane).filter(|i| self.out.ids[*i] != 0) {
            let light = AMBIENT + FRONTAL * (-self.out.normals[i][2]).max(0.0);
            for c in 0..3 {
                let value = f32::from(self.out.color.as_raw()[3 * i + c]) / 255.0;
                out[c * plane + i] = (value * light).min(1.0);
            }
            let (x, y) = ((i % size as usize) as f64, (i / size as usize) as f64);
            let p = camera.unproject(x, y, f64::from(self.out.depth.data[i]));
            for (c, value) in normal.channels(&p).into_iter().enumerate() {
                out[(3 + c) * plane + i] = value;
            }
        }
        out
    }

    /// Depth (m) of the last picture, 0 where the target is not.
    pub fn depth(&self) -> &[f32] {
        &self.out.depth.data
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;
    use tdv_rendering::mesh::primitives;

    #[test]
    fn a_mesh_is_centred_and_poses_come_back() {
        let cuboid = primitives::cuboid([0.06, 0.08, 0.1], [200, 100, 50]);
        let mesh = cuboid.transformed(&pose_from_xyz_rpy([0.3, 0.1, -0.2], [0.0; 3]));
        let t = Target::new(&mesh, &Symmetry::None).unwrap();
        assert!((t.diameter() - (0.0036f64 + 0.0064 + 0.01).sqrt()).abs() < 1e-6);
        assert!(t.mesh.center().coords.norm() < 1e-6);
        let pose = pose_from_xyz_rpy([0.1, 0.0, 0.8], [0.5, -0.3, 2.0]);
        let centred = t.centred(&pose);
        assert!((centred.translation.vector - (pose * mesh.center()).coords).norm() < 1e-6);
        assert!((t.original(&centred).to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12);
        let e = Target::new(&mesh.scaled(1000.0), &Symmetry::None).unwrap_err().to_string();
        assert!(e.contains("metres"), "{e}");
        assert!(Target::new(&Mesh::default(), &Symmetry::None).is_err());
    }

    #[test]
    fn a_picture_holds_colour_under_the_networks_light_and_points() {
        let mesh = primitives::cuboid([0.1; 3], [200, 100, 50]);
        let t = Target::new(&mesh, &Symmetry::None).unwrap();
        let k = Intrinsics { width: 640, height: 480, fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
        let pose = Pose::translation(0.02, 0.01, 0.8);
        let window = Window::around(&Point3::new(0.02, 0.01, 0.8), 0.1, &k).unwrap();
        let normal = Normal { origin: pose.translation.vector, radius: 0.0866, nearest: 0.1 };
        let out = Artist::default().draw(&t, &pose, &k, (&window, 64), &normal);
        let (plane, middle) = (64 * 64, 32 * 64 + 32);
        // A face square to the camera: 0.8 + 0.5, and what exceeds white is cut.
        for (c, want) in [1.0, 100.0 / 255.0 * 1.3, 50.0 / 255.0 * 1.3].into_iter().enumerate() {
            assert!((out[c * plane + middle] - want).abs() < 0.01, "{}", out[c * plane + middle]);
        }
        assert!((f64::from(out[5 * plane + middle]) + 0.05 / 0.0866).abs() < 1e-4);
        assert_eq!(out[0], 0.0);
        assert_eq!(out[5 * plane], 0.0);
    }
}
