//! The lab's controller on real sockets: RTDE, dashboard, primary, secondary and real-time interface,
//! and the gripper's URCap.
//!
//! The lab's own loop calls [`UrServer::exchange`] once a tick; the threads behind the sockets only
//! move bytes and registers. Garbage ends the connection that it came from and nothing else.

mod dashboard;
mod gripper;
mod meter;
mod outbox;
mod rtde;
mod script;
mod session;
mod state;
mod stream;

use crate::controller::{Controller, Generation, Message, Script};
use crate::error::SimulationError;
use crate::gripper::{GripperRequest, GripperStatus};
use crate::lab::Lab;
use crate::world::DT;
use meter::CommandMeter;
use outbox::{Outbox, lock};
use script::{Port, StreamClient};
use session::{Owners, Session};
use state::InputRegisters;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use tdv_ur_protocol::rtde::{CB3_RATE, E_SERIES_RATE};
use tdv_ur_protocol::{DASHBOARD_PORT, GRIPPER_PORT, RTDE_PORT};

pub use meter::CommandFigures;
pub use tdv_ur_protocol::script::{REALTIME_PORT, SECONDARY_PORT};

/// TCP port of the primary interface.
pub const PRIMARY_PORT: u16 = 30001;
/// Connections at one time; more are closed at once.
const MAX_CONNECTIONS: usize = 64;

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
    /// Primary interface.
    pub primary: u16,
    /// Secondary interface.
    pub secondary: u16,
    /// Real-time interface.
    pub realtime: u16,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            rtde: RTDE_PORT,
            gripper: GRIPPER_PORT,
            dashboard: DASHBOARD_PORT,
            primary: PRIMARY_PORT,
            secondary: SECONDARY_PORT,
            realtime: REALTIME_PORT,
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
type DashboardRequest = (String, SyncSender<String>);

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
    desk: Mutex<dashboard::Desk>,
    scripts: Mutex<Vec<Script>>,
    streams: Mutex<Vec<StreamClient>>,
    /// Clients of all servers together.
    connections: AtomicUsize,
    meter: Mutex<CommandMeter>,
    /// By [`Link`].
    cut: [AtomicBool; 2],
}

/// A connection that can be cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// RTDE.
    Rtde,
    /// The gripper's socket.
    Gripper,
}

/// Cuts connections of a running server and lets them come again; clones act on the same server.
#[derive(Clone)]
pub struct Cutter(Arc<Shared>);

impl Cutter {
    /// While a link is cut its connections are closed, and new ones as soon as they are made.
    pub fn cut(&self, link: Link, cut: bool) {
        self.0.cut[link as usize].store(cut, Ordering::Relaxed);
    }
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

    fn is_cut(&self, link: Link) -> bool {
        self.cut[link as usize].load(Ordering::Relaxed)
    }
}

/// The servers. They end when this is dropped.
pub struct UrServer {
    shared: Arc<Shared>,
    addresses: [SocketAddr; 6],
    threads: Vec<JoinHandle<()>>,
}

impl UrServer {
    /// Opens all ports.
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
            desk: Mutex::default(),
            scripts: Mutex::default(),
            streams: Mutex::default(),
            connections: AtomicUsize::new(0),
            meter: Mutex::default(),
            cut: Default::default(),
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
        let servers: [(_, Serve); 6] = [
            (open("the RTDE server", config.rtde)?, rtde::serve),
            (open("the gripper server", config.gripper)?, gripper::serve),
            (open("the dashboard server", config.dashboard)?, dashboard::serve),
            (open("the primary interface", config.primary)?, |stream, shared| {
                script::serve(stream, shared, Port::Primary);
            }),
            (open("the secondary interface", config.secondary)?, |stream, shared| {
                script::serve(stream, shared, Port::Secondary);
            }),
            (open("the real-time interface", config.realtime)?, |stream, shared| {
                script::serve(stream, shared, Port::Realtime);
            }),
        ];
        let addresses = servers.each_ref().map(|s| s.0.1);
        let threads = servers
            .into_iter()
            .map(|((listener, _), serve)| {
                let shared = Arc::clone(&shared);
                std::thread::spawn(move || accept(&listener, &shared, serve))
            })
            .collect();
        Ok(Self { shared, addresses, threads })
    }

    /// Where RTDE, gripper, dashboard, primary, secondary and real-time interface listen.
    pub fn addresses(&self) -> [SocketAddr; 6] {
        self.addresses
    }

    /// How many RTDE clients are connected.
    pub fn clients(&self) -> usize {
        lock(&self.shared.clients).len()
    }

    /// To cut connections.
    pub fn cutter(&self) -> Cutter {
        Cutter(Arc::clone(&self.shared))
    }

    /// How regularly fresh commands have come while the servo program followed; none before it did.
    pub fn command_figures(&self) -> Option<CommandFigures> {
        lock(&self.shared.meter).figures()
    }

    /// Keeps a program under a name for the dashboard's `load`.
    pub fn keep_program(&self, name: &str, text: &str) {
        lock(&self.shared.desk).programs.insert(name.to_owned(), text.to_owned());
    }

    /// Hands what the clients wrote to the lab and what the lab shows to the clients. Once a tick,
    /// before [`Lab::step`].
    pub fn exchange(&self, lab: &mut Lab) {
        self.exchange_controller(lab.controller_mut(), DT);
        lab.set_gripper_request(self.exchange_gripper(lab.gripper_status()));
    }

    /// The gripper's part of [`exchange`](Self::exchange): its registers to read in, those that
    /// clients wrote out.
    pub fn exchange_gripper(&self, status: GripperStatus) -> GripperRequest {
        let mut gripper = lock(&self.shared.gripper);
        gripper.1 = status;
        gripper.0
    }

    /// The controller's part of [`exchange`](Self::exchange), `dt` seconds after the last one.
    pub fn exchange_controller(&self, c: &mut Controller, dt: f64) {
        lock(&self.shared.registers).deliver(c);
        if due(c, dt, c.generation().cycle()) {
            lock(&self.shared.meter).tick(c);
        }
        let scripts = std::mem::take(&mut *lock(&self.shared.scripts));
        for script in scripts {
            // The controller has said why; there is no answer on these ports.
            let _ = c.run(script);
        }
        let requests = std::mem::take(&mut *lock(&self.shared.dashboard));
        for (line, answer) in requests {
            // The client may be gone by now; nobody else wants the answer.
            let _ = answer.try_send(dashboard::execute(&line, c, &mut lock(&self.shared.desk)));
        }
        let messages = c.take_messages();
        for client in lock(&self.shared.clients).iter() {
            let mut session = lock(&client.session);
            if session.started() {
                messages.iter().for_each(|m| client.outbox.text(session::text(m)));
            }
            if let Some(bytes) = session.tick(dt, c).filter(|_| !self.shared.is_cut(Link::Rtde)) {
                client.outbox.data(bytes);
            }
        }
        self.stream(c, dt, &messages);
    }

    fn stream(&self, c: &Controller, dt: f64, messages: &[Message]) {
        let mut streams = lock(&self.shared.streams);
        let (mut state, mut realtime) = (None, None);
        for client in streams.iter_mut() {
            if client.port == Port::Realtime {
                if due(c, dt, c.generation().cycle()) {
                    let bytes = realtime.get_or_insert_with(|| stream::realtime(c));
                    client.outbox.data(bytes.clone());
                }
                continue;
            }
            if !client.greeted {
                client.greeted = true;
                client.outbox.text(stream::version(c));
            }
            if client.port == Port::Primary {
                messages.iter().for_each(|m| client.outbox.text(stream::text(c, m)));
            }
            if due(c, dt, 0.1) {
                let bytes = state.get_or_insert_with(|| stream::robot_state(c));
                client.outbox.data(bytes.clone());
            }
        }
    }
}

/// True once per period of the controller's time.
fn due(c: &Controller, dt: f64, period: f64) -> bool {
    ((c.time() + dt) / period).floor() > (c.time() / period).floor()
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
                let full = shared.connections.load(Ordering::Relaxed) >= MAX_CONNECTIONS;
                if ready && !full {
                    shared.connections.fetch_add(1, Ordering::Relaxed);
                    let shared = Arc::clone(shared);
                    connections.push(std::thread::spawn(move || {
                        serve(stream, &shared);
                        shared.connections.fetch_sub(1, Ordering::Relaxed);
                    }));
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
