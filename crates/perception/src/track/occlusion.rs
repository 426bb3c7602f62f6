//! Occlusion seen by the depth camera: something clearly nearer than the object's own surface.

use crate::frame::RgbdFrame;
use crate::view::{Painter, Window};
use nalgebra::Point3;

/// Half side (m) of the neighbourhood that is looked at.
const NEIGHBOURHOOD_M: f64 = 0.008;

/// Depth of the object's own surface at the last drawing, to tell it from what hides it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Occlusion {
    window: Window,
    depth: Vec<f32>,
    /// How much nearer (m) something must be.
    margin: f32,
    /// Off: nothing is ever hidden (the depth image is stale).
    enabled: bool,
}

impl Occlusion {
    pub fn set(&mut self, painter: &Painter, window: &Window, margin: f64, enabled: bool) {
        self.window = *window;
        self.depth.clone_from(&painter.out.depth.data);
        self.margin = margin as f32;
        self.enabled = enabled;
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
                let x = (u + f64::from(i) * step).round() as i32;
                let y = (v + f64::from(j) * step).round() as i32;
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
        seen < own - self.margin
    }
}
