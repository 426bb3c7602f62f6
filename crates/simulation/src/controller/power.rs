//! Robot and safety modes, and how one leads to the other.

/// `robot_mode`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum RobotMode {
    /// No power at the arm.
    PowerOff = 3,
    /// Power comes.
    PowerOn = 4,
    /// Powered, brakes on.
    Idle = 5,
    /// Brakes off.
    Running = 7,
}

impl RobotMode {
    /// As the dashboard says it.
    pub fn name(self) -> &'static str {
        match self {
            Self::PowerOff => "POWER_OFF",
            Self::PowerOn => "POWER_ON",
            Self::Idle => "IDLE",
            Self::Running => "RUNNING",
        }
    }
}

/// `safety_mode`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum SafetyMode {
    /// Nothing is wrong.
    Normal = 1,
    /// Reduced limits.
    Reduced = 2,
    /// Stopped by the controller.
    ProtectiveStop = 3,
    /// Outside the limits, may be led back.
    Recovery = 4,
    /// Stopped by a safeguard (light curtain, door).
    SafeguardStop = 5,
    /// Emergency stop of the cell.
    SystemEmergencyStop = 6,
    /// Emergency stop of the robot.
    RobotEmergencyStop = 7,
    /// A safety limit was broken.
    Violation = 8,
    /// The safety system is broken.
    Fault = 9,
}

impl SafetyMode {
    /// As the dashboard's `safetymode` says it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "NORMAL",
            Self::Reduced => "REDUCED",
            Self::ProtectiveStop => "PROTECTIVE_STOP",
            Self::Recovery => "RECOVERY",
            Self::SafeguardStop => "SAFEGUARD_STOP",
            Self::SystemEmergencyStop => "SYSTEM_EMERGENCY_STOP",
            Self::RobotEmergencyStop => "ROBOT_EMERGENCY_STOP",
            Self::Violation => "VIOLATION",
            Self::Fault => "FAULT",
        }
    }

    /// `safety_status_bits`: the mode's own bit, and the sums of all emergency stops and all stops.
    pub fn status_bits(self) -> u32 {
        let own = match self {
            Self::Normal => 0,
            Self::Reduced => 1,
            Self::ProtectiveStop => 2,
            Self::Recovery => 3,
            Self::SafeguardStop => 4,
            Self::SystemEmergencyStop => 5,
            Self::RobotEmergencyStop => 6,
            Self::Violation => 8,
            Self::Fault => 9,
        };
        let emergency = matches!(self, Self::SystemEmergencyStop | Self::RobotEmergencyStop);
        1 << own | if emergency { 1 << 7 } else { 0 } | if self.moves() { 0 } else { 1 << 10 }
    }

    /// Whether the arm may move.
    pub fn moves(self) -> bool {
        matches!(self, Self::Normal | Self::Reduced | Self::Recovery)
    }

    /// Whether the arm loses its power.
    pub fn cuts_power(self) -> bool {
        matches!(
            self,
            Self::SystemEmergencyStop | Self::RobotEmergencyStop | Self::Violation | Self::Fault
        )
    }
}

/// Seconds from power off to idle.
const BOOT: f64 = 1.0;
/// Seconds from idle to running.
const RELEASE: f64 = 1.0;

/// Power of the arm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Power {
    mode: RobotMode,
    release: bool,
    left: f64,
}

impl Power {
    pub(crate) fn new(running: bool) -> Self {
        let mode = if running { RobotMode::Running } else { RobotMode::PowerOff };
        Self { mode, release: false, left: 0.0 }
    }

    pub(crate) fn mode(&self) -> RobotMode {
        self.mode
    }

    pub(crate) fn off(&mut self) {
        *self = Self::new(false);
    }

    /// Power on; with `release` the brakes follow.
    pub(crate) fn on(&mut self, release: bool) {
        match self.mode {
            RobotMode::PowerOff => {
                *self = Self { mode: RobotMode::PowerOn, release, left: BOOT };
            }
            RobotMode::PowerOn => self.release |= release,
            RobotMode::Idle if release && !self.release => {
                (self.release, self.left) = (true, RELEASE)
            }
            _ => {}
        }
    }

    pub(crate) fn step(&mut self, dt: f64) {
        self.left -= dt;
        if self.left > 0.0 {
            return;
        }
        match self.mode {
            RobotMode::PowerOn => (self.mode, self.left) = (RobotMode::Idle, RELEASE),
            RobotMode::Idle if self.release => *self = Self::new(true),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_comes_step_by_step() {
        let mut p = Power::new(false);
        p.on(false);
        assert_eq!(p.mode(), RobotMode::PowerOn);
        for _ in 0..3000 {
            p.step(0.002);
        }
        assert_eq!(p.mode(), RobotMode::Idle, "brakes are released only when asked");
        p.on(true);
        p.step(0.002);
        assert_eq!(p.mode(), RobotMode::Idle);
        for _ in 0..600 {
            p.step(0.002);
        }
        assert_eq!(p.mode(), RobotMode::Running);
        p.off();
        p.on(true);
        for _ in 0..1200 {
            p.step(0.002);
        }
        assert_eq!(p.mode(), RobotMode::Running);
    }

    #[test]
    fn status_bits_as_documented() {
        assert_eq!(SafetyMode::Normal.status_bits(), 1);
        assert_eq!(SafetyMode::Reduced.status_bits(), 0b10);
        assert_eq!(SafetyMode::ProtectiveStop.status_bits(), 1 << 2 | 1 << 10);
        assert_eq!(SafetyMode::RobotEmergencyStop.status_bits(), 1 << 6 | 1 << 7 | 1 << 10);
    }
}
