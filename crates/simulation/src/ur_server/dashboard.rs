use super::outbox::lock;
use super::{Shared, read_all};
use crate::controller::{Controller, RuntimeState};
use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use tdv_ur_protocol::dashboard::{Command, GREETING};
use tdv_ur_protocol::gripper::LineReader;

/// Serves one client of the dashboard.
pub(super) fn serve(mut stream: TcpStream, shared: &Arc<Shared>) {
    let mut lines = LineReader::default();
    let Ok(mut out) = stream.try_clone() else { return };
    if out.write_all(format!("{GREETING}\n").as_bytes()).is_err() {
        return;
    }
    let end = read_all(&mut stream, shared, |bytes| {
        lines.push(bytes).map_err(|e| e.to_string())?;
        while let Some(line) = lines.next_line() {
            let mut say = |text: &str| {
                out.write_all(format!("{text}\n").as_bytes()).map_err(|e| e.to_string())
            };
            match Command::parse(&line) {
                None => say(&format!("could not understand: '{line}'"))?,
                Some(Command::Quit) => {
                    say("Disconnected")?;
                    return Err("quit".into());
                }
                Some(command) => {
                    let (send, receive) = sync_channel(1);
                    lock(&shared.dashboard).push((command, send));
                    let answer = receive.recv_timeout(Duration::from_secs(2));
                    say(answer.as_deref().unwrap_or("the lab does not answer"))?;
                }
            }
        }
        Ok(())
    });
    if let Err(reason) = end {
        tracing::debug!("dashboard client disconnected: {reason}");
    }
}

/// Carries out a command and returns the answer's line.
pub(super) fn execute(command: Command, c: &mut Controller) -> String {
    match command {
        Command::RobotMode => "Robotmode: RUNNING".into(),
        Command::SafetyMode => match c.protective_stop() {
            None => "Safetymode: NORMAL".into(),
            Some(_) => "Safetymode: PROTECTIVE_STOP".into(),
        },
        Command::Running => {
            format!("Program running: {}", c.runtime_state() == RuntimeState::Playing)
        }
        Command::ProgramState => match c.runtime_state() {
            RuntimeState::Stopped => "STOPPED servo.urp".into(),
            RuntimeState::Playing => "PLAYING servo.urp".into(),
            RuntimeState::Paused => "PAUSED servo.urp".into(),
        },
        Command::PolyscopeVersion => {
            let [major, minor, bugfix, build] = c.generation().version();
            format!("URSoftware {major}.{minor}.{bugfix}.{build}")
        }
        Command::Play => match c.play() {
            Ok(()) => "Starting program".into(),
            Err(_) => "Failed to execute: play".into(),
        },
        Command::Pause => {
            c.pause();
            "Pausing program".into()
        }
        Command::Stop => {
            c.stop_program();
            "Stopped".into()
        }
        Command::UnlockProtectiveStop => match c.unlock() {
            Ok(()) => "Protective stop releasing".into(),
            Err(reason) => reason.into(),
        },
        Command::Quit => "Disconnected".into(),
    }
}
