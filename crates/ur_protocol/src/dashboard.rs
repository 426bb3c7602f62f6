//! The dashboard server (TCP 29999): the commands that the lab's server knows, the whole client's side,
//! and the way back from any stop.

mod client;
mod recovery;

pub use client::{
    Answer, MAX_ARGUMENT, ROBOT_MODES, Request, SAFETY_MODES, robot_mode_name, safety_mode_name,
};
pub use recovery::{Recovery, RobotStatus, Step, UNLOCK_AFTER};

/// Sent by the server on connection.
pub const GREETING: &str = "Connected: Universal Robots Dashboard Server";

/// A command to the dashboard server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// `robotmode`
    RobotMode,
    /// `safetymode`
    SafetyMode,
    /// `running`
    Running,
    /// `programState`
    ProgramState,
    /// `PolyscopeVersion`
    PolyscopeVersion,
    /// `play`
    Play,
    /// `pause`
    Pause,
    /// `stop`
    Stop,
    /// `unlock protective stop`
    UnlockProtectiveStop,
    /// `quit`
    Quit,
}

const TEXTS: [(Command, &str); 10] = [
    (Command::RobotMode, "robotmode"),
    (Command::SafetyMode, "safetymode"),
    (Command::Running, "running"),
    (Command::ProgramState, "programState"),
    (Command::PolyscopeVersion, "PolyscopeVersion"),
    (Command::Play, "play"),
    (Command::Pause, "pause"),
    (Command::Stop, "stop"),
    (Command::UnlockProtectiveStop, "unlock protective stop"),
    (Command::Quit, "quit"),
];

impl Command {
    /// The line without its newline.
    pub fn text(self) -> &'static str {
        TEXTS.iter().find(|t| t.0 == self).map_or("", |t| t.1)
    }

    /// Command from a line; the server ignores case.
    pub fn parse(line: &str) -> Option<Self> {
        let line = line.trim();
        TEXTS.iter().find(|t| t.1.eq_ignore_ascii_case(line)).map(|t| t.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_round_trip() {
        for (command, text) in TEXTS {
            assert_eq!(Command::parse(&format!("{text}\n")), Some(command));
            assert_eq!(command.text(), text);
        }
        assert_eq!(Command::parse("self destruct"), None);
    }
}
