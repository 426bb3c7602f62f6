use crate::arm::{self, ArmEvent, ArmState, RUNNING};
use crate::gripper::{self, GripperEvent, GripperState, Move};
use crate::params::DriverParameters;
use crate::state::Shared;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, mpsc};
use tdv_geometry::Stamp;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_msgs::control_msgs::action::{GripperCommand, GripperCommandResult};
use tdv_msgs::geometry_msgs::msg::PoseStamped;
use tdv_msgs::sensor_msgs::msg::JointState;
use tdv_msgs::std_msgs::msg::{Bool, Float64};
use tdv_msgs::trajectory_msgs::msg::JointTrajectory as TrajectoryMessage;
use tdv_msgs::ur_dashboard_msgs::msg::{RobotMode, SafetyMode};
use tdv_robot::gripper::{
    FORCE_RANGE, KNUCKLE_JOINT, knuckle_from_register, register_from_knuckle,
};
use tdv_robot::{JOINT_NAMES, JointTrajectory, TrajectoryPoint};
use tdv_runtime::{Goal, GoalEnd, Level, Node, Params, Publisher, Qos, tracked};
use tdv_ur_protocol::gripper::ObjectStatus;
use tokio::sync::watch;

struct Outputs {
    node: Node,
    joints: Publisher<JointState>,
    tcp: Publisher<PoseStamped>,
    speed_scaling: Publisher<Float64>,
    robot_mode: Publisher<RobotMode>,
    safety_mode: Publisher<SafetyMode>,
    program: Publisher<Bool>,
    /// Last published robot mode, safety mode and whether a program runs.
    latched: Option<(i32, i32, bool)>,
    knuckle: watch::Receiver<Option<GripperState>>,
}

/// The node's life.
pub async fn drive(node: Node, params: Params<DriverParameters>) -> anyhow::Result<()> {
    let p = params.get();
    let shared = Arc::new(Shared::new(&p.limits()?));
    let (knuckle_sender, knuckle) = watch::channel(None);
    let outputs = Outputs::new(&node, knuckle.clone())?;
    node.diagnostics().level(Level::Warn, format!("connecting to {}", p.robot_ip));
    take_trajectories(&node, &p, shared.clone())?;
    let (moves, to_gripper) = mpsc::channel();
    serve_gripper(&node, &p, moves, knuckle)?;
    start_gripper(&node, &p, to_gripper, knuckle_sender);
    let (address, frequency) = (p.address(p.rtde_port), p.frequency);
    let thread_node = node.clone();
    let arm = tokio::task::spawn_blocking(move || {
        let mut outputs = outputs;
        arm::run(&thread_node, address, frequency, &shared, |event| outputs.arm(event));
    });
    arm.await?;
    Ok(())
}

fn take_trajectories(node: &Node, p: &DriverParameters, shared: Arc<Shared>) -> anyhow::Result<()> {
    let topic = format!("/{}/joint_trajectory", p.controller_name);
    let clock = node.clock().clone();
    let diagnostics = node.diagnostics().clone();
    node.subscribe(&topic, Qos::reliable(1), move |m: TrajectoryMessage| {
        let now = clock.now();
        let stamp = tracked::stamp(&m.header);
        if let Err(why) = shared.accept(&trajectory(m), now) {
            tracing::warn!("trajectory refused: {why}");
            diagnostics.set("last_refusal", why);
        } else if stamp != Stamp(0) {
            diagnostics.latency("command_age", now.since(stamp));
        }
    })?;
    Ok(())
}

fn trajectory(m: TrajectoryMessage) -> JointTrajectory {
    let stamp = tracked::stamp(&m.header);
    JointTrajectory {
        names: m.joint_names,
        stamp: (stamp != Stamp(0)).then_some(stamp),
        points: m
            .points
            .into_iter()
            .map(|p| TrajectoryPoint {
                positions: p.positions,
                velocities: p.velocities,
                accelerations: p.accelerations,
                effort: p.effort,
                time_from_start: f64::from(p.time_from_start.sec)
                    + f64::from(p.time_from_start.nanosec) * 1e-9,
            })
            .collect(),
    }
}

fn start_gripper(
    node: &Node,
    p: &DriverParameters,
    moves: mpsc::Receiver<Move>,
    states: watch::Sender<Option<GripperState>>,
) {
    let (node, address) = (node.clone(), p.address(p.gripper_port));
    std::thread::spawn(move || {
        let diagnostics = node.diagnostics().clone();
        gripper::run(&node, address, &moves, |event| match event {
            GripperEvent::Ready => {
                tracing::info!("gripper ready");
                diagnostics.set("gripper", "ready");
            }
            GripperEvent::State(state) => {
                diagnostics.set("gripper_position", state.position);
                states.send_replace(Some(state));
            }
            GripperEvent::Lost(why) => {
                tracing::warn!("{why}");
                diagnostics.set("gripper", why);
                states.send_replace(None);
            }
        });
    });
}

fn serve_gripper(
    node: &Node,
    p: &DriverParameters,
    moves: mpsc::Sender<Move>,
    states: watch::Receiver<Option<GripperState>>,
) -> anyhow::Result<()> {
    let name = format!("/{}/gripper_cmd", p.gripper_controller_name);
    let number = Arc::new(AtomicU32::new(0));
    let (speed, default_force) = (p.gripper_speed as u8, p.gripper_force as u8);
    let known = states.clone();
    node.action_server::<GripperCommand, _, _, _>(
        &name,
        move |goal| {
            if !goal.command.position.is_finite() {
                return Err("the position is not finite".into());
            }
            if known.borrow().is_none() {
                return Err("the gripper is not connected".into());
            }
            Ok(())
        },
        move |goal: Goal<GripperCommand>| {
            let command = &goal.goal.command;
            let force = if command.max_effort > 0.0 {
                let (low, high) = FORCE_RANGE;
                ((command.max_effort - low) / (high - low) * 255.0).clamp(0.0, 255.0) as u8
            } else {
                default_force
            };
            let order = Move {
                number: number.fetch_add(1, Ordering::SeqCst) + 1,
                position: register_from_knuckle(command.position),
                speed,
                force,
            };
            // The receiver ends with the node; then nobody waits for the goal any more.
            let _ = moves.send(order);
            carry_out(goal, order, states.clone())
        },
    )?;
    Ok(())
}

/// Waits until the fingers rest at the target or at an object.
async fn carry_out(
    mut goal: Goal<GripperCommand>,
    order: Move,
    mut states: watch::Receiver<Option<GripperState>>,
) -> (GoalEnd, GripperCommandResult) {
    let result = |state: Option<GripperState>, stalled: bool, reached: bool| GripperCommandResult {
        position: state.map_or(f64::NAN, |s| knuckle_from_register(s.position)),
        effort: 0.0,
        stalled,
        reached_goal: reached,
    };
    loop {
        tokio::select! {
            () = goal.canceled() => {
                let state = *states.borrow();
                return (GoalEnd::Canceled, result(state, false, false));
            }
            changed = states.changed() => {
                if changed.is_err() {
                    return (GoalEnd::Aborted, result(None, false, false));
                }
            }
        }
        let Some(state) = *states.borrow_and_update() else {
            return (GoalEnd::Aborted, result(None, false, false));
        };
        // The status belongs to this order only once the gripper echoes its position.
        if state.request < order.number || state.requested != order.position {
            continue;
        }
        match state.object {
            ObjectStatus::Moving => {}
            ObjectStatus::ContactClosing | ObjectStatus::ContactOpening => {
                return (GoalEnd::Succeeded, result(Some(state), true, false));
            }
            ObjectStatus::AtPosition => {
                return (GoalEnd::Succeeded, result(Some(state), false, true));
            }
        }
    }
}

impl Outputs {
    fn new(node: &Node, knuckle: watch::Receiver<Option<GripperState>>) -> anyhow::Result<Self> {
        Ok(Self {
            joints: node.publisher("/joint_states", Qos::reliable(10))?,
            tcp: node.publisher("/tcp_pose_broadcaster/pose", Qos::reliable(10))?,
            speed_scaling: node
                .publisher("/speed_scaling_state_broadcaster/speed_scaling", Qos::reliable(1))?,
            robot_mode: node.publisher("/io_and_status_controller/robot_mode", Qos::latched())?,
            safety_mode: node.publisher("/io_and_status_controller/safety_mode", Qos::latched())?,
            program: node
                .publisher("/io_and_status_controller/robot_program_running", Qos::latched())?,
            latched: None,
            knuckle,
            node: node.clone(),
        })
    }

    fn arm(&mut self, event: ArmEvent) {
        let diagnostics = self.node.diagnostics().clone();
        match event {
            ArmEvent::Connected([major, minor, ..]) => {
                tracing::info!("connected to PolyScope {major}.{minor}");
                diagnostics.level(Level::Ok, format!("connected to PolyScope {major}.{minor}"));
            }
            ArmEvent::State(state) => self.state(&state),
            ArmEvent::Refused(why) => diagnostics.level(Level::Error, why),
            ArmEvent::Lost(why) => {
                tracing::warn!("{why}");
                diagnostics.level(Level::Error, why);
                // Nothing is published with a fresh stamp while there is no state; modes say so.
                self.modes(0, 0, false);
            }
        }
    }

    fn state(&mut self, s: &ArmState) {
        let stamp = self.node.now();
        let mut message = JointState {
            header: tracked::header(stamp),
            name: JOINT_NAMES.map(String::from).to_vec(),
            position: s.q.to_vec(),
            velocity: s.qd.to_vec(),
            effort: s.current.to_vec(),
        };
        if let Some(g) = *self.knuckle.borrow() {
            message.name.push(KNUCKLE_JOINT.into());
            message.position.push(knuckle_from_register(g.position));
            message.velocity.push(f64::NAN);
            message.effort.push(f64::NAN);
        }
        self.joints.publish(message);
        let [x, y, z, rx, ry, rz] = s.tcp_pose;
        let pose = tdv_geometry::Pose::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)),
        );
        self.tcp.publish(PoseStamped {
            header: tracked::header_in(stamp, "base"),
            pose: tracked::pose_message(&pose),
        });
        self.speed_scaling.publish(Float64 { data: 100.0 * s.speed_scaling });
        let ready = s.has_program();
        self.modes(s.robot_mode, s.safety_mode, ready);
        let level = if s.robot_mode == RUNNING && ready { Level::Ok } else { Level::Warn };
        let program = s.program.map_or("unknown".into(), |p| format!("{p:?}"));
        self.node.diagnostics().level(
            level,
            format!(
                "robot mode {}, safety mode {}, program {program}",
                s.robot_mode, s.safety_mode
            ),
        );
    }

    fn modes(&mut self, robot: i32, safety: i32, program: bool) {
        if self.latched == Some((robot, safety, program)) {
            return;
        }
        self.latched = Some((robot, safety, program));
        self.robot_mode.publish(RobotMode { mode: robot as i8 });
        self.safety_mode.publish(SafetyMode { mode: safety as u8 });
        self.program.publish(Bool { data: program });
    }
}
