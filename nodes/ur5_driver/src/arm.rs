//! The RTDE connection: state in, servo commands out, once per package of the controller.

use crate::state::Shared;
use anyhow::{Context as _, bail};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;
use tdv_robot::Joints;
use tdv_runtime::Node;
use tdv_ur_protocol::rtde::{Client, ClientConfig, ClientEvent, Value};
use tdv_ur_protocol::servo::{self, Command, ProgramState};

/// Robot mode in which the arm moves.
pub const RUNNING: i32 = 7;
/// Safety modes in which it does: normal and reduced.
const SAFE: [i32; 2] = [1, 2];
/// Silence after which the connection counts as lost.
const SILENCE: Duration = Duration::from_millis(200);

const OUTPUTS: [&str; 10] = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_TCP_pose",
    "speed_scaling",
    "robot_mode",
    "safety_mode",
    "robot_status_bits",
    servo::PROGRAM_STATE,
];

/// One state of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmState {
    pub q: Joints,
    pub qd: Joints,
    pub current: Joints,
    /// Position (m) and rotation vector (rad) of tool0 in the frame `base`.
    pub tcp_pose: [f64; 6],
    pub speed_scaling: f64,
    pub robot_mode: i32,
    pub safety_mode: i32,
    pub program_running: bool,
    /// State of the servo program, none for a value it never writes.
    pub program: Option<ProgramState>,
}

impl ArmState {
    fn from_values(values: &[Value]) -> Option<Self> {
        let vector = |i: usize| values.get(i)?.as_vector6d();
        let state = Self {
            q: vector(1)?,
            qd: vector(2)?,
            current: vector(3)?,
            tcp_pose: vector(4)?,
            speed_scaling: values.get(5)?.as_f64()?,
            robot_mode: values.get(6)?.as_i32()?,
            safety_mode: values.get(7)?.as_i32()?,
            program_running: values.get(8)?.as_u32()? & 0b10 != 0,
            program: ProgramState::from_register(values.get(9)?.as_i32()?),
        };
        let finite = [state.q, state.qd, state.tcp_pose].iter().flatten().all(|v| v.is_finite());
        finite.then_some(state)
    }

    /// Whether a program is there that follows the targets.
    pub fn has_program(&self) -> bool {
        self.program_running && self.program != Some(ProgramState::NotRunning)
    }

    /// Whether the robot would follow a target now.
    fn may_move(&self) -> bool {
        self.has_program() && self.robot_mode == RUNNING && SAFE.contains(&self.safety_mode)
    }
}

/// What happened, for the ROS side.
pub enum ArmEvent {
    Connected([u32; 4]),
    State(Box<ArmState>),
    /// The target that was due was refused.
    Refused(String),
    Lost(String),
}

/// Connects again and again, with growing pauses, until the node ends.
pub fn run(
    node: &Node,
    address: SocketAddr,
    frequency: f64,
    shared: &Shared,
    mut report: impl FnMut(ArmEvent),
) {
    let mut pause = Duration::from_millis(250);
    while !node.shutdown().is_requested() {
        let outcome = session(node, address, frequency, shared, &mut |event| {
            if matches!(event, ArmEvent::State(_)) {
                pause = Duration::from_millis(250);
            }
            report(event);
        });
        shared.forget();
        if let Err(error) = outcome {
            report(ArmEvent::Lost(format!("robot at {address}: {error:#}")));
        }
        if !node.shutdown().is_requested() {
            std::thread::sleep(pause);
        }
        pause = (pause * 2).min(Duration::from_secs(4));
    }
}

fn session(
    node: &Node,
    address: SocketAddr,
    frequency: f64,
    shared: &Shared,
    report: &mut impl FnMut(ArmEvent),
) -> anyhow::Result<()> {
    let mut socket = TcpStream::connect_timeout(&address, Duration::from_secs(2))
        .context("no connection (is it on, is the address right?)")?;
    socket.set_nodelay(true)?;
    socket.set_read_timeout(Some(SILENCE))?;
    socket.set_write_timeout(Some(SILENCE))?;
    let mut names = vec![servo::COMMAND, servo::HEARTBEAT];
    names.extend(servo::TARGETS);
    let config = ClientConfig { frequency, outputs: OUTPUTS.to_vec(), inputs: vec![names] };
    let (mut client, first) = Client::new(config);
    socket.write_all(&first)?;
    let mut heartbeat = 0_i32;
    let mut buffer = [0_u8; 8192];
    while !node.shutdown().is_requested() {
        let n = match socket.read(&mut buffer) {
            Ok(0) => bail!("the controller closed the connection"),
            Ok(n) => n,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                bail!("no data for {} ms", SILENCE.as_millis())
            }
            Err(e) => return Err(e.into()),
        };
        let mut newest = None;
        for event in client.receive(&buffer[..n])? {
            match event {
                ClientEvent::Send(bytes) => socket.write_all(&bytes)?,
                ClientEvent::Ready(version) => report(ArmEvent::Connected(version)),
                ClientEvent::Text(_, text) => tracing::info!("controller: {text}"),
                ClientEvent::Data(values) => newest = Some(values),
            }
        }
        let Some(values) = newest else { continue };
        let Some(state) = ArmState::from_values(&values) else {
            bail!("the controller sends states that are not numbers");
        };
        let (target, refusal) = match shared.target(node.now(), state.q, state.may_move()) {
            Ok(target) => (target, None),
            Err(why) => (None, Some(why)),
        };
        let command = if target.is_some() { Command::Servo } else { Command::Idle };
        heartbeat = heartbeat.wrapping_add(1);
        let mut inputs = vec![Value::Int32(command as i32), Value::Int32(heartbeat)];
        inputs.extend(target.unwrap_or(state.q).map(Value::Double));
        socket.write_all(&client.input(0, &inputs)?)?;
        report(ArmEvent::State(Box::new(state)));
        if let Some(why) = refusal {
            report(ArmEvent::Refused(why));
        }
    }
    // An orderly end: the arm rests where it is.
    let mut inputs =
        vec![Value::Int32(Command::Idle as i32), Value::Int32(heartbeat.wrapping_add(1))];
    inputs.extend([Value::Double(0.0); 6]);
    if client.is_running() {
        socket.write_all(&client.input(0, &inputs)?)?;
    }
    Ok(())
}
