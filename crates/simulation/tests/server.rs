//! The lab's controller over real sockets, driven in lockstep: the test steps the lab itself.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::time::Duration;
use tdv_simulation::controller::RuntimeState;
use tdv_simulation::ur_server::{Link, ServerConfig, UrServer};
use tdv_simulation::{Lab, Scene};
use tdv_ur_protocol::rtde::{ClientPackage, FrameReader, Recipe, ServerPackage, Value};
use tdv_ur_protocol::servo;

const ANY_PORT: ServerConfig = ServerConfig {
    address: std::net::IpAddr::V4(Ipv4Addr::LOCALHOST),
    rtde: 0,
    gripper: 0,
    dashboard: 0,
    primary: 0,
    secondary: 0,
    realtime: 0,
};

struct Bench {
    server: UrServer,
    lab: Lab,
}

impl Bench {
    fn new() -> Self {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes/cup_on_coaster.yaml");
        let lab = Lab::new(&Scene::load(&path).unwrap(), 7).unwrap();
        let server = UrServer::start(ANY_PORT, lab.controller().generation()).unwrap();
        Self { server, lab }
    }

    fn tick(&mut self) {
        self.server.exchange(&mut self.lab);
        self.lab.step();
        std::thread::sleep(Duration::from_millis(1));
    }

    /// Steps until `done`; panics after a number of ticks that no healthy machine needs.
    fn until(&mut self, what: &str, mut done: impl FnMut(&mut Self) -> bool) {
        for _ in 0..20_000 {
            if done(self) {
                return;
            }
            self.tick();
        }
        panic!("{what} did not happen");
    }
}

struct Rtde {
    stream: TcpStream,
    frames: FrameReader,
}

impl Rtde {
    fn connect(bench: &Bench) -> Self {
        let stream = TcpStream::connect(bench.server.addresses()[0]).unwrap();
        stream.set_nonblocking(true).unwrap();
        Self { stream, frames: FrameReader::default() }
    }

    fn send(&mut self, p: &ClientPackage) {
        self.stream.write_all(&p.to_bytes()).unwrap();
    }

    fn poll(&mut self) -> Option<ServerPackage> {
        let mut buffer = [0; 4096];
        if let Ok(n) = self.stream.read(&mut buffer) {
            self.frames.push(&buffer[..n]);
        }
        self.frames.next_frame().unwrap().map(|f| ServerPackage::parse(f).unwrap())
    }

    fn ask(&mut self, bench: &mut Bench, p: &ClientPackage) -> ServerPackage {
        self.send(p);
        let mut answer = None;
        bench.until("an answer", |_| {
            answer = self.poll();
            answer.is_some()
        });
        answer.unwrap()
    }
}

fn names(list: &[&str]) -> Vec<String> {
    list.iter().map(|n| (*n).to_owned()).collect()
}

#[test]
fn handshake_stream_servo_and_watchdog() {
    let mut bench = Bench::new();
    let mut c = Rtde::connect(&bench);
    assert_eq!(
        c.ask(&mut bench, &ClientPackage::ProtocolVersion(2)),
        ServerPackage::ProtocolVersion(true)
    );
    assert!(matches!(
        c.ask(&mut bench, &ClientPackage::ControllerVersion),
        ServerPackage::ControllerVersion([3, 15, ..])
    ));
    let fields = ["timestamp", "actual_q", servo::PROGRAM_STATE, servo::HEARTBEAT_ECHO];
    let setup = ClientPackage::SetupOutputs { frequency: 125.0, names: names(&fields) };
    let ServerPackage::SetupOutputs { id, types } = c.ask(&mut bench, &setup) else { panic!() };
    let outputs = Recipe::from_answer(id, &fields, &types).unwrap();
    let mut wanted = vec![servo::COMMAND, servo::HEARTBEAT];
    wanted.extend(servo::TARGETS);
    let setup = ClientPackage::SetupInputs { names: names(&wanted) };
    let ServerPackage::SetupInputs { id, types } = c.ask(&mut bench, &setup) else { panic!() };
    let inputs = Recipe::from_answer(id, &wanted, &types).unwrap();
    assert_eq!(c.ask(&mut bench, &ClientPackage::Start), ServerPackage::Start(true));

    // Until a program is sent nothing runs; it may come in any pieces.
    assert_eq!(bench.lab.controller().runtime_state(), RuntimeState::Stopped);
    let mut upload = TcpStream::connect(bench.server.addresses()[5]).unwrap();
    let text = servo::ServoProgram::cb3().text().unwrap();
    for piece in text.as_bytes().chunks(700) {
        upload.write_all(piece).unwrap();
    }
    bench.until("the program", |b| b.lab.controller().outputs().ints[24] == 1);

    let home = *bench.lab.joints().0;
    let mut target = home;
    let mut stamps = Vec::new();
    let mut beat = 0;
    let mut last = Vec::new();
    bench.until("0.2 rad of servo motion", |bench| {
        while let Some(ServerPackage::Data(payload)) = c.poll() {
            last = outputs.decode(&payload).unwrap();
            stamps.push(last[0].as_f64().unwrap());
            beat += 1;
            target[0] = (target[0] + 0.004).min(home[0] + 0.2);
            let mut values = vec![Value::Int32(1), Value::Int32(beat)];
            values.extend(target.map(Value::Double));
            c.send(&ClientPackage::Data(inputs.encode(&values).unwrap()));
        }
        (bench.lab.joints().0[0] - home[0] - 0.2).abs() < 1e-3
    });
    assert_eq!(last[2], Value::Int32(servo::ProgramState::Servoing as i32));
    let gap = stamps.windows(2).map(|w| w[1] - w[0]).fold(f64::MAX, f64::min);
    assert!(gap > 0.0079, "125 Hz, got {gap}");
    // Silence: the watchdog stops the program.
    bench.until("the watchdog", |b| {
        b.lab.controller().outputs().ints[24] == servo::ProgramState::WatchdogStop as i32
    });
    // What was measured: a command for each package while it moved, then 100 ms of nothing.
    let measured = bench.server.command_figures().unwrap();
    assert!(measured.intervals >= 40 && measured.ticks >= 50, "{measured:?}");
    assert!((10..=14).contains(&measured.missed_run), "{measured:?}");
    assert!(measured.missed >= measured.missed_run && measured.p50_ms > 0.0, "{measured:?}");
    // A second client may not take the registers; when the first one goes, it may.
    let mut second = Rtde::connect(&bench);
    let ServerPackage::SetupInputs { types, .. } = second.ask(&mut bench, &setup) else { panic!() };
    assert!(types.starts_with("IN_USE"), "{types}");
    drop(c);
    bench.until("the first client's end", |b| b.server.clients() == 1);
    let ServerPackage::SetupInputs { id, .. } = second.ask(&mut bench, &setup) else { panic!() };
    assert_eq!(id, 1);
}

#[test]
fn garbage_ends_its_own_connection_only() {
    let mut bench = Bench::new();
    let mut good = Rtde::connect(&bench);
    good.ask(&mut bench, &ClientPackage::ProtocolVersion(2));
    for garbage in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0, 3, 200], &[0, 3, b'O'], &[0, 4, b'U', 9]] {
        let mut bad = TcpStream::connect(bench.server.addresses()[0]).unwrap();
        bad.write_all(garbage).unwrap();
        bad.set_nonblocking(true).unwrap();
        let mut buffer = [0; 64];
        bench.until("the disconnection", |_| {
            matches!(bad.read(&mut buffer), Ok(0))
                || bad
                    .peek(&mut buffer)
                    .is_err_and(|e| e.kind() == std::io::ErrorKind::ConnectionReset)
        });
    }
    assert!(matches!(
        good.ask(&mut bench, &ClientPackage::ControllerVersion),
        ServerPackage::ControllerVersion(_)
    ));
}

fn line(bench: &mut Bench, stream: &mut TcpStream, ask: &str) -> String {
    stream.write_all(ask.as_bytes()).unwrap();
    let mut got = String::new();
    bench.until("an answer", |_| {
        let mut buffer = [0; 256];
        if let Ok(n) = stream.read(&mut buffer) {
            got.push_str(&String::from_utf8_lossy(&buffer[..n]));
        }
        got.ends_with('\n')
    });
    got.trim_end().to_owned()
}

#[test]
fn gripper_activates_closes_and_says_so() {
    let mut bench = Bench::new();
    let mut g = TcpStream::connect(bench.server.addresses()[1]).unwrap();
    g.set_nonblocking(true).unwrap();
    assert_eq!(line(&mut bench, &mut g, "GET STA\n"), "STA 0");
    assert_eq!(line(&mut bench, &mut g, "nonsense\n"), "?");
    assert_eq!(line(&mut bench, &mut g, "SET ACT 1\n"), "ack");
    while line(&mut bench, &mut g, "GET STA\n") != "STA 3" {}
    assert_eq!(line(&mut bench, &mut g, "SET POS 255 SPE 255 FOR 50 GTO 1\n"), "ack");
    while line(&mut bench, &mut g, "GET PRE\n") != "PRE 255" {}
    while line(&mut bench, &mut g, "GET OBJ\n") == "OBJ 0" {}
    assert_eq!(line(&mut bench, &mut g, "GET OBJ\n"), "OBJ 3");
    assert_eq!(line(&mut bench, &mut g, "GET POS\n"), "POS 230");
    assert!(bench.lab.world().gap() < 0.001);
}

/// Whether the server has closed the connection.
fn closed(stream: &mut TcpStream) -> bool {
    match stream.read(&mut [0; 256]) {
        Ok(n) => n == 0,
        Err(e) => e.kind() != std::io::ErrorKind::WouldBlock,
    }
}

#[test]
fn a_cut_link_is_closed_and_comes_again() {
    let mut bench = Bench::new();
    let connect = |bench: &Bench| {
        let g = TcpStream::connect(bench.server.addresses()[1]).unwrap();
        g.set_nonblocking(true).unwrap();
        g
    };
    let mut g = connect(&bench);
    assert_eq!(line(&mut bench, &mut g, "GET STA\n"), "STA 0");
    let mut robot = Rtde::connect(&bench);
    bench.server.cutter().cut(Link::Gripper, true);
    g.write_all(b"GET STA\n").unwrap();
    bench.until("the end of the connection", |_| closed(&mut g));
    let mut again = connect(&bench);
    bench.until("the end of a new one", |_| closed(&mut again));
    // The other link is as it was.
    let version = robot.ask(&mut bench, &ClientPackage::ProtocolVersion(2));
    assert_eq!(version, ServerPackage::ProtocolVersion(true));
    bench.server.cutter().cut(Link::Gripper, false);
    let mut g = connect(&bench);
    assert_eq!(line(&mut bench, &mut g, "GET STA\n"), "STA 0");
}

#[test]
fn dashboard_answers() {
    let mut bench = Bench::new();
    let mut d = TcpStream::connect(bench.server.addresses()[2]).unwrap();
    d.set_nonblocking(true).unwrap();
    assert!(line(&mut bench, &mut d, "").starts_with("Connected: "));
    assert_eq!(line(&mut bench, &mut d, "robotmode\n"), "Robotmode: RUNNING");
    assert_eq!(line(&mut bench, &mut d, "SafetyMode\n"), "Safetymode: NORMAL");
    assert_eq!(line(&mut bench, &mut d, "programState\n"), "STOPPED <unnamed>");
    assert_eq!(line(&mut bench, &mut d, "play\n"), "Failed to execute: play");
    assert_eq!(line(&mut bench, &mut d, "load a.urp\n"), "File not found: a.urp");
    bench.server.keep_program("a.urp", "def a():\n while True:\n  sync()\n end\nend\n");
    assert_eq!(line(&mut bench, &mut d, "load a.urp\n"), "Loading program: a.urp");
    assert_eq!(line(&mut bench, &mut d, "get loaded program\n"), "Loaded program: a.urp");
    assert_eq!(line(&mut bench, &mut d, "play\n"), "Starting program");
    assert_eq!(line(&mut bench, &mut d, "running\n"), "Program running: true");
    assert_eq!(line(&mut bench, &mut d, "pause\n"), "Pausing program");
    assert_eq!(line(&mut bench, &mut d, "programState\n"), "PAUSED a.urp");
    assert_eq!(line(&mut bench, &mut d, "play\n"), "Starting program");
    assert_eq!(line(&mut bench, &mut d, "stop\n"), "Stopped");
    assert_eq!(line(&mut bench, &mut d, "running\n"), "Program running: false");
    assert_eq!(line(&mut bench, &mut d, "power off\n"), "Powering off");
    assert_eq!(line(&mut bench, &mut d, "robotmode\n"), "Robotmode: POWER_OFF");
    assert_eq!(line(&mut bench, &mut d, "play\n"), "Failed to execute: play");
    assert_eq!(line(&mut bench, &mut d, "brake release\n"), "Brake releasing");
    while line(&mut bench, &mut d, "robotmode\n") != "Robotmode: RUNNING" {}
    assert!(line(&mut bench, &mut d, "PolyscopeVersion\n").starts_with("URSoftware 3.15.8."));
    assert_eq!(line(&mut bench, &mut d, "get robot model\n"), "UR5");
    // A CB3 knows no remote control.
    assert!(line(&mut bench, &mut d, "is in remote control\n").contains("could not understand"));
    assert_eq!(line(&mut bench, &mut d, "popup hello you\n"), "showing popup");
    assert_eq!(bench.lab.controller().popup(), Some("hello you"));
    assert_eq!(line(&mut bench, &mut d, "close popup\n"), "closing popup");
    assert!(line(&mut bench, &mut d, "dance\n").contains("could not understand"));
    assert_eq!(line(&mut bench, &mut d, "quit\n"), "Disconnected");
}

#[test]
fn a_taken_port_is_named() {
    let bench = Bench::new();
    let config = ServerConfig { rtde: bench.server.addresses()[0].port(), ..ANY_PORT };
    let e = UrServer::start(config, bench.lab.controller().generation()).err().unwrap();
    assert!(e.to_string().contains("RTDE") && e.to_string().contains("127.0.0.1"), "{e}");
}

/// The next whole message of a state stream.
fn message(bench: &mut Bench, s: &mut TcpStream, buffer: &mut Vec<u8>) -> Vec<u8> {
    let mut got = Vec::new();
    bench.until("a message", |_| {
        let mut part = [0; 4096];
        if let Ok(n) = s.read(&mut part) {
            buffer.extend_from_slice(&part[..n]);
        }
        let Some(size) = buffer.first_chunk::<4>() else { return false };
        let size = u32::from_be_bytes(*size) as usize;
        assert!((5..10_000).contains(&size), "{size}");
        if buffer.len() >= size {
            got = buffer.drain(..size).collect();
        }
        !got.is_empty()
    });
    got
}

#[test]
fn state_streams_and_scripts_on_all_three_ports() {
    let mut bench = Bench::new();
    let connect = |bench: &Bench, i: usize| {
        let s = TcpStream::connect(bench.server.addresses()[i]).unwrap();
        s.set_nonblocking(true).unwrap();
        s
    };
    let (mut primary, mut secondary, mut realtime) =
        (connect(&bench, 3), connect(&bench, 4), connect(&bench, 5));
    let (mut p, mut s, mut r) = (Vec::new(), Vec::new(), Vec::new());
    assert_eq!(message(&mut bench, &mut primary, &mut p)[4], 20);
    assert_eq!(message(&mut bench, &mut secondary, &mut s)[4], 20);
    let state = message(&mut bench, &mut secondary, &mut s);
    // Robot mode data: running, no program.
    assert_eq!((state[4], state[9], state[18..25].to_vec()), (16, 0, vec![1, 1, 1, 0, 0, 0, 0]));
    let first = message(&mut bench, &mut realtime, &mut r);
    assert_eq!(first.len(), 1108);
    let time = |m: &[u8]| f64::from_be_bytes(std::array::from_fn(|i| m[4 + i]));
    let next = message(&mut bench, &mut realtime, &mut r);
    assert!(time(&next) - time(&first) > 0.0079, "{} {}", time(&first), time(&next));

    // One line is a program, and what it says reaches the primary clients.
    for (k, port) in [&mut primary, &mut secondary, &mut realtime].into_iter().enumerate() {
        port.write_all(format!("set_digital_out({k}, True)\n").as_bytes()).unwrap();
        bench.until("the output", |b| b.lab.controller().lines().digital_out >> k & 1 == 1);
    }
    primary.write_all(b"textmsg(\"here \", 5)\n").unwrap();
    loop {
        let m = message(&mut bench, &mut primary, &mut p);
        if m[4] == 20 && m[14] == 0 {
            assert_eq!(&m[15..], b"here 5");
            break;
        }
    }
    // A script that is none says so on the primary port and leaves the lab alone.
    secondary.write_all(b"def f(:\n\nend\n").unwrap();
    loop {
        let m = message(&mut bench, &mut primary, &mut p);
        if m[4] == 20 && m[14] == 10 {
            assert!(String::from_utf8_lossy(&m[23..]).contains("line 1"), "{m:?}");
            break;
        }
    }
}

#[test]
fn floods_end_their_own_connection_only() {
    let mut bench = Bench::new();
    let mut flood = TcpStream::connect(bench.server.addresses()[4]).unwrap();
    let ended = std::thread::spawn(move || {
        let junk = [b'x'; 1 << 16];
        (0..1000).any(|_| flood.write_all(&junk).is_err())
    });
    bench.until("the end of the flood", |_| ended.is_finished());
    assert!(ended.join().unwrap());
    let mut c = Rtde::connect(&bench);
    assert_eq!(
        c.ask(&mut bench, &ClientPackage::ProtocolVersion(2)),
        ServerPackage::ProtocolVersion(true)
    );
}
