//! The binary state messages of the primary, secondary and real-time interfaces.
//!
//! Sources: "Client interfaces" and "Real-time client interface" guides (Universal Robots). What the
//! lab does not simulate (currents, voltages, temperatures, moments, accelerometer) is zero.

use super::state::{elbow, joint_mode};
use crate::controller::{Controller, Generation, Message, MessageKind, RobotMode, RuntimeState};
use crate::controller::{SafetyMode, six};

/// Big-endian bytes behind a size that is filled in at the end.
struct Packet(Vec<u8>);

impl Packet {
    fn new() -> Self {
        Self(vec![0; 4])
    }

    fn f64s(&mut self, values: &[f64]) -> &mut Self {
        values.iter().for_each(|v| self.0.extend_from_slice(&v.to_be_bytes()));
        self
    }

    fn f32s(&mut self, values: &[f32]) -> &mut Self {
        values.iter().for_each(|v| self.0.extend_from_slice(&v.to_be_bytes()));
        self
    }

    fn bytes(&mut self, values: &[u8]) -> &mut Self {
        self.0.extend_from_slice(values);
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.bytes(&value.to_be_bytes())
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.bytes(&value.to_be_bytes())
    }

    fn finish(mut self) -> Vec<u8> {
        let size = (self.0.len() as u32).to_be_bytes();
        self.0[..4].copy_from_slice(&size);
        self.0
    }
}

/// Size of the real-time message.
fn realtime_size(generation: Generation) -> usize {
    match generation {
        Generation::Cb3 => 1108,
        Generation::ESeries => 1220,
    }
}

/// One message of the real-time interface.
pub(super) fn realtime(c: &Controller) -> Vec<u8> {
    let (zero, none) = ([0.0; 6], [0.0; 3]);
    let (tcp, speed, lines) = (six(&c.tcp_pose()), c.tcp_speed(), c.lines());
    let mut p = Packet::new();
    p.f64s(&[c.time()]);
    // Targets (q, qd, qdd, current, moment), then what is measured (q, qd, current, control current).
    for v in [c.q(), c.qd(), c.qdd(), &zero, &zero, c.q(), c.qd(), &zero, &zero] {
        p.f64s(v);
    }
    for v in [&tcp, &speed, &c.tcp_force(), &tcp, &speed] {
        p.f64s(v);
    }
    // Bits as an integer, temperatures, controller timer, test value.
    p.u64(lines.digital_in).f64s(&zero).f64s(&[0.0, 0.0]);
    p.f64s(&[f64::from(c.robot_mode() as i32)]).f64s(&[f64::from(joint_mode(c)); 6]);
    p.f64s(&[f64::from(c.safety_mode() as i32)]).f64s(&zero).f64s(&none).f64s(&zero);
    // Scaling, momentum, two reserved, main voltage, robot voltage, robot current, joint voltages.
    p.f64s(&[c.speed_scaling() * c.speed_fraction(), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).f64s(&zero);
    p.u64(lines.digital_out).f64s(&[f64::from(c.runtime_state() as u32)]);
    p.f64s(&elbow(c)).f64s(&none);
    if c.generation() == Generation::ESeries {
        let (mass, cog, inertia) = c.payload();
        p.f64s(&[f64::from(c.safety_mode() as i32)]).f64s(&none);
        p.f64s(&[mass]).f64s(&cog).f64s(&inertia);
    }
    // A size that the client does not expect would put it out of step.
    p.0.resize(realtime_size(c.generation()), 0);
    p.finish()
}

fn microseconds(c: &Controller) -> u64 {
    (c.time() * 1e6) as u64
}

fn sub(kind: u8) -> Packet {
    let mut p = Packet::new();
    p.bytes(&[kind]);
    p
}

fn mode_data(c: &Controller) -> Vec<u8> {
    let powered = c.robot_mode() != RobotMode::PowerOff;
    let emergency =
        matches!(c.safety_mode(), SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop);
    let flags = [
        true,
        c.robot_mode() == RobotMode::Running,
        powered,
        emergency,
        c.protective_stop().is_some(),
        c.program_running(),
        matches!(c.runtime_state(), RuntimeState::Paused | RuntimeState::Pausing),
    ];
    let mut p = sub(0);
    p.u64(microseconds(c)).bytes(&flags.map(u8::from));
    p.bytes(&[c.robot_mode() as u8, 0]);
    p.f64s(&[c.speed_fraction(), c.speed_scaling() * c.speed_fraction(), 1.0]).bytes(&[0]);
    p.finish()
}

fn joint_data(c: &Controller) -> Vec<u8> {
    let mut p = sub(1);
    for i in 0..6 {
        p.f64s(&[c.q()[i], c.q()[i], c.qd()[i]]).f32s(&[0.0; 4]);
        p.bytes(&[joint_mode(c) as u8]);
    }
    p.finish()
}

fn tool_data(c: &Controller) -> Vec<u8> {
    let mut p = sub(2);
    p.bytes(&[0, 0]).f64s(&[0.0, 0.0]).f32s(&[0.0]);
    p.bytes(&[c.lines().tool_voltage as u8]).f32s(&[0.0, 0.0]).bytes(&[joint_mode(c) as u8]);
    p.finish()
}

fn masterboard_data(c: &Controller) -> Vec<u8> {
    let l = c.lines();
    let mut p = sub(3);
    p.u32(l.digital_in as u32).u32(l.digital_out as u32);
    p.bytes(&[1, 1]).f64s(&l.analog_in);
    p.bytes(&[1, 1]).f64s(&l.analog_out.map(|v| 10.0 * v)).f32s(&[0.0; 4]);
    // Safety mode, reduced mode, no Euromap 67, reserved, mode selector, enabling device, reserved.
    let reduced = c.safety_mode() == SafetyMode::Reduced;
    p.bytes(&[c.safety_mode() as u8, u8::from(reduced), 0]).u32(0).bytes(&[0, 0, 0]);
    p.finish()
}

fn cartesian_data(c: &Controller) -> Vec<u8> {
    let mut p = sub(4);
    p.f64s(&six(&c.tcp_pose())).f64s(&six(&c.tcp_offset()));
    p.finish()
}

/// Robot state of the primary and the secondary interface.
pub(super) fn robot_state(c: &Controller) -> Vec<u8> {
    let mut p = sub(16);
    for part in [mode_data(c), joint_data(c), tool_data(c), masterboard_data(c), cartesian_data(c)]
    {
        p.bytes(&part);
    }
    p.finish()
}

fn robot_message(c: &Controller, kind: u8) -> Packet {
    let mut p = sub(20);
    // Source: the controller.
    p.u64(microseconds(c)).bytes(&[(-2_i8).cast_unsigned(), kind]);
    p
}

/// The first message to a client of these interfaces.
pub(super) fn version(c: &Controller) -> Vec<u8> {
    let [major, minor, bugfix, build] = c.generation().version();
    let (name, date) = (b"URControl", b"01-01-2020, 00:00:00");
    let mut p = robot_message(c, 3);
    p.bytes(&[name.len() as u8]).bytes(name).bytes(&[major as u8, minor as u8]);
    p.u32(bugfix).u32(build).bytes(date);
    p.finish()
}

/// A text of the controller, for the primary interface.
pub(super) fn text(c: &Controller, message: &Message) -> Vec<u8> {
    let words: Vec<u8> = message.text.bytes().filter(u8::is_ascii).take(1000).collect();
    let mut p = match message.kind {
        MessageKind::Log => robot_message(c, 0),
        MessageKind::Popup => {
            let mut p = robot_message(c, 2);
            let title = b"Popup";
            p.u32(0).u32(0).bytes(&[0, 0, 0, title.len() as u8]).bytes(title);
            p
        }
        MessageKind::Error => {
            let mut p = robot_message(c, 10);
            // Line and column are in the text.
            p.u32(0).u32(0);
            p
        }
    };
    p.bytes(&words);
    p.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn f64_at(bytes: &[u8], at: usize) -> f64 {
        f64::from_be_bytes(std::array::from_fn(|i| bytes[at + i]))
    }

    #[test]
    fn realtime_numbers_stand_where_the_guide_has_them() {
        for (generation, size) in [(Generation::Cb3, 1108), (Generation::ESeries, 1220)] {
            let mut c = Controller::new(generation, [0.1, -1.2, 1.3, -1.4, 1.5, 0.6]);
            c.lines_mut().digital_in = 5;
            c.lines_mut().digital_out = 2;
            let b = realtime(&c);
            assert_eq!((b.len(), &b[..4]), (size, &(size as u32).to_be_bytes()[..]));
            assert_eq!((f64_at(&b, 12), f64_at(&b, 252 + 40)), (0.1, 0.6));
            assert!((f64_at(&b, 444) - six(&c.tcp_pose())[0]).abs() < 1e-12);
            assert_eq!((f64_at(&b, 588), f64_at(&b, 756)), (f64_at(&b, 444), 7.0));
            assert_eq!((b[691], b[1051]), (5, 2));
            assert_eq!((f64_at(&b, 812), f64_at(&b, 940), f64_at(&b, 1052)), (1.0, 1.0, 1.0));
            assert!((f64_at(&b, 1060) - elbow(&c)[0]).abs() < 1e-12);
        }
    }

    #[test]
    fn robot_state_is_made_of_whole_parts() {
        let c = Controller::new(Generation::ESeries, [0.0; 6]);
        let b = robot_state(&c);
        let size = |at: usize| u32::from_be_bytes(std::array::from_fn(|i| b[at + i])) as usize;
        assert_eq!((size(0), b[4]), (b.len(), 16));
        let (mut at, mut kinds) = (5, Vec::new());
        while at < b.len() {
            kinds.push((b[at + 4], size(at)));
            at += size(at);
        }
        assert_eq!(at, b.len());
        assert_eq!(kinds, [(0, 47), (1, 251), (2, 37), (3, 75), (4, 101)]);
        let v = version(&c);
        assert_eq!((v[4], v[14]), (20, 3));
    }
}
