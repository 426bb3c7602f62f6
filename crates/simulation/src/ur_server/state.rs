//! What the sockets and the lab share: registers in, a snapshot out.

use crate::controller::{Controller, ServoInputs};
use crate::lab::Lab;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Vector3;
use tdv_ur_protocol::rtde::{Value, output_field};
use tdv_ur_protocol::servo;

/// The registers that RTDE clients write. A value stays until it is overwritten.
#[derive(Debug, Clone)]
pub(crate) struct InputRegisters {
    ints: [i32; 48],
    doubles: [f64; 48],
    bits: [bool; 64],
    slider_mask: u32,
    slider_fraction: f64,
}

impl Default for InputRegisters {
    fn default() -> Self {
        Self {
            ints: [0; 48],
            doubles: [0.0; 48],
            bits: [false; 64],
            slider_mask: 0,
            slider_fraction: 1.0,
        }
    }
}

fn register_index(name: &str, prefix: &str) -> Option<usize> {
    name.strip_prefix(prefix)?.parse().ok()
}

impl InputRegisters {
    /// Writes a field that `input_field` knows; outputs that this lab has no use for are dropped.
    pub(crate) fn write(&mut self, name: &str, value: Value) {
        match value {
            Value::Int32(v) => {
                let slot = register_index(name, "input_int_register_");
                if let Some(r) = slot.and_then(|i| self.ints.get_mut(i)) {
                    *r = v;
                }
            }
            Value::Double(v) if name == "speed_slider_fraction" => self.slider_fraction = v,
            Value::Double(v) => {
                let slot = register_index(name, "input_double_register_");
                if let Some(r) = slot.and_then(|i| self.doubles.get_mut(i)) {
                    *r = v;
                }
            }
            Value::Bool(v) => {
                let slot = register_index(name, "input_bit_register_");
                if let Some(r) = slot.and_then(|i| self.bits.get_mut(i.wrapping_sub(64))) {
                    *r = v;
                }
            }
            Value::Uint32(v) if name == "speed_slider_mask" => self.slider_mask = v,
            _ => {}
        }
    }

    fn read(&self, name: &str) -> Option<Value> {
        if let Some(i) = register_index(name, "input_int_register_") {
            return self.ints.get(i).copied().map(Value::Int32);
        }
        if let Some(i) = register_index(name, "input_double_register_") {
            return self.doubles.get(i).copied().map(Value::Double);
        }
        let i = register_index(name, "input_bit_register_")?;
        self.bits.get(i.checked_sub(64)?).copied().map(Value::Bool)
    }

    fn int(&self, name: &str) -> i32 {
        self.read(name).and_then(|v| v.as_i32()).unwrap_or(0)
    }

    /// The registers of the servo program.
    pub(crate) fn servo(&self) -> ServoInputs {
        ServoInputs {
            command: self.int(servo::COMMAND),
            heartbeat: self.int(servo::HEARTBEAT),
            targets: servo::TARGETS
                .map(|n| self.read(n).and_then(|v| v.as_f64()).unwrap_or(f64::NAN)),
        }
    }

    /// The speed slider, if a client moves it.
    pub(crate) fn slider(&self) -> Option<f64> {
        (self.slider_mask & 1 == 1).then_some(self.slider_fraction)
    }
}

/// The controller's state as RTDE shows it.
#[derive(Debug, Clone)]
pub(crate) struct Snapshot {
    timestamp: f64,
    q: [f64; 6],
    qd: [f64; 6],
    target: [f64; 6],
    tool: [f64; 6],
    target_tool: [f64; 6],
    force: [f64; 6],
    robot_mode: i32,
    safety_mode: i32,
    runtime_state: u32,
    robot_status_bits: u32,
    safety_status_bits: u32,
    speed_fraction: f64,
    program: i32,
    echo: i32,
}

fn six(pose: &Pose) -> [f64; 6] {
    let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

impl Snapshot {
    pub(crate) fn of(lab: &Lab) -> Self {
        let c = lab.controller();
        // RTDE gives forces in the controller's base, which is base_link turned by pi about z.
        let f: Vector3<f64> = crate::arm::base_link_to_base().rotation.inverse() * lab.tool_force();
        Self {
            timestamp: c.time(),
            q: *c.q(),
            qd: *c.qd(),
            target: *c.target(),
            tool: six(&c.tool_pose()),
            target_tool: six(&Controller::tool_pose_at(c.target())),
            force: [f.x, f.y, f.z, 0.0, 0.0, 0.0],
            robot_mode: c.robot_mode(),
            safety_mode: c.safety_mode(),
            runtime_state: c.runtime_state() as u32,
            robot_status_bits: c.robot_status_bits(),
            safety_status_bits: c.safety_status_bits(),
            speed_fraction: c.speed_fraction(),
            program: c.program_state() as i32,
            echo: c.heartbeat_echo(),
        }
    }

    /// Value of an output field; fields that the lab does not simulate are zero.
    pub(crate) fn value(&self, name: &str, inputs: &InputRegisters) -> Option<Value> {
        let kind = output_field(name)?;
        let value = match name {
            "timestamp" => Value::Double(self.timestamp),
            "actual_q" => Value::Vector6d(self.q),
            "actual_qd" => Value::Vector6d(self.qd),
            "target_q" => Value::Vector6d(self.target),
            "actual_TCP_pose" => Value::Vector6d(self.tool),
            "target_TCP_pose" => Value::Vector6d(self.target_tool),
            "actual_TCP_force" => Value::Vector6d(self.force),
            "robot_mode" => Value::Int32(self.robot_mode),
            "joint_mode" => Value::Vector6Int32([253; 6]),
            "safety_mode" => Value::Int32(self.safety_mode),
            "runtime_state" => Value::Uint32(self.runtime_state),
            "robot_status_bits" => Value::Uint32(self.robot_status_bits),
            "safety_status_bits" => Value::Uint32(self.safety_status_bits),
            "speed_scaling" => Value::Double(1.0),
            "target_speed_fraction" => Value::Double(self.speed_fraction),
            servo::PROGRAM_STATE => Value::Int32(self.program),
            servo::HEARTBEAT_ECHO => Value::Int32(self.echo),
            _ => inputs.read(name).unwrap_or_else(|| Value::zero(kind)),
        };
        // A table that names one type and a match that makes another would break the stream.
        (value.field_type() == kind).then_some(value).or_else(|| Some(Value::zero(kind)))
    }
}
