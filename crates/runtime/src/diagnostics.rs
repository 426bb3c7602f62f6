//! What a node says about itself once a second on `/diagnostics`.

use std::collections::{BTreeMap, VecDeque};
use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;
use tdv_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};

/// How the node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Level {
    /// Working.
    #[default]
    Ok,
    /// Working, but someone should look.
    Warn,
    /// Not working.
    Error,
    /// Input is missing or old.
    Stale,
}

impl Level {
    fn to_ros(self) -> u8 {
        match self {
            Level::Ok => DiagnosticStatus::OK,
            Level::Warn => DiagnosticStatus::WARN,
            Level::Error => DiagnosticStatus::ERROR,
            Level::Stale => DiagnosticStatus::STALE,
        }
    }
}

/// Counters of one publisher or subscription.
#[derive(Debug)]
pub(crate) struct TopicCounters {
    pub name: String,
    pub incoming: bool,
    pub messages: AtomicU64,
    pub dropped: AtomicU64,
    pub undecodable: AtomicU64,
}

impl TopicCounters {
    pub fn new(name: &str, incoming: bool) -> Arc<Self> {
        Arc::new(Self {
            name: name.into(),
            incoming,
            messages: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            undecodable: AtomicU64::new(0),
        })
    }
}

/// Collects what goes out on `/diagnostics`. Cloning is cheap; any thread may write.
#[derive(Clone, Debug, Default)]
pub struct Diagnostics {
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    level: Level,
    sentence: String,
    values: BTreeMap<String, String>,
    latencies: BTreeMap<String, LatencyWindow>,
    topics: Vec<(Arc<TopicCounters>, u64)>,
    cpu: Option<(Instant, f64)>,
}

/// Samples kept for the percentiles: 10 s at 30 Hz.
const WINDOW: usize = 300;

impl Diagnostics {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Sets the state and its sentence for the operator.
    pub fn level(&self, level: Level, sentence: impl Into<String>) {
        let mut state = self.lock();
        state.level = level;
        state.sentence = sentence.into();
    }

    /// Sets a value.
    pub fn set(&self, key: &str, value: impl Display) {
        self.lock().values.insert(key.into(), value.to_string());
    }

    /// Adds a latency sample in seconds; p50, p99 and the maximum over the last 300 samples are
    /// published in milliseconds as `key_p50_ms` and so on.
    pub fn latency(&self, key: &str, seconds: f64) {
        let mut state = self.lock();
        let window =
            state.latencies.entry(key.into()).or_insert_with(|| LatencyWindow::new(WINDOW));
        window.add(seconds);
    }

    pub(crate) fn add_topic(&self, counters: Arc<TopicCounters>) {
        self.lock().topics.push((counters, 0));
    }

    /// One status message; called once a second.
    pub(crate) fn status(&self, node: &str) -> DiagnosticStatus {
        let mut guard = self.lock();
        let state = &mut *guard;
        let mut values = state.values.clone();
        for (key, window) in &state.latencies {
            let ms = |seconds: f64| format!("{:.2}", seconds * 1e3);
            if let Some(summary) = window.summary() {
                values.insert(format!("{key}_p50_ms"), ms(summary.p50));
                values.insert(format!("{key}_p99_ms"), ms(summary.p99));
                values.insert(format!("{key}_max_ms"), ms(summary.max));
            }
        }
        let (cpu_seconds, memory) = process_usage();
        let now = Instant::now();
        if let Some((then, before)) = state.cpu {
            let elapsed = now.duration_since(then).as_secs_f64();
            if elapsed > 0.0 {
                let percent = 100.0 * (cpu_seconds - before) / elapsed;
                values.insert("cpu_percent".into(), format!("{percent:.1}"));
            }
            for (topic, last) in &mut state.topics {
                let count = topic.messages.load(Ordering::Relaxed);
                let rate = count.saturating_sub(*last) as f64 / elapsed.max(1e-9);
                *last = count;
                let direction = if topic.incoming { "in" } else { "out" };
                values.insert(format!("{direction}{}_hz", topic.name), format!("{rate:.1}"));
                for (what, counter) in
                    [("dropped", &topic.dropped), ("undecodable", &topic.undecodable)]
                {
                    let n = counter.load(Ordering::Relaxed);
                    if n > 0 {
                        values.insert(format!("{direction}{}_{what}", topic.name), n.to_string());
                    }
                }
            }
        }
        state.cpu = Some((now, cpu_seconds));
        values.insert("cpu_seconds".into(), format!("{cpu_seconds:.2}"));
        values.insert("memory_mb".into(), format!("{:.1}", memory as f64 / 1e6));
        DiagnosticStatus {
            level: state.level.to_ros(),
            name: node.trim_start_matches('/').into(),
            message: state.sentence.clone(),
            hardware_id: node.into(),
            values: values.into_iter().map(|(key, value)| KeyValue { key, value }).collect(),
        }
    }
}

/// (CPU seconds in user and system mode, resident bytes) of this process; zeros where `/proc` is
/// missing.
pub fn process_usage() -> (f64, u64) {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: u64 = statm.split_whitespace().nth(1).and_then(|p| p.parse().ok()).unwrap_or(0);
    // Linux reports to user space in ticks of 10 ms and, on the machines built for, pages of 4 KiB.
    (cpu_ticks(&stat).unwrap_or(0) as f64 / 100.0, pages * 4096)
}

/// utime + stime out of `/proc/<pid>/stat`. The program name may contain spaces and brackets.
fn cpu_ticks(stat: &str) -> Option<u64> {
    let after_name = &stat[stat.rfind(')')? + 1..];
    let mut fields = after_name.split_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(user + system)
}

/// Percentiles over the last samples.
#[derive(Clone, Debug)]
pub struct LatencyWindow {
    samples: VecDeque<f64>,
    capacity: usize,
}

/// Percentiles in the unit of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencySummary {
    /// Median.
    pub p50: f64,
    /// 99 of 100 samples are at most this.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Samples in the window.
    pub count: usize,
}

impl LatencyWindow {
    /// Keeps the last `capacity` samples (at least one).
    pub fn new(capacity: usize) -> Self {
        Self { samples: VecDeque::new(), capacity: capacity.max(1) }
    }

    /// Adds a sample; not-a-number is ignored.
    pub fn add(&mut self, sample: f64) {
        if sample.is_nan() {
            return;
        }
        if self.samples.len() == self.capacity {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
    }

    /// Percentiles by nearest rank; `None` without samples.
    pub fn summary(&self) -> Option<LatencySummary> {
        let mut sorted: Vec<f64> = self.samples.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let rank = |q: f64| {
            let index = (q * sorted.len() as f64).ceil() as usize;
            sorted.get(index.saturating_sub(1)).copied()
        };
        Some(LatencySummary {
            p50: rank(0.5)?,
            p99: rank(0.99)?,
            max: *sorted.last()?,
            count: sorted.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles() {
        let mut window = LatencyWindow::new(100);
        assert_eq!(window.summary(), None);
        for i in 0..=100 {
            window.add(f64::from(i));
        }
        window.add(f64::NAN);
        let s = window.summary().expect("samples");
        assert_eq!((s.p50, s.p99, s.max, s.count), (50.0, 99.0, 100.0, 100));
    }

    #[test]
    fn ticks_with_a_strange_program_name() {
        let stat = "12 (a) b (c)) S 1 2 3 4 5 6 7 8 9 10 70 30 0 0";
        assert_eq!(cpu_ticks(stat), Some(100));
        assert_eq!(cpu_ticks("nothing"), None);
        assert!(process_usage().1 > 0);
    }

    #[test]
    fn status_message() {
        let d = Diagnostics::default();
        d.level(Level::Warn, "slow");
        d.set("objects", 2);
        d.latency("pose", 0.0105);
        let counters = TopicCounters::new("/t", true);
        counters.dropped.store(3, Ordering::Relaxed);
        d.add_topic(counters);
        d.status("/ns/n");
        let status = d.status("/ns/n");
        assert_eq!((status.level, status.message.as_str()), (1, "slow"));
        assert_eq!((status.name.as_str(), status.hardware_id.as_str()), ("ns/n", "/ns/n"));
        let get = |key: &str| status.values.iter().find(|v| v.key == key).map(|v| v.value.as_str());
        assert_eq!(get("objects"), Some("2"));
        assert_eq!(get("pose_p99_ms"), Some("10.50"));
        assert_eq!(get("in/t_dropped"), Some("3"));
        assert!(get("cpu_percent").is_some() && get("in/t_hz").is_some());
    }
}
