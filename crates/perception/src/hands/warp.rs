//! Square windows of an image, rotated and scaled, as network input.

use image::RgbImage;

/// What lies outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Border {
    /// Black.
    Zero,
    /// The nearest pixel of the image.
    Nearest,
}

/// A square of an image: centre and side in pixels, and the angle (rad) by which its upright
/// direction is turned clockwise (image y points down) against the image's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Centre (u, v), pixels; pixel centres at integer coordinates.
    pub centre: (f64, f64),
    /// Side, pixels.
    pub side: f64,
    /// Clockwise rotation, rad.
    pub angle: f64,
}

impl Window {
    /// The image pixel at a place of the window given in sides from its upper left corner.
    #[must_use]
    pub fn to_image(&self, x: f64, y: f64) -> (f64, f64) {
        let (dx, dy) = self.turn((x - 0.5) * self.side, (y - 0.5) * self.side);
        (self.centre.0 + dx, self.centre.1 + dy)
    }

    /// Turns a vector of the window's axes into the image's axes.
    #[must_use]
    pub fn turn(&self, x: f64, y: f64) -> (f64, f64) {
        let (sin, cos) = self.angle.sin_cos();
        (cos * x - sin * y, sin * x + cos * y)
    }

    /// Turns a vector of the image's axes into the window's axes.
    #[must_use]
    pub fn turn_back(&self, x: f64, y: f64) -> (f64, f64) {
        let (sin, cos) = self.angle.sin_cos();
        (cos * x + sin * y, cos * y - sin * x)
    }

    /// Whether the window is worth looking at: finite, of a sensible size, centred on the image.
    pub(super) fn is_sensible(&self, width: u32, height: u32) -> bool {
        let (w, h) = (f64::from(width), f64::from(height));
        self.angle.is_finite()
            && (16.0..=4.0 * w.max(h)).contains(&self.side)
            && (0.0..w).contains(&self.centre.0)
            && (0.0..h).contains(&self.centre.1)
    }

    /// Resamples the window to `size` x `size` RGB values in 0..1 (row-major, channels last), by
    /// bilinear interpolation. Where it shrinks the image, several samples per pixel are averaged.
    pub(super) fn sample(&self, image: &RgbImage, size: usize, border: Border, out: &mut [f32]) {
        let (width, height) = (image.width() as i64, image.height() as i64);
        if width == 0 || height == 0 || size == 0 {
            out.fill(0.0);
            return;
        }
        let step = self.side / size as f64;
        let taps = (step.round() as usize).clamp(1, 3);
        let scale = 1.0 / (255.0 * (taps * taps) as f32);
        let (right, down) = (self.turn(step, 0.0), self.turn(0.0, step));
        let origin = self.to_image(0.0, 0.0);
        let source = Source { pixels: image.as_raw(), width, height, border };
        for (i, out) in out.chunks_exact_mut(3).enumerate() {
            let (row, column) = (i / size, i % size);
            let mut sum = [0.0f32; 3];
            for tap in 0..taps * taps {
                let inner = |k: usize| (k as f64 + 0.5) / taps as f64 - 0.5;
                let (x, y) = (column as f64 + inner(tap % taps), row as f64 + inner(tap / taps));
                let u = origin.0 + x * right.0 + y * down.0;
                let v = origin.1 + x * right.1 + y * down.1;
                source.add(u, v, &mut sum);
            }
            for (out, sum) in out.iter_mut().zip(sum) {
                *out = sum * scale;
            }
        }
    }
}

struct Source<'a> {
    pixels: &'a [u8],
    width: i64,
    height: i64,
    border: Border,
}

impl Source<'_> {
    /// Adds the interpolated colour (0..255) at an image position.
    fn add(&self, u: f64, v: f64, sum: &mut [f32; 3]) {
        let (x, y) = (u.floor(), v.floor());
        let (fx, fy) = ((u - x) as f32, (v - y) as f32);
        let (x, y) = (x as i64, y as i64);
        let corners = [
            (x, y, (1.0 - fx) * (1.0 - fy)),
            (x + 1, y, fx * (1.0 - fy)),
            (x, y + 1, (1.0 - fx) * fy),
            (x + 1, y + 1, fx * fy),
        ];
        for (x, y, weight) in corners {
            let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
            if !inside && self.border == Border::Zero {
                continue;
            }
            let (x, y) = (x.clamp(0, self.width - 1), y.clamp(0, self.height - 1));
            let at = 3 * (y * self.width + x) as usize;
            for (sum, value) in sum.iter_mut().zip(&self.pixels[at..at + 3]) {
                *sum += f32::from(*value) * weight;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> RgbImage {
        RgbImage::from_fn(64, 48, |x, y| image::Rgb([4 * x as u8, 5 * y as u8, 7]))
    }

    #[test]
    fn upright_window_copies_the_image() {
        let image = gradient();
        let window = Window { centre: (24.0, 24.0), side: 16.0, angle: 0.0 };
        let mut out = vec![0.0; 16 * 16 * 3];
        window.sample(&image, 16, Border::Zero, &mut out);
        // Window index 0 is image index 16.
        assert!((out[0] - 64.0 / 255.0).abs() < 1e-6 && (out[1] - 80.0 / 255.0).abs() < 1e-6);
        let last = &out[(16 * 16 - 1) * 3..];
        assert!((last[0] - 124.0 / 255.0).abs() < 1e-6 && (last[1] - 155.0 / 255.0).abs() < 1e-6);
    }

    #[test]
    fn shrinking_averages() {
        let image = RgbImage::from_fn(64, 64, |x, y| image::Rgb([255 * ((x + y) % 2) as u8; 3]));
        let window = Window { centre: (32.0, 32.0), side: 32.0, angle: 0.0 };
        let mut out = vec![0.0; 16 * 16 * 3];
        window.sample(&image, 16, Border::Nearest, &mut out);
        assert!(out.iter().all(|value| (value - 0.5).abs() < 1e-5), "{:?}", &out[..9]);
    }

    #[test]
    fn a_quarter_turn_makes_the_right_side_the_upper_one() {
        let window = Window { centre: (10.0, 20.0), side: 8.0, angle: std::f64::consts::FRAC_PI_2 };
        let (u, v) = window.to_image(0.5, 0.0);
        assert!((u - 14.0).abs() < 1e-12 && (v - 20.0).abs() < 1e-12);
        let there = window.turn(1.0, 2.0);
        let back = window.turn_back(there.0, there.1);
        assert!((back.0 - 1.0).abs() < 1e-12 && (back.1 - 2.0).abs() < 1e-12);
    }

    #[test]
    fn outside_is_black_or_the_border() {
        let image = RgbImage::from_pixel(8, 8, image::Rgb([255, 255, 255]));
        let window = Window { centre: (4.0, 4.0), side: 32.0, angle: 0.3 };
        let mut out = vec![0.0; 16 * 16 * 3];
        window.sample(&image, 16, Border::Zero, &mut out);
        assert_eq!(out[0], 0.0);
        window.sample(&image, 16, Border::Nearest, &mut out);
        assert!(out.iter().all(|value| (value - 1.0).abs() < 1e-5));
    }
}
