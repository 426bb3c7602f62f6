//! The functions that a script on this controller may call.
//!
//! A call that takes time answers [`Reply::Wait`] and is asked again in the next cycle. What this
//! controller does not simulate is known, so that scripts which contain it load, and fails by name
//! when it is called.

use super::core::{Core, MessageKind};
use super::motion::{Motion, Pace, Six};
use super::registers::{Slot, Watchdog, WatchdogAction};
use super::{MAX_SPEED, POSITION_LIMIT, STOP_DECELERATION, StopReason, host_sockets, pose_of, six};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Vector6;
use tdv_urscript::{Call, Host, Reply, Value};

/// Signatures of what this controller has besides the usual functions, or with other defaults.
pub(super) const SIGNATURES: &str = "\
servoj(q, a = 0, v = 0, t = 0.002, lookahead_time = 0.1, gain = 300)
set_speed(fraction)
get_robot_mode()
get_safety_mode()
";

/// More signatures of what a script may contain but this controller does not do.
pub(super) const NOT_SIMULATED: &str = "\
direct_torque(torque, friction_comp = True)
get_jacobian(q = None, tcp = None)
get_jacobian_time_derivative(q = None, qd = None, tcp = None)
get_mass_matrix(q = None, include_rotors_inertia = True)
get_coriolis_and_centrifugal_torques(q = None, qd = None)
get_target_joint_accelerations()
set_conveyor_tick_count(tick_count, absolute_encoder_resolution = 0)
modbus_add_signal(ip, slave, address, type, name)
rpc_factory(type, url)
";

/// A text for the operator.
type Fault = String;

fn number(v: &Value, what: &str) -> Result<f64, Fault> {
    match v.number() {
        Some(x) if x.is_finite() => Ok(x),
        _ => Err(format!("{what} has to be a finite number, not {}", v.kind())),
    }
}

fn positive(v: &Value, what: &str) -> Result<f64, Fault> {
    let x = number(v, what)?;
    if x > 0.0 { Ok(x) } else { Err(format!("{what} is {x}: it has to be greater than 0")) }
}

fn optional(v: &Value, what: &str) -> Result<Option<f64>, Fault> {
    match v {
        Value::Nothing => Ok(None),
        _ => number(v, what).map(Some),
    }
}

fn truth(v: &Value) -> bool {
    match v {
        Value::Bool(b) => *b,
        other => other.number().is_some_and(|x| x != 0.0),
    }
}

fn numbers<const N: usize>(v: &Value, what: &str) -> Result<[f64; N], Fault> {
    let mut out = [0.0; N];
    match v {
        Value::Pose(p) if N == 6 => out.copy_from_slice(&p[..N]),
        Value::List(list) if list.items().len() == N => {
            for (o, item) in out.iter_mut().zip(list.items()) {
                *o = number(item, what)?;
            }
        }
        _ => return Err(format!("{what} has to be a list of {N} numbers, not {}", v.kind())),
    }
    match out.iter().all(|x| x.is_finite()) {
        true => Ok(out),
        false => Err(format!("{what} is not finite")),
    }
}

fn index(v: &Value, end: usize) -> Result<usize, Fault> {
    let x = number(v, "the address")?;
    if x >= 0.0 && x < end as f64 && x.fract() == 0.0 {
        Ok(x as usize)
    } else {
        Err(format!("address {x} is not one of 0 to {}", end - 1))
    }
}

fn done(value: Value) -> Result<Reply, Fault> {
    Ok(Reply::Done(value))
}

/// The line of a text value, or of anything else as a number.
fn words(v: &Value) -> String {
    match v {
        Value::Text(t) => t.to_string(),
        other => other.to_string(),
    }
}

impl Host for Core {
    fn call(&mut self, call: Call<'_>) -> Reply {
        let outcome = if call.function.starts_with("socket_") {
            host_sockets::call(self, call)
        } else {
            self.dispatch(&call)
        };
        outcome.unwrap_or_else(Reply::Error)
    }

    fn abandoned(&mut self, call: Call<'_>) {
        let moves =
            ["movej", "movel", "movep", "servoj", "speedj", "speedl"].contains(&call.function);
        if moves && !matches!(self.mover.motion, Motion::Rest | Motion::Brake(_)) {
            self.mover.brake(STOP_DECELERATION);
        }
    }
}

impl Core {
    fn dispatch(&mut self, call: &Call<'_>) -> Result<Reply, Fault> {
        if let Some(reply) = self.motion(call)? {
            return Ok(reply);
        }
        if let Some(reply) = self.state(call)? {
            return Ok(reply);
        }
        if let Some(reply) = self.line(call)? {
            return Ok(reply);
        }
        Err("is not simulated by this controller".into())
    }

    /// Begins a motion at the first call, then waits for it.
    fn wait(
        &mut self,
        call: &Call<'_>,
        begin: impl FnOnce(&mut Self) -> Result<(), Fault>,
    ) -> Result<Reply, Fault> {
        if call.waited == 0 {
            if !self.can_move() {
                return Err(format!(
                    "the arm cannot move: robot mode {}, safety mode {}",
                    self.power.mode().name(),
                    self.safety.name()
                ));
            }
            begin(self)?;
            self.polled = true;
            // A command takes a cycle even where there is nothing to wait for.
            return Ok(if self.mover.busy() { Reply::Wait } else { Reply::Spent(Value::Nothing) });
        }
        self.polled = true;
        Ok(if self.mover.busy() { Reply::Wait } else { Reply::Done(Value::Nothing) })
    }

    /// Joint angles given as such or as a pose.
    fn joints(&self, v: &Value, what: &str) -> Result<Six, Fault> {
        match v {
            Value::Pose(p) => self
                .mover
                .ik(&pose_of(p), &self.mover.q)
                .ok_or_else(|| format!("no inverse kinematics solution for {what} {p:?}")),
            _ => numbers(v, what),
        }
    }

    fn pose(&self, v: &Value, what: &str) -> Result<Pose, Fault> {
        match v {
            Value::Pose(_) => Ok(pose_of(&numbers::<6>(v, what)?)),
            _ => Ok(self.mover.fk(&numbers(v, what)?)),
        }
    }

    fn motion(&mut self, call: &Call<'_>) -> Result<Option<Reply>, Fault> {
        let a = call.args;
        let blend = |v: &Value| match number(v, "r")? {
            0.0 => Ok(()),
            r => Err(format!("a blend radius (r = {r}) is not simulated by this controller")),
        };
        let pace = |t: &Value| -> Result<Pace, Fault> {
            let (acceleration, v) = (positive(&a[1], "a")?, positive(&a[2], "v")?);
            let t = number(t, "t")?;
            Ok(Pace { v, a: acceleration, t: (t > 0.0).then_some(t) })
        };
        let zero = Value::Int(0);
        let reply = match call.function {
            "movej" => self.wait(call, |c| {
                blend(&a[4])?;
                let to = c.joints(&a[0], "q")?;
                let mut pace = pace(&a[3])?;
                pace.v = pace.v.min(MAX_SPEED);
                c.mover.motion = Motion::Joint { to, pace, plan: None };
                Ok(())
            })?,
            "movel" | "movep" => self.wait(call, |c| {
                let (t, r) = if call.function == "movep" { (&zero, &a[3]) } else { (&a[3], &a[4]) };
                blend(r)?;
                let to = c.pose(&a[0], "pose")?;
                c.mover.motion = Motion::Line { to, pace: pace(t)?, plan: None };
                Ok(())
            })?,
            "servoj" => self.wait(call, |c| {
                let t = positive(&a[3], "t")?;
                let (lookahead, gain) = (number(&a[4], "lookahead_time")?, number(&a[5], "gain")?);
                c.mover.servo(numbers(&a[0], "q")?, t, lookahead, gain);
                Ok(())
            })?,
            "speedj" => self.wait(call, |c| {
                let left = optional(&a[2], "t")?.filter(|t| *t > 0.0);
                let (qd, a) = (numbers(&a[0], "qd")?, positive(&a[1], "a")?);
                c.mover.motion = Motion::SpeedJ { qd, a, left };
                Ok(())
            })?,
            "speedl" => self.wait(call, |c| {
                let left = optional(&a[2], "t")?.filter(|t| *t > 0.0);
                let linear = positive(&a[1], "a")?;
                let turning = optional(&a[3], "aRot")?.filter(|x| *x > 0.0).unwrap_or(linear);
                let xd = Vector6::from(numbers::<6>(&a[0], "xd")?);
                c.mover.speed_l(xd, [linear, turning], left);
                Ok(())
            })?,
            "stopj" => {
                let rate = positive(&a[0], "a")?;
                self.halt(call, |c| c.mover.brake(rate))
            }
            "stopl" => {
                let rate = positive(&a[0], "a")?;
                self.halt(call, |c| c.mover.brake_tool(rate))
            }
            "protective_stop" => {
                self.protect(StopReason::Asked);
                Reply::Spent(Value::Nothing)
            }
            _ => return Ok(None),
        };
        Ok(Some(reply))
    }

    /// Braking is allowed in every mode.
    fn halt(&mut self, call: &Call<'_>, begin: impl FnOnce(&mut Self)) -> Reply {
        if call.waited == 0 {
            begin(self);
            return if self.mover.at_rest() { Reply::Spent(Value::Nothing) } else { Reply::Wait };
        }
        if self.mover.at_rest() { Reply::Done(Value::Nothing) } else { Reply::Wait }
    }

    fn state(&mut self, call: &Call<'_>) -> Result<Option<Reply>, Fault> {
        let a = call.args;
        let list = |v: &[f64]| done(Value::numbers(v)).map(Some);
        let pose = |p: &Pose| done(Value::Pose(six(p))).map(Some);
        let value = |v: Value| done(v).map(Some);
        let reply = match call.function {
            "get_actual_joint_positions" | "get_target_joint_positions" | "get_joint_positions" => {
                return list(&self.mover.q);
            }
            "get_actual_joint_speeds" | "get_target_joint_speeds" => return list(&self.mover.qd),
            "get_actual_joint_positions_history" => {
                let back = index(&a[0], 500)?;
                return list(self.history.get(back).unwrap_or(&self.mover.q));
            }
            "get_actual_tcp_pose" | "get_target_tcp_pose" => {
                return pose(&self.mover.fk(&self.mover.q));
            }
            "get_actual_tool_flange_pose" => {
                return pose(&self.mover.flange(&self.mover.q));
            }
            "get_actual_tcp_speed" | "get_target_tcp_speed" => {
                return list(self.mover.tcp_speed().as_slice());
            }
            "get_tcp_force" => return list(&self.force()),
            "force" => {
                let [x, y, z, ..] = self.force();
                return value(Value::Float((x * x + y * y + z * z).sqrt()));
            }
            "get_tcp_offset" => return pose(self.mover.tool()),
            "set_tcp" => {
                self.mover.set_tool(pose_of(&numbers(&a[0], "the tool centre point")?));
                Reply::Done(Value::Nothing)
            }
            "set_payload" | "set_payload_mass" | "set_target_payload" => {
                let m = number(&a[0], "the payload")?;
                if !(0.0..=50.0).contains(&m) {
                    return Err(format!("a payload of {m} kg is not possible"));
                }
                self.payload = m;
                if let Some(cog) = a.get(1).filter(|v| **v != Value::Nothing) {
                    self.payload_cog = numbers(cog, "cog")?;
                }
                if let Some(inertia) = a.get(2).filter(|v| **v != Value::Nothing) {
                    self.payload_inertia = numbers(inertia, "inertia")?;
                }
                Reply::Done(Value::Nothing)
            }
            "set_payload_cog" => {
                self.payload_cog = numbers(&a[0], "cog")?;
                Reply::Done(Value::Nothing)
            }
            "get_target_payload" => return value(Value::Float(self.payload)),
            "get_target_payload_cog" => return list(&self.payload_cog),
            "get_target_payload_inertia" => return list(&self.payload_inertia),
            "get_inverse_kin" => {
                let q = self.inverse(a)?;
                let q = q.ok_or_else(|| format!("no solution for {}", words(&a[0])))?;
                return list(&q);
            }
            "get_inverse_kin_has_solution" => {
                return value(Value::Bool(self.inverse(a)?.is_some()));
            }
            "get_forward_kin" => {
                let q = match &a[0] {
                    Value::Nothing => self.mover.q,
                    v => numbers(v, "q")?,
                };
                let tool = match &a[1] {
                    Value::Nothing => *self.mover.tool(),
                    v => pose_of(&numbers(v, "tcp")?),
                };
                return pose(&(self.mover.flange(&q) * tool));
            }
            "is_within_safety_limits" => {
                let within = match &a[0] {
                    Value::Pose(p) => self.mover.ik(&pose_of(p), &self.mover.q).is_some(),
                    v => numbers::<6>(v, "q")?.iter().all(|x| x.abs() <= POSITION_LIMIT),
                };
                return value(Value::Bool(within));
            }
            "is_steady" => return value(Value::Bool(self.mover.at_rest())),
            "get_steptime" => return value(Value::Float(self.generation.cycle())),
            "get_robot_mode" => return value(Value::Int(self.power.mode() as i32)),
            "get_safety_mode" => return value(Value::Int(self.safety as i32)),
            "get_freedrive_status" => return value(Value::Int(0)),
            "popup" => {
                let text = words(&a[0]);
                let blocking = truth(&a[4]);
                if call.waited == 0 {
                    self.popup = Some(text.clone());
                    self.say(MessageKind::Popup, text);
                }
                if blocking && self.popup.is_some() {
                    Reply::Wait
                } else {
                    Reply::Done(Value::Nothing)
                }
            }
            "textmsg" => {
                let more = if a[1] == Value::Nothing { String::new() } else { words(&a[1]) };
                let text = words(&a[0]) + &more;
                self.say(MessageKind::Log, text);
                Reply::Done(Value::Nothing)
            }
            "set_speed" => {
                self.slider = number(&a[0], "the speed")?.clamp(0.0, 1.0);
                Reply::Done(Value::Nothing)
            }
            // Settings of what is not simulated, and ends of modes that cannot be entered.
            "force_mode_set_damping"
            | "force_mode_set_gain_scaling"
            | "end_force_mode"
            | "end_teach_mode"
            | "end_freedrive_mode"
            | "set_gravity" => Reply::Done(Value::Nothing),
            "zero_ftsensor" => {
                self.force_zero = self.force_raw;
                Reply::Done(Value::Nothing)
            }
            _ => return Ok(None),
        };
        Ok(Some(reply))
    }

    fn inverse(&self, a: &[Value]) -> Result<Option<Six>, Fault> {
        let mut goal = pose_of(&numbers(&a[0], "x")?);
        if a[4] != Value::Nothing {
            let tool = pose_of(&numbers(&a[4], "tcp")?);
            goal = goal * tool.inverse() * self.mover.tool();
        }
        let near = match &a[1] {
            Value::Nothing => self.mover.q,
            v => numbers(v, "qnear")?,
        };
        Ok(self.mover.ik(&goal, &near))
    }

    fn line(&mut self, call: &Call<'_>) -> Result<Option<Reply>, Fault> {
        let a = call.args;
        let value = |v: Value| done(v).map(Some);
        let bit = |bits: u64, i: usize| value(Value::Bool(bits >> i & 1 == 1));
        let (inputs, outputs) = (&self.inputs.registers, &mut self.outputs);
        match call.function {
            "read_input_integer_register" => {
                return value(Value::Int(inputs.ints[index(&a[0], 48)?]));
            }
            "read_input_float_register" => {
                return value(Value::Float(inputs.doubles[index(&a[0], 48)?]));
            }
            "read_input_boolean_register" => {
                return value(Value::Bool(inputs.bits[index(&a[0], 128)?]));
            }
            "read_output_integer_register" => {
                return value(Value::Int(outputs.ints[index(&a[0], 48)?]));
            }
            "read_output_float_register" => {
                return value(Value::Float(outputs.doubles[index(&a[0], 48)?]));
            }
            "read_output_boolean_register" => {
                return value(Value::Bool(outputs.bits[index(&a[0], 128)?]));
            }
            "write_output_integer_register" => {
                outputs.ints[index(&a[0], 48)?] = number(&a[1], "the value")? as i32;
            }
            "write_output_float_register" => {
                outputs.doubles[index(&a[0], 48)?] = number(&a[1], "the value")?;
            }
            "write_output_boolean_register" => outputs.bits[index(&a[0], 128)?] = truth(&a[1]),
            "rtde_set_watchdog" => self.watch(a)?,
            "get_standard_digital_in" => return bit(self.lines.digital_in, index(&a[0], 8)?),
            "get_configurable_digital_in" => {
                return bit(self.lines.digital_in, 8 + index(&a[0], 8)?);
            }
            "get_tool_digital_in" => return bit(self.lines.digital_in, 16 + index(&a[0], 2)?),
            "get_digital_in" => return bit(self.lines.digital_in, index(&a[0], 18)?),
            "get_standard_digital_out" => return bit(self.lines.digital_out, index(&a[0], 8)?),
            "get_configurable_digital_out" => {
                return bit(self.lines.digital_out, 8 + index(&a[0], 8)?);
            }
            "get_tool_digital_out" => return bit(self.lines.digital_out, 16 + index(&a[0], 2)?),
            "get_digital_out" => return bit(self.lines.digital_out, index(&a[0], 18)?),
            "set_standard_digital_out" => self.switch(index(&a[0], 8)?, &a[1]),
            "set_configurable_digital_out" => self.switch(8 + index(&a[0], 8)?, &a[1]),
            "set_tool_digital_out" => self.switch(16 + index(&a[0], 2)?, &a[1]),
            "set_digital_out" => self.switch(index(&a[0], 18)?, &a[1]),
            "get_standard_analog_in" | "get_analog_in" => {
                return value(Value::Float(self.lines.analog_in[index(&a[0], 2)?]));
            }
            "get_standard_analog_out" => {
                return value(Value::Float(self.lines.analog_out[index(&a[0], 2)?]));
            }
            "set_standard_analog_out" | "set_analog_out" => {
                self.lines.analog_out[index(&a[0], 2)?] = number(&a[1], "f")?.clamp(0.0, 1.0);
            }
            "set_tool_voltage" => self.lines.tool_voltage = number(&a[0], "the voltage")? as i32,
            _ => return Ok(None),
        }
        value(Value::Nothing)
    }

    fn switch(&mut self, bit: usize, to: &Value) {
        self.lines.set_outputs(1 << bit, u64::from(truth(to)) << bit);
    }

    fn watch(&mut self, a: &[Value]) -> Result<(), Fault> {
        let name = words(&a[0]);
        let slot = Slot::parse(&name).ok_or_else(|| format!("there is no RTDE input '{name}'"))?;
        let frequency = number(&a[1], "min_frequency")?;
        let action = match words(&a[2]).to_ascii_lowercase().as_str() {
            "ignore" => WatchdogAction::Ignore,
            "pause" => WatchdogAction::Pause,
            "stop" => WatchdogAction::Stop,
            other => return Err(format!("action '{other}' is not ignore, pause or stop")),
        };
        self.watchdogs.retain(|w| w.slot != slot);
        if frequency > 0.0 {
            let seen = self.inputs.arrivals(slot);
            let period = 1.0 / frequency;
            self.watchdogs.push(Watchdog { slot, period, action, seen, silent: 0.0 });
        }
        Ok(())
    }
}
