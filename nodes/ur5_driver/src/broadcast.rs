//! What the driver publishes about the robot, under the names of the official driver's broadcasters.

use crate::arm_state::ArmState;
use crate::description::Description;
use crate::gripper::GripperState;
use crate::state::Shared;
use std::sync::Arc;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, Stamp};
use tdv_msgs::control_msgs::msg::JointTrajectoryControllerState;
use tdv_msgs::geometry_msgs::msg::{PoseStamped, Vector3 as VectorMessage, Wrench, WrenchStamped};
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_msgs::msg::{Bool, Float64};
use tdv_msgs::tf2_msgs::msg::TFMessage;
use tdv_msgs::trajectory_msgs::msg::JointTrajectoryPoint;
use tdv_msgs::ur_dashboard_msgs::msg::{RobotMode, SafetyMode};
use tdv_msgs::ur_msgs::msg::{Analog, Digital, IOStates, ToolDataMsg};
use tdv_robot::gripper::{KNUCKLE_JOINT, knuckle_from_register};
use tdv_robot::{Desired, JOINT_NAMES};
use tdv_runtime::{Node, Publisher, Qos, RuntimeError, tracked};
use tdv_ur_protocol::dashboard::safety_mode_name;
use tokio::sync::watch;

/// Every how manyth state goes out on what people look at rather than controllers.
const SLOW: u64 = 4;
/// The same for inputs and outputs that have not changed.
const SLOWEST: u64 = 12;
/// Pins: eight standard, eight configurable, two of the tool.
const PINS: u8 = 18;

/// The publishers and what they need.
pub struct Broadcast {
    joints: Publisher<JointState>,
    tcp: Publisher<PoseStamped>,
    wrench: Publisher<WrenchStamped>,
    speed_scaling: Publisher<Float64>,
    robot_mode: Publisher<RobotMode>,
    safety_mode: Publisher<SafetyMode>,
    program: Publisher<Bool>,
    io: Publisher<IOStates>,
    tool: Publisher<ToolDataMsg>,
    controller: Publisher<JointTrajectoryControllerState>,
    tf: Publisher<TFMessage>,
    description: Option<Description>,
    knuckle: watch::Receiver<Option<GripperState>>,
    shared: Arc<Shared>,
    /// Last published robot mode, safety mode and whether a program runs.
    latched: Option<(i32, i32, bool)>,
    last_io: Option<IOStates>,
    count: u64,
}

impl Broadcast {
    pub fn new(
        node: &Node,
        controller_name: &str,
        description: Option<Description>,
        knuckle: watch::Receiver<Option<GripperState>>,
        shared: Arc<Shared>,
    ) -> Result<Self, RuntimeError> {
        let io = |name: &str| format!("/io_and_status_controller/{name}");
        Ok(Self {
            joints: node.publisher("/joint_states", Qos::reliable(10))?,
            tcp: node.publisher("/tcp_pose_broadcaster/pose", Qos::reliable(10))?,
            wrench: node.publisher("/force_torque_sensor_broadcaster/wrench", Qos::reliable(1))?,
            speed_scaling: node
                .publisher("/speed_scaling_state_broadcaster/speed_scaling", Qos::reliable(1))?,
            robot_mode: node.publisher(&io("robot_mode"), Qos::latched())?,
            safety_mode: node.publisher(&io("safety_mode"), Qos::latched())?,
            program: node.publisher(&io("robot_program_running"), Qos::latched())?,
            io: node.publisher(&io("io_states"), Qos::reliable(1))?,
            tool: node.publisher(&io("tool_data"), Qos::reliable(1))?,
            controller: node
                .publisher(&format!("/{controller_name}/controller_state"), Qos::reliable(1))?,
            tf: node.publisher("/tf", Qos::reliable(100))?,
            description,
            knuckle,
            shared,
            latched: None,
            last_io: None,
            count: 0,
        })
    }

    /// One state of the robot.
    pub fn state(&mut self, s: &ArmState, followed: bool, stamp: Stamp) {
        self.count += 1;
        let knuckle = self.knuckle.borrow().map(|g| knuckle_from_register(g.position));
        self.joints.publish(joint_state(s, knuckle, stamp));
        let pose = tcp_pose(&s.tcp_pose);
        self.tcp.publish(PoseStamped {
            header: tracked::header_in(stamp, "base"),
            pose: tracked::pose_message(&pose),
        });
        let [fx, fy, fz, tx, ty, tz] = s.tcp_force;
        let force = VectorMessage { x: fx, y: fy, z: fz };
        let torque = VectorMessage { x: tx, y: ty, z: tz };
        let header = tracked::header_in(stamp, "tool0_controller");
        self.wrench.publish(WrenchStamped { header, wrench: Wrench { force, torque } });
        // After a pause trajectories run slower than the robot would let them.
        let scale = self.shared.follow_state().map_or(1.0, |f| f.scale);
        self.speed_scaling.publish(Float64 { data: 100.0 * s.factor().min(scale) });
        self.modes(s.robot_mode, s.safety_mode, followed);
        self.inputs_outputs(s);
        if self.count.is_multiple_of(SLOW) {
            let mut transforms = vec![tracked::transform("base", "tool0_controller", stamp, &pose)];
            if let Some(d) = &self.description {
                d.moving(&mut transforms, s, knuckle.unwrap_or(0.0), stamp);
            }
            self.tf.publish(TFMessage { transforms });
            self.controller_state(s, stamp);
        }
    }

    /// Nothing is published with a fresh stamp while there is no state; the modes say so.
    pub fn lost(&mut self) {
        self.modes(0, 0, false);
    }

    fn modes(&mut self, robot: i32, safety: i32, program: bool) {
        let now = (robot, safety, program);
        let before = self.latched.replace(now);
        if before.is_none_or(|b| b.0 != robot) {
            self.robot_mode.publish(RobotMode { mode: robot as i8 });
        }
        if before.is_none_or(|b| b.1 != safety) {
            if before.is_some() {
                tracing::warn!("safety mode {}", safety_mode_name(safety));
            }
            self.safety_mode.publish(SafetyMode { mode: safety as u8 });
        }
        if before.is_none_or(|b| b.2 != program) {
            self.program.publish(Bool { data: program });
        }
    }

    fn inputs_outputs(&mut self, s: &ArmState) {
        let regular = self.count.is_multiple_of(SLOWEST);
        let message = regular.then(|| io_states(s));
        let changed = self.last_io.as_ref().is_none_or(|last| {
            last.digital_in_states != digital(s.io.digital_in)
                || last.digital_out_states != digital(s.io.digital_out)
        });
        if changed || regular {
            let message = message.unwrap_or_else(|| io_states(s));
            self.last_io = Some(message.clone());
            self.io.publish(message);
        }
        if regular {
            self.tool.publish(tool_data(s));
        }
    }

    fn controller_state(&self, s: &ArmState, stamp: Stamp) {
        let Some(follow) = self.shared.follow_state() else { return };
        let point = |d: &Desired| JointTrajectoryPoint {
            positions: d.q.to_vec(),
            velocities: d.qd.to_vec(),
            ..Default::default()
        };
        self.controller.publish(JointTrajectoryControllerState {
            header: tracked::header(stamp),
            joint_names: JOINT_NAMES.map(String::from).to_vec(),
            reference: point(&follow.desired),
            feedback: point(&follow.actual),
            error: point(&follow.error()),
            output: point(&follow.desired),
            speed_scaling_factor: s.factor(),
            ..Default::default()
        });
    }
}

fn joint_state(s: &ArmState, knuckle: Option<f64>, stamp: Stamp) -> JointState {
    let mut message = JointState {
        header: tracked::header(stamp),
        name: JOINT_NAMES.map(String::from).to_vec(),
        position: s.q.to_vec(),
        velocity: s.qd.to_vec(),
        effort: s.current.to_vec(),
    };
    if let Some(angle) = knuckle {
        message.name.push(KNUCKLE_JOINT.into());
        message.position.push(angle);
        message.velocity.push(f64::NAN);
        message.effort.push(f64::NAN);
    }
    message
}

fn tcp_pose(p: &[f64; 6]) -> Pose {
    let [x, y, z, rx, ry, rz] = *p;
    Pose::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)),
    )
}

fn digital(bits: u64) -> Vec<Digital> {
    (0..PINS).map(|pin| Digital { pin, state: bits >> pin & 1 == 1 }).collect()
}

fn io_states(s: &ArmState) -> IOStates {
    let analog = |values: [f64; 2], shift: u32| {
        let of = |(pin, value): (usize, f64)| Analog {
            pin: pin as u8,
            domain: (s.io.analog_types >> (shift + pin as u32) & 1) as u8,
            state: value as f32,
        };
        values.into_iter().enumerate().map(of).collect()
    };
    IOStates {
        digital_in_states: digital(s.io.digital_in),
        digital_out_states: digital(s.io.digital_out),
        flag_states: Vec::new(),
        analog_in_states: analog(s.io.analog_in, 0),
        analog_out_states: analog(s.io.analog_out, 2),
    }
}

fn tool_data(s: &ArmState) -> ToolDataMsg {
    ToolDataMsg {
        analog_input_range2: (s.io.tool_analog_types & 1) as i8,
        analog_input_range3: (s.io.tool_analog_types >> 1 & 1) as i8,
        analog_input2: s.io.tool_analog[0],
        analog_input3: s.io.tool_analog[1],
        tool_output_voltage: s.io.tool_voltage as u8,
        tool_current: s.io.tool_current as f32,
        tool_mode: s.io.tool_mode as u8,
        ..Default::default()
    }
}
