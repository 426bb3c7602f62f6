//! Rendering one object into a small window of the image.

use crate::catalogue::ObjectModel;
use nalgebra::Point3;
use tdv_geometry::Pose;
use tdv_rendering::{DepthOnly, Instance, Intrinsics, Renderer};

/// The pixel that holds an image coordinate (anything above -1000); the library's `round` is a call.
#[inline]
pub(crate) fn pixel(x: f64) -> i32 {
    (x + 1024.5) as i32 - 1024
}

/// A window of the image in pixels, inside the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Window {
    pub x0: i32,
    pub y0: i32,
    pub width: u32,
    pub height: u32,
}

impl Window {
    /// The part of the image that an object of this pose can cover, grown by `margin` px; `None` when
    /// it is behind the camera, nearer than its own size or outside the image.
    pub fn of(model: &ObjectModel, pose: &Pose, k: &Intrinsics, margin: f64) -> Option<Self> {
        let c = pose * model.centre();
        if c.z < model.radius + 0.05 {
            return None;
        }
        let (u, v) = k.project(&c)?;
        // The exact outline of a sphere is a little larger than radius / z.
        let r = model.radius / (c.z * c.z - model.radius * model.radius).sqrt().max(1e-3);
        let (ru, rv) = (k.fx * r + margin, k.fy * r + margin);
        let x0 = (u - ru).floor().max(0.0);
        let y0 = (v - rv).floor().max(0.0);
        let x1 = (u + ru).ceil().min(f64::from(k.width) - 1.0);
        let y1 = (v + rv).ceil().min(f64::from(k.height) - 1.0);
        (x1 - x0 >= 4.0 && y1 - y0 >= 4.0).then(|| Self {
            x0: x0 as i32,
            y0: y0 as i32,
            width: (x1 - x0) as u32 + 1,
            height: (y1 - y0) as u32 + 1,
        })
    }

    pub fn intrinsics(&self, k: &Intrinsics) -> Intrinsics {
        k.crop(self.x0, self.y0, self.width, self.height)
    }
}

/// A renderer with its buffers.
pub(crate) struct Painter {
    renderer: Renderer,
    /// What was drawn last.
    pub out: DepthOnly,
}

impl std::fmt::Debug for Painter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Painter").finish_non_exhaustive()
    }
}

impl Painter {
    pub fn new() -> Self {
        Self { renderer: Renderer::new(), out: DepthOnly::default() }
    }

    /// Draws depth, ids and normals of one object into `self.out`.
    pub fn draw(&mut self, k: &Intrinsics, model: &ObjectModel, pose: &Pose) {
        let instance = Instance { mesh: &model.mesh, pose: *pose, id: 1 };
        self.renderer.render_depth(k, &[instance], &mut self.out);
    }

    /// Mean of the visible surface points (camera frame) of the last drawing.
    pub fn visible_centroid(&self, k: &Intrinsics) -> Option<Point3<f64>> {
        let mut sum = nalgebra::Vector3::zeros();
        let mut n = 0.0;
        for (i, z) in self.out.depth.data.iter().enumerate() {
            if *z > 0.0 {
                let (u, v) = (i as u32 % k.width, i as u32 / k.width);
                sum += k.unproject(f64::from(u), f64::from(v), f64::from(*z)).coords;
                n += 1.0;
            }
        }
        (n > 0.0).then(|| Point3::from(sum / n))
    }
}
