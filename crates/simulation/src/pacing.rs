//! Keeping the lab at real time without chasing lost time.

use std::time::{Duration, Instant};

/// Says how long to sleep so that simulated time runs with the clock, and measures how well it does.
/// When the machine is too slow, the debt beyond `slack` is forgiven: the lab then runs slower than
/// real time instead of trying to catch up in a burst.
#[derive(Debug, Clone)]
pub struct Pacer {
    /// Simulated seconds per second of the clock that are aimed at.
    speed: f64,
    slack: f64,
    origin: Option<(Instant, f64)>,
    first: Option<(Instant, f64)>,
    forgiven: f64,
    window: Option<(Instant, f64)>,
    factor: f64,
}

impl Pacer {
    /// A pacer for `speed` simulated seconds per second (1 = real time).
    pub fn new(speed: f64) -> Self {
        Self {
            speed: if speed.is_finite() && speed > 0.0 { speed } else { 1.0 },
            slack: 0.05,
            origin: None,
            first: None,
            forgiven: 0.0,
            window: None,
            factor: 1.0,
        }
    }

    /// Call after simulating up to `simulated` (s), at clock time `now`; returns how long to sleep.
    pub fn pace(&mut self, simulated: f64, now: Instant) -> Duration {
        let (start, from) = *self.origin.get_or_insert((now, simulated));
        self.first.get_or_insert((now, simulated));
        let (w0, ws) = *self.window.get_or_insert((now, simulated));
        let span = now.saturating_duration_since(w0).as_secs_f64();
        if span >= 1.0 {
            self.factor = (simulated - ws) / span;
            self.window = Some((now, simulated));
        }
        let due = (simulated - from) / self.speed;
        let ahead = due - now.saturating_duration_since(start).as_secs_f64();
        if ahead < -self.slack {
            self.forgiven += -ahead;
            self.origin = Some((now, simulated));
            return Duration::ZERO;
        }
        Duration::from_secs_f64(ahead.max(0.0))
    }

    /// Simulated over real seconds in the last whole second.
    pub fn recent_factor(&self) -> f64 {
        self.factor
    }

    /// Simulated over real seconds since the first call, at clock time `now`.
    pub fn factor(&self, simulated: f64, now: Instant) -> f64 {
        match self.first {
            Some((t0, s0)) if now > t0 => (simulated - s0) / (now - t0).as_secs_f64(),
            _ => 1.0,
        }
    }

    /// Seconds of debt that were forgiven.
    pub fn forgiven(&self) -> f64 {
        self.forgiven
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeps_when_ahead_and_forgives_when_behind() {
        let t0 = Instant::now();
        let at = |s: f64| t0 + Duration::from_secs_f64(s);
        let mut p = Pacer::new(1.0);
        assert_eq!(p.pace(0.0, at(0.0)), Duration::ZERO);
        let nap = p.pace(0.008, at(0.003)).as_secs_f64();
        assert!((nap - 0.005).abs() < 1e-6);
        // A short hiccup is caught up ...
        assert_eq!(p.pace(0.016, at(0.040)), Duration::ZERO);
        assert!(p.forgiven() == 0.0);
        let nap = p.pace(0.050, at(0.041)).as_secs_f64();
        assert!((nap - 0.009).abs() < 1e-6);
        // ... a long one is not.
        assert_eq!(p.pace(0.060, at(0.560)), Duration::ZERO);
        assert!((p.forgiven() - 0.5).abs() < 1e-6);
        let nap = p.pace(0.070, at(0.562)).as_secs_f64();
        assert!((nap - 0.008).abs() < 1e-6, "{nap}");
    }

    #[test]
    fn factor_is_simulated_over_real() {
        let t0 = Instant::now();
        let mut p = Pacer::new(1.0);
        for k in 0..300 {
            p.pace(k as f64 * 0.008, t0 + Duration::from_secs_f64(k as f64 * 0.010));
        }
        let end = t0 + Duration::from_secs_f64(299.0 * 0.010);
        assert!((p.factor(299.0 * 0.008, end) - 0.8).abs() < 1e-9);
        assert!((p.recent_factor() - 0.8).abs() < 1e-6);
    }
}
