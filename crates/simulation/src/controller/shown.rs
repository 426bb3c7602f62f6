//! What the controller shows and what can be wired to it.

use super::core::MessageKind;
use super::{
    Controller, Generation, Inputs, Lines, Message, RESUME, Registers, RobotMode, RuntimeState,
    SafetyMode, StopReason,
};
use tdv_geometry::Pose;

impl Controller {
    /// Which controller this is.
    pub fn generation(&self) -> Generation {
        self.core.generation
    }

    /// Seconds since it was switched on.
    pub fn time(&self) -> f64 {
        self.core.time
    }

    /// Joint angles, rad.
    pub fn q(&self) -> &[f64; 6] {
        &self.core.mover.q
    }

    /// Joint speeds, rad/s.
    pub fn qd(&self) -> &[f64; 6] {
        &self.core.mover.qd
    }

    /// Joint accelerations, rad/s^2.
    pub fn qdd(&self) -> &[f64; 6] {
        &self.core.mover.qdd
    }

    /// `T_base_tool0`: the flange in the controller's own frame `base`.
    pub fn tool_pose(&self) -> Pose {
        self.core.mover.flange(self.q())
    }

    /// `T_base_tcp`: the tool centre point that the program has set.
    pub fn tcp_pose(&self) -> Pose {
        self.core.mover.fk(self.q())
    }

    /// Speed of the tool centre point in `base` axes: m/s, rad/s.
    pub fn tcp_speed(&self) -> [f64; 6] {
        let x = self.core.mover.tcp_speed();
        std::array::from_fn(|i| x[i])
    }

    /// `T_tool0_tcp`.
    pub fn tcp_offset(&self) -> Pose {
        *self.core.mover.tool()
    }

    /// Payload: kg, centre of gravity in `tool0` (m), inertia (kg m^2: xx, yy, zz, xy, xz, yz).
    pub fn payload(&self) -> (f64, [f64; 3], [f64; 6]) {
        (self.core.payload, self.core.payload_cog, self.core.payload_inertia)
    }

    /// Tells the controller the force (N) and torque (N m) at its tool, in `base` axes.
    pub fn set_tcp_force(&mut self, force: [f64; 6]) {
        self.core.force_raw = force;
    }

    /// What [`set_tcp_force`](Self::set_tcp_force) said last, less what a script zeroed.
    pub fn tcp_force(&self) -> [f64; 6] {
        self.core.force()
    }

    /// The input registers, as clients see them.
    pub fn inputs(&self) -> &Inputs {
        &self.core.inputs
    }

    /// The input registers, to write.
    pub fn inputs_mut(&mut self) -> &mut Inputs {
        &mut self.core.inputs
    }

    /// The output registers that programs write.
    pub fn outputs(&self) -> &Registers {
        &self.core.outputs
    }

    /// Digital and analog lines.
    pub fn lines(&self) -> &Lines {
        &self.core.lines
    }

    /// Digital and analog lines, to wire something up.
    pub fn lines_mut(&mut self) -> &mut Lines {
        &mut self.core.lines
    }

    /// What the controller has said since the last call, oldest first.
    pub fn take_messages(&mut self) -> Vec<Message> {
        self.core.messages.drain(..).collect()
    }

    /// Shows a popup.
    pub fn show_popup(&mut self, text: &str) {
        self.core.popup = Some(text.to_owned());
        self.core.say(MessageKind::Popup, text.to_owned());
    }

    /// Closes the popup.
    pub fn close_popup(&mut self) {
        self.core.popup = None;
    }

    /// The popup that is shown.
    pub fn popup(&self) -> Option<&str> {
        self.core.popup.as_deref()
    }

    /// `runtime_state`.
    pub fn runtime_state(&self) -> RuntimeState {
        self.runtime
    }

    /// Why it stands in a protective stop, if it does.
    pub fn protective_stop(&self) -> Option<StopReason> {
        self.core.stop.map(|s| s.0)
    }

    /// `robot_mode`.
    pub fn robot_mode(&self) -> RobotMode {
        self.core.power.mode()
    }

    /// `safety_mode`.
    pub fn safety_mode(&self) -> SafetyMode {
        self.core.safety
    }

    /// `robot_status_bits`: power, program running, power button.
    pub fn robot_status_bits(&self) -> u32 {
        let powered = self.robot_mode() != RobotMode::PowerOff;
        u32::from(powered) | u32::from(self.program_running()) << 1 | 1 << 3
    }

    /// `safety_status_bits`.
    pub fn safety_status_bits(&self) -> u32 {
        self.core.safety.status_bits()
    }

    /// Whether a program runs (not: waits).
    pub fn program_running(&self) -> bool {
        matches!(self.runtime, RuntimeState::Playing | RuntimeState::Resuming)
    }

    /// The speed slider, 0..=1.
    pub fn speed_fraction(&self) -> f64 {
        self.core.slider
    }

    /// `speed_scaling`: 1 while a program may move the arm at the slider's speed, 0 while it waits.
    pub fn speed_scaling(&self) -> f64 {
        match self.runtime {
            RuntimeState::Playing | RuntimeState::Stopped => 1.0,
            RuntimeState::Resuming => 1.0 - (self.resume_left / RESUME).clamp(0.0, 1.0),
            _ => 0.0,
        }
    }
}
