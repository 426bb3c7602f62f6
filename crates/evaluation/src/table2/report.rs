//! From trials to cells.

use super::run::POINTS;
use super::{Arm, Level, PolicyKind, TrialRecord};
use crate::{percentile, wilson_interval};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The 13 fixed points of a cell.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Points13 {
    /// Successes over all points and seeds.
    pub successes: usize,
    /// Trials over all points and seeds.
    pub trials: usize,
    /// Their ratio.
    pub rate: f64,
    /// Wilson interval at 95 %.
    pub ci95: [f64; 2],
    /// Successes and trials of each point.
    pub each: Vec<[usize; 2]>,
}

/// One cell over all its seeds. `successes` to `ci95` are of the drawn starts; the fixed points have
/// their own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellResult {
    /// Task.
    pub task: String,
    /// Demonstrations.
    pub demos: usize,
    /// Level.
    pub level: Level,
    /// Who drove.
    pub policy: PolicyKind,
    /// An object was pushed in mid-run.
    pub disturbed: bool,
    /// Arm of the ablation study.
    pub arm: String,
    /// `truth` or `perceived`.
    pub poses: String,
    /// Successes from drawn starts.
    pub successes: usize,
    /// Drawn starts.
    pub trials: usize,
    /// Their ratio.
    pub rate: f64,
    /// Wilson interval at 95 %.
    pub ci95: [f64; 2],
    /// The fixed points.
    pub points13: Points13,
    /// Seeds of training.
    pub seeds: Vec<u64>,
    /// Why trials failed, counted over all starts.
    pub causes: BTreeMap<String, usize>,
    /// Medians over the successes: distance from the target (mm), yaw error (deg), duration (s).
    pub median: [Option<f64>; 3],
    /// Median time of a plan on this machine, ms.
    pub plan_ms: Option<f64>,
    /// Median time of a trial on this machine, s.
    pub wall_s: Option<f64>,
}

/// A whole table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Table2Report {
    /// The cells, in order.
    pub cells: Vec<CellResult>,
    /// The trials they are made of.
    pub trials: Vec<TrialRecord>,
}

type CellKey = (String, String, PolicyKind, bool, Level, usize, String);

fn cell_key(r: &TrialRecord) -> CellKey {
    // Arms in the order of the study.
    let arm = Arm::all().iter().position(|a| a.name == r.arm).unwrap_or(usize::MAX);
    let arm = format!("{arm:03}{}", r.arm);
    (r.task.clone(), arm, r.policy, r.disturbed, r.level, r.demos, r.poses.clone())
}

impl Table2Report {
    /// Sums up. Of two records of the same trial the later one counts.
    pub fn new(records: impl IntoIterator<Item = TrialRecord>) -> Self {
        let mut trials: BTreeMap<(CellKey, u64, usize), TrialRecord> = BTreeMap::new();
        for r in records {
            trials.insert((cell_key(&r), r.seed, r.trial), r);
        }
        let trials: Vec<TrialRecord> = trials.into_values().collect();
        let cells = trials
            .chunk_by(|a, b| cell_key(a) == cell_key(b))
            .filter_map(|of| of.first().map(|first| cell(first, of)))
            .collect();
        Self { cells, trials }
    }
}

fn cell(first: &TrialRecord, of: &[TrialRecord]) -> CellResult {
    let (points, drawn): (Vec<&TrialRecord>, Vec<&TrialRecord>) =
        of.iter().partition(|r| r.start.point.is_some());
    let count = |v: &[&TrialRecord]| (v.iter().filter(|r| r.success).count(), v.len());
    let rate = |(s, n): (usize, usize)| if n == 0 { 0.0 } else { s as f64 / n as f64 };
    let mut each = vec![[0, 0]; POINTS];
    for r in &points {
        if let Some(e) = r.start.point.and_then(|p| each.get_mut(p)) {
            *e = [e[0] + usize::from(r.success), e[1] + 1];
        }
    }
    let mut causes = BTreeMap::new();
    for cause in of.iter().filter_map(|r| r.cause) {
        *causes.entry(cause.words().to_owned()).or_insert(0) += 1;
    }
    let median = |f: &dyn Fn(&TrialRecord) -> Option<f64>, all: bool| {
        let some = of.iter().filter(|r| all || r.success).filter_map(f);
        percentile(&some.collect::<Vec<_>>(), 0.5)
    };
    let mut seeds: Vec<u64> = of.iter().map(|r| r.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let ((successes, trials), at_points) = (count(&drawn), count(&points));
    CellResult {
        task: first.task.clone(),
        demos: first.demos,
        level: first.level,
        policy: first.policy,
        disturbed: first.disturbed,
        arm: first.arm.clone(),
        poses: first.poses.clone(),
        successes,
        trials,
        rate: rate((successes, trials)),
        ci95: wilson_interval(successes, trials),
        points13: Points13 {
            successes: at_points.0,
            trials: at_points.1,
            rate: rate(at_points),
            ci95: wilson_interval(at_points.0, at_points.1),
            each,
        },
        seeds,
        causes,
        median: [
            median(&|r| r.error_mm, false),
            median(&|r| r.error_deg, false),
            median(&|r| Some(r.duration_s), false),
        ],
        plan_ms: median(&|r| Some(r.plan_ms), true),
        wall_s: median(&|r| Some(r.wall_s), true),
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    #[test]
    fn points_and_drawn_starts_are_counted_apart() {
        let mut records: Vec<TrialRecord> = (0..33).map(|i| record(i, i % 4 != 0)).collect();
        // A later record of the same trial replaces the earlier one.
        records.push(record(16, true));
        let other = TrialRecord { level: Level::PoG, ..record(40, false) };
        records.push(other);
        let report = Table2Report::new(records);
        assert_eq!(report.trials.len(), 34);
        let [pg, pog] = &report.cells[..] else { panic!("{:?}", report.cells) };
        assert_eq!((pg.level, pog.level), (Level::PG, Level::PoG));
        assert_eq!((pg.trials, pg.successes), (20, 16));
        assert_eq!((pg.points13.trials, pg.points13.successes), (13, 9));
        assert_eq!(pg.points13.each[4], [0, 1]);
        assert_eq!(pg.causes["let go off the target"], 8);
        assert!(pg.ci95[0] < 0.8 && pg.ci95[1] > 0.8);
        assert_eq!((pog.trials, pog.successes, pog.rate), (1, 0, 0.0));
        let json = serde_json::to_value(&report).unwrap();
        for field in
            ["task", "demos", "level", "policy", "disturbed", "successes", "trials", "rate"]
        {
            assert!(json["cells"][0].get(field).is_some(), "{field}");
        }
        assert_eq!(json["cells"][1]["level"], "PoG");
        assert!(json["cells"][0]["points13"].get("each").is_some());
    }
}
