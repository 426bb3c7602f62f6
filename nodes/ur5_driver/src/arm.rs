//! The RTDE connection: state in, servo commands out, once per package of the controller.

use crate::arm_state::{ArmState, OUTPUTS};
use crate::settings::{self, Setting};
use crate::state::{Order, Shared};
use anyhow::{Context as _, bail};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use tdv_runtime::Node;
use tdv_ur_protocol::rtde::{Client, ClientConfig, ClientEvent, Value};
use tdv_ur_protocol::servo::{self, Command};

/// Silence after which the connection counts as lost.
const SILENCE: Duration = Duration::from_millis(200);
/// Shortest and longest time between two attempts to connect.
const PAUSES: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(4));

/// What happened, for the ROS side.
pub enum ArmEvent {
    Connected([u32; 4]),
    /// A state, and whether a program of ours follows.
    State(Box<ArmState>, bool),
    /// A fault of the motion.
    Fault(String),
    Lost(String),
}

/// Where and how to connect.
pub struct ArmLink {
    pub address: SocketAddr,
    /// Packages per second, zero for the controller's highest.
    pub frequency: f64,
    pub settings: Receiver<Setting>,
}

/// Connects again and again, with growing pauses, until the node ends.
pub fn run(node: &Node, link: &ArmLink, shared: &Shared, mut report: impl FnMut(ArmEvent)) {
    let mut pause = PAUSES.0;
    // Goes on through all connections, so that the program always sees a fresh value.
    let mut heartbeat = 0_i32;
    while !node.shutdown().is_requested() {
        let outcome = session(node, link, shared, &mut heartbeat, &mut |event| {
            if matches!(event, ArmEvent::State(..)) {
                pause = PAUSES.0;
            }
            report(event);
        });
        shared.forget();
        // What was to be set on a robot that was not there is not set later.
        while link.settings.try_recv().is_ok() {}
        if let Err(error) = outcome {
            report(ArmEvent::Lost(format!("robot at {}: {error:#}", link.address)));
        }
        let end = Instant::now() + pause;
        while Instant::now() < end && !node.shutdown().is_requested() {
            std::thread::sleep(Duration::from_millis(50));
        }
        pause = (pause * 2).min(PAUSES.1);
    }
}

fn session(
    node: &Node,
    link: &ArmLink,
    shared: &Shared,
    heartbeat: &mut i32,
    report: &mut impl FnMut(ArmEvent),
) -> anyhow::Result<()> {
    let mut socket = TcpStream::connect_timeout(&link.address, Duration::from_secs(2))
        .context("no connection (is it on, is the address right?)")?;
    socket.set_nodelay(true)?;
    socket.set_read_timeout(Some(SILENCE))?;
    socket.set_write_timeout(Some(SILENCE))?;
    let mut names = vec![servo::COMMAND, servo::HEARTBEAT];
    names.extend(servo::TARGETS);
    let mut inputs = vec![names];
    inputs.extend(settings::recipes());
    let config = ClientConfig { frequency: link.frequency, outputs: OUTPUTS.to_vec(), inputs };
    let (mut client, first) = Client::new(config);
    socket.write_all(&first)?;
    let mut buffer = vec![0_u8; 64 * 1024];
    let mut last_state = Instant::now();
    while !node.shutdown().is_requested() {
        let mut newest = None;
        loop {
            let n = match socket.read(&mut buffer) {
                Ok(0) => bail!("the controller closed the connection"),
                Ok(n) => n,
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    bail!("no data for {} ms", SILENCE.as_millis())
                }
                Err(e) => return Err(e.into()),
            };
            for event in client.receive(&buffer[..n])? {
                match event {
                    ClientEvent::Send(bytes) => socket.write_all(&bytes)?,
                    ClientEvent::Ready(version) => report(ArmEvent::Connected(version)),
                    ClientEvent::Text(_, text) => tracing::info!("controller: {text}"),
                    ClientEvent::Data(values) => newest = Some(values),
                }
            }
            // A full buffer means that we were held up: what waits behind it is newer.
            if n < buffer.len() {
                break;
            }
        }
        let Some(values) = newest else {
            // Texts alone are no sign of a robot that is there.
            if client.is_running() && last_state.elapsed() > SILENCE {
                bail!("no state for {} ms", SILENCE.as_millis());
            }
            continue;
        };
        last_state = Instant::now();
        let Some(state) = ArmState::from_values(&values) else {
            bail!("the controller sends states that are not numbers");
        };
        let followed = state.has_program(*heartbeat);
        let (order, fault) = shared.step(&state, followed);
        let (command, target) = match order {
            Order::Servo(target) => (Command::Servo, target),
            Order::Idle => (Command::Idle, state.q),
            Order::Stop => (Command::Stop, state.q),
        };
        *heartbeat = heartbeat.wrapping_add(1);
        send(&mut socket, &client, command, *heartbeat, target)?;
        for setting in link.settings.try_iter() {
            let (recipe, values) = setting.values();
            socket.write_all(&client.input(1 + recipe, &values)?)?;
        }
        report(ArmEvent::State(Box::new(state), followed));
        if let Some(why) = fault {
            report(ArmEvent::Fault(why));
        }
    }
    // An orderly end: the arm rests where it is.
    if client.is_running() {
        *heartbeat = heartbeat.wrapping_add(1);
        send(&mut socket, &client, Command::Idle, *heartbeat, [0.0; 6])?;
    }
    Ok(())
}

fn send(
    socket: &mut TcpStream,
    client: &Client,
    command: Command,
    heartbeat: i32,
    targets: [f64; 6],
) -> anyhow::Result<()> {
    let mut inputs = vec![Value::Int32(command as i32), Value::Int32(heartbeat)];
    inputs.extend(targets.map(Value::Double));
    Ok(socket.write_all(&client.input(0, &inputs)?)?)
}
