//! The square windows that the networks look through, and what is seen in them.

use super::depth_filter::NEAREST_M;
use nalgebra::{Point3, Vector3};
use tdv_rendering::{DepthImage, Intrinsics, RgbImage};

/// A square part of the camera image, in its pixels (edges, at whole pixels).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Left edge.
    pub left: f64,
    /// Upper edge.
    pub top: f64,
    /// Width and height, at least 1.
    pub side: f64,
}

impl Window {
    /// The window round a point (m, camera frame) that reaches `reach` (m) to each side; `None`
    /// unless all of it lies in front of the camera.
    pub fn around(centre: &Point3<f64>, reach: f64, k: &Intrinsics) -> Option<Self> {
        if !(reach > 0.0 && centre.z > reach * 0.1) {
            return None;
        }
        let (u, v) = k.project(centre)?;
        let mut radius = 0.0f64;
        for axis in [Vector3::x(), Vector3::y()] {
            for sign in [-reach, reach] {
                let (a, b) = k.project(&(centre + axis * sign))?;
                radius = radius.max((a - u).abs()).max((b - v).abs());
            }
        }
        let (left, top) = ((u - radius).round(), (v - radius).round());
        let side = ((u + radius).round() - left).max(1.0);
        let window = Self { left, top, side };
        [u, v, side].iter().all(|x| x.is_finite() && x.abs() < 1e6).then_some(window)
    }

    /// The camera whose image of `size` x `size` pixels is this window; border falls on border.
    pub fn camera(&self, k: &Intrinsics, size: u32) -> Intrinsics {
        let s = f64::from(size) / self.side;
        // The networks learned from renderings whose first pixel's centre lies half a pixel inside
        // the window's edge, ours at the integer.
        Intrinsics {
            width: size,
            height: size,
            fx: k.fx * s,
            fy: k.fy * s,
            cx: (k.cx - self.left) * s - 0.5,
            cy: (k.cy - self.top) * s - 0.5,
        }
    }

    /// The image position that the window's pixel (x, y) of `size` shows. Camera crops are sampled at
    /// the pixels' corners, as those that the networks learned from were.
    pub fn source(&self, x: u32, y: u32, size: u32) -> (f64, f64) {
        let s = self.side / f64::from(size);
        (self.left + f64::from(x) * s, self.top + f64::from(y) * s)
    }
}

/// How points become a network's channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normal {
    /// The hypothesis (m, camera frame) that becomes the origin.
    pub origin: Vector3<f64>,
    /// Length (m) that becomes 1: half of the mesh diameter.
    pub radius: f64,
    /// Points nearer than this (m) count as none.
    pub nearest: f64,
}

/// Coordinates from here on (radii) count as none.
const FARTHEST: f32 = 2.0;

impl Normal {
    /// Channels x, y, z of a point.
    pub fn channels(&self, p: &Point3<f64>) -> [f32; 3] {
        if p.z.is_nan() || p.z < self.nearest {
            return [0.0; 3];
        }
        let d = (p.coords - self.origin) / self.radius;
        std::array::from_fn(|i| {
            let v = d[i] as f32;
            if v.abs() < FARTHEST { v } else { 0.0 }
        })
    }
}

/// A picture ready for a network: 6 planes of `size` x `size`, colour 0..1 and normalised xyz.
pub fn observed(
    color: &RgbImage,
    depth: &DepthImage,
    k: &Intrinsics,
    window: &Window,
    normal: &Normal,
    size: u32,
) -> Vec<f32> {
    let plane = size as usize * size as usize;
    let mut out = vec![0.0; 6 * plane];
    for y in 0..size {
        for x in 0..size {
            let i = y as usize * size as usize + x as usize;
            let (u, v) = window.source(x, y, size);
            for (c, value) in bilinear(color, u, v).into_iter().enumerate() {
                out[c * plane + i] = value;
            }
            let (nu, nv) = (u.round() as i32, v.round() as i32);
            let Some(z) = depth.get(nu, nv).filter(|z| *z >= NEAREST_M) else { continue };
            let p = k.unproject(f64::from(nu), f64::from(nv), f64::from(z));
            for (c, value) in normal.channels(&p).into_iter().enumerate() {
                out[(3 + c) * plane + i] = value;
            }
        }
    }
    out
}

/// Colour 0..1 between four pixels; black outside the image.
fn bilinear(image: &RgbImage, u: f64, v: f64) -> [f32; 3] {
    let (u0, v0) = (u.floor(), v.floor());
    let (fu, fv) = ((u - u0) as f32, (v - v0) as f32);
    let mut out = [0.0; 3];
    for (dx, dy, weight) in [
        (0.0, 0.0, (1.0 - fu) * (1.0 - fv)),
        (1.0, 0.0, fu * (1.0 - fv)),
        (0.0, 1.0, (1.0 - fu) * fv),
        (1.0, 1.0, fu * fv),
    ] {
        let (x, y) = (u0 + dx, v0 + dy);
        if weight <= 0.0 || x < 0.0 || y < 0.0 {
            continue;
        }
        if let Some(pixel) = image.get_pixel_checked(x as u32, y as u32) {
            for (o, c) in out.iter_mut().zip(pixel.0) {
                *o += weight * f32::from(c) / 255.0;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: Intrinsics =
        Intrinsics { width: 640, height: 480, fx: 610.0, fy: 600.0, cx: 319.5, cy: 239.5 };

    #[test]
    fn a_window_holds_its_sphere_and_its_camera_agrees_with_it() {
        let centre = Point3::new(0.12, -0.07, 0.8);
        let w = Window::around(&centre, 0.06, &K).unwrap();
        assert_eq!((w.left.fract(), w.top.fract(), w.side.fract()), (0.0, 0.0, 0.0));
        assert!((w.side - 2.0 * 0.06 * 610.0 / 0.8).abs() < 2.0, "{w:?}");
        let crop = w.camera(&K, 160);
        // A window's border is the crop's border, and both see the same ray.
        for (u, v) in [(w.left, w.top), (w.left + w.side, w.top + 0.3 * w.side)] {
            let s = 160.0 / w.side;
            let (x, y) = ((u - w.left) * s - 0.5, (v - w.top) * s - 0.5);
            assert!((crop.ray(x, y) - K.ray(u, v)).norm() < 1e-12);
        }
        let (u, v) = crop.project(&centre).unwrap();
        assert!((u - 79.5).abs() < 2.0 && (v - 79.5).abs() < 2.0, "{u} {v}");
        assert_eq!(w.source(0, 0, 160), (w.left, w.top));
        assert_eq!(w.source(160, 160, 160), (w.left + w.side, w.top + w.side));
        assert!(Window::around(&Point3::new(0.0, 0.0, -0.5), 0.06, &K).is_none());
        assert!(Window::around(&Point3::new(0.0, 0.0, f64::NAN), 0.06, &K).is_none());
    }

    #[test]
    fn points_come_back_from_the_channels() {
        let mut depth = DepthImage::new(640, 480);
        depth.data.fill(0.8);
        depth.data[0] = f32::NAN;
        let color =
            RgbImage::from_fn(640, 480, |x, y| image_pixel((x % 256) as u8, (y % 256) as u8));
        let centre = Point3::new(0.1, -0.05, 0.8);
        let window = Window::around(&centre, 0.06, &K).unwrap();
        let normal = Normal { origin: centre.coords, radius: 0.05, nearest: 0.001 };
        let size = 40;
        let out = observed(&color, &depth, &K, &window, &normal, size);
        let plane = (size * size) as usize;
        for (x, y) in [(0, 0), (20, 17), (39, 39)] {
            let i = (y * size + x) as usize;
            let (u, v) = window.source(x, y, size);
            let p = K.unproject(u.round(), v.round(), 0.8);
            for c in 0..3 {
                let back = f64::from(out[(3 + c) * plane + i]) * 0.05 + centre[c];
                assert!((back - p[c]).abs() < 1e-7, "{x} {y} {c}");
            }
            assert!((f64::from(out[i]) * 255.0 - u % 256.0).abs() < 1e-3);
            assert!((f64::from(out[plane + i]) * 255.0 - v % 256.0).abs() < 1e-3);
        }
        // Too near, and farther than two radii: nothing.
        assert_eq!(normal.channels(&Point3::new(0.1, -0.05, 0.0005)), [0.0; 3]);
        assert_eq!(normal.channels(&Point3::new(0.1, 0.06, 0.8)), [0.0; 3]);
        assert!(normal.channels(&Point3::new(0.1, 0.04, 0.8))[1] > 1.7);
        // A window beside the image is black and empty, not a panic.
        let off = Window { left: -500.0, top: 900.0, side: 80.0 };
        assert!(observed(&color, &depth, &K, &off, &normal, 16).iter().all(|v| *v == 0.0));
    }

    fn image_pixel(r: u8, g: u8) -> tdv_rendering::Rgb<u8> {
        tdv_rendering::Rgb([r, g, 0])
    }
}
