//! Several frames of a scene at rest as one with less noise.

use crate::frame::{RgbdFrame, usable};
use tdv_rendering::{DepthImage, RgbImage};

/// The frames as one: the median of each pixel's depth readings (none where fewer than a third of the
/// frames have one), the mean of its colours. Frames of another size than the first are left out;
/// `None` without any frame.
pub fn average_frames(frames: &[RgbdFrame]) -> Option<RgbdFrame> {
    let first = frames.first().filter(|f| f.check().is_ok())?;
    let same: Vec<&RgbdFrame> =
        frames.iter().filter(|f| f.intrinsics == first.intrinsics && f.check().is_ok()).collect();
    let n = first.depth.data.len();
    let mut depth = DepthImage::new(first.depth.width, first.depth.height);
    let mut readings = Vec::with_capacity(same.len());
    for i in 0..n {
        readings.clear();
        readings.extend(same.iter().filter_map(|f| usable(f.depth.data[i])));
        if readings.is_empty() || readings.len() * 3 < same.len() {
            continue;
        }
        readings.sort_by(f32::total_cmp);
        let middle = readings[readings.len() / 2];
        // The mean of what agrees with the median: finer than the sensor's steps.
        let (mut sum, mut count) = (0.0, 0.0);
        for z in readings.iter().filter(|z| (*z - middle).abs() < 0.01 * middle) {
            sum += z;
            count += 1.0;
        }
        depth.data[i] = sum / count;
    }
    let mut color = RgbImage::new(first.color.width(), first.color.height());
    for (i, c) in color.as_mut().iter_mut().enumerate() {
        let sum: u32 = same.iter().map(|f| u32::from(f.color.as_raw()[i])).sum();
        *c = (sum as f32 / same.len() as f32 + 0.5) as u8;
    }
    Some(RgbdFrame { stamp: first.stamp, color, depth, intrinsics: first.intrinsics })
}
