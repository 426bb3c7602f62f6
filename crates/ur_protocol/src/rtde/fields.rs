use super::FieldType;

/// Outputs that Universal Robots' own ROS driver asks for, on every controller that it knows.
pub const DRIVER_OUTPUTS: [&str; 32] = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "speed_scaling",
    "target_speed_fraction",
    "runtime_state",
    "actual_TCP_force",
    "actual_TCP_pose",
    "target_TCP_pose",
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
    "tool_temperature",
    "robot_mode",
    "safety_mode",
    "robot_status_bits",
    "safety_status_bits",
    "actual_current",
    "tcp_offset",
    "payload",
    "payload_cog",
    "payload_inertia",
];
/// Inputs that Universal Robots' own ROS driver sets.
pub const DRIVER_INPUTS: [&str; 12] = [
    "speed_slider_mask",
    "speed_slider_fraction",
    "standard_digital_output_mask",
    "standard_digital_output",
    "configurable_digital_output_mask",
    "configurable_digital_output",
    "tool_digital_output_mask",
    "tool_digital_output",
    "standard_analog_output_mask",
    "standard_analog_output_type",
    "standard_analog_output_0",
    "standard_analog_output_1",
];

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
    ("actual_current_window", FieldType::Vector6d),
    ("actual_current_as_torque", FieldType::Vector6d),
    ("actual_TCP_acceleration", FieldType::Vector6d),
    ("target_TCP_acceleration", FieldType::Vector6d),
    ("actual_configurable_digital_input_bits", FieldType::Uint64),
    ("actual_configurable_digital_output_bits", FieldType::Uint64),
    ("target_execution_time", FieldType::Double),
    ("safety_status", FieldType::Int32),
    ("elbow_position", FieldType::Vector3d),
    ("elbow_velocity", FieldType::Vector3d),
    ("analog_io_types", FieldType::Uint32),
    ("io_current", FieldType::Double),
    ("euromap67_input_bits", FieldType::Uint32),
    ("euromap67_output_bits", FieldType::Uint32),
    ("euromap67_24V_voltage", FieldType::Double),
    ("euromap67_24V_current", FieldType::Double),
    ("tool_analog_input_types", FieldType::Uint32),
    ("tool_analog_input0", FieldType::Double),
    ("tool_analog_input1", FieldType::Double),
    ("tool_output_voltage", FieldType::Int32),
    ("tool_output_current", FieldType::Double),
    ("tool_temperature", FieldType::Double),
    ("tool_output_mode", FieldType::Uint8),
    ("tool_digital_output0_mode", FieldType::Uint8),
    ("tool_digital_output1_mode", FieldType::Uint8),
    ("tcp_force_scalar", FieldType::Double),
    ("joint_position_deviation_ratio", FieldType::Double),
    ("collision_detection_ratio", FieldType::Double),
    ("ft_raw_wrench", FieldType::Vector6d),
    ("wrench_calc_from_currents", FieldType::Vector6d),
    ("payload_inertia", FieldType::Vector6d),
    ("script_control_line", FieldType::Uint32),
    ("time_scale_source", FieldType::Int32),
    ("target_gravity", FieldType::Vector3d),
    ("target_base_acceleration", FieldType::Vector6d),
    ("target_base_wrench", FieldType::Vector6d),
    ("control_step", FieldType::Uint64),
    ("output_bit_registers0_to_31", FieldType::Uint32),
    ("output_bit_registers32_to_63", FieldType::Uint32),
    ("input_bit_registers0_to_31", FieldType::Uint32),
    ("input_bit_registers32_to_63", FieldType::Uint32),
];

const INPUTS: &[(&str, FieldType)] = &[
    ("speed_slider_mask", FieldType::Uint32),
    ("speed_slider_fraction", FieldType::Double),
    ("standard_digital_output_mask", FieldType::Uint8),
    ("standard_digital_output", FieldType::Uint8),
    ("configurable_digital_output_mask", FieldType::Uint8),
    ("configurable_digital_output", FieldType::Uint8),
    ("tool_digital_output_mask", FieldType::Uint8),
    ("tool_digital_output", FieldType::Uint8),
    ("standard_analog_output_mask", FieldType::Uint8),
    ("standard_analog_output_type", FieldType::Uint8),
    ("standard_analog_output_0", FieldType::Double),
    ("standard_analog_output_1", FieldType::Double),
    ("external_force_torque", FieldType::Vector6d),
    ("input_bit_registers0_to_31", FieldType::Uint32),
    ("input_bit_registers32_to_63", FieldType::Uint32),
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

    #[test]
    fn the_official_drivers_recipes_are_known() {
        assert!(DRIVER_OUTPUTS.iter().all(|n| output_field(n).is_some()));
        assert!(DRIVER_INPUTS.iter().all(|n| input_field(n).is_some()));
        // Types where a guess would go wrong.
        for (name, kind) in [
            ("tool_output_voltage", FieldType::Int32),
            ("tool_analog_input_types", FieldType::Uint32),
            ("actual_digital_input_bits", FieldType::Uint64),
            ("payload_cog", FieldType::Vector3d),
        ] {
            assert_eq!(output_field(name), Some(kind), "{name}");
        }
        assert_eq!(input_field("standard_analog_output_mask"), Some(FieldType::Uint8));
        let mut names: Vec<&str> = OUTPUTS.iter().map(|f| f.0).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), OUTPUTS.len(), "a name occurs twice");
    }
}
