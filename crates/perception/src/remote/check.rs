//! What a pose from elsewhere is worth: the object drawn at it against the measured depth and the mask.

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::segment::Mask;
use crate::table::TablePlane;
use crate::view::{Painter, Window};
use tdv_geometry::Pose;

/// Depth (m) by which something nearer hides the object.
const OCCLUDER_M: f32 = 0.03;
/// Lowest height (m) above the table of what may hide an object: the table itself does not.
const OVER_TABLE_M: f64 = 0.01;
/// Overlap with the mask below which a pose is worth nothing, and from which it is worth everything. A mask
/// cut out by depth and colour covers a true outline by 0.7 and more.
const OVERLAP: [f64; 2] = [0.2, 0.6];

/// How an answered pose compares with the image it is about.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Check {
    /// Of the drawn pixels that nothing hides and that have a reading, the part with the same depth.
    pub agreement: f64,
    /// Intersection over union of the visible drawn pixels and the mask; 1 without a mask.
    pub overlap: f64,
    /// Visible drawn pixels: row-major index and depth (m).
    pub pixels: Vec<(usize, f32)>,
}

impl Check {
    /// 0..1: agreement, reduced where the outline is off. A thin object on a table agrees in depth
    /// anywhere on it, so that depth alone says nothing about it.
    pub fn confidence(&self) -> f64 {
        self.agreement * ((self.overlap - OVERLAP[0]) / (OVERLAP[1] - OVERLAP[0])).clamp(0.0, 1.0)
    }
}

/// Draws the model at `pose` (`T_camera_object`) and compares; nothing agrees where it is out of sight.
pub(crate) fn check(
    painter: &mut Painter,
    frame: &RgbdFrame,
    model: &ObjectModel,
    pose: &Pose,
    mask: Option<&Mask>,
    table: Option<&TablePlane>,
) -> Check {
    let mut out = Check::default();
    let k = &frame.intrinsics;
    let Some(window) = Window::of(model, pose, k, 2.0) else { return out };
    painter.draw(&window.intrinsics(k), model, pose);
    let (mut measured, mut agreed, mut common) = (0.0, 0.0, 0.0);
    for (i, z) in painter.out.depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        let u = window.x0 + (i % window.width as usize) as i32;
        let v = window.y0 + (i / window.width as usize) as i32;
        if let Some(d) = frame.depth_at(u, v) {
            if d < z - OCCLUDER_M {
                let seen = k.unproject(f64::from(u), f64::from(v), f64::from(d));
                let sunk = table.is_some_and(|t| t.height(&seen) < OVER_TABLE_M);
                measured += f64::from(u8::from(sunk));
                continue;
            }
            measured += 1.0;
            agreed += f64::from(u8::from((d - z).abs() < 0.006 + 0.004 * z * z));
        }
        out.pixels.push((v as usize * k.width as usize + u as usize, *z));
        common += f64::from(u8::from(mask.is_some_and(|m| m.at(u, v))));
    }
    // A handful of pixels proves nothing.
    if measured >= 30.0 {
        out.agreement = agreed / measured;
    }
    let asked = mask.map(|m| m.data.iter().filter(|on| **on).count() as f64);
    out.overlap = asked.map_or(1.0, |n| common / (n + out.pixels.len() as f64 - common).max(1.0));
    out
}
