//! What the machine's host takes from it.

use std::fs;
use std::time::{Duration, Instant};

/// The kernel counts in hundredths of a second (`USER_HZ`).
const TICK_MS: f64 = 10.0;
const WINDOW: Duration = Duration::from_secs(1);

/// The CPU time that the host of a virtual machine gave to others while this one wanted it: the `steal`
/// of `/proc/stat` (proc(5)), of all cores together. Nothing that runs on the machine itself can raise
/// it, so it tells a slow program from a machine that stood still.
#[derive(Debug, Clone)]
pub struct StolenTime {
    since: Instant,
    ticks: u64,
    worst: u64,
}

impl StolenTime {
    /// Counts from now on.
    pub fn start() -> Self {
        Self { since: Instant::now(), ticks: stolen_ticks(), worst: 0 }
    }

    /// To be called a few times a second.
    pub fn look(&mut self) {
        let ticks = stolen_ticks();
        self.worst = self.worst.max(ticks.saturating_sub(self.ticks));
        if self.since.elapsed() >= WINDOW {
            (self.since, self.ticks) = (Instant::now(), ticks);
        }
    }

    /// The most that went within a second, milliseconds of CPU time; 0 on a machine of its own.
    pub fn worst_ms(&self) -> f64 {
        TICK_MS * self.worst as f64
    }
}

fn stolen_ticks() -> u64 {
    fs::read_to_string("/proc/stat").ok().and_then(|text| ticks_of(&text)).unwrap_or(0)
}

/// The eighth number of the line `cpu`.
fn ticks_of(stat: &str) -> Option<u64> {
    let all = stat.lines().find(|line| line.starts_with("cpu "))?;
    all.split_whitespace().nth(8)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_eighth_number_of_all_cores_is_read() {
        let text = "cpu  10 20 30 40 50 60 70 80 90 100\ncpu0 1 2 3 4 5 6 7 8 9 10\n";
        assert_eq!(ticks_of(text), Some(80));
        assert_eq!(ticks_of("cpu0 1 2 3 4 5 6 7 8 9 10\n"), None);
        assert_eq!(ticks_of("cpu  1 2 3\n"), None);
    }

    #[test]
    fn the_worst_window_counts() {
        let mut stolen = StolenTime { since: Instant::now(), ticks: stolen_ticks(), worst: 0 };
        stolen.ticks -= 7.min(stolen.ticks);
        let wanted = 10.0 * 7.0_f64.min(stolen_ticks() as f64);
        stolen.look();
        let worst = stolen.worst_ms();
        assert!(worst >= wanted);
        stolen.look();
        assert!(stolen.worst_ms() >= worst);
    }
}
