//! The two ways to a 2F-85: the URCap's socket, and Modbus RTU on a serial line.

use crate::gripper::{GripperState, Move};
use crate::serial::Serial;
use anyhow::{Context as _, bail};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};
use tdv_ur_protocol::gripper::{LineReader, ObjectStatus, Request, Response, Variable};
use tdv_ur_protocol::modbus::{GripperInputs, GripperOutputs, ModbusError, ModbusRequest, SLAVE};

/// Time for an answer.
const PATIENCE: Duration = Duration::from_millis(500);

/// Where the gripper is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GripperAddress {
    /// Socket of the URCap.
    Socket(SocketAddr),
    /// A serial device.
    Modbus(String),
}

impl std::fmt::Display for GripperAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Socket(a) => write!(f, "{a}"),
            Self::Modbus(device) => write!(f, "{device}"),
        }
    }
}

/// An open connection.
pub enum GripperLink {
    Socket(TcpStream, LineReader),
    Modbus(Serial, GripperOutputs),
}

impl GripperLink {
    pub fn open(address: &GripperAddress) -> anyhow::Result<Self> {
        match address {
            GripperAddress::Socket(a) => {
                let socket = TcpStream::connect_timeout(a, Duration::from_secs(2))
                    .context("no connection")?;
                socket.set_nodelay(true)?;
                socket.set_read_timeout(Some(Duration::from_millis(50)))?;
                socket.set_write_timeout(Some(PATIENCE))?;
                Ok(Self::Socket(socket, LineReader::default()))
            }
            GripperAddress::Modbus(device) => {
                let port = Serial::open(device)
                    .with_context(|| format!("serial device {device} cannot be used"))?;
                Ok(Self::Modbus(port, GripperOutputs::default()))
            }
        }
    }

    /// 0 reset, 1 activating, 3 active.
    pub fn status(&mut self) -> anyhow::Result<u8> {
        match self {
            Self::Socket(s, l) => get(s, l, Variable::Status),
            Self::Modbus(port, _) => Ok(inputs(port)?.status),
        }
    }

    /// Sets or clears the activation bit; clearing it forgets every order.
    pub fn activate(&mut self, on: bool) -> anyhow::Result<()> {
        match self {
            Self::Socket(s, l) => set(s, l, &[(Variable::Activate, u8::from(on))]),
            Self::Modbus(port, outputs) => {
                *outputs = GripperOutputs { activate: on, ..Default::default() };
                write(port, outputs)
            }
        }
    }

    /// Sends the fingers to a position.
    pub fn order(&mut self, m: &Move) -> anyhow::Result<()> {
        match self {
            Self::Socket(s, l) => set(
                s,
                l,
                &[
                    (Variable::Position, m.position),
                    (Variable::Speed, m.speed),
                    (Variable::Force, m.force),
                    (Variable::GoTo, 1),
                ],
            ),
            Self::Modbus(port, outputs) => {
                *outputs = GripperOutputs {
                    activate: true,
                    go_to: true,
                    auto_release: false,
                    position: m.position,
                    speed: m.speed,
                    force: m.force,
                };
                write(port, outputs)
            }
        }
    }

    /// What the gripper says now; `request` is the number of the last order.
    pub fn state(&mut self, request: u32) -> anyhow::Result<GripperState> {
        match self {
            Self::Socket(s, l) => {
                let object = get(s, l, Variable::Object)?;
                Ok(GripperState {
                    position: get(s, l, Variable::Position)?,
                    requested: get(s, l, Variable::RequestEcho)?,
                    object: ObjectStatus::from_register(object)
                        .with_context(|| format!("OBJ is {object}, 0 to 3 are possible"))?,
                    fault: get(s, l, Variable::Fault)?,
                    request,
                })
            }
            Self::Modbus(port, _) => {
                let i = inputs(port)?;
                Ok(GripperState {
                    position: i.position,
                    requested: i.requested,
                    object: i.object,
                    fault: i.fault,
                    request,
                })
            }
        }
    }
}

fn ask(s: &mut TcpStream, lines: &mut LineReader, request: &Request) -> anyhow::Result<Response> {
    s.write_all(request.to_line().as_bytes())?;
    let end = Instant::now() + PATIENCE;
    let mut buffer = [0_u8; 256];
    loop {
        if let Some(line) = lines.next_line() {
            return Ok(Response::parse(&line)?);
        }
        match s.read(&mut buffer) {
            Ok(0) => bail!("the gripper closed the connection"),
            Ok(n) => lines.push(&buffer[..n])?,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                if Instant::now() > end {
                    bail!("no answer to {:?}", request.to_line().trim());
                }
            }
            Err(e) => return Err(e.into()),
        }
    }
}

fn get(s: &mut TcpStream, lines: &mut LineReader, variable: Variable) -> anyhow::Result<u8> {
    match ask(s, lines, &Request::Get(variable))? {
        Response::Value(v, x) if v == variable => Ok(x),
        other => bail!("asked for {}, got {:?}", variable.name(), other.to_line().trim()),
    }
}

fn set(s: &mut TcpStream, l: &mut LineReader, pairs: &[(Variable, u8)]) -> anyhow::Result<()> {
    match ask(s, l, &Request::Set(pairs.to_vec()))? {
        Response::Ack => Ok(()),
        other => bail!("a setting was answered by {:?}", other.to_line().trim()),
    }
}

fn write(port: &mut Serial, outputs: &GripperOutputs) -> anyhow::Result<()> {
    exchange(port, &outputs.request(SLAVE)).map(|_| ())
}

fn inputs(port: &mut Serial) -> anyhow::Result<GripperInputs> {
    let registers = exchange(port, &GripperInputs::request(SLAVE))?;
    GripperInputs::from_registers(&registers)
        .context("the gripper sends another number of registers")
}

/// One request and its reply; a disturbed reply is asked for once more.
fn exchange(port: &mut Serial, request: &ModbusRequest) -> anyhow::Result<Vec<u16>> {
    match once(port, request) {
        Err(error) if error.downcast_ref::<ModbusError>().is_some() => once(port, request),
        other => other,
    }
}

fn once(port: &mut Serial, request: &ModbusRequest) -> anyhow::Result<Vec<u16>> {
    port.discard()?;
    port.write_all(&request.to_bytes())?;
    let end = Instant::now() + PATIENCE;
    let mut received = Vec::new();
    loop {
        let n = port.read_some(&mut received)?;
        if let Some(registers) = request.reply(&received)? {
            return Ok(registers);
        }
        if n == 0 && Instant::now() > end {
            bail!("the gripper does not answer on the serial line");
        }
    }
}
