//! The virtual UR controller and gripper alone, without physics and without ROS, for clients of the
//! robot's own interfaces.
//!
//! `controller [ADDRESS] [cb3|e_series] [off]` listens on the robot's ports (default 127.0.0.1, cb3,
//! powered) and prints `ready`. Lines on stdin:
//!
//! | line | effect |
//! |---|---|
//! | `state` | prints one JSON line of what is true |
//! | `protect` | protective stop |
//! | `safety NAME` | e.g. `ROBOT_EMERGENCY_STOP`; `NORMAL` releases |
//! | `object GAP` | the fingers close on something GAP metres wide; `object none` takes it away |
//! | `input BIT on` | sets a digital input; `off` clears it |
//! | `quit` | ends (so does the end of stdin) |
#![allow(clippy::print_stdout, missing_docs)]

use std::f64::consts::FRAC_PI_2;
use std::io::BufRead;
use std::net::IpAddr;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};
use tdv_simulation::controller::{Controller, Generation, SafetyMode, StopReason, six};
use tdv_simulation::gripper::{Gripper, STROKE};
use tdv_simulation::ur_server::{ServerConfig, UrServer};

const DT: f64 = 0.002;
/// The tool points down, half a metre above the table's edge.
const HOME: [f64; 6] = [-0.276380, -1.794073, 1.592088, -1.368812, -FRAC_PI_2, -1.847177];
/// A delay longer than this is forgiven instead of made up for.
const FORGIVEN: Duration = Duration::from_millis(50);

/// Fingers that follow their drive exactly and stop at what is between them.
struct Fingers {
    gap: f64,
    object: f64,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("{reason}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (mut address, mut generation, mut powered) = ("127.0.0.1", Generation::Cb3, true);
    for a in &arguments {
        match a.as_str() {
            "cb3" => generation = Generation::Cb3,
            "e_series" => generation = Generation::ESeries,
            "off" => powered = false,
            other => address = other,
        }
    }
    let address: IpAddr = address.parse().map_err(|_| format!("'{address}' is no IP address"))?;
    let config = ServerConfig { address, ..ServerConfig::default() };
    let server = UrServer::start(config, generation).map_err(|e| e.to_string())?;
    let mut controller = Controller::with_power(generation, HOME, powered);
    let mut gripper = Gripper::new();
    let mut fingers = Fingers { gap: STROKE, object: 0.0 };

    let (lines, received) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if lines.send(line).is_err() {
                return;
            }
        }
    });
    println!("ready");
    let mut next = Instant::now();
    let (mut busy, mut worst, mut ticks) = (Duration::ZERO, Duration::ZERO, 0_u32);
    loop {
        let began = Instant::now();
        server.exchange_controller(&mut controller, DT);
        controller.step(DT);
        let took = began.elapsed();
        (busy, worst, ticks) = (busy + took, worst.max(took), ticks + 1);
        gripper.set_request(server.exchange_gripper(gripper.status()));
        let drive = gripper.step(DT, fingers.gap);
        let step = (drive.gap - fingers.gap).clamp(-drive.speed * DT, drive.speed * DT);
        fingers.gap = (fingers.gap + step).max(fingers.object.min(fingers.gap));
        let mean = busy.as_secs_f64() * 1e6 / f64::from(ticks);
        if !obey(&received, &mut controller, &mut fingers, [mean, worst.as_secs_f64() * 1e6]) {
            return Ok(());
        }
        next += Duration::from_secs_f64(DT);
        let now = Instant::now();
        if next > now {
            std::thread::sleep(next - now);
        } else if now - next > FORGIVEN {
            next = now;
        }
    }
}

/// Carries out what came on stdin; false when it is time to end.
fn obey(
    received: &Receiver<String>,
    c: &mut Controller,
    fingers: &mut Fingers,
    cost: [f64; 2],
) -> bool {
    loop {
        let line = match received.try_recv() {
            Ok(line) => line,
            Err(TryRecvError::Empty) => return true,
            Err(TryRecvError::Disconnected) => return false,
        };
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["quit"] => return false,
            ["state"] => println!("{}", state(c, fingers, cost)),
            ["protect"] => c.protect(StopReason::Asked),
            ["safety", name] => match safety(name) {
                Some(mode) => c.set_safety(mode),
                None => eprintln!("no safety mode {name}"),
            },
            ["object", "none"] => fingers.object = 0.0,
            ["object", gap] => fingers.object = gap.parse().unwrap_or(0.0),
            ["input", bit, on] => {
                let mask = 1 << bit.parse::<u32>().unwrap_or(0).min(17);
                let lines = c.lines_mut();
                lines.digital_in &= !mask;
                lines.digital_in |= if *on == "on" { mask } else { 0 };
            }
            _ => eprintln!("not understood: {line}"),
        }
    }
}

fn safety(name: &str) -> Option<SafetyMode> {
    use SafetyMode as S;
    [
        S::Normal,
        S::Reduced,
        S::ProtectiveStop,
        S::SafeguardStop,
        S::SystemEmergencyStop,
        S::RobotEmergencyStop,
        S::Violation,
        S::Fault,
    ]
    .into_iter()
    .find(|m| m.name() == name)
}

fn state(c: &Controller, fingers: &Fingers, [mean, worst]: [f64; 2]) -> String {
    format!(
        "{{\"time\": {:.6}, \"q\": {:?}, \"qd\": {:?}, \"tcp\": {:?}, \"robot_mode\": {}, \
         \"safety_mode\": {}, \"runtime_state\": {}, \"digital_out\": {}, \"slider\": {}, \
         \"gap\": {}, \"step_us\": {mean:.1}, \"worst_us\": {worst:.1}}}",
        c.time(),
        c.q(),
        c.qd(),
        six(&c.tcp_pose()),
        c.robot_mode() as i32,
        c.safety_mode() as i32,
        c.runtime_state() as u32,
        c.lines().digital_out,
        c.speed_fraction(),
        fingers.gap,
    )
}
