//! Occlusion seen by the depth camera: something clearly nearer than the object's own surface.

use crate::frame::RgbdFrame;
use crate::view::{Painter, Window, pixel};
use nalgebra::Point3;

/// Half side (m) of the neighbourhood that is looked at.
const NEIGHBOURHOOD_M: f64 = 0.008;

/// Depth of the object's own surface at the last drawing, to tell it from what hides it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Occlusion {
    window: Window,
    depth: Vec<f32>,
    /// How much nearer (m at 1 m distance) something must be.
    margin: f64,
    /// Off: nothing is ever hidden (the depth image is stale).
    enabled: bool,
}

impl Occlusion {
    pub fn set(&mut self, painter: &Painter, window: &Window, margin: f64, enabled: bool) {
        self.window = *window;
        self.depth.clone_from(&painter.out.depth.data);
        self.margin = margin;
        self.enabled = enabled;
    }

    /// Whether the pixel's own reading is nearer than the object's surface there.
    pub fn covered(&self, frame: &RgbdFrame, u: i32, v: i32) -> bool {
        let (x, y) = (u - self.window.x0, v - self.window.y0);
        if !self.enabled
            || x < 0
            || y < 0
            || x >= self.window.width as i32
            || y >= self.window.height as i32
        {
            return false;
        }
        let z = self.depth[(y * self.window.width as i32 + x) as usize];
        z > 0.0 && frame.depth_at(u, v).is_some_and(|d| d < z - margin_at(self.margin, z))
    }

    /// Whether a surface point (camera frame) is hidden.
    pub fn hides(&self, frame: &RgbdFrame, p: &Point3<f64>) -> bool {
        if !self.enabled {
            return false;
        }
        let k = &frame.intrinsics;
        let Some((u, v)) = k.project(p) else { return true };
        let r = NEIGHBOURHOOD_M * k.fx / p.z;
        // At most five looks along each axis.
        let step = (2.0 * r / 4.0).max(1.0);
        let n = (r / step).round() as i32;
        let (mut seen, mut own) = (f32::INFINITY, p.z as f32);
        for j in -n..=n {
            for i in -n..=n {
                let x = pixel(u + f64::from(i) * step);
                let y = pixel(v + f64::from(j) * step);
                if let Some(z) = frame.depth_at(x, y) {
                    seen = seen.min(z);
                }
                let (wx, wy) = (x - self.window.x0, y - self.window.y0);
                if wx >= 0
                    && wy >= 0
                    && wx < self.window.width as i32
                    && wy < self.window.height as i32
                {
                    let z = self.depth[(wy * self.window.width as i32 + wx) as usize];
                    if z > 0.0 {
                        own = own.min(z);
                    }
                }
            }
        }
        seen < own - margin_at(self.margin, own)
    }
}

/// How much nearer (m) than a surface at `z` something must be to hide it: half of `margin` always, the
/// other half growing with z^2 as the depth noise does.
pub(crate) fn margin_at(margin: f64, z: f32) -> f32 {
    (0.5 * margin) as f32 * (1.0 + z * z)
}
