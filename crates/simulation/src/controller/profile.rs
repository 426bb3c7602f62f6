//! Speed profiles of the point-to-point motions.

/// A trapezoid of speed (a triangle where the way is short): up at `a`, along at `v`, down at `a`.
/// The unit of the way is the caller's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Trapezoid {
    length: f64,
    peak: f64,
    ramp: f64,
    duration: f64,
}

impl Trapezoid {
    /// From rest to rest over `length` with at most `v` and `a`, all positive.
    pub(crate) fn new(length: f64, v: f64, a: f64) -> Self {
        if length <= 0.0 {
            return Self { length: 0.0, peak: 0.0, ramp: 0.0, duration: 0.0 };
        }
        let peak = v.min((length * a).sqrt());
        let ramp = peak / a;
        Self { length, peak, ramp, duration: ramp + length / peak }
    }

    /// From rest to rest over `length` in exactly `duration` seconds, a quarter of it for each ramp.
    pub(crate) fn timed(length: f64, duration: f64) -> Self {
        Self { length, peak: length / (0.75 * duration), ramp: 0.25 * duration, duration }
    }

    /// Seconds from rest to rest.
    pub(crate) fn duration(&self) -> f64 {
        self.duration
    }

    /// Way after `t` seconds.
    pub(crate) fn at(&self, t: f64) -> f64 {
        if self.duration <= 0.0 || t >= self.duration {
            return self.length;
        }
        let t = t.max(0.0);
        let slope = if self.ramp > 0.0 { self.peak / self.ramp } else { 0.0 };
        if t < self.ramp {
            0.5 * slope * t * t
        } else if t < self.duration - self.ramp {
            self.peak * (t - 0.5 * self.ramp)
        } else {
            let left = self.duration - t;
            self.length - 0.5 * slope * left * left
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_speed_and_acceleration_and_arrives() {
        for (length, v, a) in [(1.0, 0.5, 2.0), (0.01, 0.5, 2.0), (3.0, 1.05, 1.4)] {
            let p = Trapezoid::new(length, v, a);
            let (dt, mut last, mut speed) = (1e-3, 0.0, 0.0);
            for k in 1..=(p.duration() / dt) as usize + 2 {
                let s = p.at(k as f64 * dt);
                let now = (s - last) / dt;
                assert!(now <= v + 1e-9 && (now - speed).abs() <= a * dt + 1e-6, "{now} {speed}");
                (last, speed) = (s, now);
            }
            assert!((last - length).abs() < 1e-12);
        }
        let p = Trapezoid::timed(0.6, 2.0);
        assert!((p.duration() - 2.0).abs() < 1e-12 && (p.at(1.0) - 0.3).abs() < 1e-12);
        assert!((p.at(2.0) - 0.6).abs() < 1e-12 && p.at(1.999) < 0.6);
        assert_eq!(Trapezoid::new(0.0, 1.0, 1.0).duration(), 0.0);
    }
}
