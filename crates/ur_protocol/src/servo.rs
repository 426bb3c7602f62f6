//! How the driver and the servo program on the controller talk through RTDE registers (the range
//! 24-47 is the one left to external RTDE clients; 0-23 belong to fieldbuses).

/// Input, INT32: what the program has to do, see [`Command`].
pub const COMMAND: &str = "input_int_register_24";
/// Input, INT32: changes with every fresh command.
pub const HEARTBEAT: &str = "input_int_register_25";
/// Inputs, DOUBLE: joint targets, rad, in UR order.
pub const TARGETS: [&str; 6] = [
    "input_double_register_24",
    "input_double_register_25",
    "input_double_register_26",
    "input_double_register_27",
    "input_double_register_28",
    "input_double_register_29",
];
/// Output, INT32: see [`ProgramState`].
pub const PROGRAM_STATE: &str = "output_int_register_24";
/// Output, INT32: the last heartbeat the program has seen.
pub const HEARTBEAT_ECHO: &str = "output_int_register_25";
/// Without a changed heartbeat for this long (s) while servoing the program decelerates to rest.
pub const WATCHDOG: f64 = 0.100;
/// A target farther than this (rad, any joint) from the measured position is refused at a (re)start.
pub const START_WINDOW: f64 = 0.1;

/// Value of [`COMMAND`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum Command {
    /// Rest.
    Idle = 0,
    /// Follow the joint targets.
    Servo = 1,
}

/// Value of [`PROGRAM_STATE`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum ProgramState {
    /// No program.
    NotRunning = 0,
    /// Running, at rest.
    Ready = 1,
    /// Following.
    Servoing = 2,
    /// At rest because the heartbeat stopped; a fresh command near the present position resumes.
    WatchdogStop = 3,
}

impl ProgramState {
    /// From the register; `None` for a value that the program never writes.
    pub fn from_register(value: i32) -> Option<Self> {
        [Self::NotRunning, Self::Ready, Self::Servoing, Self::WatchdogStop]
            .into_iter()
            .find(|s| *s as i32 == value)
    }
}
