//! How far a tracked pose can be believed.

use crate::frame::RgbdFrame;
use crate::view::{Painter, Window};

/// The figures behind a confidence, all 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quality {
    /// Of the visible surface with a depth reading, the part whose depth agrees (1 cm at 1 m).
    pub agreement: f64,
    /// Of the drawn surface, the part that nothing nearer hides.
    pub visible: f64,
    /// Outline lines in use, of those asked for.
    pub lines: f64,
    /// How different the object's colours are from those around it.
    pub separability: f64,
}

impl Quality {
    /// 0..1: depth agreement of what is visible, reduced when less than 40 % is visible or hardly any
    /// outline is in use. Below about 0.35 the pose should not be trusted.
    pub fn confidence(&self) -> f64 {
        let sight = (self.visible / 0.4).min(1.0);
        let outline = 0.7 + 0.3 * (self.lines / 0.2).min(1.0);
        (self.agreement * sight * outline).clamp(0.0, 1.0)
    }
}

/// Compares the painter's last drawing with the measured depth.
pub(crate) fn compare(frame: &RgbdFrame, painter: &Painter, window: &Window) -> Quality {
    let w = window.width as i32;
    let (mut drawn, mut agree, mut through, mut hidden) = (0.0, 0.0, 0.0, 0.0);
    // Every second pixel is enough for a fraction.
    for y in (0..window.height as i32).step_by(2) {
        for x in (0..w).step_by(2) {
            let r = painter.out.depth.data[(y * w + x) as usize];
            if r <= 0.0 {
                continue;
            }
            drawn += 1.0;
            let Some(d) = frame.depth_at(window.x0 + x, window.y0 + y) else { continue };
            let tol = 0.006 + 0.004 * r * r;
            let diff = d - r;
            if diff.abs() < tol {
                agree += 1.0;
            } else if diff > 0.0 {
                through += 1.0;
            } else if diff < -0.02 {
                hidden += 1.0;
            } else {
                // Slightly nearer than drawn: neither the object where it should be nor an occluder.
                through += 0.5;
            }
        }
    }
    if drawn < 8.0 {
        return Quality::default();
    }
    Quality {
        agreement: if agree + through > 0.0 { agree / (agree + through) } else { 0.0 },
        visible: 1.0 - hidden / drawn,
        ..Quality::default()
    }
}
