//! How far a tracked pose can be believed.

use super::histogram::Histograms;
use super::occlusion::margin_at;
use crate::frame::RgbdFrame;
use crate::view::{Painter, Window};

/// The figures behind a confidence, all 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quality {
    /// Of the visible surface with a depth reading, the part whose depth agrees (1 cm at 1 m).
    pub agreement: f64,
    /// Of the drawn surface, the part that nothing nearer hides.
    pub visible: f64,
    /// Whether the visible part has the object's colours (1) or those of its surroundings (0).
    pub likeness: f64,
    /// Outline lines in use, of those asked for.
    pub lines: f64,
    /// How different the object's colours are from those around it.
    pub separability: f64,
}

impl Quality {
    /// 0..1: depth agreement of what is visible, reduced when less than 40 % is visible, when hardly
    /// any outline is in use, and when the colours are not the object's (as far as they tell
    /// anything). Below about 0.35 the pose should not be trusted.
    pub fn confidence(&self) -> f64 {
        let sight = (self.visible / 0.4).min(1.0);
        let outline = 0.7 + 0.3 * (self.lines / 0.2).min(1.0);
        let color = 1.0 - self.separability * (1.0 - (self.likeness / 0.5).min(1.0));
        (self.agreement * sight * outline * color).clamp(0.0, 1.0)
    }
}

/// Compares the painter's last drawing with the measured depth and colour.
pub(crate) fn compare(
    frame: &RgbdFrame,
    painter: &Painter,
    window: &Window,
    colors: &Histograms,
    margin: f64,
) -> Quality {
    let w = window.width as i32;
    let raw = frame.color.as_raw();
    let row = frame.color.width() as i32;
    let (mut drawn, mut agree, mut through, mut hidden) = (0.0, 0.0, 0.0, 0.0);
    let (mut posterior, mut looked) = (0.0f32, 0.0f32);
    // Every second pixel is enough for a fraction.
    for y in (0..window.height as i32).step_by(2) {
        for x in (0..w).step_by(2) {
            let r = painter.out.depth.data[(y * w + x) as usize];
            if r <= 0.0 {
                continue;
            }
            drawn += 1.0;
            let (u, v) = (window.x0 + x, window.y0 + y);
            let tol = 0.006 + 0.004 * r * r;
            match frame.depth_at(u, v).map(|d| d - r) {
                Some(diff) if diff < -margin_at(margin, r) => {
                    hidden += 1.0;
                    continue;
                }
                Some(diff) if diff.abs() < tol => agree += 1.0,
                Some(diff) if diff > 0.0 => through += 1.0,
                // Slightly nearer than drawn: neither the object where it should be nor an occluder.
                Some(_) => through += 0.5,
                None => {}
            }
            let c = 3 * (v * row + u) as usize;
            posterior += colors.posterior(&raw[c..c + 3]);
            looked += 1.0;
        }
    }
    if drawn < 8.0 {
        return Quality::default();
    }
    Quality {
        agreement: if agree + through > 0.0 { agree / (agree + through) } else { 0.0 },
        visible: 1.0 - hidden / drawn,
        likeness: if looked > 0.0 { colors.likeness(posterior / looked) } else { 0.0 },
        separability: colors.separability(),
        lines: 0.0,
    }
}
