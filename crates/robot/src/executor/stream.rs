use super::Desired;
use crate::kinematics::Joints;
use crate::limits::Limits;

/// Longest time (s) that a streamed command counts without a fresh one. The forward controllers of
/// ros2_control have no such limit and repeat the last command for ever.
pub(super) const STALE: f64 = 0.1;

/// What a forward controller was told last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Command {
    /// Rad.
    Position(Joints),
    /// Rad/s.
    Velocity(Joints),
}

/// One cycle of `dt` seconds towards a streamed command within the limits on speed, acceleration and
/// range; without a command the arm comes to rest.
pub(super) fn step(from: &Desired, command: Option<&Command>, dt: f64, limits: &Limits) -> Desired {
    let mut out = *from;
    if dt <= 0.0 {
        return out;
    }
    for i in 0..6 {
        let (q, qd) = (from.q[i], from.qd[i]);
        let most = limits.joint_velocity;
        let (wanted, rate) = match command {
            Some(Command::Position(target)) => {
                let error = target[i].clamp(limits.joint_lower[i], limits.joint_upper[i]) - q;
                (approach(error, limits.joint_acceleration, dt), limits.joint_acceleration)
            }
            Some(Command::Velocity(v)) => (v[i], limits.joint_acceleration),
            None => (0.0, limits.stop_acceleration),
        };
        // Never faster towards the end of the range than what still stops before it.
        let stop = limits.stop_acceleration;
        let up = approach(limits.joint_upper[i] - q, stop, dt).max(0.0);
        let down = approach(limits.joint_lower[i] - q, stop, dt).min(0.0);
        let wanted = wanted.clamp(-most, most).clamp(down, up);
        // Braking may be as hard as a stop.
        let slower = wanted.abs() < qd.abs() || wanted * qd < 0.0;
        let rate = if slower { rate.max(limits.stop_acceleration) } else { rate };
        out.qd[i] = qd + (wanted - qd).clamp(-rate * dt, rate * dt);
        out.q[i] = (q + out.qd[i] * dt).clamp(limits.joint_lower[i], limits.joint_upper[i]);
    }
    out
}

/// Greatest speed (rad/s) at a distance `error` (rad) that still comes to rest there with
/// `deceleration` when it is changed only every `dt` seconds.
fn approach(error: f64, deceleration: f64, dt: f64) -> f64 {
    let a = 0.8 * deceleration;
    let speed = (a * a * dt * dt / 4.0 + 2.0 * a * error.abs()).sqrt() - a * dt / 2.0;
    speed.min(error.abs() / dt).copysign(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.008;

    fn run(command: Option<Command>, from: Desired, n: usize) -> Vec<Desired> {
        let limits = Limits::default();
        let mut s = from;
        (0..n)
            .map(|_| {
                let next = step(&s, command.as_ref(), DT, &limits);
                for i in 0..6 {
                    let a = (next.qd[i] - s.qd[i]).abs() / DT;
                    assert!(a <= limits.stop_acceleration + 1e-9, "{a}");
                    assert!(next.qd[i].abs() <= limits.joint_velocity + 1e-9);
                }
                s = next;
                s
            })
            .collect()
    }

    #[test]
    fn a_far_target_is_reached_without_overshoot() {
        let mut target = [0.2; 6];
        target[0] = 1.0;
        target[5] = -1.0;
        let path = run(Some(Command::Position(target)), Desired { q: [0.0; 6], qd: [0.0; 6] }, 400);
        let end = path[path.len() - 1];
        for i in 0..6 {
            assert!((end.q[i] - target[i]).abs() < 1e-6 && end.qd[i].abs() < 1e-4, "{end:?}");
        }
        let beyond = path.iter().map(|s| s.q[0]).fold(0.0, f64::max);
        assert!(beyond < 1.0 + 1e-6, "{beyond}");
    }

    #[test]
    fn velocity_stops_at_the_end_of_the_range_and_without_a_command() {
        let limits = Limits::default();
        let start = Desired { q: [2.8; 6], qd: [0.0; 6] };
        let path = run(Some(Command::Velocity([5.0; 6])), start, 300);
        let end = path[path.len() - 1];
        assert!((end.q[2] - limits.joint_upper[2]).abs() < 0.01 && end.qd[2].abs() < 0.02);
        assert!((end.qd[0] - limits.joint_velocity).abs() < 1e-9);
        let rest = run(None, Desired { q: [0.0; 6], qd: [1.0; 6] }, 20);
        assert_eq!(rest[rest.len() - 1].qd, [0.0; 6]);
        assert!(rest[rest.len() - 1].q[0] < 0.05);
    }
}
