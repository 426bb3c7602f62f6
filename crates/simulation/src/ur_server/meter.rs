//! How regularly fresh commands reach the robot while the servo program follows them.

use crate::controller::{Controller, Inputs};
use std::time::{Duration, Instant};
use tdv_ur_protocol::servo::{self, Command, ProgramState};

/// Width of a bin of the histogram, and how many there are; longer intervals go into the last one.
/// Beyond the program's watchdog of 100 ms there is no motion to be commanded.
const BIN: Duration = Duration::from_micros(100);
const BINS: usize = 2000;

/// What was measured so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandFigures {
    /// Intervals between fresh commands.
    pub intervals: u64,
    /// Their median, ms.
    pub p50_ms: f64,
    /// Their 99th percentile, ms.
    pub p99_ms: f64,
    /// The longest, ms.
    pub max_ms: f64,
    /// Control cycles of the robot in which motion was commanded.
    pub ticks: u64,
    /// Those without a fresh command.
    pub missed: u64,
    /// Most of these in a row.
    pub missed_run: u64,
}

/// Measures: the interval of packages on the wall clock as they come out of the socket, missed cycles on
/// the robot's own count.
#[derive(Debug)]
pub(super) struct CommandMeter {
    bins: Vec<u32>,
    intervals: u64,
    longest: Duration,
    /// Heartbeat and time of the last fresh package of the present motion.
    beat: Option<i32>,
    last: Option<Instant>,
    /// Heartbeat at the last cycle.
    seen: Option<i32>,
    ticks: u64,
    missed: u64,
    run: u64,
    missed_run: u64,
}

impl Default for CommandMeter {
    fn default() -> Self {
        Self {
            bins: vec![0; BINS],
            intervals: 0,
            longest: Duration::ZERO,
            beat: None,
            last: None,
            seen: None,
            ticks: 0,
            missed: 0,
            run: 0,
            missed_run: 0,
        }
    }
}

/// The value of the integer register that `name` ends with the number of.
fn int(registers: &[i32], name: &str) -> i32 {
    let index = name.rsplit('_').next().and_then(|n| n.parse::<usize>().ok());
    index.and_then(|i| registers.get(i).copied()).unwrap_or(0)
}

fn commands_motion(inputs: &Inputs) -> bool {
    int(&inputs.registers.ints, servo::COMMAND) == Command::Servo as i32
}

impl CommandMeter {
    /// A package has come; `inputs` has what it wrote.
    pub(super) fn arrived(&mut self, inputs: &Inputs, at: Instant) {
        let beat = int(&inputs.registers.ints, servo::HEARTBEAT);
        if self.beat.replace(beat) == Some(beat) {
            return;
        }
        if !commands_motion(inputs) {
            self.last = None;
        } else if let Some(last) = self.last.replace(at) {
            let interval = at.saturating_duration_since(last);
            let bin = (interval.as_nanos() / BIN.as_nanos()) as usize;
            self.bins[bin.min(BINS - 1)] += 1;
            self.intervals += 1;
            self.longest = self.longest.max(interval);
        }
    }

    /// A control cycle begins.
    pub(super) fn tick(&mut self, c: &Controller) {
        let beat = int(&c.inputs().registers.ints, servo::HEARTBEAT);
        let fresh = self.seen.replace(beat) != Some(beat);
        let state = int(&c.outputs().ints, servo::PROGRAM_STATE);
        let follows = state == ProgramState::Servoing as i32 && c.program_running();
        if !follows || !commands_motion(c.inputs()) {
            // What comes next begins a motion: the pause before it is no interval.
            self.last = None;
            self.run = 0;
            return;
        }
        self.ticks += 1;
        if fresh {
            self.run = 0;
        } else {
            self.missed += 1;
            self.run += 1;
            self.missed_run = self.missed_run.max(self.run);
        }
    }

    /// The figures; none before the first interval.
    pub(super) fn figures(&self) -> Option<CommandFigures> {
        let at = |share: f64| {
            let rank = (share * self.intervals as f64).ceil() as u64;
            let mut sum = 0;
            let bin = self.bins.iter().position(|n| {
                sum += u64::from(*n);
                sum >= rank
            });
            // The middle of the bin.
            1e3 * BIN.as_secs_f64() * (bin.unwrap_or(BINS - 1) as f64 + 0.5)
        };
        (self.intervals > 0).then(|| CommandFigures {
            intervals: self.intervals,
            p50_ms: at(0.5),
            p99_ms: at(0.99),
            max_ms: 1e3 * self.longest.as_secs_f64(),
            ticks: self.ticks,
            missed: self.missed,
            missed_run: self.missed_run,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Generation;

    fn write(inputs: &mut Inputs, command: Command, beat: i32) {
        inputs.write_int(24, command as i32);
        inputs.write_int(25, beat);
    }

    #[test]
    fn intervals_count_within_a_motion_only() {
        let (mut meter, mut inputs, begin) =
            (CommandMeter::default(), Inputs::default(), Instant::now());
        let mut send = |ms: u64, command, beat| {
            write(&mut inputs, command, beat);
            meter.arrived(&inputs, begin + Duration::from_millis(ms));
        };
        send(0, Command::Idle, 1);
        send(8, Command::Servo, 2);
        for k in 0..98 {
            send(16 + 8 * k, Command::Servo, 3 + k as i32);
        }
        // The same heartbeat again is nothing fresh; then one comes late, then the motion pauses.
        send(793, Command::Servo, 100);
        send(822, Command::Servo, 101);
        send(830, Command::Idle, 102);
        send(3000, Command::Servo, 103);
        send(3008, Command::Servo, 104);
        let f = meter.figures().unwrap();
        assert_eq!(f.intervals, 100);
        assert!((f.p50_ms - 8.05).abs() < 1e-9 && (f.p99_ms - 8.05).abs() < 1e-9, "{f:?}");
        assert!((f.max_ms - 30.0).abs() < 1e-9, "{f:?}");
    }

    #[test]
    fn cycles_without_a_fresh_heartbeat_are_missed_while_the_program_follows() {
        let mut c = Controller::new(Generation::Cb3, [0.0; 6]);
        let text = "def p():\n  write_output_integer_register(24, 2)\n  while True:\n    sync()\n  end\nend\n";
        c.run_script(text).unwrap();
        let mut meter = CommandMeter::default();
        let mut cycle = |command, beat: i32| {
            write(c.inputs_mut(), command, beat);
            for _ in 0..4 {
                c.step(0.002);
            }
            meter.tick(&c);
        };
        for (command, beat) in [(Command::Idle, 1), (Command::Servo, 2), (Command::Servo, 3)] {
            cycle(command, beat);
        }
        for beat in [3, 3, 4, 4, 5] {
            cycle(Command::Servo, beat);
        }
        cycle(Command::Idle, 5);
        assert_eq!((meter.ticks, meter.missed, meter.missed_run), (7, 3, 2));
    }
}
