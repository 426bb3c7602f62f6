//! Robotiq 2F-85: knuckle angle <-> pad gap <-> position register, and where the fingertips are.
//!
//! Each finger is a parallelogram: the tip keeps its orientation and swings about the knuckle. In the
//! gripper's plane (x = closing direction, z = approach) the knuckle sits at `x = PIVOT_X`, and the
//! vector to the tip at angle zero is `(ARM_X, ARM_Z)`; turning by `q` gives
//! `x = PIVOT_X + ARM_X cos q - ARM_Z sin q` and `z = PIVOT_Z + ARM_X sin q + ARM_Z cos q`.
//! The lengths are those of the public ROS description of the gripper, and reproduce its figures:
//! gap 85.0 mm at 0 rad, 45.3 mm at 0.4 rad, 1.0 mm at 0.7929 rad.

/// Name of the actuated joint in `/joint_states`.
pub const KNUCKLE_JOINT: &str = "robotiq_85_left_knuckle_joint";
/// Knuckle angle (rad) of the open gripper.
pub const KNUCKLE_OPEN: f64 = 0.0;
/// Knuckle angle (rad) of the closed gripper.
pub const KNUCKLE_CLOSED: f64 = 0.7929;
/// Position register of the open gripper.
pub const REGISTER_OPEN: u8 = 3;
/// Position register of the closed gripper.
pub const REGISTER_CLOSED: u8 = 230;
/// Grip force of the 2F-85 (N): least, greatest.
pub const FORCE_RANGE: (f64, f64) = (20.0, 235.0);
/// Finger speed of the 2F-85 (m/s, of the gap): least, greatest.
pub const SPEED_RANGE: (f64, f64) = (0.020, 0.150);

const PIVOT_X: f64 = 0.030_601_14;
const ARM_X: f64 = 0.037_157_5;
const ARM_Z: f64 = 0.043_421_68;
const PAD_X: f64 = 0.025_26;
/// Height of the fingertips' ends above `tool0` at angle zero, less `ARM_Z`.
const TIP_BASE_Z: f64 = 0.149_3 - ARM_Z;

/// Gap between the pads (m) at knuckle angle `q` (rad, kept within 0..=[`KNUCKLE_CLOSED`]).
pub fn gap_from_knuckle(q: f64) -> f64 {
    let (s, c) = q.clamp(KNUCKLE_OPEN, KNUCKLE_CLOSED).sin_cos();
    2.0 * (PIVOT_X + ARM_X * c - ARM_Z * s - PAD_X)
}

/// Knuckle angle (rad) at which the pads are `gap` metres apart; beyond the range, its end.
pub fn knuckle_from_gap(gap: f64) -> f64 {
    let x = gap / 2.0 + PAD_X - PIVOT_X;
    // x = R cos(q + phi)
    let (r, phi) = (ARM_X.hypot(ARM_Z), ARM_Z.atan2(ARM_X));
    ((x / r).clamp(-1.0, 1.0).acos() - phi).clamp(KNUCKLE_OPEN, KNUCKLE_CLOSED)
}

/// Distance (m) of the fingertips' ends from `tool0` along its z axis at knuckle angle `q` (rad):
/// 149.3 mm open, 162.9 mm closed.
pub fn fingertip_z(q: f64) -> f64 {
    let (s, c) = q.clamp(KNUCKLE_OPEN, KNUCKLE_CLOSED).sin_cos();
    TIP_BASE_Z + ARM_X * s + ARM_Z * c
}

/// How far (m) the fingertips are beyond where the open gripper has them, along `tool0` z: up to 13.5 mm.
pub fn tip_advance(q: f64) -> f64 {
    fingertip_z(q) - fingertip_z(KNUCKLE_OPEN)
}

/// Position register (3 open .. 230 closed) for a knuckle angle (rad); the nearest end outside, open
/// for NaN.
pub fn register_from_knuckle(q: f64) -> u8 {
    let span = f64::from(REGISTER_CLOSED - REGISTER_OPEN);
    // `as` maps NaN to zero and saturates.
    let x = (q / KNUCKLE_CLOSED).clamp(0.0, 1.0) * span;
    REGISTER_OPEN + x.round() as u8
}

/// Knuckle angle (rad) for a position register; registers below 3 and above 230 are the ends.
pub fn knuckle_from_register(register: u8) -> f64 {
    let r = register.clamp(REGISTER_OPEN, REGISTER_CLOSED) - REGISTER_OPEN;
    KNUCKLE_CLOSED * f64::from(r) / f64::from(REGISTER_CLOSED - REGISTER_OPEN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_figures() {
        for (q, mm) in [(0.0, 85.0), (0.4, 45.3), (0.7929, 1.0)] {
            assert!((gap_from_knuckle(q) * 1e3 - mm).abs() < 0.06, "{}", gap_from_knuckle(q) * 1e3);
        }
        assert!((fingertip_z(0.0) - 0.1493).abs() < 1e-9);
        assert!((fingertip_z(KNUCKLE_CLOSED) - 0.1629).abs() < 2e-4);
    }

    #[test]
    fn maps_invert_and_saturate() {
        for i in 0..=100 {
            let q = KNUCKLE_CLOSED * f64::from(i) / 100.0;
            assert!((knuckle_from_gap(gap_from_knuckle(q)) - q).abs() < 1e-12);
            assert!((knuckle_from_register(register_from_knuckle(q)) - q).abs() < 0.5 / 227.0);
        }
        assert_eq!(register_from_knuckle(-1.0), 3);
        assert_eq!(register_from_knuckle(2.0), 230);
        assert_eq!(register_from_knuckle(f64::NAN), 3);
        assert_eq!(knuckle_from_gap(1.0), KNUCKLE_OPEN);
        assert_eq!(knuckle_from_gap(-1.0), KNUCKLE_CLOSED);
        assert_eq!(knuckle_from_register(0), 0.0);
        assert!((knuckle_from_register(255) - KNUCKLE_CLOSED).abs() < 1e-12);
    }
}
