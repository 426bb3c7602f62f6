//! Whether a limit was broken, by the robot's own measure.

use super::Rig;
use tdv_simulation::controller::StopReason;
use tdv_simulation::world::DT;
/// Share of a limit by which the robot's own motion may exceed it: the servo's filter.
const ROOM: f64 = 1.15;
/// Joint acceleration (rad/s^2) of the robot that counts as a jolt; its servo allows 20.
const JOLT: f64 = 25.0;

impl Rig {
    /// The robot's own measure of what happens to it.
    pub(super) fn judge(&mut self) {
        let (q, qd) = (*self.lab.joints().0, *self.lab.joints().1);
        let mut broken = |what: String| {
            let words = |s: &str| s.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
            if self.result.violations.iter().all(|v| words(v) != words(&what)) {
                self.result.violations.push(what);
            }
        };
        for i in 0..6 {
            if qd[i].abs() > ROOM * self.limits.joint_velocity {
                broken(format!("joint {i} at {:.2} rad/s", qd[i]));
            }
            let jolt = (qd[i] - self.last_qd[i]).abs() / DT;
            if jolt > JOLT {
                broken(format!("joint {i} accelerates by {jolt:.0} rad/s^2"));
            }
            if q[i] < self.limits.joint_lower[i] || q[i] > self.limits.joint_upper[i] {
                broken(format!("joint {i} at {:.2} rad", q[i]));
            }
        }
        let (speed, _) = self.arm.tcp_speed(&q, &qd);
        if speed > ROOM * self.limits.tcp_speed {
            broken(format!("tcp at {speed:.3} m/s"));
        }
        let height = self.lab.world().clearance();
        if height < 0.0 {
            broken(format!("{:.1} mm into the table", -1e3 * height));
        }
        match self.lab.controller().protective_stop() {
            None | Some(StopReason::Asked) => {}
            Some(reason) => broken(format!("the robot stopped itself: {reason:?}")),
        }
        self.last_qd = qd;
    }
}
