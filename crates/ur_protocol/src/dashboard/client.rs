//! The client's side of the dashboard server: every command, and what its answer says.

use crate::ProtocolError;

/// Longest argument of a command (a file name, a text), bytes.
pub const MAX_ARGUMENT: usize = 200;

/// A command with its argument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// `power on`
    PowerOn,
    /// `power off`
    PowerOff,
    /// `brake release`
    BrakeRelease,
    /// `play`
    Play,
    /// `pause`
    Pause,
    /// `stop`
    Stop,
    /// `unlock protective stop`: refused within 5 s of the stop.
    UnlockProtectiveStop,
    /// `restart safety`: after a violation or a fault.
    RestartSafety,
    /// `close popup`
    ClosePopup,
    /// `close safety popup`
    CloseSafetyPopup,
    /// `shutdown`: of the controller's computer.
    Shutdown,
    /// `quit`: of this connection.
    Quit,
    /// `clear operational mode`
    ClearOperationalMode,
    /// `robotmode`
    RobotMode,
    /// `safetymode`
    SafetyMode,
    /// `safetystatus` (e-Series)
    SafetyStatus,
    /// `running`
    Running,
    /// `programState`
    ProgramState,
    /// `get loaded program`
    LoadedProgram,
    /// `isProgramSaved`
    IsProgramSaved,
    /// `PolyscopeVersion`
    PolyscopeVersion,
    /// `get serial number`
    SerialNumber,
    /// `get robot model`
    RobotModel,
    /// `is in remote control` (e-Series)
    IsInRemoteControl,
    /// `load NAME`
    Load(String),
    /// `load installation NAME`
    LoadInstallation(String),
    /// `popup TEXT`
    Popup(String),
    /// `addToLog TEXT`
    AddToLog(String),
    /// Any other line.
    Raw(String),
}

/// What an answer says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// The command was taken; the server's words.
    Done,
    /// The command was refused or not understood.
    Refused,
    /// `robot_mode` as RTDE numbers it.
    RobotMode(i8),
    /// `safety_mode` as RTDE numbers it.
    SafetyMode(u8),
    /// Yes or no: a program runs, the robot is in remote control.
    Flag(bool),
    /// `STOPPED`, `PLAYING` or `PAUSED`, and the program's name.
    Program(String, String),
    /// Whether the loaded program is saved, and its name.
    Saved(bool, String),
    /// A text: a program's name, the robot's model.
    Text(String),
    /// A serial number.
    Number(u64),
    /// Major, minor, bug-fix, build.
    Version([u32; 4]),
}

impl Request {
    fn command(&self) -> &'static str {
        match self {
            Self::PowerOn => "power on",
            Self::PowerOff => "power off",
            Self::BrakeRelease => "brake release",
            Self::Play => "play",
            Self::Pause => "pause",
            Self::Stop => "stop",
            Self::UnlockProtectiveStop => "unlock protective stop",
            Self::RestartSafety => "restart safety",
            Self::ClosePopup => "close popup",
            Self::CloseSafetyPopup => "close safety popup",
            Self::Shutdown => "shutdown",
            Self::Quit => "quit",
            Self::ClearOperationalMode => "clear operational mode",
            Self::RobotMode => "robotmode",
            Self::SafetyMode => "safetymode",
            Self::SafetyStatus => "safetystatus",
            Self::Running => "running",
            Self::ProgramState => "programState",
            Self::LoadedProgram => "get loaded program",
            Self::IsProgramSaved => "isProgramSaved",
            Self::PolyscopeVersion => "PolyscopeVersion",
            Self::SerialNumber => "get serial number",
            Self::RobotModel => "get robot model",
            Self::IsInRemoteControl => "is in remote control",
            Self::Load(_) => "load",
            Self::LoadInstallation(_) => "load installation",
            Self::Popup(_) => "popup",
            Self::AddToLog(_) => "addToLog",
            Self::Raw(_) => "",
        }
    }

    /// The line with its newline.
    ///
    /// # Errors
    /// [`ProtocolError::Argument`] for an argument that would not stay on its line or is too long.
    pub fn to_line(&self) -> Result<String, ProtocolError> {
        let (Self::Load(text)
        | Self::LoadInstallation(text)
        | Self::Popup(text)
        | Self::AddToLog(text)
        | Self::Raw(text)) = self
        else {
            return Ok(format!("{}\n", self.command()));
        };
        let text = text.trim();
        if text.is_empty() || text.len() > MAX_ARGUMENT || text.chars().any(char::is_control) {
            return Err(ProtocolError::Argument(text.chars().take(40).collect()));
        }
        Ok(format!("{} {text}\n", self.command()).trim_start().to_owned())
    }

    /// What the server's line says to this command.
    pub fn answer(&self, line: &str) -> Answer {
        let line = line.trim();
        let after = |prefix: &str| line.strip_prefix(prefix).map(str::trim);
        let begins = |words: &[&str]| {
            let lower = line.to_ascii_lowercase();
            if words.iter().any(|w| lower.starts_with(w)) { Answer::Done } else { Answer::Refused }
        };
        let text = |t: Option<&str>| t.map_or(Answer::Refused, |t| Answer::Text(t.to_owned()));
        match self {
            Self::PowerOn => begins(&["powering on"]),
            Self::PowerOff => begins(&["powering off"]),
            Self::BrakeRelease => begins(&["brake releasing"]),
            Self::Play => begins(&["starting program"]),
            Self::Pause => begins(&["pausing program"]),
            Self::Stop => begins(&["stopped"]),
            Self::UnlockProtectiveStop => begins(&["protective stop releasing"]),
            Self::RestartSafety => begins(&["restarting safety"]),
            Self::ClosePopup => begins(&["closing popup"]),
            Self::CloseSafetyPopup => begins(&["closing safety popup"]),
            Self::Shutdown => begins(&["shutting down"]),
            Self::Quit => begins(&["disconnected"]),
            Self::ClearOperationalMode => begins(&["operational mode", "no longer controlling"]),
            Self::Load(_) => begins(&["loading program"]),
            Self::LoadInstallation(_) => begins(&["loading installation"]),
            Self::Popup(_) => begins(&["showing popup"]),
            Self::AddToLog(_) => begins(&["added log message"]),
            Self::RobotMode => after("Robotmode:")
                .and_then(|n| number_of(&ROBOT_MODES, n))
                .map_or(Answer::Refused, |m| Answer::RobotMode(m as i8)),
            Self::SafetyMode => after("Safetymode:")
                .and_then(|n| number_of(&SAFETY_MODES, n))
                .map_or(Answer::Refused, |m| Answer::SafetyMode(m as u8)),
            Self::SafetyStatus => text(after("Safetystatus:")),
            Self::Running => after("Program running:").map_or(Answer::Refused, flag),
            Self::IsInRemoteControl => flag(line),
            Self::ProgramState => match line.split_once(' ').unwrap_or((line, "")) {
                (state @ ("STOPPED" | "PLAYING" | "PAUSED"), name) => {
                    Answer::Program(state.into(), name.trim().into())
                }
                _ => Answer::Refused,
            },
            Self::LoadedProgram => text(after("Loaded program:")),
            Self::IsProgramSaved => match line.split_once(' ').unwrap_or((line, "")) {
                ("true", name) => Answer::Saved(true, name.trim().into()),
                ("false", name) => Answer::Saved(false, name.trim().into()),
                _ => Answer::Refused,
            },
            Self::PolyscopeVersion => version(line).map_or(Answer::Refused, Answer::Version),
            Self::SerialNumber => line.parse().map_or(Answer::Refused, Answer::Number),
            Self::RobotModel => text(line.starts_with("UR").then_some(line)),
            Self::Raw(_) => Answer::Text(line.to_owned()),
        }
    }
}

fn flag(text: &str) -> Answer {
    match text {
        "true" => Answer::Flag(true),
        "false" => Answer::Flag(false),
        _ => Answer::Refused,
    }
}

/// `URSoftware 3.15.8.106339 (Jun 01 2022)`, with two to four numbers.
fn version(line: &str) -> Option<[u32; 4]> {
    let numbers = line.strip_prefix("URSoftware ")?.split_whitespace().next()?;
    let mut out = [0; 4];
    for (i, part) in numbers.split('.').enumerate() {
        *out.get_mut(i)? = part.parse().ok()?;
    }
    Some(out)
}

fn number_of(names: &[(i16, &str)], name: &str) -> Option<i16> {
    names.iter().find(|n| n.1 == name).map(|n| n.0)
}

/// Robot modes by number.
pub const ROBOT_MODES: [(i16, &str); 10] = [
    (-1, "NO_CONTROLLER"),
    (0, "DISCONNECTED"),
    (1, "CONFIRM_SAFETY"),
    (2, "BOOTING"),
    (3, "POWER_OFF"),
    (4, "POWER_ON"),
    (5, "IDLE"),
    (6, "BACKDRIVE"),
    (7, "RUNNING"),
    (8, "UPDATING_FIRMWARE"),
];
/// Safety modes by number.
pub const SAFETY_MODES: [(i16, &str); 13] = [
    (1, "NORMAL"),
    (2, "REDUCED"),
    (3, "PROTECTIVE_STOP"),
    (4, "RECOVERY"),
    (5, "SAFEGUARD_STOP"),
    (6, "SYSTEM_EMERGENCY_STOP"),
    (7, "ROBOT_EMERGENCY_STOP"),
    (8, "VIOLATION"),
    (9, "FAULT"),
    (10, "VALIDATE_JOINT_ID"),
    (11, "UNDEFINED"),
    (12, "AUTOMATIC_MODE_SAFEGUARD_STOP"),
    (13, "SYSTEM_THREE_POSITION_ENABLING_STOP"),
];

/// Name of a robot mode for people.
pub fn robot_mode_name(mode: i32) -> &'static str {
    ROBOT_MODES.iter().find(|m| i32::from(m.0) == mode).map_or("unknown", |m| m.1)
}

/// Name of a safety mode for people.
pub fn safety_mode_name(mode: i32) -> &'static str {
    SAFETY_MODES.iter().find(|m| i32::from(m.0) == mode).map_or("unknown", |m| m.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_answers_as_the_server_has_them() {
        let load = Request::Load("pick.urp".into());
        assert_eq!(load.to_line().unwrap(), "load pick.urp\n");
        assert_eq!(Request::Raw("robotmode".into()).to_line().unwrap(), "robotmode\n");
        for (request, line, answer) in [
            (Request::RobotMode, "Robotmode: RUNNING", Answer::RobotMode(7)),
            (Request::RobotMode, "Robotmode: NO_CONTROLLER", Answer::RobotMode(-1)),
            (Request::SafetyMode, "Safetymode: PROTECTIVE_STOP", Answer::SafetyMode(3)),
            (Request::Running, "Program running: true", Answer::Flag(true)),
            (Request::ProgramState, "STOPPED", Answer::Program("STOPPED".into(), String::new())),
            (Request::Play, "Failed to execute: play", Answer::Refused),
            (Request::Play, "Starting program", Answer::Done),
            (Request::UnlockProtectiveStop, "Cannot unlock protective stop", Answer::Refused),
            (
                Request::PolyscopeVersion,
                "URSoftware 3.15.8.106339 (Jun 2022)",
                Answer::Version([3, 15, 8, 106_339]),
            ),
            (Request::SerialNumber, "2017301234", Answer::Number(2_017_301_234)),
            (Request::LoadedProgram, "No program loaded", Answer::Refused),
            (load, "File not found: pick.urp", Answer::Refused),
        ] {
            assert_eq!(request.answer(line), answer, "{request:?} {line}");
        }
    }

    #[test]
    fn arguments_stay_on_their_line() {
        for text in ["", "two\nstop", "a\rb", &"x".repeat(300)] {
            assert!(Request::Popup(text.to_owned()).to_line().is_err(), "{text:?}");
        }
    }
}
