//! The dashboard server's lines and what they do.

use super::outbox::lock;
use super::{Shared, read_all};
use crate::controller::{Controller, Generation, RobotMode, RuntimeState, SafetyMode};
use std::collections::BTreeMap;
use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use tdv_ur_protocol::dashboard::GREETING;
use tdv_ur_protocol::gripper::LineReader;

/// Serial number that the controller gives.
const SERIAL: &str = "2017350123";

/// What the dashboard keeps besides the controller.
#[derive(Debug, Default)]
pub(super) struct Desk {
    /// Programs that `load` finds, by name.
    pub(super) programs: BTreeMap<String, String>,
    loaded: Option<String>,
    user_role: String,
    operational_mode: Option<String>,
    log: Vec<String>,
}

/// Log lines that are kept.
const MAX_LOG: usize = 200;

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
            let line = line.trim().to_owned();
            if line.is_empty() {
                continue;
            }
            let mut say = |text: &str| {
                out.write_all(format!("{text}\n").as_bytes()).map_err(|e| e.to_string())
            };
            if line.eq_ignore_ascii_case("quit") {
                say("Disconnected")?;
                return Err("quit".into());
            }
            let (send, receive) = sync_channel(1);
            lock(&shared.dashboard).push((line, send));
            let answer = receive.recv_timeout(Duration::from_secs(2));
            say(answer.as_deref().unwrap_or("the lab does not answer"))?;
        }
        Ok(())
    });
    if let Err(reason) = end {
        tracing::debug!("dashboard client disconnected: {reason}");
    }
}

/// The rest of a line after a command's words, whatever their case.
fn after<'a>(line: &'a str, command: &str) -> Option<&'a str> {
    let head = line.get(..command.len())?;
    let rest = &line[command.len()..];
    let whole = rest.is_empty() || rest.starts_with(' ');
    (head.eq_ignore_ascii_case(command) && whole).then(|| rest.trim())
}

/// Carries out a line and returns the answer's line.
pub(super) fn execute(line: &str, c: &mut Controller, desk: &mut Desk) -> String {
    query(line, c, desk)
        .or_else(|| act(line, c, desk))
        .unwrap_or_else(|| format!("could not understand: '{line}'"))
}

fn program_name(desk: &Desk) -> &str {
    desk.loaded.as_deref().unwrap_or("<unnamed>")
}

/// Lines that only ask.
fn query(line: &str, c: &Controller, desk: &Desk) -> Option<String> {
    let e_series = c.generation() == Generation::ESeries;
    Some(match line.to_ascii_lowercase().as_str() {
        "robotmode" => format!("Robotmode: {}", c.robot_mode().name()),
        "safetymode" => format!("Safetymode: {}", c.safety_mode().name()),
        "safetystatus" => format!("Safetystatus: {}", c.safety_mode().name()),
        "running" => format!("Program running: {}", c.program_running()),
        "programstate" => {
            let state = match c.runtime_state() {
                RuntimeState::Stopping | RuntimeState::Stopped => "STOPPED",
                RuntimeState::Playing | RuntimeState::Resuming => "PLAYING",
                RuntimeState::Pausing | RuntimeState::Paused => "PAUSED",
            };
            format!("{state} {}", program_name(desk))
        }
        "polyscopeversion" => {
            let [major, minor, bugfix, build] = c.generation().version();
            let date = if e_series { "Jul 14 2022, 11:15:26" } else { "Mar 31 2020, 08:31:12" };
            format!("URSoftware {major}.{minor}.{bugfix}.{build} ({date})")
        }
        "version" if e_series => {
            let [major, minor, bugfix, build] = c.generation().version();
            format!("URSoftware {major}.{minor}.{bugfix}.{build}")
        }
        "get loaded program" => match &desk.loaded {
            Some(name) => format!("Loaded program: {name}"),
            None => "No program loaded".into(),
        },
        "isprogramsaved" => format!("true {}", program_name(desk)),
        "get serial number" if e_series => SERIAL.into(),
        "get robot model" => "UR5".into(),
        "is in remote control" if e_series => "true".into(),
        "get operational mode" if e_series => {
            desk.operational_mode.clone().unwrap_or_else(|| "NONE".into())
        }
        "getuserrole" => {
            if desk.user_role.is_empty() {
                "PROGRAMMER".into()
            } else {
                desk.user_role.clone()
            }
        }
        _ => return None,
    })
}

/// Lines that do something.
fn act(line: &str, c: &mut Controller, desk: &mut Desk) -> Option<String> {
    let e_series = c.generation() == Generation::ESeries;
    let failed = |what: &str| format!("Failed to execute: {what}");
    if let Some(name) = after(line, "load installation") {
        return Some(format!("Loading installation: {name}"));
    }
    if let Some(name) = after(line, "load") {
        return Some(load(name, c, desk));
    }
    if let Some(text) = after(line, "popup") {
        c.show_popup(text);
        return Some("showing popup".into());
    }
    if let Some(text) = after(line, "addtolog") {
        if desk.log.len() >= MAX_LOG {
            desk.log.remove(0);
        }
        desk.log.push(text.to_owned());
        return Some("Added log message".into());
    }
    if let Some(role) = after(line, "setuserrole") {
        desk.user_role = role.to_owned();
        return Some(format!("Setting user role: {role}"));
    }
    if let Some(mode) = after(line, "set operational mode").filter(|_| e_series) {
        desk.operational_mode = Some(mode.to_ascii_uppercase());
        return Some(format!("Setting operational mode: {mode}"));
    }
    Some(match line.to_ascii_lowercase().as_str() {
        "play" => match c.play() {
            Ok(()) => "Starting program".into(),
            Err(reason) => {
                tracing::debug!("play: {reason}");
                failed("play")
            }
        },
        "pause" => {
            if c.program_running() {
                c.pause();
                "Pausing program".into()
            } else {
                failed("pause")
            }
        }
        "stop" => {
            c.stop_program();
            "Stopped".into()
        }
        "power on" => match c.power_on(false) {
            Ok(()) => "Powering on".into(),
            Err(_) => failed("power on"),
        },
        "power off" => {
            c.power_off();
            "Powering off".into()
        }
        "brake release" => match c.power_on(true) {
            Ok(()) => "Brake releasing".into(),
            Err(_) => failed("brake release"),
        },
        "unlock protective stop" => match c.unlock() {
            Ok(()) => "Protective stop releasing".into(),
            Err(reason) => reason.into(),
        },
        "close safety popup" => "closing safety popup".into(),
        "close popup" => {
            c.close_popup();
            "closing popup".into()
        }
        "restart safety" => {
            let broken = matches!(c.safety_mode(), SafetyMode::Violation | SafetyMode::Fault);
            if broken || c.robot_mode() == RobotMode::PowerOff {
                c.restart_safety();
                "Restarting safety".into()
            } else {
                // A restart that nothing calls for would cut the power of a working arm.
                failed("restart safety")
            }
        }
        "clear operational mode" if e_series => {
            desk.operational_mode = None;
            "operational mode is no longer controlled by Dashboard Server".into()
        }
        "shutdown" => {
            c.power_off();
            "Shutting down".into()
        }
        _ => return None,
    })
}

fn load(name: &str, c: &mut Controller, desk: &mut Desk) -> String {
    let text = desk.programs.get(name).cloned();
    match text {
        None => format!("File not found: {name}"),
        Some(text) => match c.load(&text) {
            Ok(()) => {
                c.stop_program();
                desk.loaded = Some(name.to_owned());
                format!("Loading program: {name}")
            }
            Err(reason) => {
                tracing::warn!("{name}: {reason}");
                format!("Error while loading program: {name}")
            }
        },
    }
}
