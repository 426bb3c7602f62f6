//! Scripts on their way to the controller, and when the servo program is sent there.

use crate::arm_state::ArmState;
use anyhow::Context as _;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::{timeout, timeout_at};

/// Time to connect and to write.
const PATIENCE: Duration = Duration::from_secs(2);
/// The controller reads a script while it sends its states; a socket closed too early takes the script
/// with it.
const LINGER: Duration = Duration::from_millis(500);

/// Sends a script to a script port.
pub async fn send_script(address: SocketAddr, text: &str) -> anyhow::Result<()> {
    let bytes = tdv_ur_protocol::script::upload(text)?;
    let connected = timeout(PATIENCE, TcpStream::connect(address)).await;
    let mut socket = connected
        .map_err(|_| std::io::Error::from(std::io::ErrorKind::TimedOut))
        .flatten()
        .with_context(|| {
            format!("no script port at {address} (is the robot in remote control?)")
        })?;
    timeout(PATIENCE, socket.write_all(&bytes)).await.context("the script was not taken")??;
    let end = tokio::time::Instant::now() + LINGER;
    let mut sink = [0_u8; 4096];
    while let Ok(Ok(n)) = timeout_at(end, socket.read(&mut sink)).await {
        if n == 0 {
            break;
        }
    }
    Ok(())
}

/// When the servo program is to be sent: at the start, and when somebody asks; not against a stop, and
/// not against an operator who has stopped it.
#[derive(Debug)]
pub struct ProgramKeeper {
    headless: bool,
    keep: bool,
    wanted: bool,
    next: Option<Instant>,
    pause: Duration,
}

impl ProgramKeeper {
    /// `headless`: sends by itself; `keep`: also again after somebody has stopped the program.
    pub fn new(headless: bool, keep: bool) -> Self {
        let pause = Duration::from_secs(1);
        Self { headless, keep, wanted: headless, next: None, pause }
    }

    /// Somebody asks for the program, or a robot was connected.
    pub fn ask(&mut self) {
        self.wanted = self.headless;
        self.next = None;
        self.pause = Duration::from_secs(1);
    }

    /// Somebody else takes the arm: it is not sent by itself until it is asked for.
    pub fn release(&mut self) {
        self.wanted = false;
    }

    /// Whether to send it now. `ours`: a program of ours runs already.
    pub fn due(&mut self, now: Instant, state: &ArmState, ours: bool) -> bool {
        if ours {
            self.wanted = self.keep;
            self.pause = Duration::from_secs(1);
            // Its echo may be missing for a moment; that is no reason to send it again.
            self.next = Some(now + self.pause);
            return false;
        }
        // Another program, or ours that is paused: theirs.
        if !self.wanted || !state.is_safe() || state.program_running || state.runtime_state > 2 {
            return false;
        }
        if self.next.is_some_and(|at| now < at) {
            return false;
        }
        self.next = Some(now + self.pause);
        self.pause = (self.pause * 2).min(Duration::from_secs(16));
        true
    }

    /// Why no program of ours runs, for the diagnostics.
    pub fn reason(&self, state: &ArmState) -> &'static str {
        if state.program_running {
            "another program runs on the robot"
        } else if !state.is_safe() {
            "the robot is stopped or not powered"
        } else if !self.headless {
            "waiting for play: the program has to be started on the robot"
        } else if self.wanted {
            "the servo program is being sent"
        } else {
            "the servo program was stopped: resend_robot_program starts it again"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm_state::OUTPUTS;
    use tdv_ur_protocol::rtde::{Value, output_field};

    fn state(robot_mode: i32, safety_mode: i32, running: bool) -> ArmState {
        let values: Vec<Value> =
            OUTPUTS.iter().map(|n| Value::zero(output_field(n).unwrap())).collect();
        let mut s = ArmState::from_values(&values).unwrap();
        (s.robot_mode, s.safety_mode, s.program_running) = (robot_mode, safety_mode, running);
        s
    }

    #[test]
    fn it_is_sent_once_and_never_against_a_stop_or_a_person() {
        let t = Instant::now();
        let s = Duration::from_secs;
        let mut k = ProgramKeeper::new(true, false);
        for bad in [state(5, 1, false), state(7, 3, false), state(7, 7, false), state(7, 1, true)] {
            assert!(!k.due(t, &bad, false), "{bad:?}");
        }
        let idle = state(7, 1, false);
        assert!(k.due(t, &idle, false));
        assert!(!k.due(t, &idle, false), "it pauses before it tries again");
        assert!(k.due(t + s(2), &idle, false) && !k.due(t + s(3), &idle, false));
        assert!(!k.due(t + s(5), &state(7, 1, true), true));
        // Somebody stops it.
        assert!(!k.due(t + s(60), &idle, false));
        assert!(k.reason(&idle).contains("resend"));
        k.ask();
        assert!(k.due(t + s(61), &idle, false));
        let mut keep = ProgramKeeper::new(true, true);
        keep.due(t, &state(7, 1, true), true);
        assert!(keep.due(t + s(2), &idle, false));
        let mut pendant = ProgramKeeper::new(false, false);
        pendant.ask();
        assert!(!pendant.due(t, &idle, false));
    }
}
