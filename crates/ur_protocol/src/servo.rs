//! How the driver and the servo program on the controller talk through RTDE registers (the range
//! 24-47 is the one left to external RTDE clients; 0-23 belong to fieldbuses), and the program's text.

use thiserror::Error;

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
/// Output, INT32: the last heartbeat whose command the program has accepted.
pub const HEARTBEAT_ECHO: &str = "output_int_register_25";
/// Without a changed heartbeat for this long (s) while servoing the program decelerates to rest.
pub const WATCHDOG: f64 = 0.100;
/// A target farther than this (rad, any joint) from the measured position is refused at a (re)start.
pub const START_WINDOW: f64 = 0.1;
/// A target farther than this (rad, any joint) from the one before is refused while servoing.
pub const MAX_STEP: f64 = 0.1;
/// While targets are missing the program goes on at their last speed for this long (s), and comes to
/// rest within as long again.
pub const EXTRAPOLATE: f64 = 0.024;
/// Greatest joint speed (rad/s) at which it goes on: the robot's own limit.
pub const MAX_SPEED: f64 = std::f64::consts::PI;
/// Name under which the program runs on the controller.
pub const PROGRAM_NAME: &str = "tdv_servo";

/// The text of the program; names in double braces are parameters.
const TEMPLATE: &str = include_str!("servo.script");

/// Value of [`COMMAND`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum Command {
    /// Rest.
    Idle = 0,
    /// Follow the joint targets.
    Servo = 1,
    /// Come to rest and end the program (only with a fresh heartbeat: registers outlive programs).
    Stop = 2,
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

/// A parameter of the program outside its range.
#[derive(Debug, Error, Clone, PartialEq)]
#[error("servo program: {name} is {value}, {least} to {greatest} is possible")]
pub struct ServoProgramError {
    /// The parameter.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// The least possible.
    pub least: f64,
    /// The greatest possible.
    pub greatest: f64,
}

/// Parameters of the servo program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoProgram {
    /// Control cycle (s): 0.008 on a CB3, 0.002 on an e-Series.
    pub cycle: f64,
    /// `servoj` gain, 100 to 2000.
    pub gain: f64,
    /// `servoj` look-ahead time (s), 0.03 to 0.2.
    pub lookahead: f64,
    /// Deceleration of every stop (rad/s^2).
    pub deceleration: f64,
    /// Tool centre point in the flange: position (m) and rotation vector (rad). Zero keeps the measured
    /// tool pose at the flange.
    pub tcp: [f64; 6],
    /// Mass at the flange (kg).
    pub payload: f64,
    /// Its centre of gravity in the flange (m).
    pub center_of_gravity: [f64; 3],
}

impl ServoProgram {
    /// For a CB3 with a 2F-85: gain and look-ahead of Universal Robots' own driver.
    pub fn cb3() -> Self {
        Self {
            cycle: 0.008,
            gain: 2000.0,
            lookahead: 0.03,
            deceleration: 10.0,
            tcp: [0.0; 6],
            payload: 0.92,
            center_of_gravity: [0.0, 0.0, 0.058],
        }
    }

    /// The same for an e-Series.
    pub fn e_series() -> Self {
        Self { cycle: 0.002, ..Self::cb3() }
    }

    /// For a controller of this major software version: 5 and later are e-Series.
    pub fn for_version(major: u32) -> Self {
        if major < 5 { Self::cb3() } else { Self::e_series() }
    }

    /// The program's text, as it is sent to the script port, with its newline at the end.
    ///
    /// # Errors
    /// [`ServoProgramError`] for the first parameter outside its range.
    pub fn text(&self) -> Result<String, ServoProgramError> {
        let single = [
            ("cycle", self.cycle, 0.001, 0.02),
            ("gain", self.gain, 100.0, 2000.0),
            ("lookahead", self.lookahead, 0.03, 0.2),
            ("deceleration", self.deceleration, 0.5, 40.0),
            ("payload", self.payload, 0.0, 20.0),
        ];
        let vectors = self.tcp[..3].iter().map(|v| ("tcp (m)", *v, -1.0, 1.0));
        let turns = self.tcp[3..].iter().map(|v| ("tcp (rad)", *v, -6.2832, 6.2832));
        let masses = self.center_of_gravity.iter().map(|v| ("center_of_gravity", *v, -1.0, 1.0));
        for (name, value, least, greatest) in
            single.into_iter().chain(vectors).chain(turns).chain(masses)
        {
            // Also refuses what is not a number.
            if !(value >= least && value <= greatest) {
                return Err(ServoProgramError { name, value, least, greatest });
            }
        }
        let values = [
            ("CYCLE", number(self.cycle)),
            ("MAX_STEP", number(MAX_STEP)),
            ("START_WINDOW", number(START_WINDOW)),
            ("WATCHDOG", number(WATCHDOG)),
            ("EXTRAPOLATE", number(EXTRAPOLATE)),
            ("MAX_SPEED", number(MAX_SPEED)),
            ("DECELERATION", number(self.deceleration)),
            ("TCP", self.tcp.map(number).join(", ")),
            ("PAYLOAD", number(self.payload)),
            ("COG", self.center_of_gravity.map(number).join(", ")),
            ("LOOKAHEAD", number(self.lookahead)),
            ("GAIN", number(self.gain)),
        ];
        let mut text = TEMPLATE.to_owned();
        for (name, value) in values {
            text = text.replace(&format!("{{{{{name}}}}}"), &value);
        }
        Ok(text)
    }
}

/// A number as URScript reads it: with a point, without an exponent.
fn number(value: f64) -> String {
    format!("{value:.6}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_is_filled_in() {
        for program in [ServoProgram::for_version(3), ServoProgram::for_version(5)] {
            let text = program.text().unwrap();
            assert!(!text.contains("{{") && !text.contains("}}"), "{text}");
            assert!(text.is_ascii() && text.ends_with("end\n"));
            assert!(text.starts_with(&format!("def {PROGRAM_NAME}():\n")));
            assert!(text.contains(&format!("CYCLE = {:.6}\n", program.cycle)));
            assert!(text.contains("servoj(aim, 0, 0, CYCLE, 0.030000, 2000.000000)"));
        }
        let p = ServoProgram { tcp: [0.0, 0.0, 0.15, 0.0, 0.0, 0.0], ..ServoProgram::cb3() };
        let tcp = "set_tcp(p[0.000000, 0.000000, 0.150000, 0.000000, 0.000000, 0.000000])";
        assert!(p.text().unwrap().contains(tcp));
    }

    #[test]
    fn blocks_are_closed() {
        let text = ServoProgram::cb3().text().unwrap();
        let mut depth = 0_i32;
        for line in text.lines().map(str::trim).filter(|l| !l.starts_with('#')) {
            let opens =
                line.ends_with(':') && !line.starts_with("else") && !line.starts_with("elif");
            depth += i32::from(opens) - i32::from(line == "end");
            assert!(depth >= 0, "{line}");
        }
        assert_eq!(depth, 0);
    }

    #[test]
    fn the_registers_are_those_of_the_text() {
        let number = |name: &str| name.rsplit('_').next().unwrap().to_owned();
        let text = TEMPLATE;
        assert!(
            text.contains(&format!("command = read_input_integer_register({})", number(COMMAND)))
        );
        assert!(
            text.contains(&format!(
                "heartbeat = read_input_integer_register({})",
                number(HEARTBEAT)
            ))
        );
        assert!(text.contains(&format!("read_input_float_register({} + i)", number(TARGETS[0]))));
        let state = format!("write_output_integer_register({}, value)", number(PROGRAM_STATE));
        let echo = format!("write_output_integer_register({}, heartbeat)", number(HEARTBEAT_ECHO));
        assert!(text.contains(&state) && text.contains(&echo));
        for (name, value) in [
            ("NOT_RUNNING", ProgramState::NotRunning as i32),
            ("READY", ProgramState::Ready as i32),
            ("SERVOING", ProgramState::Servoing as i32),
            ("WATCHDOG_STOP", ProgramState::WatchdogStop as i32),
            ("SERVO", Command::Servo as i32),
            ("STOP", Command::Stop as i32),
        ] {
            assert!(text.contains(&format!("global {name} = {value}\n")), "{name}");
        }
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        for (p, name) in [
            (ServoProgram { gain: 50.0, ..ServoProgram::cb3() }, "gain"),
            (ServoProgram { lookahead: f64::NAN, ..ServoProgram::cb3() }, "lookahead"),
            (ServoProgram { payload: 30.0, ..ServoProgram::cb3() }, "payload"),
            (ServoProgram { center_of_gravity: [0.0, 2.0, 0.0], ..ServoProgram::cb3() }, "center"),
        ] {
            assert!(p.text().unwrap_err().to_string().contains(name));
        }
    }
}
