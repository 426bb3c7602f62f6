//! What the machine's host takes from it.

use std::fs;
use std::time::{Duration, Instant};

/// The kernel counts in hundredths of a second (`USER_HZ`).
const TICK_MS: f64 = 10.0;
const WINDOW: Duration = Duration::from_secs(1);

/// Time between two looks at the kernel's count.
const LOOK: Duration = Duration::from_millis(100);

/// The CPU time that the host of a virtual machine gave to others while this one wanted it: the `steal`
/// of `/proc/stat` (proc(5)), of all cores together. Nothing that runs on the machine itself can raise
/// it, so it tells a slow program from a machine that stood still.
#[derive(Debug, Clone)]
pub struct StolenTime {
    window: Window,
    looked: Instant,
}

impl StolenTime {
    /// Counts from now on.
    pub fn start() -> Self {
        let now = Instant::now();
        Self { window: Window { since: now, ticks: stolen_ticks(), worst: 0 }, looked: now }
    }

    /// To be called a few times a second, or as often as one likes.
    pub fn look(&mut self) {
        let now = Instant::now();
        if now.duration_since(self.looked) >= LOOK {
            self.looked = now;
            self.window.count(stolen_ticks(), now);
        }
    }

    /// The most that went within a second, milliseconds of CPU time; 0 on a machine of its own.
    pub fn worst_ms(&self) -> f64 {
        TICK_MS * self.window.worst as f64
    }
}

/// The most ticks within one of the seconds that follow each other.
#[derive(Debug, Clone)]
struct Window {
    since: Instant,
    /// The count when the window began.
    ticks: u64,
    worst: u64,
}

impl Window {
    fn count(&mut self, ticks: u64, now: Instant) {
        self.worst = self.worst.max(ticks.saturating_sub(self.ticks));
        if now.duration_since(self.since) >= WINDOW {
            (self.since, self.ticks) = (now, ticks);
        }
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
    fn the_worst_second_counts() {
        let start = Instant::now();
        let mut window = Window { since: start, ticks: 100, worst: 0 };
        // 3 ticks in the first second, 12 in the second one, 5 in the third.
        for (ms, ticks) in [(500, 102), (1000, 103), (1600, 110), (2000, 115), (2500, 120)] {
            window.count(ticks, start + Duration::from_millis(ms));
        }
        assert_eq!(window.worst, 12);
    }
}
