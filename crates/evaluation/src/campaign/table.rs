use super::{CaseResult, FaultKind};
use crate::percentile;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// All cases of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KindSummary {
    /// The kind.
    pub kind: FaultKind,
    /// How many cases.
    pub cases: usize,
    /// Cases without a broken limit, a collision with the table, or a late rest.
    pub safe: usize,
    /// Cases whose task was finished afterwards.
    pub recovered: usize,
    /// Cases whose object ended where it belongs.
    pub placed: usize,
    /// Milliseconds to rest, median and greatest, of the cases that demand it.
    pub rest_ms: Option<[f64; 2]>,
}

/// A whole campaign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CampaignReport {
    /// By kind.
    pub kinds: Vec<KindSummary>,
    /// All cases.
    pub cases: Vec<CaseResult>,
}

impl CampaignReport {
    /// Sums up.
    pub fn new(cases: Vec<CaseResult>) -> Self {
        let live_only = FaultKind::LIVE.into_iter().filter(|k| !FaultKind::ALL.contains(k));
        let kinds = FaultKind::ALL
            .into_iter()
            .chain(live_only)
            .filter_map(|kind| {
                let of: Vec<&CaseResult> = cases.iter().filter(|c| c.kind == kind).collect();
                let count = |f: &dyn Fn(&CaseResult) -> bool| of.iter().filter(|c| f(c)).count();
                let rests: Vec<f64> = of
                    .iter()
                    .filter(|c| c.rest_due.is_some())
                    .filter_map(|c| c.rest_s.map(|s| 1e3 * s))
                    .collect();
                (!of.is_empty()).then(|| KindSummary {
                    kind,
                    cases: of.len(),
                    safe: count(&CaseResult::safe),
                    recovered: count(&|c| c.recovered),
                    placed: count(&|c| c.placed),
                    rest_ms: percentile(&rests, 0.5).zip(percentile(&rests, 1.0)).map(Into::into),
                })
            })
            .collect();
        Self { kinds, cases }
    }

    /// True when no case broke anything.
    pub fn safe(&self) -> bool {
        self.cases.iter().all(CaseResult::safe)
    }

    /// A table for the terminal, then every case that was not safe or did not recover.
    pub fn table(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(
            out,
            "  {:18} {:>5} {:>5} {:>9} {:>6}   rest p50 / max",
            "trouble", "cases", "safe", "recovered", "placed"
        );
        for k in &self.kinds {
            let name = serde_json::to_string(&k.kind).unwrap_or_default().replace('"', "");
            let rest = k
                .rest_ms
                .map_or_else(|| "-".into(), |[p50, max]| format!("{p50:.0} / {max:.0} ms"));
            let _ = writeln!(
                out,
                "  {name:18} {:5} {:5} {:9} {:6}   {rest}",
                k.cases, k.safe, k.recovered, k.placed
            );
        }
        let sum = |f: &dyn Fn(&KindSummary) -> usize| self.kinds.iter().map(f).sum::<usize>();
        let _ = writeln!(
            out,
            "  {:18} {:5} {:5} {:9} {:6}",
            "all",
            sum(&|k| k.cases),
            sum(&|k| k.safe),
            sum(&|k| k.recovered),
            sum(&|k| k.placed)
        );
        for c in self.cases.iter().filter(|c| !c.safe() || !c.recovered) {
            let rest = c.rest_s.map_or("no rest".into(), |s| format!("rest {:.0} ms", 1e3 * s));
            let _ = writeln!(
                out,
                "  seed {}: {:?}{} for {:.2} s at {:.2} rad/s, {rest}; {} {}; told: {}",
                c.seed,
                c.kind,
                if c.carrying == Some(true) { " while carrying" } else { "" },
                c.lasted,
                c.speed,
                if c.recovered { "recovered" } else { "NOT recovered" },
                c.violations.join(", "),
                c.sentence
            );
        }
        out
    }
}
