//! The servo program on the robot: which text, when it is sent, and what else goes to the script port.

use crate::arm_state::ArmState;
use crate::upload::{ProgramKeeper, send_script};
use anyhow::bail;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tdv_runtime::Diagnostics;
use tdv_ur_protocol::script::replaces_program;
use tdv_ur_protocol::servo::ServoProgram;

struct Inner {
    keeper: ProgramKeeper,
    /// Major version of the controller's software.
    major: u32,
    safe: bool,
}

/// Everything that is sent to the script port. Clones share it.
#[derive(Clone)]
pub struct Programs {
    address: SocketAddr,
    template: ServoProgram,
    inner: Arc<Mutex<Inner>>,
    diagnostics: Diagnostics,
}

impl Programs {
    pub fn new(
        address: SocketAddr,
        template: ServoProgram,
        keeper: ProgramKeeper,
        diagnostics: Diagnostics,
    ) -> Self {
        let inner = Inner { keeper, major: 3, safe: false };
        Self { address, template, inner: Arc::new(Mutex::new(inner)), diagnostics }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A controller was connected.
    pub fn connected(&self, major: u32) {
        let mut c = self.lock();
        c.major = major;
        c.keeper.ask();
    }

    /// The connection was lost.
    pub fn lost(&self) {
        self.lock().safe = false;
    }

    /// One state of the robot; true when the servo program has to be sent now.
    pub fn look(&self, state: &ArmState, ours: bool) -> bool {
        let mut c = self.lock();
        c.safe = state.is_safe();
        c.keeper.due(Instant::now(), state, ours)
    }

    /// Why no program of ours runs.
    pub fn reason(&self, state: &ArmState) -> &'static str {
        self.lock().keeper.reason(state)
    }

    /// The operator takes the arm: the program is not sent again by itself.
    pub fn release(&self) {
        self.lock().keeper.release();
    }

    /// Sends the servo program, whatever runs on the robot; refused while it is stopped for safety.
    pub async fn send_servo(&self) -> anyhow::Result<()> {
        let (major, safe) = {
            let c = self.lock();
            (c.major, c.safe)
        };
        if !safe {
            bail!("the robot is not running in a normal safety mode: use set_mode first");
        }
        let program =
            ServoProgram { cycle: ServoProgram::for_version(major).cycle, ..self.template };
        let sent = send_script(self.address, &program.text()?).await;
        match &sent {
            Ok(()) => {
                tracing::info!("servo program sent to {}", self.address);
                self.diagnostics.set("servo_program", "sent");
            }
            Err(error) => {
                tracing::warn!("servo program not sent: {error:#}");
                self.diagnostics.set("servo_program", format!("not sent: {error:#}"));
            }
        }
        sent
    }

    /// Sends somebody's script; one that replaces the servo program ends our hold on the arm.
    pub async fn send(&self, text: &str) -> anyhow::Result<()> {
        if replaces_program(text) {
            self.release();
        }
        send_script(self.address, text).await
    }
}
