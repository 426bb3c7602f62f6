use crate::{StreamFigures, percentile, wilson_interval};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// CPU time (ms) that a machine's host may take within a second before the loop can go stale: as much as
/// the oldest image that it acts on is old.
pub const STOLEN_MS: f64 = 150.0;

/// A node that was killed while the arm moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// The node.
    pub node: String,
    /// Fastest joint when it was killed, rad/s.
    pub speed: f64,
    /// Milliseconds from the kill until the arm was at rest; `None` when it did not come to rest.
    pub rest_ms: Option<f64>,
    /// What the operator was told meanwhile.
    pub sentence: String,
}

/// One trial of the closed loop, judged on the lab's truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Seed of the lab.
    pub seed: u64,
    /// Whether the success definition held.
    pub success: bool,
    /// Start of the moving object in base_link: x, y, z (m), yaw (rad).
    pub start: [f64; 4],
    /// Distance from the target in the plane, millimetres; `None` when the trial had no verdict.
    pub error_mm: Option<f64>,
    /// Yaw error, degrees (0 for a symmetric object).
    pub error_deg: Option<f64>,
    /// Seconds until the verdict.
    pub duration_s: f64,
    /// The lab's real-time factor over the trial.
    pub real_time_factor: f64,
    /// The most CPU time (ms) that the host of a virtual machine took within one second of the trial.
    #[serde(default)]
    pub stolen_ms: f64,
    /// Why it ended as it did.
    pub reason: String,
    /// What was done to it, if anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
}

/// Median and 99th percentile, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LatencyFigures {
    /// Median.
    pub p50_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
}

/// Summary over all trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClosedLoopSummary {
    /// Task name.
    pub task: String,
    /// What was changed against the plain loop: `none`, `displace`, `freeze`, ...
    pub condition: String,
    /// Trials run.
    pub trials: usize,
    /// Successes among them.
    pub successes: usize,
    /// Share of successes.
    pub rate: f64,
    /// Wilson interval of the rate at 95 %.
    pub ci95: [f64; 2],
    /// Lowest real-time factor of the lab over the trials.
    pub real_time_factor: f64,
    /// Trials in which the machine's host took CPU time enough to make the loop stale ([`STOLEN_MS`]).
    #[serde(default)]
    pub stolen_trials: usize,
    /// Failures among them.
    #[serde(default)]
    pub stolen_failures: usize,
    /// Median distance from the target, millimetres, over trials with a verdict.
    pub median_error_mm: Option<f64>,
    /// Median yaw error, degrees.
    pub median_error_deg: Option<f64>,
    /// Median duration of the successes, seconds.
    pub median_duration_s: Option<f64>,
    /// Latency by stage: `image_to_pose`, `pose_to_plan`, `plan_to_command`.
    pub latency: BTreeMap<String, LatencyFigures>,
    /// CPU seconds per wall second, by node.
    pub cpu: BTreeMap<String, f64>,
    /// Smoothness of the motion.
    #[serde(default)]
    pub stream: StreamFigures,
}

/// The file that `tdv eval closed-loop --json` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClosedLoopReport {
    /// Figures over all trials.
    pub summary: ClosedLoopSummary,
    /// The trials.
    pub trials: Vec<Trial>,
}

impl ClosedLoopReport {
    /// Sums up trials; latencies in milliseconds by stage, CPU shares by node.
    pub fn new(
        task: &str,
        condition: &str,
        trials: Vec<Trial>,
        latency_ms: &BTreeMap<String, Vec<f64>>,
        cpu: BTreeMap<String, f64>,
        stream: StreamFigures,
    ) -> Self {
        let successes = trials.iter().filter(|t| t.success).count();
        let collect = |f: &dyn Fn(&Trial) -> Option<f64>| -> Option<f64> {
            percentile(&trials.iter().filter_map(f).collect::<Vec<_>>(), 0.5)
        };
        let stolen = trials.iter().filter(|t| t.stolen_ms > STOLEN_MS);
        let summary = ClosedLoopSummary {
            task: task.into(),
            condition: condition.into(),
            trials: trials.len(),
            successes,
            rate: if trials.is_empty() { 0.0 } else { successes as f64 / trials.len() as f64 },
            ci95: wilson_interval(successes, trials.len()),
            real_time_factor: trials.iter().map(|t| t.real_time_factor).fold(f64::NAN, f64::min),
            stolen_trials: stolen.clone().count(),
            stolen_failures: stolen.filter(|t| !t.success).count(),
            median_error_mm: collect(&|t| t.error_mm),
            median_error_deg: collect(&|t| t.error_deg),
            median_duration_s: collect(&|t| t.success.then_some(t.duration_s)),
            latency: latency_ms
                .iter()
                .filter_map(|(name, v)| {
                    let f = LatencyFigures {
                        p50_ms: percentile(v, 0.5)?,
                        p99_ms: percentile(v, 0.99)?,
                    };
                    Some((name.clone(), f))
                })
                .collect(),
            cpu,
            stream,
        };
        Self { summary, trials }
    }

    /// A table for the terminal.
    pub fn table(&self) -> String {
        let mut out = String::new();
        let s = &self.summary;
        let _ = writeln!(out, "  seed  start x      y    yaw   error mm  deg   time s  result");
        for t in &self.trials {
            let number = |v: Option<f64>| v.map_or_else(|| "     -".into(), |v| format!("{v:6.1}"));
            let _ = writeln!(
                out,
                "{:6}  {:7.3} {:6.3} {:6.1}   {}   {} {:7.1}  {}",
                t.seed,
                t.start[0],
                t.start[1],
                t.start[3].to_degrees(),
                number(t.error_mm),
                number(t.error_deg),
                t.duration_s,
                t.reason
            );
        }
        let _ = writeln!(
            out,
            "{} ({}): {}/{} = {:.0} % [95 %: {:.0} to {:.0}], real-time factor {:.3}",
            s.task,
            s.condition,
            s.successes,
            s.trials,
            100.0 * s.rate,
            100.0 * s.ci95[0],
            100.0 * s.ci95[1],
            s.real_time_factor
        );
        if s.stolen_trials > 0 {
            let _ = writeln!(
                out,
                "  in {} trials ({} of them failed) the machine's host took more than {STOLEN_MS:.0} ms \
                 of CPU time within a second",
                s.stolen_trials, s.stolen_failures
            );
        }
        let mut sum = 0.0;
        for (stage, l) in &s.latency {
            sum += l.p99_ms;
            let _ = writeln!(out, "  {stage:18} p50 {:6.1} ms  p99 {:6.1} ms", l.p50_ms, l.p99_ms);
        }
        if !s.latency.is_empty() {
            let _ = writeln!(out, "  sum of p99         {sum:.1} ms");
        }
        for (node, share) in &s.cpu {
            let _ = writeln!(out, "  {node:18} {:5.1} % of a core", 100.0 * share);
        }
        let m = &s.stream;
        let _ = writeln!(
            out,
            "  {:.1} s of motion: velocity step at most {:.3} rad/s in 8 ms, jerk at most {:.0} rad/s^3 \
             (p99.9 {:.0})",
            m.moving_s, m.velocity_step, m.jerk_max, m.jerk_p999
        );
        let [p50, p99, most] = m.path_mm;
        let _ = writeln!(
            out,
            "  executed to predicted tool path: p50 {p50:.1} mm  p99 {p99:.1} mm  max {most:.1} mm"
        );
        for (name, value) in &m.measured {
            let _ = writeln!(out, "  {name:34} {value:.2}");
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(success: bool, error: Option<f64>) -> Trial {
        Trial {
            seed: 1,
            success,
            start: [0.4, 0.1, 0.0, 1.0],
            error_mm: error,
            error_deg: error,
            duration_s: 20.0,
            real_time_factor: 0.99,
            stolen_ms: if success { 0.0 } else { 2.0 * STOLEN_MS },
            reason: "placed".into(),
            fault: None,
        }
    }

    #[test]
    fn summary_counts_and_json_has_the_agreed_fields() {
        let latency = BTreeMap::from([("image_to_pose".to_owned(), vec![10.0, 20.0])]);
        let trials = vec![trial(true, Some(2.0)), trial(false, None), trial(true, Some(4.0))];
        let r = ClosedLoopReport::new(
            "cup",
            "none",
            trials,
            &latency,
            BTreeMap::new(),
            StreamFigures::default(),
        );
        assert_eq!((r.summary.trials, r.summary.successes), (3, 2));
        assert_eq!(r.summary.median_error_mm, Some(3.0));
        let json: serde_json::Value = serde_json::to_value(&r).unwrap();
        for field in ["trials", "successes", "real_time_factor"] {
            assert!(json["summary"].get(field).is_some(), "{field}");
        }
        for field in ["success", "start", "error_mm", "error_deg", "duration_s", "reason"] {
            assert!(json["trials"][0].get(field).is_some(), "{field}");
        }
        assert!(r.table().contains("2/3"));
        assert_eq!((r.summary.stolen_trials, r.summary.stolen_failures), (1, 1));
        assert!(r.table().contains("in 1 trials (1 of them failed) the machine's host"));
    }
}
