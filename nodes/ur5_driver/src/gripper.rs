//! The gripper's socket: one thread that polls the state and carries out requests.

use anyhow::{Context as _, bail};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use tdv_runtime::Node;
use tdv_ur_protocol::gripper::{LineReader, ObjectStatus, Request, Response, Variable};

/// Time between two looks at the gripper.
const PERIOD: Duration = Duration::from_millis(30);
/// Time for an answer.
const PATIENCE: Duration = Duration::from_millis(500);
/// Time for an activation.
const ACTIVATION: Duration = Duration::from_secs(10);

/// One state of the gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperState {
    /// Measured position register.
    pub position: u8,
    /// Requested position as the gripper has understood it.
    pub requested: u8,
    pub object: ObjectStatus,
    pub fault: u8,
    /// Number of the last request that was carried over.
    pub request: u32,
}

/// A position to go to, in registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    pub number: u32,
    pub position: u8,
    pub speed: u8,
    pub force: u8,
}

/// What happened, for the ROS side.
pub enum GripperEvent {
    Ready,
    State(GripperState),
    Lost(String),
}

/// Connects again and again until the node ends.
pub fn run(
    node: &Node,
    address: SocketAddr,
    moves: &Receiver<Move>,
    mut report: impl FnMut(GripperEvent),
) {
    let mut pause = Duration::from_millis(250);
    while !node.shutdown().is_requested() {
        let outcome = session(node, address, moves, &mut |event| {
            if matches!(event, GripperEvent::Ready) {
                pause = Duration::from_millis(250);
            }
            report(event);
        });
        if let Err(error) = outcome {
            report(GripperEvent::Lost(format!("gripper at {address}: {error:#}")));
        }
        if !node.shutdown().is_requested() {
            std::thread::sleep(pause);
        }
        pause = (pause * 2).min(Duration::from_secs(4));
    }
}

struct Connection {
    socket: TcpStream,
    lines: LineReader,
}

impl Connection {
    fn ask(&mut self, request: &Request) -> anyhow::Result<Response> {
        self.socket.write_all(request.to_line().as_bytes())?;
        let end = Instant::now() + PATIENCE;
        let mut buffer = [0_u8; 256];
        loop {
            if let Some(line) = self.lines.next_line() {
                return Ok(Response::parse(&line)?);
            }
            match self.socket.read(&mut buffer) {
                Ok(0) => bail!("the gripper closed the connection"),
                Ok(n) => self.lines.push(&buffer[..n])?,
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    if Instant::now() > end {
                        bail!("no answer to {:?}", request.to_line().trim());
                    }
                }
                Err(e) => return Err(e.into()),
            }
        }
    }

    fn get(&mut self, variable: Variable) -> anyhow::Result<u8> {
        match self.ask(&Request::Get(variable))? {
            Response::Value(v, x) if v == variable => Ok(x),
            other => bail!("asked for {}, got {:?}", variable.name(), other.to_line().trim()),
        }
    }

    fn set(&mut self, pairs: &[(Variable, u8)]) -> anyhow::Result<()> {
        match self.ask(&Request::Set(pairs.to_vec()))? {
            Response::Ack => Ok(()),
            other => bail!("a setting was answered by {:?}", other.to_line().trim()),
        }
    }

    /// Resets and activates the gripper unless it is active: the fingers move fully open and closed on a
    /// real one.
    fn activate(&mut self, node: &Node) -> anyhow::Result<()> {
        if self.get(Variable::Status)? == 3 {
            return Ok(());
        }
        self.set(&[(Variable::Activate, 0)])?;
        self.wait_for(node, 0)?;
        self.set(&[(Variable::Activate, 1)])?;
        self.wait_for(node, 3)
    }

    fn wait_for(&mut self, node: &Node, status: u8) -> anyhow::Result<()> {
        let end = Instant::now() + ACTIVATION;
        while self.get(Variable::Status)? != status {
            if Instant::now() > end || node.shutdown().is_requested() {
                bail!("activation did not come to status {status}");
            }
            std::thread::sleep(PERIOD);
        }
        Ok(())
    }
}

fn session(
    node: &Node,
    address: SocketAddr,
    moves: &Receiver<Move>,
    report: &mut impl FnMut(GripperEvent),
) -> anyhow::Result<()> {
    let socket =
        TcpStream::connect_timeout(&address, Duration::from_secs(2)).context("no connection")?;
    socket.set_nodelay(true)?;
    socket.set_read_timeout(Some(Duration::from_millis(50)))?;
    let mut c = Connection { socket, lines: LineReader::default() };
    c.activate(node)?;
    // What was ordered while nobody was there has been reported as aborted.
    while moves.try_recv().is_ok() {}
    report(GripperEvent::Ready);
    let mut request = 0;
    while !node.shutdown().is_requested() {
        let next = match moves.recv_timeout(PERIOD) {
            // Only the newest request counts.
            Ok(first) => Some(moves.try_iter().last().unwrap_or(first)),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        if let Some(m) = next {
            c.set(&[
                (Variable::Position, m.position),
                (Variable::Speed, m.speed),
                (Variable::Force, m.force),
                (Variable::GoTo, 1),
            ])?;
            request = m.number;
        }
        let object = c.get(Variable::Object)?;
        report(GripperEvent::State(GripperState {
            position: c.get(Variable::Position)?,
            requested: c.get(Variable::RequestEcho)?,
            object: ObjectStatus::from_register(object)
                .with_context(|| format!("OBJ is {object}, 0 to 3 are possible"))?,
            fault: c.get(Variable::Fault)?,
            request,
        }));
    }
    Ok(())
}
