//! The filter behind `servoj`.
//!
//! The joints follow a critically damped second-order tracker whose lag on a ramp is
//! `lookahead_time + GAIN_LAG / gain`: 32 ms at lookahead 0.03 s and gain 2000, and with the 2 ms in
//! which a new target is led in 34 ms, as published for a 500 Hz controller; 113 ms at lookahead 0.1 s
//! and gain 300. Speed and acceleration are limited, so that a step of the target gives no overshoot.

use super::{MAX_ACCELERATION, MAX_SPEED};

/// Lag that the proportional gain adds, times the gain, s.
const GAIN_LAG: f64 = 4.0;
/// Range of `gain`.
pub(crate) const GAIN: (f64, f64) = (100.0, 2000.0);
/// Range of `lookahead_time`, s.
pub(crate) const LOOKAHEAD: (f64, f64) = (0.03, 0.2);

/// Lag on a ramp, s.
pub(crate) fn lag(lookahead: f64, gain: f64) -> f64 {
    lookahead.clamp(LOOKAHEAD.0, LOOKAHEAD.1) + GAIN_LAG / gain.clamp(GAIN.0, GAIN.1)
}

/// One tick of one joint towards `target`: the new angle and speed.
pub(crate) fn track(q: f64, qd: f64, target: f64, lag: f64, dt: f64) -> (f64, f64) {
    let error = target - q;
    let rate = 1.0 / lag;
    // Never faster than what still stops in time within the acceleration limit.
    let stoppable = (2.0 * 0.8 * MAX_ACCELERATION * error.abs()).sqrt();
    let wanted = (rate * error).clamp(-stoppable, stoppable);
    let wanted = wanted.clamp(-MAX_SPEED, MAX_SPEED);
    let acceleration = ((wanted - qd) * 4.0 * rate).clamp(-MAX_ACCELERATION, MAX_ACCELERATION);
    let qd = qd + acceleration * dt;
    (q + qd * dt, qd)
}
