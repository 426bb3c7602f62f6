//! What happens to a depth image before the networks see it: lone readings go, the rest is smoothed.

use tdv_rendering::DepthImage;

/// Readings nearer than this (m) count as none.
pub const NEAREST_M: f32 = 0.001;
/// Readings from here on (m) count as none.
const FARTHEST_M: f32 = 100.0;
/// Half width (px) of the windows.
const RADIUS: i32 = 2;
/// A neighbour that differs by more (m) does not support a reading,
const SUPPORT_M: f32 = 0.001;
/// and a reading with more than this share of such neighbours goes.
const MOST_BAD: f64 = 0.8;
/// Readings farther than this (m) from the window's mean stay out of the average.
const SAME_SURFACE_M: f64 = 0.01;
/// Spread (px) of the average's weights.
const SPREAD_PX: f64 = 2.0;

fn valid(z: f32) -> bool {
    (NEAREST_M..FARTHEST_M).contains(&z)
}

/// The readings in the window round (x, y) with their offsets; `None` for bad ones.
fn window(
    depth: &DepthImage,
    x: i32,
    y: i32,
) -> impl Iterator<Item = (i32, i32, Option<f32>)> + '_ {
    let (w, h) = (depth.width as i32, depth.height as i32);
    (-RADIUS..=RADIUS).flat_map(move |dy| {
        (-RADIUS..=RADIUS).filter_map(move |dx| {
            let (u, v) = (x + dx, y + dy);
            if u < 0 || v < 0 || u >= w || v >= h {
                return None;
            }
            let z = *depth.data.get((v * w + u) as usize)?;
            Some((dx, dy, valid(z).then_some(z)))
        })
    })
}

fn each(depth: &DepthImage, f: impl Fn(i32, i32) -> f32) -> DepthImage {
    let (w, h) = (depth.width as i32, depth.height as i32);
    let data = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| f(x, y)).collect();
    DepthImage { width: depth.width, height: depth.height, data }
}

/// Removes readings that hardly any neighbour supports (flying pixels at edges).
pub fn erode(depth: &DepthImage) -> DepthImage {
    each(depth, |x, y| {
        let z0 = depth.get(x, y).unwrap_or(0.0);
        if !valid(z0) {
            return 0.0;
        }
        let (mut bad, mut all) = (0, 0);
        for (_, _, z) in window(depth, x, y) {
            all += 1;
            bad += i32::from(z.is_none_or(|z| (z - z0).abs() > SUPPORT_M));
        }
        if f64::from(bad) > MOST_BAD * f64::from(all) { 0.0 } else { z0 }
    })
}

/// Averages over each window's main surface. A hole is filled when its window has readings.
pub fn smooth(depth: &DepthImage) -> DepthImage {
    each(depth, |x, y| {
        let (mut sum, mut count) = (0.0, 0);
        for z in window(depth, x, y).filter_map(|w| w.2) {
            sum += f64::from(z);
            count += 1;
        }
        if count == 0 {
            return 0.0;
        }
        let mean = sum / f64::from(count);
        let (mut sum, mut total) = (0.0, 0.0);
        for (dx, dy, z) in window(depth, x, y) {
            let Some(z) = z.map(f64::from).filter(|z| (z - mean).abs() < SAME_SURFACE_M) else {
                continue;
            };
            let weight = (-f64::from(dx * dx + dy * dy) / (2.0 * SPREAD_PX * SPREAD_PX)).exp();
            sum += weight * z;
            total += weight;
        }
        if total > 0.0 { (sum / total) as f32 } else { 0.0 }
    })
}

/// Both, in their order.
pub fn clean(depth: &DepthImage) -> DepthImage {
    smooth(&erode(depth))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(z: f32) -> DepthImage {
        DepthImage { width: 12, height: 10, data: vec![z; 120] }
    }

    #[test]
    fn a_plane_stays_and_lone_readings_go() {
        let mut d = flat(0.8);
        d.data[5 * 12 + 6] = 0.7;
        let e = erode(&d);
        assert_eq!(e.data[5 * 12 + 6], 0.0, "1 mm is the limit of support");
        assert_eq!(e.data.iter().filter(|z| **z == 0.8).count(), 119);
        // The corner's window is smaller, and all of it agrees.
        assert_eq!(e.data[0], 0.8);
        for bad in [f32::NAN, f32::INFINITY, -1.0, 0.0005, 100.0] {
            assert!(clean(&flat(bad)).data.iter().all(|z| *z == 0.0), "{bad}");
        }
    }

    #[test]
    fn noise_shrinks_holes_close_and_steps_stay() {
        let mut d = flat(0.8);
        for (i, z) in d.data.iter_mut().enumerate() {
            *z += if (i * 7 + i / 12 * 5) % 2 == 0 { 4e-4 } else { -4e-4 };
            if i % 12 >= 6 {
                *z += 0.3;
            }
        }
        d.data[4 * 12 + 2] = 0.0;
        let c = clean(&d);
        assert!((c.data[4 * 12 + 2] - 0.8).abs() < 2e-4, "{}", c.data[4 * 12 + 2]);
        assert!((c.data[4 * 12 + 3] - 0.8).abs() < 1.5e-4);
        // Within two pixels of the step the window's mean lies between both surfaces: no reading is
        // near it, so there is none; nothing floats between the two.
        for z in &c.data {
            let near = |t: f32| (z - t).abs() < 1e-3;
            assert!(*z == 0.0 || near(0.8) || near(1.1), "{z}");
        }
        assert!((c.data[4 * 12 + 10] - 1.1).abs() < 2e-4);
    }
}
