//! From 21 pixels to 21 points in space.
//!
//! The landmark network knows the hand's shape (joints in metres, for a hand of average size) but
//! not how far away it is, and where fingers point along the line of sight it is often wrong by
//! centimetres. The depth image knows distances, but only of surfaces, with holes, flying pixels at
//! edges, and other things in front of the hand. So every joint may stand anywhere along the ray
//! through its pixel, and the depths are chosen together, as the cheapest set under three costs:
//!
//! - a joint's skin should be where the readings round its pixel are; hidden behind something is
//!   dearer, and dearest is a joint that the camera would have to look through;
//! - bones should have the length that they have in the network's shape, times the hand's size;
//! - one end of a bone should be as much nearer than the other as in the network's shape.
//!
//! The bones form a tree, so dynamic programming over a grid of depths finds the exact optimum; it
//! is repeated for several sizes of the hand. Joints with readings are then put exactly behind
//! them: readings stand on the skin, the joint's centre lies [`HALF_THICKNESS`] deeper.

use nalgebra::{Point3, Rotation3, Vector3};
use tdv_rendering::{DepthImage, Intrinsics};

use super::landmark::JOINTS;

/// How far a joint's centre lies behind the skin that the camera sees, metres, for a hand of
/// average size. Half of the usual thickness of an adult's wrist, thumb and fingers there.
pub const HALF_THICKNESS: [f64; JOINTS] = [
    0.018, 0.015, 0.012, 0.010, 0.007, //
    0.013, 0.009, 0.008, 0.006, //
    0.013, 0.009, 0.008, 0.006, //
    0.013, 0.009, 0.008, 0.006, //
    0.012, 0.008, 0.007, 0.006,
];

/// The joint that each joint hangs on; the wrist on itself. Parents come first.
pub(super) const PARENT: [usize; JOINTS] =
    [0, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19];

/// Grid of depths: step and longest extent, metres.
const STEP: f64 = 0.005;
const EXTENT: f64 = 0.36;
/// Sizes of the hand that are tried (1 = the network's), and the spread of ln(size) among adults.
const SIZES: [f64; 6] = [0.8, 0.88, 0.96, 1.05, 1.15, 1.26];
const SIGMA_SIZE: f64 = 0.12;
/// Readings this close to the expected skin belong to it, in front of or behind it not, metres.
const SKIN: f64 = 0.010;
const APART: f64 = 0.015;
/// Depth readings that are taken for readings at all, metres.
const RANGE: std::ops::RangeInclusive<f64> = 0.1..=8.0;
/// Least number of joints with a reading.
const LEAST_READINGS: usize = 4;

/// Joints in space.
#[derive(Clone, Debug, PartialEq)]
pub struct Lifted {
    /// Joint centres in the camera's optical frame, metres.
    pub joints: [Point3<f64>; JOINTS],
    /// Which joints a depth reading confirms; the others follow from the hand's shape.
    pub measured: [bool; JOINTS],
    /// Size of the hand against the network's shape.
    pub size: f64,
}

/// Places the network's hand in space. `pixels`: joints in the image (pixel centres at integer
/// coordinates); `shape`: the network's joints in metres, axes parallel to the camera's; `depth`:
/// metres along the optical axis, 0 = no reading, same size as the image of `k`.
///
/// `None` if fewer than four joints have depth readings, or if pixels or shape are no hand (not
/// finite, no extent).
#[must_use]
pub fn lift(
    pixels: &[(f64, f64); JOINTS],
    shape: &[Vector3<f64>; JOINTS],
    depth: &DepthImage,
    k: &Intrinsics,
) -> Option<Lifted> {
    let hand = Hand::new(pixels, shape, depth, k)?;
    let mut best: Option<(f64, f64, [usize; JOINTS])> = None;
    for size in SIZES {
        let (cost, choice) = hand.cheapest(size);
        let cost = cost + 0.5 * (size.ln() / SIGMA_SIZE).powi(2);
        if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, size, choice));
        }
    }
    let (_, size, choice) = best?;
    Some(hand.settle(size, &choice)).filter(|lifted| {
        lifted.measured.iter().filter(|measured| **measured).count() >= LEAST_READINGS
    })
}

/// What is known before depths are chosen.
struct Hand {
    /// Directions through the pixels, z = 1.
    rays: [Vector3<f64>; JOINTS],
    /// The network's shape, turned as seen along the line of sight.
    shape: [Vector3<f64>; JOINTS],
    /// Depth readings round each joint's pixel, sorted, metres.
    readings: [Vec<f64>; JOINTS],
    /// How likely each joint is to be seen, by the network's shape.
    visible: [f64; JOINTS],
    /// Depths to choose from, metres.
    grid: Vec<f64>,
    /// Uncertainty of a length across the line of sight from that of the pixels, metres.
    blur: f64,
}

impl Hand {
    fn new(
        pixels: &[(f64, f64); JOINTS],
        shape: &[Vector3<f64>; JOINTS],
        depth: &DepthImage,
        k: &Intrinsics,
    ) -> Option<Self> {
        let finite = pixels.iter().all(|(u, v)| u.is_finite() && v.is_finite())
            && shape.iter().all(|p| p.iter().all(|value| value.is_finite()));
        let extent = (shape[9] - shape[0]).norm();
        let spread =
            pixels.iter().map(|p| (p.0 - pixels[0].0).hypot(p.1 - pixels[0].1)).fold(0.0, f64::max);
        if !finite || extent < 0.02 || spread < 8.0 {
            return None;
        }
        let nearby = pixels.map(|pixel| {
            let mut readings = window(depth, pixel, 2.0);
            middle(&mut readings)
        });
        let (near, far) = densest(nearby.into_iter().flatten().collect())?;
        let steps = ((far - near) / STEP).ceil() as usize;
        let grid = (0..=steps).map(|i| near + i as f64 * STEP).collect();

        // The network describes the hand as if it stood in the middle of the image.
        let middle_ray =
            pixels.iter().map(|(u, v)| k.ray(*u, *v) / JOINTS as f64).sum::<Vector3<f64>>();
        let turn = Rotation3::rotation_between(&Vector3::z(), &middle_ray)?;
        let shape = shape.map(|p| turn * p);
        let scale = k.fx / near;
        let readings = std::array::from_fn(|i| {
            let radius = (0.8 * HALF_THICKNESS[i] * scale).clamp(2.0, 12.0);
            let mut readings = window(depth, pixels[i], radius);
            readings.sort_by(f64::total_cmp);
            readings
        });
        let visible =
            std::array::from_fn(|i| if is_covered(i, pixels, &shape, scale) { 0.3 } else { 0.75 });
        let rays = pixels.map(|(u, v)| k.ray(u, v));
        // The network's pixels are good to about two hundredths of the hand.
        let blur = 0.02 * spread * near / k.fx;
        Some(Self { rays, shape, readings, visible, grid, blur })
    }

    /// Cost of joint `i` standing at depth `z`.
    fn joint_cost(&self, i: usize, z: f64, size: f64) -> f64 {
        let skin = z - HALF_THICKNESS[i] * size;
        let readings = &self.readings[i];
        if readings.is_empty() {
            return -f64::ln(0.12);
        }
        let count = readings.len() as f64;
        let below = |limit: f64| readings.partition_point(|reading| *reading < limit);
        let (first, last) = (below(skin - SKIN), below(skin + SKIN));
        let on = readings[first..last].iter().map(|r| 1.0 - (r - skin).abs() / SKIN).sum::<f64>();
        let before = below(skin - APART) as f64;
        let behind = count - below(skin + APART) as f64;
        let visible = self.visible[i];
        // Readings that scatter over half of the skin's width already count in full.
        let on = (2.0 * on / count).min(1.0);
        -f64::ln(
            0.02 + visible * on + 0.13 / (0.2 + visible) * before / count + 0.03 * behind / count,
        )
    }

    /// Cost of the bone from joint `a` at depth `za` to joint `b` at `zb`.
    fn bone_cost(&self, (a, za): (usize, f64), (b, zb): (usize, f64), size: f64) -> f64 {
        let expected = (self.shape[b] - self.shape[a]) * size;
        let length = expected.norm();
        let off = (self.rays[b] * zb - self.rays[a] * za).norm() - length;
        let slant = zb - za - expected.z;
        let sigma_length = 0.12 * length + self.blur;
        let sigma_slant = 0.30 * length + 0.004;
        (0.5 * (off / sigma_length).powi(2)).min(8.0)
            + (0.5 * (slant / sigma_slant).powi(2)).min(2.5)
    }

    /// The cheapest depths (grid indices) for a hand of `size`, and their cost.
    fn cheapest(&self, size: f64) -> (f64, [usize; JOINTS]) {
        let count = self.grid.len();
        let mut cost: [Vec<f64>; JOINTS] = std::array::from_fn(|i| {
            self.grid.iter().map(|z| self.joint_cost(i, *z, size)).collect()
        });
        // For each joint and each depth of its parent, the joint's best depth.
        let mut best: [Vec<usize>; JOINTS] = std::array::from_fn(|_| vec![0; count]);
        for child in (1..JOINTS).rev() {
            let parent = PARENT[child];
            let branch = std::mem::take(&mut cost[child]);
            for (i, z) in self.grid.iter().enumerate() {
                let (mut least, mut place) = (f64::MAX, 0);
                for (j, zc) in self.grid.iter().enumerate() {
                    // The bone only adds to it.
                    if branch[j] < least {
                        let sum = branch[j] + self.bone_cost((parent, *z), (child, *zc), size);
                        if sum < least {
                            (least, place) = (sum, j);
                        }
                    }
                }
                cost[parent][i] += least;
                best[child][i] = place;
            }
        }
        let mut choice = [0; JOINTS];
        let root = cost[0].iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
        let (place, least) = root.map_or((0, f64::MAX), |(place, least)| (place, *least));
        choice[0] = place;
        for child in 1..JOINTS {
            choice[child] = best[child][choice[PARENT[child]]];
        }
        (least, choice)
    }

    /// From grid depths to final ones.
    fn settle(&self, size: f64, choice: &[usize; JOINTS]) -> Lifted {
        let mut measured = [false; JOINTS];
        let joints = std::array::from_fn(|i| {
            let z = self.grid[choice[i]];
            let thickness = HALF_THICKNESS[i] * size;
            let near = |reading: &&f64| (*reading - (z - thickness)).abs() < SKIN;
            let mut on: Vec<f64> = self.readings[i].iter().filter(near).copied().collect();
            measured[i] = 4 * on.len() > self.readings[i].len();
            let z = match middle(&mut on) {
                Some(skin) if measured[i] => skin + thickness,
                _ => z,
            };
            Point3::from(self.rays[i] * z)
        });
        Lifted { joints, measured, size }
    }
}

/// Whether by the network's shape another bone stands in front of joint `i`. `scale`: pixels per
/// metre.
fn is_covered(
    i: usize,
    pixels: &[(f64, f64); JOINTS],
    shape: &[Vector3<f64>; JOINTS],
    scale: f64,
) -> bool {
    (1..JOINTS).any(|b| {
        let a = PARENT[b];
        if a == i || b == i {
            return false;
        }
        let (dx, dy) = (pixels[b].0 - pixels[a].0, pixels[b].1 - pixels[a].1);
        let (px, py) = (pixels[i].0 - pixels[a].0, pixels[i].1 - pixels[a].1);
        let along = ((px * dx + py * dy) / (dx * dx + dy * dy).max(1e-9)).clamp(0.0, 1.0);
        let away = (px - along * dx).hypot(py - along * dy);
        let z = shape[a].z * (1.0 - along) + shape[b].z * along;
        let thick = HALF_THICKNESS[a] * (1.0 - along) + HALF_THICKNESS[b] * along;
        z < shape[i].z - 0.012 && away < thick * scale
    })
}

/// The range of depths, of at most [`EXTENT`], that holds the most of the readings; nothing if
/// there are too few.
fn densest(mut readings: Vec<f64>) -> Option<(f64, f64)> {
    readings.sort_by(f64::total_cmp);
    // Room for skin and for joints behind what is seen.
    let (front, back) = (0.02, 0.10);
    let inside = |near: f64| {
        let last = readings.partition_point(|r| *r < near + EXTENT - front - back);
        let first = readings.partition_point(|r| *r < near);
        (first, last)
    };
    let near = readings.iter().copied().max_by_key(|near| {
        let (first, last) = inside(*near);
        // The nearer of two equal ones: the hand is in front of the background.
        (last - first, usize::MAX - first)
    })?;
    let (first, last) = inside(near);
    if last - first < LEAST_READINGS {
        return None;
    }
    Some((near - front, readings[last - 1] + back))
}

/// The valid readings within `radius` pixels.
fn window(depth: &DepthImage, pixel: (f64, f64), radius: f64) -> Vec<f64> {
    let mut readings = Vec::new();
    let (width, height) = (f64::from(depth.width), f64::from(depth.height));
    let range = |centre: f64, size: f64| {
        let low = (centre - radius).ceil().clamp(0.0, size);
        let high = (centre + radius).floor().clamp(-1.0, size - 1.0);
        low as i64..=high as i64
    };
    for y in range(pixel.1, height) {
        for x in range(pixel.0, width) {
            let away = (x as f64 - pixel.0).hypot(y as f64 - pixel.1);
            let at = y as usize * depth.width as usize + x as usize;
            let reading = depth.data.get(at).map_or(0.0, |reading| f64::from(*reading));
            if away <= radius && RANGE.contains(&reading) {
                readings.push(reading);
            }
        }
    }
    readings
}

fn middle(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests;
