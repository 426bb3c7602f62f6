//! One state of the robot as RTDE sends it.

use tdv_robot::Joints;
use tdv_ur_protocol::rtde::Value;
use tdv_ur_protocol::servo::{self, ProgramState};

/// Robot mode in which the arm moves.
pub const RUNNING: i32 = 7;
/// Safety modes in which it does: normal and reduced.
pub const SAFE: [i32; 2] = [1, 2];
/// `runtime_state` while a paused program is taken up again.
const RESUMING: u32 = 5;
/// Heartbeats that the program's echo may be behind, longer than any `stopj` takes: 1.2 s on a CB3, 0.3 s on
/// an e-Series.
const ECHO_BEHIND: i32 = 150;

/// What is asked for, in this order.
pub const OUTPUTS: [&str; 28] = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_TCP_pose",
    "actual_TCP_force",
    "speed_scaling",
    "target_speed_fraction",
    "runtime_state",
    "robot_mode",
    "safety_mode",
    "robot_status_bits",
    "safety_status_bits",
    servo::PROGRAM_STATE,
    servo::HEARTBEAT_ECHO,
    "actual_digital_input_bits",
    "actual_digital_output_bits",
    "standard_analog_input0",
    "standard_analog_input1",
    "standard_analog_output0",
    "standard_analog_output1",
    "analog_io_types",
    "tool_mode",
    "tool_analog_input_types",
    "tool_analog_input0",
    "tool_analog_input1",
    "tool_output_voltage",
    "tool_output_current",
];

/// Inputs and outputs of the control box and the tool.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InputsOutputs {
    /// Bits 0-7 standard, 8-15 configurable, 16-17 tool.
    pub digital_in: u64,
    pub digital_out: u64,
    /// Standard analog 0 and 1 (A or V).
    pub analog_in: [f64; 2],
    pub analog_out: [f64; 2],
    /// Bits 0-1 inputs, 2-3 outputs; set: voltage.
    pub analog_types: u32,
    pub tool_mode: u32,
    pub tool_analog_types: u32,
    pub tool_analog: [f64; 2],
    /// V
    pub tool_voltage: i32,
    /// A
    pub tool_current: f64,
}

/// One state of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmState {
    /// The robot's clock, s.
    pub time: f64,
    pub q: Joints,
    pub qd: Joints,
    pub current: Joints,
    /// Position (m) and rotation vector (rad) of the TCP in the frame `base`.
    pub tcp_pose: [f64; 6],
    /// Force (N) and torque (N m) at the TCP.
    pub tcp_force: [f64; 6],
    pub speed_scaling: f64,
    pub speed_fraction: f64,
    pub runtime_state: u32,
    pub robot_mode: i32,
    pub safety_mode: i32,
    pub program_running: bool,
    /// State of the servo program, none for a value it never writes.
    pub program: Option<ProgramState>,
    pub echo: i32,
    pub io: InputsOutputs,
}

impl ArmState {
    /// From the values of [`OUTPUTS`]; `None` for types or numbers that no robot sends.
    pub fn from_values(values: &[Value]) -> Option<Self> {
        let at = |name: &str| values.get(OUTPUTS.iter().position(|n| *n == name)?);
        let vector = |name| at(name)?.as_vector6d();
        let double = |name| at(name)?.as_f64();
        let int = |name| at(name)?.as_i32();
        let bits = |name| at(name)?.as_u32();
        let state = Self {
            time: double("timestamp")?,
            q: vector("actual_q")?,
            qd: vector("actual_qd")?,
            current: vector("actual_current")?,
            tcp_pose: vector("actual_TCP_pose")?,
            tcp_force: vector("actual_TCP_force")?,
            speed_scaling: double("speed_scaling")?,
            speed_fraction: double("target_speed_fraction")?,
            runtime_state: bits("runtime_state")?,
            robot_mode: int("robot_mode")?,
            safety_mode: int("safety_mode")?,
            program_running: bits("robot_status_bits")? & 0b10 != 0,
            program: ProgramState::from_register(int(servo::PROGRAM_STATE)?),
            echo: int(servo::HEARTBEAT_ECHO)?,
            io: InputsOutputs {
                digital_in: at("actual_digital_input_bits")?.as_u64()?,
                digital_out: at("actual_digital_output_bits")?.as_u64()?,
                analog_in: [double("standard_analog_input0")?, double("standard_analog_input1")?],
                analog_out: [
                    double("standard_analog_output0")?,
                    double("standard_analog_output1")?,
                ],
                analog_types: bits("analog_io_types")?,
                tool_mode: bits("tool_mode")?,
                tool_analog_types: bits("tool_analog_input_types")?,
                tool_analog: [double("tool_analog_input0")?, double("tool_analog_input1")?],
                tool_voltage: int("tool_output_voltage")?,
                tool_current: double("tool_output_current")?,
            },
        };
        let finite = [state.q, state.qd, state.tcp_pose].iter().flatten().all(|v| v.is_finite());
        (finite && state.time.is_finite()).then_some(state)
    }

    /// Powered, and no stop for safety.
    pub fn is_safe(&self) -> bool {
        self.robot_mode == RUNNING && SAFE.contains(&self.safety_mode)
    }

    /// Whether a program of ours runs that has answered to one of the last heartbeats. The program's
    /// registers alone say nothing: they outlive it.
    pub fn has_program(&self, heartbeat: i32) -> bool {
        self.program_running
            && matches!(self.program, Some(p) if p != ProgramState::NotRunning)
            && (0..=ECHO_BEHIND).contains(&heartbeat.wrapping_sub(self.echo))
    }

    /// Speed scaling times slider; zero while a paused program is taken up again.
    pub fn factor(&self) -> f64 {
        if self.runtime_state == RESUMING { 0.0 } else { self.speed_scaling * self.speed_fraction }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_ur_protocol::rtde::output_field;

    #[test]
    fn every_field_is_read_by_its_type() {
        let mut values: Vec<Value> =
            OUTPUTS.iter().map(|n| Value::zero(output_field(n).unwrap())).collect();
        let s = ArmState::from_values(&values).unwrap();
        assert!(!s.has_program(0) && !s.is_safe());
        values[11] = Value::Uint32(0b11);
        values[13] = Value::Int32(1);
        values[14] = Value::Int32(i32::MAX - 3);
        let s = ArmState::from_values(&values).unwrap();
        // The counter wraps.
        assert!(s.has_program(i32::MIN + 5) && s.has_program(i32::MAX - 3));
        assert!(!s.has_program(i32::MIN + 200) && !s.has_program(i32::MAX - 4));
        values[1] = Value::Vector6d([f64::NAN; 6]);
        assert!(ArmState::from_values(&values).is_none());
    }
}
