/// How fast a trajectory's time runs: the robot's speed scaling, without jumps. Below 1 the trajectory
/// is stretched; after a pause it starts slowly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedScale {
    /// 0..=1
    now: f64,
}

impl SpeedScale {
    /// Growth (1/s) after a pause or a move of the slider: from standstill to full speed in 0.8 s, as the
    /// official driver does it (0.01 in each cycle of 8 ms).
    pub const UP: f64 = 1.25;
    /// Fall (1/s): 1 rad/s comes to rest with 8 rad/s^2.
    pub const DOWN: f64 = 8.0;
    /// Longest step of the robot's clock (s) that is passed on: a driver that was held up does not catch
    /// up.
    pub const LONGEST_STEP: f64 = 0.04;

    /// At full speed.
    pub fn full() -> Self {
        Self { now: 1.0 }
    }

    /// At standstill, to be ramped up.
    pub fn standstill() -> Self {
        Self { now: 0.0 }
    }

    /// The present factor.
    pub fn factor(&self) -> f64 {
        self.now
    }

    /// Trajectory time (s) for `dt` seconds of the robot's clock under the robot's `factor` (its speed
    /// scaling times the slider); a factor that is no number counts as zero.
    pub fn advance(&mut self, dt: f64, factor: f64) -> f64 {
        let dt = if dt.is_finite() { dt.clamp(0.0, Self::LONGEST_STEP) } else { 0.0 };
        let wanted = if factor.is_finite() { factor.clamp(0.0, 1.0) } else { 0.0 };
        let before = self.now;
        self.now = wanted.clamp(before - Self::DOWN * dt, before + Self::UP * dt).clamp(0.0, 1.0);
        0.5 * (before + self.now) * dt
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramps_and_bounds() {
        let mut s = SpeedScale::full();
        assert!((s.advance(0.008, 1.0) - 0.008).abs() < 1e-12);
        // The slider goes to zero: at rest after 1/8 s, never backwards.
        let mut sum = 0.0;
        for _ in 0..20 {
            let step = s.advance(0.008, 0.0);
            assert!(step >= 0.0);
            sum += step;
        }
        assert_eq!(s.factor(), 0.0);
        assert!((sum - 0.5 / SpeedScale::DOWN).abs() < 1e-3, "{sum}");
        let cycles = (0..200).take_while(|_| s.advance(0.008, 1.0) < 0.008 - 1e-9).count();
        assert!((95..=101).contains(&cycles), "{cycles}");
        // A long silence, a clock that runs back, nonsense.
        assert!((s.advance(3.0, 1.0) - SpeedScale::LONGEST_STEP).abs() < 1e-12);
        assert_eq!(s.advance(-1.0, 1.0), 0.0);
        assert_eq!(s.advance(f64::NAN, f64::NAN), 0.0);
    }
}
