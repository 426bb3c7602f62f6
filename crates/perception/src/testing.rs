//! A rendered table with a mug and a coaster, with the noise of a depth camera, for tests.

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use nalgebra::{Point3, UnitQuaternion};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::{Pose, Stamp, Symmetry, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives::{self, MugSize};
use tdv_rendering::{
    DepthImage, Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer, RgbImage, look_at,
};

pub(crate) const K: Intrinsics =
    Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };

pub(crate) fn mug_model() -> ObjectModel {
    let mesh = primitives::mug(&MugSize::default(), 48, [40, 80, 190], [60, 100, 210]);
    let mut m = ObjectModel::new("mug", mesh, Symmetry::None);
    m.synonyms = vec!["cup".into()];
    m.colors = vec!["blue".into()];
    m
}

pub(crate) fn coaster_model() -> ObjectModel {
    let mesh = primitives::disc(0.05, 0.008, 64, [150, 80, 50]);
    let axis = [0.0, 0.0, 1.0];
    ObjectModel::new("coaster", mesh, Symmetry::Continuous { axis })
}

/// `T_base_camera` of the lab.
pub(crate) fn camera() -> Pose {
    look_at(&Point3::new(0.95, 0.0, 0.70), &Point3::new(0.475, 0.0, 0.02))
}

pub(crate) struct Lab {
    renderer: Renderer,
    out: Rendered,
    table: Mesh,
    rng: ChaCha8Rng,
    frames: i64,
}

impl Lab {
    pub fn new(seed: u64) -> Self {
        let table = primitives::cuboid([1.2, 1.4, 0.04], [150, 145, 138])
            .transformed(&pose_from_xyz_rpy([0.4, 0.0, -0.02], [0.0; 3]));
        Self {
            renderer: Renderer::new(),
            out: Rendered::default(),
            table,
            rng: ChaCha8Rng::seed_from_u64(seed),
            frames: 0,
        }
    }

    /// Renders objects standing at poses in the base frame (table at z = 0), with depth noise of 2 mm
    /// at 0.85 m growing with z^2, holes at edges and in 1 % of all pixels, 1 mm steps, and colour noise.
    pub fn frame(&mut self, objects: &[(&Mesh, Pose)]) -> RgbdFrame {
        let to_camera = camera().inverse();
        let mut scene = vec![Instance { mesh: &self.table, pose: to_camera, id: 1 }];
        for (i, (mesh, pose)) in objects.iter().enumerate() {
            scene.push(Instance { mesh, pose: to_camera * pose, id: i as u16 + 2 });
        }
        self.renderer.render(&K, &scene, &Lighting::default(), &mut self.out);
        let (w, h) = (K.width as usize, K.height as usize);
        let clean = &self.out.depth.data;
        let mut depth = vec![0.0f32; w * h];
        for y in 0..h {
            for x in 0..w {
                let z = clean[y * w + x];
                if z <= 0.0 {
                    continue;
                }
                let edge = [(1i32, 0i32), (-1, 0), (0, 1), (0, -1)].iter().any(|(dx, dy)| {
                    let (nx, ny) = (x as i32 + dx, y as i32 + dy);
                    nx >= 0
                        && ny >= 0
                        && nx < w as i32
                        && ny < h as i32
                        && (clean[ny as usize * w + nx as usize] - z).abs() > 0.015
                });
                let hole = if edge { 0.4 } else { 0.01 };
                if self.rng.random::<f32>() < hole {
                    continue;
                }
                let sigma = 0.002 * (z / 0.85).powi(2);
                let n = gauss(&mut self.rng) * sigma;
                depth[y * w + x] = ((z + n) * 1000.0).round() / 1000.0;
            }
        }
        let mut color = RgbImage::new(K.width, K.height);
        for (c, o) in color.iter_mut().zip(self.out.color.as_raw()) {
            *c = (f32::from(*o) + 3.0 * gauss(&mut self.rng)).clamp(0.0, 255.0) as u8;
        }
        self.frames += 1;
        RgbdFrame {
            stamp: Stamp(self.frames * 33_333_333),
            color,
            depth: DepthImage { width: K.width, height: K.height, data: depth },
            intrinsics: K,
        }
    }
}

/// Irwin-Hall approximation of a normal number.
fn gauss(rng: &mut ChaCha8Rng) -> f32 {
    let s: f32 = (0..6).map(|_| rng.random::<f32>()).sum();
    (s - 3.0) * std::f32::consts::SQRT_2
}

pub(crate) fn upright(x: f64, y: f64, z: f64, yaw: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [0.0, 0.0, yaw])
}

/// Angle (rad) between the headings of two nearly upright poses in the base frame.
pub(crate) fn yaw_error(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let d = tdv_geometry::yaw_of(a) - tdv_geometry::yaw_of(b);
    d.sin().atan2(d.cos()).abs()
}
