//! The law of motion: one step toward a moving target within the limits, and the stop at the end.

use crate::kinematics::{Joints, Kinematics};
use crate::limits::Limits;

/// Commanded state of the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MotionState {
    /// Rad.
    pub q: Joints,
    /// Rad/s.
    pub qd: Joints,
    /// Rad/s^2.
    pub qdd: Joints,
}

impl MotionState {
    pub fn at_rest(q: Joints) -> Self {
        Self { q, qd: [0.0; 6], qdd: [0.0; 6] }
    }
}

/// Gains of [`step`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Gains {
    /// 1/s, joint error to velocity.
    pub position: f64,
    /// 1/s, velocity error to acceleration.
    pub velocity: f64,
}

/// Room left below the hard limits, for what the linearisation over one step neglects.
const MARGIN: f64 = 0.96;

/// Advances by `dt` seconds toward target joints `q` moving at `qd`.
///
/// Velocity, acceleration and jerk are bounded by scaling the whole joint vector, never joint by
/// joint: the new velocity is then a convex combination of the old one and an admissible one, so
/// that the tcp's speed limit holds on the way too, and the path keeps its direction.
pub(super) fn step(
    k: &Kinematics,
    limits: &Limits,
    gains: Gains,
    s: &MotionState,
    q: &Joints,
    qd: &Joints,
    dt: f64,
) -> MotionState {
    let a_max = limits.joint_acceleration * MARGIN;
    let mut v_ref: Joints = std::array::from_fn(|i| {
        // The target now, not one step on: at a steady rate the error is then zero.
        let e = q[i] - qd[i] * dt - s.q[i];
        // Linear near the target; farther off no faster than can be braked at half the acceleration.
        let approach = (gains.position * e.abs()).min((a_max * e.abs()).sqrt());
        qd[i] + approach.copysign(e)
    });
    let scale =
        velocity_scale(k, limits, &s.q, &v_ref) * singularity_scale(k, limits, &s.q, &v_ref);
    v_ref.iter_mut().for_each(|v| *v *= scale);
    let mut a: Joints = std::array::from_fn(|i| gains.velocity * (v_ref[i] - s.qd[i]));
    let worst = max_abs(&a);
    if worst > a_max {
        a.iter_mut().for_each(|v| *v *= a_max / worst);
    }
    let change: Joints = std::array::from_fn(|i| a[i] - s.qdd[i]);
    let worst = max_abs(&change);
    let most = limits.joint_jerk * dt;
    if worst > most {
        a = std::array::from_fn(|i| s.qdd[i] + change[i] * most / worst);
    }
    let v: Joints = std::array::from_fn(|i| s.qd[i] + a[i] * dt);
    let q = std::array::from_fn(|i| s.q[i] + 0.5 * (s.qd[i] + v[i]) * dt);
    MotionState { q, qd: v, qdd: a }
}

/// Factor (at most 1) that brings joint velocities within the joint and tcp speed limits.
fn velocity_scale(k: &Kinematics, limits: &Limits, q: &Joints, v: &Joints) -> f64 {
    let (linear, angular) = k.tcp_speed(q, v);
    let over = (max_abs(v) / limits.joint_velocity)
        .max(linear / limits.tcp_speed)
        .max(angular / limits.tcp_angular_speed);
    if over > MARGIN { MARGIN / over } else { 1.0 }
}

/// Factor (at most 1) that slows the way into a singularity: falling from 1 at `singular_slow` to a
/// creep at `singular_stop`; the way out is free.
fn singularity_scale(k: &Kinematics, limits: &Limits, q: &Joints, v: &Joints) -> f64 {
    /// Look-ahead (s) that tells in from out.
    const AHEAD: f64 = 0.02;
    const CREEP: f64 = 0.1;
    let here = k.dexterity(q).condition;
    if here <= limits.singular_slow {
        return 1.0;
    }
    let next = std::array::from_fn(|i| q[i] + v[i] * AHEAD);
    if k.dexterity(&next).condition <= here {
        return 1.0;
    }
    let (slow, stop) = (1.0 / limits.singular_slow, 1.0 / limits.singular_stop);
    ((1.0 / here - stop) / (slow - stop)).max(CREEP)
}

/// State `t` seconds into a stop of `total` seconds from `s`: the velocity falls along
/// `1 - 3 x^2 + 2 x^3`, all joints together, so the tool stays on its course; peak deceleration is
/// `1.5 |qd| / total`.
pub(super) fn stop(s: &MotionState, t: f64, total: f64) -> MotionState {
    let x = (t / total).clamp(0.0, 1.0);
    let velocity = 1.0 - x * x * (3.0 - 2.0 * x);
    let path = total * (x - x * x * x + 0.5 * x * x * x * x);
    let acceleration = -6.0 * x * (1.0 - x) / total;
    MotionState {
        q: std::array::from_fn(|i| s.q[i] + s.qd[i] * path),
        qd: s.qd.map(|v| v * velocity),
        qdd: s.qd.map(|v| v * acceleration),
    }
}

pub(super) fn max_abs(v: &Joints) -> f64 {
    v.iter().fold(0.0, |m, x| m.max(x.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const Q0: Joints = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];
    const GAINS: Gains = Gains { position: 8.0, velocity: 32.0 };

    #[test]
    fn a_step_of_the_target_is_reached_within_all_limits_without_overshoot() {
        let (k, l) = (Kinematics::ur5(), Limits::default());
        let target: Joints = std::array::from_fn(|i| Q0[i] + [0.5, 0.2, -0.3, 0.1, 0.3, -0.9][i]);
        let mut s = MotionState::at_rest(Q0);
        let dt = 0.008;
        for n in 0..500 {
            let next = step(&k, &l, GAINS, &s, &target, &[0.0; 6], dt);
            for i in 0..6 {
                assert!(next.qd[i].abs() <= l.joint_velocity);
                assert!(next.qdd[i].abs() <= l.joint_acceleration);
                assert!((next.qdd[i] - s.qdd[i]).abs() <= l.joint_jerk * dt + 1e-9);
                let beyond = (next.q[i] - target[i]) * (target[i] - Q0[i]).signum();
                assert!(beyond < 2e-3, "joint {i} overshoots by {beyond} at step {n}");
            }
            assert!(k.tcp_speed(&next.q, &next.qd).0 <= l.tcp_speed, "step {n}");
            s = next;
        }
        assert!((0..6).all(|i| (s.q[i] - target[i]).abs() < 1e-3), "{:?}", s.q);
    }

    #[test]
    fn no_lag_behind_a_steady_target() {
        let (k, l) = (Kinematics::ur5(), Limits::default());
        let rate = [0.1, 0.05, -0.1, 0.05, 0.0, 0.2];
        let mut s = MotionState::at_rest(Q0);
        for n in 1..300 {
            let target = std::array::from_fn(|i| Q0[i] + rate[i] * 0.008 * f64::from(n));
            s = step(&k, &l, GAINS, &s, &target, &rate, 0.008);
        }
        for i in 0..6 {
            assert!((s.q[i] - (Q0[i] + rate[i] * 0.008 * 299.0)).abs() < 1e-3);
        }
    }

    #[test]
    fn the_stop_is_smooth_and_consistent() {
        let s = MotionState { q: Q0, qd: [1.0, -0.5, 0.2, 0.0, 0.3, -1.0], qdd: [0.0; 6] };
        let (total, h) = (0.136, 1e-5);
        for n in 0..100 {
            let t = total * f64::from(n) / 100.0;
            let (a, b) = (stop(&s, t, total), stop(&s, t + h, total));
            for i in 0..6 {
                assert!(((b.q[i] - a.q[i]) / h - a.qd[i]).abs() < 1e-3);
                assert!(((b.qd[i] - a.qd[i]) / h - a.qdd[i]).abs() < 2e-2);
                assert!(a.qdd[i].abs() <= 1.5 / total + 1e-9);
            }
        }
        assert_eq!(stop(&s, total, total).qd.map(f64::abs), [0.0; 6]);
    }
}
