use super::FieldType;

/// A field and its direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldKind {
    /// Controller to client.
    Output,
    /// Client to controller.
    Input,
}

const OUTPUTS: &[(&str, FieldType)] = &[
    ("timestamp", FieldType::Double),
    ("target_q", FieldType::Vector6d),
    ("target_qd", FieldType::Vector6d),
    ("target_qdd", FieldType::Vector6d),
    ("target_current", FieldType::Vector6d),
    ("target_moment", FieldType::Vector6d),
    ("actual_q", FieldType::Vector6d),
    ("actual_qd", FieldType::Vector6d),
    ("actual_current", FieldType::Vector6d),
    ("actual_robot_current", FieldType::Double),
    ("joint_control_output", FieldType::Vector6d),
    ("actual_TCP_pose", FieldType::Vector6d),
    ("actual_TCP_speed", FieldType::Vector6d),
    ("actual_TCP_force", FieldType::Vector6d),
    ("target_TCP_pose", FieldType::Vector6d),
    ("target_TCP_speed", FieldType::Vector6d),
    ("actual_digital_input_bits", FieldType::Uint64),
    ("actual_digital_output_bits", FieldType::Uint64),
    ("joint_temperatures", FieldType::Vector6d),
    ("actual_execution_time", FieldType::Double),
    ("robot_mode", FieldType::Int32),
    ("joint_mode", FieldType::Vector6Int32),
    ("safety_mode", FieldType::Int32),
    ("actual_tool_accelerometer", FieldType::Vector3d),
    ("speed_scaling", FieldType::Double),
    ("target_speed_fraction", FieldType::Double),
    ("actual_momentum", FieldType::Double),
    ("actual_main_voltage", FieldType::Double),
    ("actual_robot_voltage", FieldType::Double),
    ("actual_joint_voltage", FieldType::Vector6d),
    ("runtime_state", FieldType::Uint32),
    ("robot_status_bits", FieldType::Uint32),
    ("safety_status_bits", FieldType::Uint32),
    ("standard_analog_input0", FieldType::Double),
    ("standard_analog_input1", FieldType::Double),
    ("standard_analog_output0", FieldType::Double),
    ("standard_analog_output1", FieldType::Double),
    ("tool_mode", FieldType::Uint32),
    ("tcp_offset", FieldType::Vector6d),
    ("payload", FieldType::Double),
    ("payload_cog", FieldType::Vector3d),
];

const INPUTS: &[(&str, FieldType)] = &[
    ("speed_slider_mask", FieldType::Uint32),
    ("speed_slider_fraction", FieldType::Double),
    ("standard_digital_output_mask", FieldType::Uint8),
    ("standard_digital_output", FieldType::Uint8),
    ("configurable_digital_output_mask", FieldType::Uint8),
    ("configurable_digital_output", FieldType::Uint8),
];

fn register(name: &str, direction: &str) -> Option<FieldType> {
    let rest = name.strip_prefix(direction)?;
    let parse = |prefix: &str, kind, range: std::ops::Range<u32>| {
        let digits = rest.strip_prefix(prefix)?;
        let n: u32 = digits.parse().ok()?;
        (range.contains(&n) && digits == n.to_string()).then_some(kind)
    };
    parse("_int_register_", FieldType::Int32, 0..48)
        .or_else(|| parse("_double_register_", FieldType::Double, 0..48))
        .or_else(|| parse("_bit_register_", FieldType::Bool, 64..128))
}

/// Type of an output field, `None` if no controller has it.
pub fn output_field(name: &str) -> Option<FieldType> {
    OUTPUTS
        .iter()
        .find(|f| f.0 == name)
        .map(|f| f.1)
        .or_else(|| register(name, "output"))
        .or_else(|| register(name, "input"))
}

/// Type of an input field, `None` if no controller has it.
pub fn input_field(name: &str) -> Option<FieldType> {
    INPUTS.iter().find(|f| f.0 == name).map(|f| f.1).or_else(|| register(name, "input"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_and_their_ranges() {
        assert_eq!(input_field("input_int_register_24"), Some(FieldType::Int32));
        assert_eq!(input_field("input_double_register_47"), Some(FieldType::Double));
        assert_eq!(input_field("input_double_register_48"), None);
        assert_eq!(input_field("input_bit_register_63"), None);
        assert_eq!(input_field("input_bit_register_64"), Some(FieldType::Bool));
        assert_eq!(input_field("input_int_register_024"), None);
        assert_eq!(output_field("output_int_register_0"), Some(FieldType::Int32));
        assert_eq!(output_field("actual_q"), Some(FieldType::Vector6d));
        assert_eq!(output_field("actual_Q"), None);
        assert_eq!(input_field("actual_q"), None);
    }
}
