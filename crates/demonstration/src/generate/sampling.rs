use rand::Rng;
use rand_chacha::ChaCha8Rng;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};

/// Additive recurrence over the unit cube (generalised golden ratio, M. Roberts 2018) from a random
/// offset: covers the starts far more evenly than independent draws, also after rejections.
pub(super) struct Spread {
    state: Vec<f64>,
    step: Vec<f64>,
}

impl Spread {
    pub(super) fn new(dimensions: usize, rng: &mut ChaCha8Rng) -> Self {
        // The root of x^(d+1) = x + 1 above one, by fixed-point iteration.
        let mut g = 2.0f64;
        for _ in 0..60 {
            g = (1.0 + g).powf(1.0 / (dimensions as f64 + 1.0));
        }
        let step = (1..=dimensions).map(|i| (1.0 / g).powi(i as i32)).collect();
        Self { state: (0..dimensions).map(|_| rng.random::<f64>()).collect(), step }
    }

    /// Moves on to the next point.
    pub(super) fn advance(&mut self) {
        for (s, d) in self.state.iter_mut().zip(&self.step) {
            *s = (*s + d).fract();
        }
    }

    /// A coordinate of the point, 0..1.
    pub(super) fn coordinate(&self, i: usize) -> f64 {
        self.state[i]
    }
}

pub(super) fn lerp(range: [f64; 2], t: f64) -> f64 {
    range[0] + (range[1] - range[0]) * t
}

/// Uniform in -max..max; 0 for max = 0.
pub(super) fn symmetric(rng: &mut ChaCha8Rng, max: f64) -> f64 {
    max * (2.0 * rng.random::<f64>() - 1.0)
}

/// A turn about a random axis by at most `max` rad.
pub(super) fn small_turn(rng: &mut ChaCha8Rng, max: f64) -> UnitQuaternion<f64> {
    let axis = loop {
        let v = Vector3::new(symmetric(rng, 1.0), symmetric(rng, 1.0), symmetric(rng, 1.0));
        if (0.01..1.0).contains(&v.norm()) {
            break v.normalize();
        }
    };
    UnitQuaternion::from_scaled_axis(axis * symmetric(rng, max))
}

/// A tilt about a random horizontal axis by at most `max` rad.
pub(super) fn tilt(rng: &mut ChaCha8Rng, max: f64) -> UnitQuaternion<f64> {
    let a = std::f64::consts::TAU * rng.random::<f64>();
    let angle = max * rng.random::<f64>();
    UnitQuaternion::from_scaled_axis(Vector3::new(a.cos(), a.sin(), 0.0) * angle)
}

/// A point of the disc.
pub(super) fn in_disc(rng: &mut ChaCha8Rng, radius: f64) -> [f64; 2] {
    let r = radius * rng.random::<f64>().sqrt();
    let a = std::f64::consts::TAU * rng.random::<f64>();
    [r * a.cos(), r * a.sin()]
}

/// `T_base_tcp` of a gripper that points down, its closing axis turned by `yaw`.
pub(super) fn downward(xyz: [f64; 3], yaw: f64, tilt: UnitQuaternion<f64>) -> Pose {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Pose::from_parts(xyz.into(), tilt * turn * down)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn starts_are_spread_evenly() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut s = Spread::new(3, &mut rng);
        let mut cells = [0; 27];
        for _ in 0..270 {
            s.advance();
            let p: Vec<f64> = (0..3).map(|i| s.coordinate(i)).collect();
            assert!(p.iter().all(|v| (0.0..1.0).contains(v)));
            let i = p.iter().fold(0, |a, v| a * 3 + (v * 3.0) as usize);
            cells[i] += 1;
        }
        assert!(cells.iter().all(|n| (5..=16).contains(n)), "{cells:?}");
    }
}
