//! Smooth seeded motion: sums of sines for position and angular velocity, slow at the start.

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::Pose;

/// Frames per second.
pub const RATE: f64 = 30.0;
/// Integration steps per frame.
const STEPS: usize = 10;
/// Seconds in which the motion comes up to speed.
const RAMP: f64 = 0.6;

/// How fast and how far an object goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Greatest speed (m/s) of the object's origin.
    pub speed: f64,
    /// Greatest turning rate (rad/s).
    pub turning: f64,
    /// Greatest angle (rad) from the start; infinite for free tumbling.
    pub lean: f64,
}

/// Poses of `frames` frames about `start` (same frame); the origin stays within about 0.2 m of it.
pub fn wander(start: &Pose, limits: &MotionLimits, frames: usize, seed: u64) -> Vec<Pose> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6d6f_7665);
    // Up and down less than sideways: the table is near.
    let places = Waves::new(&mut rng, [1.0, 1.0, 0.5]);
    let turns = Waves::new(&mut rng, [1.0; 3]);
    let n = frames * STEPS;
    let dt = 1.0 / (RATE * STEPS as f64);
    // Time runs slowly at first.
    let mut clock = Vec::with_capacity(n);
    let mut t = 0.0;
    for i in 0..n {
        clock.push(t);
        t += dt * (0.05 + 0.95 * (i as f64 * dt / RAMP).min(1.0));
    }
    let top = |f: &dyn Fn(f64) -> f64| clock.iter().map(|t| f(*t)).fold(1e-9, f64::max);
    let reach = limits.speed / top(&|t| places.slope(t).norm());
    let origin = places.value(0.0);
    let mut out = Vec::with_capacity(frames);
    if limits.lean.is_finite() {
        let zero = turns.value(0.0);
        let by_angle = limits.lean / top(&|t| (turns.value(t) - zero).norm());
        let by_rate = limits.turning / top(&|t| turns.slope(t).norm());
        let scale = by_angle.min(by_rate);
        for i in 0..frames {
            let t = clock[i * STEPS];
            let turn = UnitQuaternion::from_scaled_axis((turns.value(t) - zero) * scale);
            let shift = (places.value(t) - origin) * reach;
            out.push(Pose::from_parts(
                (start.translation.vector + shift).into(),
                turn * start.rotation,
            ));
        }
        return out;
    }
    let rate = limits.turning / top(&|t| turns.value(t).norm());
    let mut rotation = start.rotation;
    for i in 0..n {
        if i % STEPS == 0 {
            let shift = (places.value(clock[i]) - origin) * reach;
            out.push(Pose::from_parts((start.translation.vector + shift).into(), rotation));
        }
        let step = clock.get(i + 1).map_or(dt, |next| next - clock[i]);
        rotation =
            UnitQuaternion::from_scaled_axis(turns.value(clock[i]) * (rate * step)) * rotation;
    }
    out
}

/// Three sines for each of three axes.
struct Waves([[(f64, f64, f64); 3]; 3]);

impl Waves {
    fn new(rng: &mut ChaCha8Rng, weights: [f64; 3]) -> Self {
        Self(weights.map(|w| {
            std::array::from_fn(|k| {
                let frequency = rng.random_range(1.4..2.6) * (1.0 + 0.6 * k as f64);
                let phase = rng.random_range(0.0..std::f64::consts::TAU);
                (w / frequency, frequency, phase)
            })
        }))
    }

    fn value(&self, t: f64) -> Vector3<f64> {
        Vector3::from(self.0.map(|axis| axis.iter().map(|(a, f, p)| a * (f * t + p).sin()).sum()))
    }

    fn slope(&self, t: f64) -> Vector3<f64> {
        Vector3::from(
            self.0.map(|axis| axis.iter().map(|(a, f, p)| a * f * (f * t + p).cos()).sum()),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_distance;

    #[test]
    fn limits_are_reached_and_kept() {
        let limits = MotionLimits { speed: 0.5, turning: 3.14, lean: f64::INFINITY };
        for seed in 0..6 {
            let poses = wander(&Pose::identity(), &limits, 150, seed);
            assert_eq!(poses.len(), 150);
            let steps: Vec<(f64, f64)> =
                poses.windows(2).map(|w| pose_distance(&w[0], &w[1])).collect();
            let fastest = steps.iter().map(|s| s.0 * RATE).fold(0.0, f64::max);
            let quickest = steps.iter().map(|s| s.1 * RATE).fold(0.0, f64::max);
            assert!((0.42..0.505).contains(&fastest), "{fastest}");
            assert!((2.6..3.2).contains(&quickest), "{quickest}");
            assert!(poses.iter().all(|p| p.translation.vector.norm() < 0.45));
            assert_eq!(poses, wander(&Pose::identity(), &limits, 150, seed));
        }
        let held = MotionLimits { lean: 0.4, ..limits };
        let poses = wander(&Pose::identity(), &held, 150, 3);
        let lean = poses.iter().map(|p| p.rotation.angle()).fold(0.0, f64::max);
        assert!((0.2..0.41).contains(&lean), "{lean}");
    }
}
