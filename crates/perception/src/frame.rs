//! One colour image with the depth image aligned to it, and the check every consumer relies on.

use nalgebra::Point3;
use tdv_geometry::Stamp;
use tdv_rendering::{DepthImage, Intrinsics, RgbImage};
use thiserror::Error;

/// Nearest depth (m) that is believed.
pub const NEAREST_M: f32 = 0.05;
/// Farthest depth (m) that is believed.
pub const FARTHEST_M: f32 = 8.0;

/// A colour image, its aligned depth image (same size and camera) and their intrinsics.
#[derive(Debug, Clone)]
pub struct RgbdFrame {
    /// When it was taken.
    pub stamp: Stamp,
    /// Colour, 8 bit RGB.
    pub color: RgbImage,
    /// Depth in metres along the optical axis, 0 = no reading, aligned to `color`.
    pub depth: DepthImage,
    /// Pinhole parameters, pixel centres at integer coordinates.
    pub intrinsics: Intrinsics,
}

/// Why a frame cannot be used at all.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum FrameError {
    /// An image has another size than the intrinsics say.
    #[error(
        "{what} is {got_width}x{got_height} but camera_info says {width}x{height}; \
         use the depth topic that is aligned to the colour camera and its camera_info"
    )]
    Size {
        /// "colour image" or "depth image".
        what: &'static str,
        /// Its width.
        got_width: u32,
        /// Its height.
        got_height: u32,
        /// Width in the intrinsics.
        width: u32,
        /// Height in the intrinsics.
        height: u32,
    },
    /// The depth buffer does not hold width x height numbers.
    #[error("depth image holds {got} values, {want} are needed; the message is truncated")]
    Truncated {
        /// Values found.
        got: usize,
        /// Values needed.
        want: usize,
    },
    /// A focal length or principal point that no camera has.
    #[error("camera_info: {field} is {value}, the camera is not calibrated")]
    Intrinsics {
        /// `fx`, `fy`, `cx` or `cy`.
        field: &'static str,
        /// What it is.
        value: f64,
    },
}

/// How good the depth of a frame is. NaN, infinite, negative and out-of-range readings count as holes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthStatus {
    /// At least 10 % of the pixels have a reading.
    Good {
        /// Fraction of pixels with a reading, 0..1.
        valid: f64,
    },
    /// Fewer than 10 % of the pixels have a reading.
    Sparse {
        /// Fraction of pixels with a reading, 0..1.
        valid: f64,
    },
    /// No pixel has a reading.
    Empty,
}

impl std::fmt::Display for DepthStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Good { valid } => write!(f, "depth on {:.0} % of the pixels", valid * 100.0),
            Self::Sparse { valid } => {
                write!(f, "depth on only {:.1} % of the pixels", valid * 100.0)
            }
            Self::Empty => write!(f, "the depth image has no reading at all"),
        }
    }
}

/// A reading that may be used, else `None`.
#[inline]
pub(crate) fn usable(z: f32) -> Option<f32> {
    // NaN fails both comparisons.
    (z > NEAREST_M && z < FARTHEST_M).then_some(z)
}

impl RgbdFrame {
    /// Checks sizes and intrinsics and rates the depth image.
    ///
    /// # Errors
    /// [`FrameError`] naming the image or field that does not fit.
    pub fn check(&self) -> Result<DepthStatus, FrameError> {
        let k = &self.intrinsics;
        let size = |what, w, h| {
            if w == k.width && h == k.height {
                return Ok(());
            }
            Err(FrameError::Size {
                what,
                got_width: w,
                got_height: h,
                width: k.width,
                height: k.height,
            })
        };
        size("colour image", self.color.width(), self.color.height())?;
        size("depth image", self.depth.width, self.depth.height)?;
        let want = k.width as usize * k.height as usize;
        if self.depth.data.len() != want || want == 0 {
            return Err(FrameError::Truncated { got: self.depth.data.len(), want });
        }
        for (field, value, positive) in
            [("fx", k.fx, true), ("fy", k.fy, true), ("cx", k.cx, false), ("cy", k.cy, false)]
        {
            if !value.is_finite() || (positive && value <= 1.0) {
                return Err(FrameError::Intrinsics { field, value });
            }
        }
        // Every 5th pixel is enough for a fraction.
        let (mut seen, mut valid) = (0usize, 0usize);
        for z in self.depth.data.iter().step_by(5) {
            seen += 1;
            valid += usize::from(usable(*z).is_some());
        }
        let fraction = valid as f64 / seen.max(1) as f64;
        Ok(if valid == 0 {
            DepthStatus::Empty
        } else if fraction < 0.1 {
            DepthStatus::Sparse { valid: fraction }
        } else {
            DepthStatus::Good { valid: fraction }
        })
    }

    /// Depth (m) at a pixel; `None` outside the image and in holes.
    #[inline]
    pub fn depth_at(&self, u: i32, v: i32) -> Option<f32> {
        if u < 0 || v < 0 || u >= self.depth.width as i32 || v >= self.depth.height as i32 {
            return None;
        }
        usable(self.depth.data[v as usize * self.depth.width as usize + u as usize])
    }

    /// The measured point (camera frame, m) at a pixel.
    #[inline]
    pub fn point(&self, u: i32, v: i32) -> Option<Point3<f64>> {
        let z = f64::from(self.depth_at(u, v)?);
        Some(self.intrinsics.unproject(f64::from(u), f64::from(v), z))
    }

    /// A number that changes with the depth image (every 7th pixel is looked at), to notice a depth
    /// image that was sent twice.
    pub(crate) fn depth_fingerprint(&self) -> u64 {
        self.depth.data.iter().step_by(7).fold(0xcbf2_9ce4_8422_2325, |h, z| {
            (h ^ u64::from(z.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }

    /// As [`Self::depth_fingerprint`], for the colour image.
    pub(crate) fn color_fingerprint(&self) -> u64 {
        self.color.as_raw().iter().step_by(23).fold(0xcbf2_9ce4_8422_2325, |h, c| {
            (h ^ u64::from(*c)).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(depth: f32) -> RgbdFrame {
        let k = Intrinsics { width: 20, height: 10, fx: 20.0, fy: 20.0, cx: 9.5, cy: 4.5 };
        RgbdFrame {
            stamp: Stamp(0),
            color: RgbImage::new(20, 10),
            depth: DepthImage { width: 20, height: 10, data: vec![depth; 200] },
            intrinsics: k,
        }
    }

    #[test]
    fn sizes_and_numbers_are_checked() {
        assert!(matches!(frame(1.0).check(), Ok(DepthStatus::Good { .. })));
        for bad in [0.0, f32::NAN, f32::INFINITY, -1.0] {
            assert_eq!(frame(bad).check(), Ok(DepthStatus::Empty));
        }
        let mut f = frame(1.0);
        f.color = RgbImage::new(19, 10);
        assert!(matches!(f.check(), Err(FrameError::Size { what: "colour image", .. })));
        let mut f = frame(1.0);
        f.depth.data.pop();
        assert!(matches!(f.check(), Err(FrameError::Truncated { got: 199, want: 200 })));
        let mut f = frame(1.0);
        f.intrinsics.fx = 0.0;
        assert!(matches!(f.check(), Err(FrameError::Intrinsics { field: "fx", .. })));
    }
}
