//! The lab's controller on real sockets: RTDE, the gripper's URCap, a small dashboard.
//!
//! The lab's own loop calls [`UrServer::exchange`] once a tick; the threads behind the sockets only
//! move bytes and registers. Garbage ends the connection that it came from and nothing else.

mod dashboard;
mod gripper;
mod outbox;
mod rtde;
mod session;
mod state;

use crate::controller::Generation;
use crate::error::SimulationError;
use crate::gripper::{GripperRequest, GripperStatus};
use crate::lab::Lab;
use crate::world::DT;
use outbox::{Outbox, lock};
use session::{Owners, Session};
use state::{InputRegisters, Snapshot};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use tdv_ur_protocol::dashboard::Command;
use tdv_ur_protocol::rtde::{CB3_RATE, E_SERIES_RATE};
use tdv_ur_protocol::{DASHBOARD_PORT, GRIPPER_PORT, RTDE_PORT};

/// Where the servers listen. Port 0 takes a free one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServerConfig {
    /// Address of all of them.
    pub address: IpAddr,
    /// RTDE.
    pub rtde: u16,
    /// Gripper.
    pub gripper: u16,
    /// Dashboard.
    pub dashboard: u16,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            rtde: RTDE_PORT,
            gripper: GRIPPER_PORT,
            dashboard: DASHBOARD_PORT,
        }
    }
}

/// One RTDE client as the lab's loop sees it.
struct RtdeClient {
    id: u64,
    session: Arc<Mutex<Session>>,
    outbox: Arc<Outbox>,
}

/// A dashboard command on its way to the lab's loop and where the answer goes.
type DashboardRequest = (Command, SyncSender<String>);

/// What a connection's thread does.
type Serve = fn(TcpStream, &Arc<Shared>);

/// What all threads share.
struct Shared {
    stop: AtomicBool,
    next_id: AtomicU64,
    generation: Generation,
    registers: Mutex<InputRegisters>,
    owners: Mutex<Owners>,
    clients: Mutex<Vec<RtdeClient>>,
    gripper: Mutex<(GripperRequest, GripperStatus)>,
    dashboard: Mutex<Vec<DashboardRequest>>,
}

impl Shared {
    fn fastest(&self) -> f64 {
        match self.generation {
            Generation::Cb3 => CB3_RATE,
            Generation::ESeries => E_SERIES_RATE,
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// The servers. They end when this is dropped.
pub struct UrServer {
    shared: Arc<Shared>,
    addresses: [SocketAddr; 3],
    threads: Vec<JoinHandle<()>>,
}

impl UrServer {
    /// Opens all three ports.
    ///
    /// # Errors
    /// [`SimulationError::Listen`] naming the server and the address.
    pub fn start(config: ServerConfig, generation: Generation) -> Result<Self, SimulationError> {
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            next_id: AtomicU64::new(1),
            generation,
            registers: Mutex::default(),
            owners: Mutex::default(),
            clients: Mutex::default(),
            gripper: Mutex::default(),
            dashboard: Mutex::default(),
        });
        let open = |what: &'static str, port: u16| {
            let address = SocketAddr::new(config.address, port);
            let fail =
                |source| SimulationError::Listen { what, address: address.to_string(), source };
            let listener = TcpListener::bind(address).map_err(fail)?;
            listener.set_nonblocking(true).map_err(fail)?;
            let at = listener.local_addr().map_err(fail)?;
            Ok::<_, SimulationError>((listener, at))
        };
        let servers: [(_, Serve); 3] = [
            (open("the RTDE server", config.rtde)?, rtde::serve),
            (open("the gripper server", config.gripper)?, gripper::serve),
            (open("the dashboard server", config.dashboard)?, dashboard::serve),
        ];
        let addresses = [servers[0].0.1, servers[1].0.1, servers[2].0.1];
        let threads = servers
            .into_iter()
            .map(|((listener, _), serve)| {
                let shared = Arc::clone(&shared);
                std::thread::spawn(move || accept(&listener, &shared, serve))
            })
            .collect();
        Ok(Self { shared, addresses, threads })
    }

    /// Where RTDE, gripper and dashboard listen.
    pub fn addresses(&self) -> [SocketAddr; 3] {
        self.addresses
    }

    /// How many RTDE clients are connected.
    pub fn clients(&self) -> usize {
        lock(&self.shared.clients).len()
    }

    /// Hands what the clients wrote to the lab and what the lab shows to the clients. Once a tick,
    /// before [`Lab::step`].
    pub fn exchange(&self, lab: &mut Lab) {
        let registers = lock(&self.shared.registers).clone();
        lab.set_servo_inputs(registers.servo());
        if let Some(fraction) = registers.slider() {
            lab.controller_mut().set_speed_fraction(fraction);
        }
        {
            let mut gripper = lock(&self.shared.gripper);
            lab.set_gripper_request(gripper.0);
            gripper.1 = lab.gripper_status();
        }
        for (command, answer) in lock(&self.shared.dashboard).drain(..) {
            // The client may be gone by now; nobody else wants the answer.
            let _ = answer.try_send(dashboard::execute(command, lab.controller_mut()));
        }
        let clients = lock(&self.shared.clients);
        if clients.is_empty() {
            return;
        }
        let snapshot = Snapshot::of(lab);
        for client in clients.iter() {
            if let Some(bytes) = lock(&client.session).tick(DT, &snapshot, &registers) {
                client.outbox.data(bytes);
            }
        }
    }
}

impl Drop for UrServer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A thread that panicked has nothing left to clean up.
            let _ = thread.join();
        }
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>, serve: Serve) {
    let mut connections: Vec<JoinHandle<()>> = Vec::new();
    while !shared.stopped() {
        match listener.accept() {
            Ok((stream, _)) => {
                let ready = stream.set_nonblocking(false).is_ok()
                    && stream.set_nodelay(true).is_ok()
                    && stream.set_read_timeout(Some(Duration::from_millis(200))).is_ok()
                    && stream.set_write_timeout(Some(Duration::from_secs(2))).is_ok();
                if ready {
                    let shared = Arc::clone(shared);
                    connections.push(std::thread::spawn(move || serve(stream, &shared)));
                }
            }
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
        connections.retain(|c| !c.is_finished());
    }
    for c in connections {
        let _ = c.join();
    }
}

/// Reads until the peer closes, the server stops, or `take` has had enough.
fn read_all(
    stream: &mut TcpStream,
    shared: &Shared,
    mut take: impl FnMut(&[u8]) -> Result<(), String>,
) -> Result<(), String> {
    use std::io::{ErrorKind, Read};
    let mut buffer = [0_u8; 4096];
    while !shared.stopped() {
        match stream.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(n) => take(&buffer[..n])?,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => return Err(e.to_string()),
        }
    }
    Ok(())
}
