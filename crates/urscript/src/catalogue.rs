//! Functions of a controller, as the script manual lists them.

/// Signatures of the controller functions that everyday programs use, in the notation of
/// [`crate::Functions::parse`]: a host announces all of them or those that it has, and changes the
/// defaults that differ between controllers (`t` of `servoj` is one cycle).
///
/// Sources: script manual, "Module motion", "Module internals", "Module interfaces". A parameter
/// that the manual lets be missing without naming a number is `None` here.
pub const CONTROLLER: &str = "\
# motion
movej(q, a = 1.4, v = 1.05, t = 0, r = 0)
movel(pose, a = 1.2, v = 0.25, t = 0, r = 0)
movep(pose, a = 1.2, v = 0.25, r = 0)
movec(pose_via, pose_to, a = 1.2, v = 0.25, r = 0, mode = 0)
servoj(q, a = 0, v = 0, t = 0.008, lookahead_time = 0.1, gain = 300)
servoc(pose, a = 1.2, v = 0.25, r = 0)
speedj(qd, a, t = None)
speedl(xd, a, t = None, aRot = None)
stopj(a)
stopl(a, aRot = None)
force_mode(task_frame, selection_vector, wrench, type, limits)
end_force_mode()
force_mode_set_damping(damping)
force_mode_set_gain_scaling(scaling)
freedrive_mode(freeAxes = None, feature = None)
end_freedrive_mode()
get_freedrive_status()
teach_mode()
end_teach_mode()
tool_contact(direction = None)
get_target_waypoint()
# state
get_actual_joint_positions()
get_actual_joint_positions_history(steps = 0)
get_actual_joint_speeds()
get_actual_tcp_pose()
get_actual_tcp_speed()
get_actual_tool_flange_pose()
get_controller_temp()
get_forward_kin(q = None, tcp = None)
get_inverse_kin(x, qnear = None, maxPositionError = 1e-10, maxOrientationError = 1e-10, tcp = None)
get_inverse_kin_has_solution(pose, qnear = None, maxPositionError = 1e-10, maxOrientationError = 1e-10, tcp = None)
get_joint_positions()
get_joint_temp(j)
get_joint_torques()
get_steptime()
get_target_joint_positions()
get_target_joint_speeds()
get_target_payload()
get_target_payload_cog()
get_target_payload_inertia()
get_target_tcp_pose()
get_target_tcp_speed()
get_tcp_force()
get_tcp_offset()
force()
is_steady()
is_within_safety_limits(pose)
# set-up
set_tcp(pose, tcp_name = None)
set_payload(m, cog = None)
set_payload_mass(m)
set_payload_cog(cog)
set_target_payload(m, cog, inertia = None, transition_time = 0)
set_gravity(d)
zero_ftsensor()
enable_external_ft_sensor(enable, sensor_mass = 0, sensor_measuring_offset = [0, 0, 0], sensor_cog = [0, 0, 0])
ft_rtde_input_enable(enable, sensor_mass = 0, sensor_measuring_offset = [0, 0, 0], sensor_cog = [0, 0, 0])
# program
textmsg(s1, s2 = None)
popup(s, title = 'Popup', warning = False, error = False, blocking = False)
protective_stop()
powerdown()
# inputs, outputs, registers
get_standard_digital_in(n)
get_standard_digital_out(n)
set_standard_digital_out(n, b)
get_configurable_digital_in(n)
get_configurable_digital_out(n)
set_configurable_digital_out(n, b)
get_tool_digital_in(n)
get_tool_digital_out(n)
set_tool_digital_out(n, b)
get_digital_in(n)
get_digital_out(n)
set_digital_out(n, b)
get_standard_analog_in(n)
get_standard_analog_out(n)
set_standard_analog_out(n, f)
get_analog_in(n)
set_analog_out(n, f)
set_tool_voltage(voltage)
read_input_boolean_register(address)
read_input_integer_register(address)
read_input_float_register(address)
read_output_boolean_register(address)
read_output_integer_register(address)
read_output_float_register(address)
write_output_boolean_register(address, value)
write_output_integer_register(address, value)
write_output_float_register(address, value)
rtde_set_watchdog(variable_name, min_frequency, action = 'pause')
# sockets
socket_open(address, port, socket_name = 'socket_0')
socket_close(socket_name = 'socket_0')
socket_get_var(name, socket_name = 'socket_0')
socket_set_var(name, value, socket_name = 'socket_0')
socket_read_ascii_float(number, socket_name = 'socket_0', timeout = 2)
socket_read_binary_integer(number, socket_name = 'socket_0', timeout = 2)
socket_read_byte_list(number, socket_name = 'socket_0', timeout = 2)
socket_read_line(socket_name = 'socket_0', timeout = 2)
socket_read_string(socket_name = 'socket_0', prefix = '', suffix = '', interpret_escape = False, timeout = 2)
socket_send_byte(value, socket_name = 'socket_0')
socket_send_int(value, socket_name = 'socket_0')
socket_send_line(str, socket_name = 'socket_0')
socket_send_string(str, socket_name = 'socket_0')
";

#[cfg(test)]
mod tests {
    use crate::{Functions, Value};

    #[test]
    fn the_catalogue_parses() {
        let all = Functions::parse(super::CONTROLLER).unwrap();
        let lines = super::CONTROLLER.lines().filter(|l| !l.starts_with('#')).count();
        assert_eq!(all.list().len(), lines);
        let servoj = all.get("servoj").unwrap();
        assert_eq!(servoj.parameters[5].default, Some(Value::Int(300)));
    }
}
