//! From 21 pixels to 21 points in space.
//!
//! The landmark network knows the hand's shape (joints in metres, for a hand of average size) but
//! not how far away it is; the depth image knows distances, but only of surfaces, with holes,
//! flying pixels at edges, and other things in front of the hand. So:
//!
//! 1. The shape is fitted to the pixels and to the depth readings: rotation, translation and size,
//!    by robust least squares with a narrowing gate on the depth, from several first distances, of
//!    which the most plausible outcome is kept (something may stand in front of the hand, but
//!    nothing is seen through it). Readings stand on the skin; the joint's centre lies
//!    [`HALF_THICKNESS`] behind it.
//! 2. The fit is stiff and the shape is wrong by about a centimetre here and there. What is left
//!    of the readings near the fitted joints is followed joint by joint, smoothly along the bones,
//!    so that a joint without reading moves with its neighbours.

use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, SVector, Vector3};
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

/// The bones: pairs of joints, and the palm's cross links.
pub(super) const BONES: [(usize, usize); 23] = [
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
    (5, 9),
    (9, 13),
    (13, 17),
];

/// Readings further than this from the fitted skin are left out, metres, round by round.
const GATES: [f64; 5] = [0.045, 0.035, 0.03, 0.025, 0.025];
/// Standard deviation of a depth reading against the fitted shape, metres (the shape's own error
/// dominates it).
const SIGMA_FIT: f64 = 0.008;
/// Standard deviation of a landmark, as a part of the hand's size in the image.
const SIGMA_PIXEL: f64 = 0.03;
/// Standard deviation of the network's idea of the orientation, rad, and of the logarithm of size.
const SIGMA_TURN: f64 = 0.35;
const SIGMA_SIZE: f64 = 0.15;
/// Second part: standard deviations of a joint's reading, of the shape's error at a joint, and of
/// the change of that error along a bone, metres.
const SIGMA_READING: f64 = 0.004;
const SIGMA_SHAPE: f64 = 0.015;
const SIGMA_BONE: f64 = 0.007;
/// Depth readings that are taken for readings at all, metres.
const RANGE: std::ops::RangeInclusive<f64> = 0.1..=8.0;
/// Least number of joints with a reading.
const LEAST_READINGS: usize = 4;

/// Joints in space.
#[derive(Clone, Debug, PartialEq)]
pub struct Lifted {
    /// Joint centres in the camera's optical frame, metres.
    pub joints: [Point3<f64>; JOINTS],
    /// Number of joints that a depth reading confirms.
    pub measured: usize,
    /// Size of the hand, 1 = average adult.
    pub size: f64,
}

/// Places the network's hand in space. `pixels`: joints in the image (pixel centres at integer
/// coordinates); `shape`: the network's joints in metres, axes parallel to the camera's; `depth`:
/// metres along the optical axis, 0 = no reading, same size as the image of `k`.
///
/// `None` if fewer than four joints have any depth reading, or if the fit does not come out as a
/// hand (not finite, behind the camera, of less than half or more than twice the usual size).
#[must_use]
pub fn lift(
    pixels: &[(f64, f64); JOINTS],
    shape: &[Vector3<f64>; JOINTS],
    depth: &DepthImage,
    k: &Intrinsics,
) -> Option<Lifted> {
    let mut best: Option<(f64, Fit<'_>)> = None;
    for distance in first_distances(pixels, depth) {
        let Some(mut fit) = Fit::start(pixels, shape, depth, k, distance) else { continue };
        if GATES.iter().all(|gate| fit.refine(*gate).is_some()) {
            let cost = fit.cost();
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, fit));
            }
        }
    }
    let (_, fit) = best?;
    let size = fit.size;
    let (depths, measured) = fit.follow_readings();
    let joints = std::array::from_fn(|i| k.unproject(pixels[i].0, pixels[i].1, depths[i]));
    let sound = measured >= LEAST_READINGS
        && (0.5..=2.0).contains(&size)
        && depths.iter().all(|z| RANGE.contains(z));
    sound.then_some(Lifted { joints, measured, size })
}

/// Distances to start from, metres: quantiles of the readings at the joints and a little behind
/// them, so that one of them is near the hand even if most joints are hidden. Empty if there are
/// too few readings.
fn first_distances(pixels: &[(f64, f64); JOINTS], depth: &DepthImage) -> Vec<f64> {
    let mut readings: Vec<f64> =
        pixels.iter().filter_map(|pixel| median(&mut window(depth, *pixel, 1.5))).collect();
    if readings.len() < LEAST_READINGS {
        return Vec::new();
    }
    readings.sort_by(f64::total_cmp);
    let quantile = |part: f64| readings[(part * (readings.len() - 1) as f64) as usize] + 0.01;
    let mut distances: Vec<f64> = [0.1, 0.3, 0.5, 0.7, 0.9]
        .into_iter()
        .flat_map(|part| [quantile(part), quantile(part) + 0.04])
        .collect();
    distances.sort_by(f64::total_cmp);
    // Fits from nearly the same distance end alike.
    distances.dedup_by(|a, b| (*a - *b).abs() < 0.015);
    distances
}

/// The fit's state: joint i stands at `size * turn * shape[i] + place`.
struct Fit<'a> {
    pixels: &'a [(f64, f64); JOINTS],
    depth: &'a DepthImage,
    k: &'a Intrinsics,
    shape: [Vector3<f64>; JOINTS],
    turn: Rotation3<f64>,
    place: Vector3<f64>,
    size: f64,
    /// The turn at the start, which the network's estimate stands for.
    first_turn: Rotation3<f64>,
    sigma_pixel: f64,
}

impl<'a> Fit<'a> {
    /// First guess at a distance (m); the rest comes from the pixels.
    fn start(
        pixels: &'a [(f64, f64); JOINTS],
        shape: &[Vector3<f64>; JOINTS],
        depth: &'a DepthImage,
        k: &'a Intrinsics,
        distance: f64,
    ) -> Option<Self> {
        let finite = pixels.iter().all(|(u, v)| u.is_finite() && v.is_finite())
            && shape.iter().all(|p| p.iter().all(|value| value.is_finite()));
        if !finite {
            return None;
        }
        let count = JOINTS as f64;
        let middle = pixels.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / count, s.1 + p.1 / count));
        let centre = shape.iter().sum::<Vector3<f64>>() / count;
        let shape = shape.map(|p| p - centre);
        let spread = pixels
            .iter()
            .map(|p| (p.0 - middle.0).powi(2) + (p.1 - middle.1).powi(2))
            .sum::<f64>()
            .sqrt();
        let flat = shape.iter().map(|p| p.xy().norm_squared()).sum::<f64>().sqrt();
        if flat < 1e-3 || spread < 1.0 {
            return None;
        }
        // The network describes the hand as if it stood in the middle of the image.
        let ray = k.ray(middle.0, middle.1);
        let turn = Rotation3::rotation_between(&Vector3::z(), &ray)?;
        let focal = 0.5 * (k.fx + k.fy);
        Some(Self {
            pixels,
            depth,
            k,
            shape,
            turn,
            place: ray * distance,
            size: (spread * distance / focal / flat).clamp(0.6, 1.6),
            first_turn: turn,
            sigma_pixel: (SIGMA_PIXEL * spread / 2.0).max(1.0),
        })
    }

    fn joint(&self, i: usize) -> Vector3<f64> {
        self.turn * self.shape[i] * self.size + self.place
    }

    /// Radius of the patch of skin in front of a joint at distance `z`, pixels.
    fn radius(&self, i: usize, z: f64) -> f64 {
        (0.6 * HALF_THICKNESS[i] * self.size * self.k.fx / z.max(0.1)).clamp(1.5, 12.0)
    }

    /// The readings round a joint's pixel that lie within `gate` of the skin expected there: their
    /// median and their share of the patch.
    fn reading(&self, i: usize, z: f64, gate: f64) -> Option<(f64, f64)> {
        let skin = z - HALF_THICKNESS[i] * self.size;
        let mut readings = window(self.depth, self.pixels[i], self.radius(i, z));
        let all = readings.len();
        readings.retain(|reading| (reading - skin).abs() < gate);
        let share = readings.len() as f64 / all.max(1) as f64;
        median(&mut readings).map(|reading| (reading, share))
    }

    /// A few damped Gauss-Newton steps with readings gated at `gate`.
    fn refine(&mut self, gate: f64) -> Option<()> {
        let readings: [Option<f64>; JOINTS] = std::array::from_fn(|i| {
            let z = self.joint(i).z;
            self.reading(i, z, gate)
                .filter(|(_, share)| *share > 0.3)
                .filter(|_| !self.is_covered(i))
                .map(|(reading, _)| reading)
        });
        for _ in 0..4 {
            self.step(&readings, gate)?;
        }
        Some(())
    }

    /// One step on (turn, place, log size).
    fn step(&mut self, readings: &[Option<f64>; JOINTS], gate: f64) -> Option<()> {
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut gradient = SVector::<f64, 7>::zeros();
        let mut add = |row: SVector<f64, 7>, residual: f64, weight: f64| {
            normal += row * row.transpose() * weight;
            gradient += row * (residual * weight);
        };
        for i in 0..JOINTS {
            let arm = self.turn * self.shape[i] * self.size;
            let p = arm + self.place;
            if p.z < 0.05 {
                return None;
            }
            // d p / d (turn, place, log size); the turn acts from the left.
            let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-arm.cross_matrix()));
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
            jacobian.fixed_view_mut::<3, 1>(0, 6).copy_from(&arm);
            let (x, y) = (p.x / p.z, p.y / p.z);
            let du = (self.k.fx * x + self.k.cx - self.pixels[i].0) / self.sigma_pixel;
            let dv = (self.k.fy * y + self.k.cy - self.pixels[i].1) / self.sigma_pixel;
            let weight = huber(du.hypot(dv));
            let u_row = Vector3::new(1.0, 0.0, -x) * (self.k.fx / p.z / self.sigma_pixel);
            let v_row = Vector3::new(0.0, 1.0, -y) * (self.k.fy / p.z / self.sigma_pixel);
            add(jacobian.transpose() * u_row, du, weight);
            add(jacobian.transpose() * v_row, dv, weight);
            if let Some(reading) = readings[i] {
                let residual = (p.z - HALF_THICKNESS[i] * self.size - reading) / SIGMA_FIT;
                let mut row: SVector<f64, 7> =
                    jacobian.transpose() * Vector3::new(0.0, 0.0, 1.0 / SIGMA_FIT);
                row[6] -= HALF_THICKNESS[i] * self.size / SIGMA_FIT;
                // Falls to zero at the gate.
                let part = (residual * SIGMA_FIT / gate).abs().min(1.0);
                add(row, residual, (1.0 - part * part).powi(2));
            }
        }
        let turned = (self.turn * self.first_turn.inverse()).scaled_axis();
        for axis in 0..3 {
            let mut row = SVector::<f64, 7>::zeros();
            row[axis] = 1.0 / SIGMA_TURN;
            add(row, turned[axis] / SIGMA_TURN, 1.0);
        }
        let mut row = SVector::<f64, 7>::zeros();
        row[6] = 1.0 / SIGMA_SIZE;
        add(row, self.size.ln() / SIGMA_SIZE, 1.0);

        let step = normal.cholesky()?.solve(&gradient);
        if !step.iter().all(|value| value.is_finite()) {
            return None;
        }
        self.turn = Rotation3::new(-Vector3::new(step[0], step[1], step[2])) * self.turn;
        self.place -= Vector3::new(step[3], step[4], step[5]);
        self.size = (self.size.ln() - step[6].clamp(-0.3, 0.3)).exp();
        Some(())
    }

    /// How badly the fit explains the image, for the comparison of fits.
    fn cost(&self) -> f64 {
        let gate = GATES[GATES.len() - 1];
        let mut cost = 0.5 * (self.size.ln() / SIGMA_SIZE).powi(2);
        for i in 0..JOINTS {
            let p = self.joint(i);
            let du = self.k.fx * p.x / p.z + self.k.cx - self.pixels[i].0;
            let dv = self.k.fy * p.y / p.z + self.k.cy - self.pixels[i].1;
            cost += 0.1 * (du.hypot(dv) / self.sigma_pixel).powi(2).min(9.0);
            let radius = self.radius(i, p.z);
            cost += match median(&mut window(self.depth, self.pixels[i], radius)) {
                None => 0.5,
                Some(reading) => {
                    let before = p.z - HALF_THICKNESS[i] * self.size - reading;
                    if before < -gate {
                        // The camera looks through the joint.
                        2.5
                    } else if before > gate {
                        // Something stands in front of it.
                        1.0
                    } else {
                        (before / gate).powi(2)
                    }
                }
            };
        }
        cost
    }

    /// Whether another part of the fitted hand stands in front of joint `i`.
    fn is_covered(&self, i: usize) -> bool {
        let (joint, pixel) = (self.joint(i), self.pixels[i]);
        BONES.iter().any(|(a, b)| {
            if *a == i || *b == i {
                return false;
            }
            let (pa, pb) = (self.pixels[*a], self.pixels[*b]);
            let (dx, dy) = (pb.0 - pa.0, pb.1 - pa.1);
            let length = (dx * dx + dy * dy).max(1e-9);
            let along = ((pixel.0 - pa.0) * dx + (pixel.1 - pa.1) * dy) / length;
            let along = along.clamp(0.0, 1.0);
            let away = (pixel.0 - pa.0 - along * dx).hypot(pixel.1 - pa.1 - along * dy);
            let z = self.joint(*a).z * (1.0 - along) + self.joint(*b).z * along;
            let thick = HALF_THICKNESS[*a] * (1.0 - along) + HALF_THICKNESS[*b] * along;
            z < joint.z - 0.012 && away < thick * self.size * self.k.fx / z.max(0.1)
        })
    }

    /// The joints' depths after following the readings, and how many of them have one.
    fn follow_readings(&self) -> ([f64; JOINTS], usize) {
        let gate = GATES[GATES.len() - 1];
        let mut normal = SMatrix::<f64, JOINTS, JOINTS>::zeros();
        let mut right = SVector::<f64, JOINTS>::zeros();
        let mut measured = 0;
        for i in 0..JOINTS {
            normal[(i, i)] += SIGMA_SHAPE.powi(-2);
            let z = self.joint(i).z;
            let Some((reading, share)) = self.reading(i, z, gate) else { continue };
            if share < 0.3 || self.is_covered(i) {
                continue;
            }
            measured += 1;
            let error = reading + HALF_THICKNESS[i] * self.size - z;
            let weight = share * SIGMA_READING.powi(-2);
            normal[(i, i)] += weight;
            right[i] += weight * error;
        }
        for (a, b) in BONES {
            let weight = SIGMA_BONE.powi(-2);
            normal[(a, a)] += weight;
            normal[(b, b)] += weight;
            normal[(a, b)] -= weight;
            normal[(b, a)] -= weight;
        }
        // Positive definite by construction: a diagonal plus a graph's Laplacian.
        let error = normal.cholesky().map_or_else(SVector::zeros, |c| c.solve(&right));
        (std::array::from_fn(|i| self.joint(i).z + error[i]), measured)
    }
}

fn huber(residual: f64) -> f64 {
    const KNEE: f64 = 1.5;
    if residual <= KNEE { 1.0 } else { KNEE / residual }
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

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests;
