//! A picture for people: the camera's image with each object's outline and axes, and what is known about
//! it in words.

mod font;

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::perceiver::{Detection, PerceptionOutput};
use font::{ADVANCE, LINE, glyph};
use nalgebra::{Point3, Vector3};
use std::sync::Arc;
use tdv_rendering::{Intrinsics, RgbImage};

/// Outline colours, by label.
const COLORS: [[u8; 3]; 6] = [
    [255, 220, 0],
    [0, 230, 230],
    [255, 110, 220],
    [140, 255, 90],
    [255, 150, 50],
    [170, 160, 255],
];
/// x, y, z.
const AXES: [[u8; 3]; 3] = [[235, 60, 50], [60, 205, 80], [70, 120, 255]];
const NOT_SEEN: [u8; 3] = [255, 120, 110];
/// Width (px) of an outline and of an axis.
const PEN: i32 = 2;
/// Size of a letter's pixel.
const SCALE: i32 = 2;

/// Draws a frame's result; `status` is the first line. Axes are as long as the object's radius, at least 4 cm.
pub fn draw(
    frame: &RgbdFrame,
    output: &PerceptionOutput,
    models: &[Arc<ObjectModel>],
    status: &str,
) -> RgbImage {
    let mut picture = frame.color.clone();
    outline(&mut picture, &output.masks);
    for d in output.detections.iter().filter(|d| d.found) {
        let model = models.iter().find(|m| m.name == d.name);
        let length = model.map_or(0.05, |m| m.radius.max(0.04));
        axes(&mut picture, &frame.intrinsics, d, length);
    }
    let mut lines = vec![(status.to_owned(), [255; 3])];
    for (i, d) in output.detections.iter().enumerate() {
        let note = if d.reason.is_empty() { String::new() } else { format!(": {}", d.reason) };
        lines.push(if d.found {
            let p = d.pose.translation;
            let state = format!("{} {:.0} % at {:.3} m{note}", d.name, 100.0 * d.confidence, p.z);
            (state, COLORS[i % COLORS.len()])
        } else {
            (format!("{} not seen{note}", d.name), NOT_SEEN)
        });
    }
    let wide = (picture.width() as i32 / (ADVANCE * SCALE) - 1).max(8) as usize;
    let mut y = 4;
    for (line, color) in lines {
        for part in wrapped(&line, wide) {
            text(&mut picture, 4, y, &part, color);
            y += LINE * SCALE;
        }
    }
    picture
}

/// A line broken at blanks so that no part is longer than `wide`, as long as words allow.
fn wrapped(line: &str, wide: usize) -> Vec<String> {
    let mut out = vec![String::new()];
    for word in line.split(' ') {
        let last = out.len() - 1;
        let used = out[last].chars().count();
        if used > 0 && used + 1 + word.chars().count() > wide {
            out.push(format!("  {word}"));
        } else {
            if used > 0 {
                out[last].push(' ');
            }
            out[last].push_str(word);
        }
    }
    out
}

fn dot(picture: &mut RgbImage, x: i32, y: i32, pen: i32, color: [u8; 3]) {
    let (w, h) = (picture.width() as i32, picture.height() as i32);
    for (u, v) in
        (y..y.saturating_add(pen)).flat_map(|v| (x..x.saturating_add(pen)).map(move |u| (u, v)))
    {
        if (0..w).contains(&u) && (0..h).contains(&v) {
            picture.get_pixel_mut(u as u32, v as u32).0 = color;
        }
    }
}

/// Marks the pixels of each label that touch another one.
fn outline(picture: &mut RgbImage, labels: &[u8]) {
    let (w, h) = (picture.width() as usize, picture.height() as usize);
    if labels.len() != w * h {
        return;
    }
    for y in 0..h {
        for x in 0..w {
            let label = labels[y * w + x];
            let other = |dx: usize, dy: usize| {
                x + dx >= 1
                    && y + dy >= 1
                    && x + dx <= w
                    && y + dy <= h
                    && labels[(y + dy - 1) * w + x + dx - 1] != label
            };
            if label > 0 && (other(0, 1) || other(2, 1) || other(1, 0) || other(1, 2)) {
                let color = COLORS[(usize::from(label) - 1) % COLORS.len()];
                dot(picture, x as i32, y as i32, PEN, color);
            }
        }
    }
}

fn axes(picture: &mut RgbImage, k: &Intrinsics, detection: &Detection, length: f64) {
    let mut ends: Vec<(Point3<f64>, [u8; 3])> = (0..3)
        .map(|i| {
            let along = Vector3::ith(i, length);
            (detection.pose * Point3::from(along), AXES[i])
        })
        .collect();
    // The nearest axis is drawn last, over the others.
    ends.sort_by(|a, b| b.0.z.total_cmp(&a.0.z));
    let Some((u0, v0)) = k.project(&Point3::from(detection.pose.translation.vector)) else {
        return;
    };
    for (end, color) in ends {
        if let Some((u1, v1)) = k.project(&end) {
            line(picture, (u0, v0), (u1, v1), color);
        }
    }
}

fn line(picture: &mut RgbImage, from: (f64, f64), to: (f64, f64), color: [u8; 3]) {
    let (du, dv) = (to.0 - from.0, to.1 - from.1);
    // A point just in front of the camera projects very far away; nobody needs that line whole.
    let steps = du.abs().max(dv.abs()).ceil().clamp(1.0, 4000.0);
    for i in 0..=steps as i32 {
        let t = f64::from(i) / steps;
        dot(picture, (from.0 + t * du) as i32, (from.1 + t * dv) as i32, PEN, color);
    }
}

/// Letters on a dark ground, so that they can be read on any image.
fn text(picture: &mut RgbImage, x: i32, y: i32, line: &str, color: [u8; 3]) {
    let (w, h) = (picture.width() as i32, picture.height() as i32);
    let right = (x + line.chars().count() as i32 * ADVANCE * SCALE).min(w);
    for v in (y - 2).max(0)..(y + 8 * SCALE).min(h) {
        for u in (x - 2).max(0)..right {
            let pixel = picture.get_pixel_mut(u as u32, v as u32);
            pixel.0 = pixel.0.map(|c| c / 3);
        }
    }
    for (i, c) in line.chars().enumerate() {
        for (row, bits) in (0..).zip(glyph(c)) {
            for column in (0..5).filter(|column| (bits >> (4 - column)) & 1 == 1) {
                let u = x + (i as i32 * ADVANCE + column) * SCALE;
                dot(picture, u, y + row * SCALE, SCALE, color);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perceiver::{Perceiver, PerceiverConfig};
    use crate::testing::{Lab, coaster_model, mug_model, upright};

    #[test]
    fn outline_axes_and_words_are_where_the_object_is() {
        let (mug, coaster) = (mug_model(), coaster_model());
        let frame = Lab::new(3).frame(&[(&mug.mesh, upright(0.45, 0.05, 0.0, 0.8))]);
        let mut perceiver = Perceiver::new(PerceiverConfig::default(), vec![mug, coaster]);
        let models: Vec<_> = perceiver.models().collect();
        let output = perceiver.step(&frame).unwrap();
        assert!(output.detections[0].found && !output.detections[1].found);
        let picture = draw(&frame, &output, &models, "classical, 12 ms");
        if let Some(file) = std::env::var_os("TDV_OVERLAY_PNG") {
            picture.save(file).unwrap();
        }
        let count = |color: [u8; 3]| picture.pixels().filter(|p| p.0 == color).count();
        assert!(count(COLORS[0]) > 300, "{}", count(COLORS[0]));
        assert!(AXES.iter().all(|a| count(*a) > 20));
        assert!(count(NOT_SEEN) > 100, "the coaster's line");
        let (u, v) = frame
            .intrinsics
            .project(&Point3::from(output.detections[0].pose.translation.vector))
            .unwrap();
        let origin = picture.get_pixel(u as u32, v as u32).0;
        assert!(AXES.contains(&origin), "{origin:?}");
    }

    #[test]
    fn long_lines_are_broken_and_odd_input_is_no_harm() {
        assert_eq!(wrapped("aa bb cc", 5), ["aa bb", "  cc"]);
        assert_eq!(wrapped("unbreakable", 4), ["unbreakable"]);
        let mut picture = RgbImage::new(16, 8);
        outline(&mut picture, &[1; 3]);
        text(&mut picture, 4, 4, "é far too long", [255; 3]);
        line(&mut picture, (-1e12, 5.0), (1e12, 5.0), [255; 3]);
        outline(&mut picture, &[0; 128]);
    }
}
