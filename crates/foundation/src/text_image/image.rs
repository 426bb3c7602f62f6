//! Colour images as the networks take them: resized, 0..1, ImageNet's mean and spread taken out.

use image::imageops::{FilterType, resize};
use tdv_rendering::RgbImage;

const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const SPREAD: [f32; 3] = [0.229, 0.224, 0.225];
/// GroundingDINO's shorter side (px), and the most for its longer one.
const SIDES: (f64, f64) = (800.0, 1333.0);

/// Three planes of `width` x `height`; the aspect is not kept.
pub fn planes(color: &RgbImage, width: u32, height: u32) -> Vec<f32> {
    let n = width as usize * height as usize;
    let mut out = vec![0.0; 3 * n];
    // Triangle averages over the source pixels when it shrinks, as the networks' own resizing does.
    let small = resize(color, width, height, FilterType::Triangle);
    for (i, pixel) in small.pixels().enumerate() {
        for c in 0..3 {
            out[c * n + i] = (f32::from(pixel.0[c]) / 255.0 - MEAN[c]) / SPREAD[c];
        }
    }
    out
}

/// The size that GroundingDINO looks at an image of `width` x `height` with.
pub fn detector_size(width: u32, height: u32) -> (u32, u32) {
    let (w, h) = (f64::from(width.max(1)), f64::from(height.max(1)));
    let factor = (SIDES.0 / w.min(h)).min(SIDES.1 / w.max(h));
    let scaled = |v: f64| (v * factor).round().max(1.0) as u32;
    (scaled(w), scaled(h))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_hold_normalised_colour() {
        let image = RgbImage::from_pixel(8, 6, tdv_rendering::Rgb([255, 0, 51]));
        let p = planes(&image, 4, 3);
        assert_eq!(p.len(), 36);
        for (c, value) in [1.0, 0.0, 0.2].into_iter().enumerate() {
            let want = (value - MEAN[c]) / SPREAD[c];
            assert!(p[c * 12..][..12].iter().all(|v| (v - want).abs() < 1e-5));
        }
    }

    #[test]
    fn the_shorter_side_is_800_unless_the_longer_one_gets_too_long() {
        assert_eq!(detector_size(640, 480), (1067, 800));
        assert_eq!(detector_size(480, 640), (800, 1067));
        assert_eq!(detector_size(2000, 400), (1333, 267));
        assert_eq!(detector_size(0, 0), (800, 800));
    }
}
