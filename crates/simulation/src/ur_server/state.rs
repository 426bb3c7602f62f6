//! What the sockets and the lab share: registers in, fields out.

use crate::controller::{Controller, Inputs, RobotMode, six};
use tdv_ur_protocol::rtde::{FieldType, Value, output_field};

/// What RTDE clients write. A value stays until it is overwritten.
#[derive(Debug, Clone, Default)]
pub(crate) struct InputRegisters {
    inputs: Inputs,
    slider_mask: u32,
    slider_fraction: f64,
    slider_moved: bool,
    /// Mask and value of standard, configurable and tool outputs in the package that is being read.
    lines: [(u8, u8); 3],
    analog: (u8, [f64; 2]),
    /// What the lab has not fetched yet.
    pending: Pending,
}

/// Changes that are not registers.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Pending {
    pub(crate) slider: Option<f64>,
    pub(crate) digital: (u64, u64),
    pub(crate) analog: [Option<f64>; 2],
}

fn register_index(name: &str, prefix: &str) -> Option<usize> {
    name.strip_prefix(prefix)?.parse().ok()
}

impl InputRegisters {
    /// Writes a field that `input_field` knows; inputs that this lab has no use for are dropped.
    pub(crate) fn write(&mut self, name: &str, value: Value) {
        match value {
            Value::Int32(v) => {
                if let Some(i) = register_index(name, "input_int_register_") {
                    self.inputs.write_int(i, v);
                }
            }
            Value::Double(v) => match name {
                "speed_slider_fraction" => (self.slider_fraction, self.slider_moved) = (v, true),
                "standard_analog_output_0" => self.analog.1[0] = v,
                "standard_analog_output_1" => self.analog.1[1] = v,
                _ => {
                    if let Some(i) = register_index(name, "input_double_register_") {
                        self.inputs.write_double(i, v);
                    }
                }
            },
            Value::Bool(v) => {
                if let Some(i) = register_index(name, "input_bit_register_") {
                    self.inputs.write_bit(i, v);
                }
            }
            Value::Uint32(v) => {
                let first = match name {
                    "speed_slider_mask" => {
                        (self.slider_mask, self.slider_moved) = (v, true);
                        return;
                    }
                    "input_bit_registers0_to_31" => 0,
                    "input_bit_registers32_to_63" => 32,
                    _ => return,
                };
                for i in 0..32 {
                    self.inputs.write_bit(first + i, v >> i & 1 == 1);
                }
            }
            Value::Uint8(v) => match name {
                "standard_digital_output_mask" => self.lines[0].0 = v,
                "standard_digital_output" => self.lines[0].1 = v,
                "configurable_digital_output_mask" => self.lines[1].0 = v,
                "configurable_digital_output" => self.lines[1].1 = v,
                "tool_digital_output_mask" => self.lines[2].0 = v,
                "tool_digital_output" => self.lines[2].1 = v,
                "standard_analog_output_mask" => self.analog.0 = v,
                _ => {}
            },
            _ => {}
        }
    }

    /// The end of a package: masks hold for it alone.
    pub(crate) fn settle(&mut self) {
        for (shift, (mask, value)) in [0, 8, 16].into_iter().zip(self.lines) {
            let (mask, value) = (u64::from(mask) << shift, u64::from(value) << shift);
            let (all, values) = &mut self.pending.digital;
            *values = (*values & !mask) | (value & mask);
            *all |= mask;
        }
        for i in 0..2 {
            if self.analog.0 >> i & 1 == 1 {
                self.pending.analog[i] = Some(self.analog.1[i]);
            }
        }
        if self.slider_moved && self.slider_mask & 1 == 1 {
            self.pending.slider = Some(self.slider_fraction);
        }
        self.slider_moved = false;
        self.lines = [(0, 0); 3];
        self.analog.0 = 0;
    }

    /// Hands everything to the controller.
    pub(crate) fn deliver(&mut self, c: &mut Controller) {
        c.inputs_mut().clone_from(&self.inputs);
        let p = std::mem::take(&mut self.pending);
        if let Some(fraction) = p.slider {
            c.set_speed_fraction(fraction);
        }
        let (mask, value) = p.digital;
        let lines = c.lines_mut();
        lines.set_outputs(mask, value);
        for (line, to) in lines.analog_out.iter_mut().zip(p.analog) {
            if let Some(to) = to.filter(|v| v.is_finite()) {
                *line = to.clamp(0.0, 1.0);
            }
        }
    }

    /// The registers as they stand.
    pub(crate) fn inputs(&self) -> &Inputs {
        &self.inputs
    }
}

/// Where the value of an output field comes from; looked up once, when a recipe is set up.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source {
    Field(Get),
    InputInt(usize),
    InputDouble(usize),
    InputBit(usize),
    OutputInt(usize),
    OutputDouble(usize),
    OutputBit(usize),
    /// Not simulated.
    Zero(FieldType),
}

fn word(bits: &[bool; 128], first: usize) -> Value {
    let bits = bits.iter().skip(first).take(32).enumerate();
    Value::Uint32(bits.fold(0, |w, (i, b)| w | u32::from(*b) << i))
}

pub(crate) fn joint_mode(c: &Controller) -> i32 {
    match c.robot_mode() {
        RobotMode::Running => 253,
        RobotMode::Idle => 255,
        RobotMode::PowerOn => 247,
        RobotMode::PowerOff => 239,
    }
}

/// Value of a field.
type Get = fn(&Controller) -> Value;

/// Names and values of what is simulated.
const FIELDS: &[(&str, Get)] = &[
    ("timestamp", |c| Value::Double(c.time())),
    ("actual_q", |c| Value::Vector6d(*c.q())),
    ("actual_qd", |c| Value::Vector6d(*c.qd())),
    ("target_q", |c| Value::Vector6d(*c.q())),
    ("target_qd", |c| Value::Vector6d(*c.qd())),
    ("target_qdd", |c| Value::Vector6d(*c.qdd())),
    ("actual_TCP_pose", |c| Value::Vector6d(six(&c.tcp_pose()))),
    ("target_TCP_pose", |c| Value::Vector6d(six(&c.tcp_pose()))),
    ("actual_TCP_speed", |c| Value::Vector6d(c.tcp_speed())),
    ("target_TCP_speed", |c| Value::Vector6d(c.tcp_speed())),
    ("actual_TCP_force", |c| Value::Vector6d(c.tcp_force())),
    ("tcp_force_scalar", |c| {
        let [x, y, z, ..] = c.tcp_force();
        Value::Double((x * x + y * y + z * z).sqrt())
    }),
    ("tcp_offset", |c| Value::Vector6d(six(&c.tcp_offset()))),
    ("payload", |c| Value::Double(c.payload().0)),
    ("payload_cog", |c| Value::Vector3d(c.payload().1)),
    ("payload_inertia", |c| Value::Vector6d(c.payload().2)),
    ("robot_mode", |c| Value::Int32(c.robot_mode() as i32)),
    ("joint_mode", |c| Value::Vector6Int32([joint_mode(c); 6])),
    ("safety_mode", |c| Value::Int32(c.safety_mode() as i32)),
    ("safety_status", |c| Value::Int32(c.safety_mode() as i32)),
    ("runtime_state", |c| Value::Uint32(c.runtime_state() as u32)),
    ("robot_status_bits", |c| Value::Uint32(c.robot_status_bits())),
    ("safety_status_bits", |c| Value::Uint32(c.safety_status_bits())),
    ("speed_scaling", |c| Value::Double(c.speed_scaling())),
    ("target_speed_fraction", |c| Value::Double(c.speed_fraction())),
    ("elbow_position", |c| Value::Vector3d(elbow(c))),
    ("actual_digital_input_bits", |c| Value::Uint64(c.lines().digital_in)),
    ("actual_digital_output_bits", |c| Value::Uint64(c.lines().digital_out)),
    // Both inputs and both outputs in volts.
    ("analog_io_types", |_| Value::Uint32(0b1111)),
    ("standard_analog_input0", |c| Value::Double(c.lines().analog_in[0])),
    ("standard_analog_input1", |c| Value::Double(c.lines().analog_in[1])),
    ("standard_analog_output0", |c| Value::Double(10.0 * c.lines().analog_out[0])),
    ("standard_analog_output1", |c| Value::Double(10.0 * c.lines().analog_out[1])),
    ("tool_output_voltage", |c| Value::Int32(c.lines().tool_voltage)),
    ("output_bit_registers0_to_31", |c| word(&c.outputs().bits, 0)),
    ("output_bit_registers32_to_63", |c| word(&c.outputs().bits, 32)),
    ("input_bit_registers0_to_31", |c| word(&c.inputs().registers.bits, 0)),
    ("input_bit_registers32_to_63", |c| word(&c.inputs().registers.bits, 32)),
];

/// The elbow in the controller's base, m.
pub(crate) fn elbow(c: &Controller) -> [f64; 3] {
    let frame = c.generation().arm().link_frames(c.q())[2];
    let e = crate::arm::base_link_to_base().inverse() * frame.translation.vector;
    [e.x, e.y, e.z]
}

impl Source {
    /// Source of an output field, `None` if no controller has it.
    pub(crate) fn of(name: &str) -> Option<Self> {
        let kind = output_field(name)?;
        type Register = fn(usize) -> Source;
        let registers: [(&str, Register); 6] = [
            ("input_int_register_", Self::InputInt),
            ("input_double_register_", Self::InputDouble),
            ("input_bit_register_", Self::InputBit),
            ("output_int_register_", Self::OutputInt),
            ("output_double_register_", Self::OutputDouble),
            ("output_bit_register_", Self::OutputBit),
        ];
        let register = registers.into_iter().find_map(|(p, s)| register_index(name, p).map(s));
        let field = FIELDS.iter().find(|f| f.0 == name).map(|f| Self::Field(f.1));
        Some(register.or(field).unwrap_or(Self::Zero(kind)))
    }

    /// Its value now.
    pub(crate) fn read(&self, c: &Controller) -> Value {
        let (i, o) = (&c.inputs().registers, c.outputs());
        let int = |r: &[i32], i: &usize| Value::Int32(r.get(*i).copied().unwrap_or(0));
        let double = |r: &[f64], i: &usize| Value::Double(r.get(*i).copied().unwrap_or(0.0));
        let bit = |r: &[bool], i: &usize| Value::Bool(r.get(*i).copied().unwrap_or(false));
        match self {
            Self::Field(get) => get(c),
            Self::InputInt(n) => int(&i.ints, n),
            Self::InputDouble(n) => double(&i.doubles, n),
            Self::InputBit(n) => bit(&i.bits, n),
            Self::OutputInt(n) => int(&o.ints, n),
            Self::OutputDouble(n) => double(&o.doubles, n),
            Self::OutputBit(n) => bit(&o.bits, n),
            Self::Zero(kind) => Value::zero(*kind),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Generation;

    #[test]
    fn every_field_has_the_type_that_the_table_names() {
        let c = Controller::new(Generation::Cb3, [0.1; 6]);
        for (name, get) in FIELDS {
            if let Some(kind) = output_field(name) {
                assert_eq!(get(&c).field_type(), kind, "{name}");
            }
        }
        assert!(Source::of("nonsense").is_none());
        assert!(matches!(Source::of("output_bit_register_64"), Some(Source::OutputBit(64))));
    }

    #[test]
    fn masks_hold_for_their_package_and_sums_reach_the_controller() {
        let mut c = Controller::new(Generation::Cb3, [0.0; 6]);
        let mut r = InputRegisters::default();
        for (mask, value) in [(0b101, 0b111), (0b010, 0b010)] {
            r.write("standard_digital_output_mask", Value::Uint8(mask));
            r.write("standard_digital_output", Value::Uint8(value));
            r.settle();
        }
        r.write("configurable_digital_output", Value::Uint8(255));
        r.write("speed_slider_fraction", Value::Double(0.4));
        r.settle();
        r.deliver(&mut c);
        assert_eq!((c.lines().digital_out, c.speed_fraction()), (0b111, 1.0));
        r.write("speed_slider_mask", Value::Uint32(1));
        r.settle();
        r.deliver(&mut c);
        assert_eq!(c.speed_fraction(), 0.4);
    }
}
