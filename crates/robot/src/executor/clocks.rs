use super::motion::RobotInput;

/// How the robot's clock and the graph's belong together. States of the robot are late now and then, never
/// early: the least difference seen is the true one.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Clocks {
    /// Graph minus robot (s), and the robot's time when it was updated.
    offset: Option<(f64, f64)>,
}

/// The clocks may drift apart by this share.
const DRIFT: f64 = 1e-3;
/// A difference that grows by more than this (s) is a clock that was set.
const SET: f64 = 0.2;

impl Clocks {
    fn difference(robot: &RobotInput) -> f64 {
        robot.clock.as_secs() - robot.time
    }

    /// One state of the robot.
    pub fn observe(&mut self, robot: &RobotInput) {
        let seen = Self::difference(robot);
        let offset = match self.offset {
            Some((offset, at)) if seen - offset < SET && robot.time >= at => {
                seen.min(offset + DRIFT * (robot.time - at))
            }
            _ => seen,
        };
        self.offset = Some((offset, robot.time));
    }

    /// How late (s) this state was looked at.
    pub fn late(&self, robot: &RobotInput) -> f64 {
        self.offset.map_or(0.0, |(offset, _)| Self::difference(robot) - offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::Stamp;

    fn state(time: f64, clock: f64) -> RobotInput {
        RobotInput {
            time,
            clock: Stamp::from_secs(clock),
            q: [0.0; 6],
            qd: [0.0; 6],
            may_move: true,
            watchdog: false,
            factor: 1.0,
            enabled: true,
        }
    }

    #[test]
    fn late_states_are_known_to_be_late_and_set_clocks_are_followed() {
        let mut c = Clocks::default();
        for n in 0..100 {
            let t = 0.008 * f64::from(n);
            let late = 0.001 * f64::from(n % 7);
            let s = state(t, 1000.0 + t + late);
            c.observe(&s);
            if n > 7 {
                assert!((c.late(&s) - late).abs() < 1e-4, "{n}: {}", c.late(&s));
            }
        }
        for clock in [2000.0, 500.0] {
            let s = state(1.0, clock);
            c.observe(&s);
            assert!(c.late(&s).abs() < 1e-9);
        }
        // A robot that was switched off and on.
        let s = state(0.1, 500.3);
        c.observe(&s);
        assert!(c.late(&s).abs() < 1e-9);
    }
}
