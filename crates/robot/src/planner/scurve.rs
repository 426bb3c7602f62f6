/// A motion from 0 to 1 that begins and ends at rest, within a speed, an acceleration and a jerk: seven
/// phases of constant jerk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SCurve {
    jerk: f64,
    /// Length of a jerk phase (s).
    tj: f64,
    /// Of the whole acceleration (s).
    ta: f64,
    /// At constant speed (s).
    tv: f64,
    /// Time runs slower by this factor, at least 1.
    stretch: f64,
}

impl SCurve {
    /// Fastest for the limits, all above zero, in units of the way per s, s^2, s^3.
    pub fn new(speed: f64, acceleration: f64, jerk: f64) -> Self {
        let (v, a, j) = (speed, acceleration, jerk);
        // With a phase at constant speed, with or without one at constant acceleration.
        let (tj, ta) = if v * j < a * a {
            let tj = (v / j).sqrt();
            (tj, 2.0 * tj)
        } else {
            (a / j, a / j + v / a)
        };
        let tv = 1.0 / v - ta;
        if tv >= 0.0 {
            return Self { jerk: j, tj, ta, tv, stretch: 1.0 };
        }
        // The speed is not reached: the way is a ta (ta - tj).
        let tj = a / j;
        let ta = 0.5 * (tj + (tj * tj + 4.0 / a).sqrt());
        if ta >= 2.0 * tj {
            return Self { jerk: j, tj, ta, tv: 0.0, stretch: 1.0 };
        }
        // Nor is the acceleration: the way is 2 j tj^3.
        let tj = (0.5 / j).cbrt();
        Self { jerk: j, tj, ta: 2.0 * tj, tv: 0.0, stretch: 1.0 }
    }

    /// Seconds.
    pub fn duration(&self) -> f64 {
        (2.0 * self.ta + self.tv) * self.stretch
    }

    /// The same made to last a whole number of `period`s (s).
    #[must_use]
    pub fn in_periods(self, period: f64) -> Self {
        let plain = Self { stretch: 1.0, ..self };
        let whole = (plain.duration() / period - 1e-9).ceil().max(1.0) * period;
        Self { stretch: whole / plain.duration(), ..self }
    }

    /// Position, speed and acceleration at a time (s).
    pub fn at(&self, t: f64) -> [f64; 3] {
        let k = self.stretch;
        let t = (t / k).clamp(0.0, self.duration() / k);
        let half = self.ta + 0.5 * self.tv;
        // The second half is the first one backwards.
        let [p, v, a] = if t <= half {
            self.rising(t)
        } else {
            let [p, v, a] = self.rising(2.0 * half - t);
            [1.0 - p, v, -a]
        };
        [p, v / k, a / (k * k)]
    }

    fn rising(&self, t: f64) -> [f64; 3] {
        let (j, tj, ta) = (self.jerk, self.tj, self.ta);
        let a = j * tj;
        let v = a * (ta - tj);
        if t < tj {
            return [j * t * t * t / 6.0, 0.5 * j * t * t, j * t];
        }
        if t < ta - tj {
            let u = t - tj;
            let v0 = 0.5 * a * tj;
            return [j * tj * tj * tj / 6.0 + v0 * u + 0.5 * a * u * u, v0 + a * u, a];
        }
        let way = 0.5 * v * ta;
        if t < ta {
            let u = ta - t;
            return [way - v * u + j * u * u * u / 6.0, v - 0.5 * j * u * u, j * u];
        }
        [way + v * (t - ta), v, 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_kept_and_used() {
        // Speed, acceleration and jerk, and which of them binds: all shapes of the profile.
        for (v, a, j) in [
            (0.5, 1.0, 10.0),
            (0.5, 9.0, 10.0),
            (9.0, 1.0, 10.0),
            (9.0, 9.0, 10.0),
            (0.1, 8.0, 400.0),
        ] {
            for s in [SCurve::new(v, a, j), SCurve::new(v, a, j).in_periods(0.008)] {
                let (d, h) = (s.duration(), s.duration() / 20_000.0);
                let (mut top, mut before, mut jerks): ([f64; 2], [f64; 3], f64) =
                    ([0.0; 2], s.at(0.0), 0.0);
                assert!(before.iter().all(|x| x.abs() < 1e-12), "{before:?}");
                for i in 1..=20_000 {
                    let now = s.at(h * f64::from(i));
                    top = [top[0].max(now[1]), top[1].max(now[2].abs())];
                    // Each is the integral of the next, but for the trapezium's error.
                    let (one, two) = (0.2 * j * h.powi(3) + 1e-12, j * h * h + 1e-12);
                    assert!((now[0] - before[0] - 0.5 * h * (now[1] + before[1])).abs() < one);
                    assert!((now[1] - before[1] - 0.5 * h * (now[2] + before[2])).abs() < two);
                    jerks = jerks.max((now[2] - before[2]).abs() / h);
                    before = now;
                }
                let [p, e, c] = s.at(d);
                assert!(
                    (p - 1.0).abs() < 1e-12 && e.abs() < 1e-12 && c.abs() < 1e-9,
                    "{p} {e} {c}"
                );
                assert!(top[0] <= v + 1e-9 && top[1] <= a + 1e-9 && jerks <= j * (1.0 + 1e-6));
                // One of them is at its limit, or it could be faster (the stretched one could).
                let used = (top[0] / v).max(top[1] / a).max(jerks / j);
                assert!(used > 0.95, "{used} {v} {a} {j}");
            }
            let n = SCurve::new(v, a, j).in_periods(0.008).duration() / 0.008;
            assert!((n - n.round()).abs() < 1e-9);
        }
    }
}
