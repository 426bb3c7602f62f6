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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::os::fd::{FromRawFd as _, OwnedFd};
    use tdv_ur_protocol::modbus::crc16;

    /// A pty: our end of the line as a file, and the name of the other.
    fn line() -> (File, OwnedFd, String) {
        let (mut ours, mut theirs) = (0, 0);
        let mut name = [0_u8; 64];
        // SAFETY: the pointers are to live variables of the right types, the name has room for any
        // /dev/pts path, and both descriptors are owned from here on.
        unsafe {
            let (none, no_size) = (std::ptr::null_mut(), std::ptr::null_mut());
            let made = libc::openpty(
                &raw mut ours,
                &raw mut theirs,
                name.as_mut_ptr().cast(),
                none,
                no_size,
            );
            assert_eq!(made, 0);
            let end = name.iter().position(|b| *b == 0).unwrap();
            let path = String::from_utf8(name[..end].to_vec()).unwrap();
            (File::from_raw_fd(ours), OwnedFd::from_raw_fd(theirs), path)
        }
    }

    #[test]
    fn a_serial_gripper_with_one_disturbed_reply() {
        let (mut far, _keep, path) = line();
        let mut link = GripperLink::open(&GripperAddress::Modbus(path)).unwrap();
        let gripper = std::thread::spawn(move || {
            let mut requests = Vec::new();
            for turn in 0..3 {
                let mut request = vec![0; if turn == 0 { 15 } else { 8 }];
                far.read_exact(&mut request).unwrap();
                let mut reply = match turn {
                    0 => vec![9, 0x10, 0x03, 0xE8, 0, 3],
                    _ => vec![9, 3, 6, 0xB9, 0, 0, 0xFF, 0xBD, 0],
                };
                let check = crc16(&reply).to_le_bytes();
                reply.extend_from_slice(&check);
                if turn == 1 {
                    reply[4] ^= 1;
                }
                far.write_all(&reply).unwrap();
                requests.push(request);
            }
            // The line stays open: a closed one takes what waits in it along.
            (requests, far)
        });
        let m = Move { number: 7, position: 0, speed: 255, force: 255 };
        link.order(&m).unwrap();
        let state = link.state(7).unwrap();
        assert_eq!((state.position, state.requested, state.request), (0xBD, 0xFF, 7));
        assert_eq!(state.object, ObjectStatus::ContactClosing);
        let (requests, _far) = gripper.join().unwrap();
        // The manual's frame that opens the gripper.
        let open = [9, 0x10, 3, 0xE8, 0, 3, 6, 9, 0, 0, 0, 0xFF, 0xFF, 0x72, 0x19];
        assert_eq!(requests[0], open);
        assert_eq!(requests[1], requests[2], "asked for again");
    }

    #[test]
    fn a_device_that_is_not_there() {
        let nowhere = GripperAddress::Modbus("/dev/no-such-line".into());
        let error = GripperLink::open(&nowhere).err().unwrap();
        assert!(format!("{error:#}").contains("/dev/no-such-line"));
    }
}
