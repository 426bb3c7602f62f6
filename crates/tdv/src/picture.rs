//! Overlays and animated pictures.

use anyhow::Context as _;
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, Rgb, RgbaImage};
use std::fs::File;
use std::path::Path;
use tdv_geometry::nalgebra::Point3;
use tdv_perception::hands::HandObservation;
use tdv_perception::{PerceptionOutput, RgbdFrame};
use tdv_rendering::RgbImage;

/// Bones of a hand as pairs of joints, OpenPose order.
const BONES: [(usize, usize); 20] = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 4),
    (0, 5),
    (5, 6),
    (6, 7),
    (7, 8),
    (0, 9),
    (9, 10),
    (10, 11),
    (11, 12),
    (0, 13),
    (13, 14),
    (14, 15),
    (15, 16),
    (0, 17),
    (17, 18),
    (18, 19),
    (19, 20),
];

const AXES: [Rgb<u8>; 3] = [Rgb([230, 60, 50]), Rgb([60, 200, 80]), Rgb([70, 120, 255])];
const OUTLINE: Rgb<u8> = Rgb([255, 220, 0]);
const HAND: Rgb<u8> = Rgb([255, 80, 220]);

/// A line of two pixels' width.
fn line(image: &mut RgbImage, a: (f64, f64), b: (f64, f64), color: Rgb<u8>) {
    let steps = (b.0 - a.0).abs().max((b.1 - a.1).abs()).clamp(1.0, 4000.0);
    for i in 0..=steps as usize {
        let t = i as f64 / steps;
        let (x, y) = (a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1));
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)] {
            let (x, y) = ((x + dx).round(), (y + dy).round());
            if x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height())
            {
                image.put_pixel(x as u32, y as u32, color);
            }
        }
    }
}

/// The frame with mask outlines, object axes and hand joints.
pub fn overlay(
    frame: &RgbdFrame,
    seen: &PerceptionOutput,
    hand: Option<&HandObservation>,
) -> RgbImage {
    let mut image = frame.color.clone();
    let (w, h) = (image.width() as usize, image.height() as usize);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let at = |x: usize, y: usize| seen.masks.get(y * w + x).copied().unwrap_or(0);
            let m = at(x, y);
            if m != 0
                && [at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1)].iter().any(|n| *n != m)
            {
                image.put_pixel(x as u32, y as u32, OUTLINE);
            }
        }
    }
    for d in seen.detections.iter().filter(|d| d.found) {
        let project = |p: Point3<f64>| frame.intrinsics.project(&(d.pose * p));
        if let Some(origin) = project(Point3::origin()) {
            for (i, color) in AXES.into_iter().enumerate() {
                let mut tip = Point3::origin();
                tip[i] = 0.06;
                if let Some(tip) = project(tip) {
                    line(&mut image, origin, tip, color);
                }
            }
        }
    }
    if let Some(hand) = hand {
        for (a, b) in BONES {
            line(&mut image, hand.pixels[a], hand.pixels[b], HAND);
        }
    }
    image
}

/// Writes pictures as an animated GIF, under a temporary name first.
pub fn save_gif(path: &Path, pictures: &[RgbImage], delay_ms: u32) -> anyhow::Result<()> {
    let partial = path.with_extension("gif.partial");
    let file = File::create(&partial).with_context(|| partial.display().to_string())?;
    let mut encoder = GifEncoder::new_with_speed(std::io::BufWriter::new(file), 20);
    encoder.set_repeat(Repeat::Infinite)?;
    for p in pictures {
        let rgba = RgbaImage::from_fn(p.width(), p.height(), |x, y| {
            let [r, g, b] = p.get_pixel(x, y).0;
            image::Rgba([r, g, b, 255])
        });
        encoder.encode_frame(Frame::from_parts(
            rgba,
            0,
            0,
            Delay::from_numer_denom_ms(delay_ms, 1),
        ))?;
    }
    drop(encoder);
    std::fs::rename(&partial, path).with_context(|| path.display().to_string())
}
