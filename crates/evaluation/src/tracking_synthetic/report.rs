//! The figures of a run, object by object, as data and as a table.

use super::judge::{Figures, SequenceResult};
use super::scene::Kind;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// What is asked of the tracker.
pub const WANTED_CONFIDENT_PERCENT: f64 = 90.0;
/// See [`WANTED_CONFIDENT_PERCENT`].
pub const WANTED_WRONG_PERCENT: f64 = 0.1;
/// See [`WANTED_CONFIDENT_PERCENT`].
pub const WANTED_AUC_UNOCCLUDED: f64 = 96.0;
/// See [`WANTED_CONFIDENT_PERCENT`].
pub const WANTED_AUC_OCCLUDED: f64 = 90.0;

/// Figures of one group of sequences.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// An object, or what happens in the sequences.
    pub name: String,
    /// Figures.
    pub figures: Figures,
}

/// A whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SyntheticReport {
    /// Over everything.
    pub all: Figures,
    /// Object by object.
    pub objects: Vec<Group>,
    /// By what happens: free, crossing, hand, gripper.
    pub kinds: Vec<Group>,
    /// Frame by frame.
    pub sequences: Vec<SequenceResult>,
}

impl SyntheticReport {
    /// Sums up.
    pub fn new(sequences: Vec<SequenceResult>) -> Self {
        let mut names: Vec<&str> = Vec::new();
        for s in &sequences {
            if !names.contains(&s.object.as_str()) {
                names.push(&s.object);
            }
        }
        let objects = names
            .iter()
            .map(|name| Group {
                name: (*name).to_owned(),
                figures: Figures::of(sequences.iter().filter(|s| s.object == *name)),
            })
            .collect();
        let kinds = [Kind::Free, Kind::Crossing, Kind::Hand, Kind::Gripper]
            .into_iter()
            .filter(|k| sequences.iter().any(|s| s.kind == *k))
            .map(|kind| Group {
                name: format!("{kind:?}").to_lowercase(),
                figures: Figures::of(sequences.iter().filter(|s| s.kind == kind)),
            })
            .collect();
        Self { all: Figures::of(&sequences), objects, kinds, sequences }
    }

    /// Whether all four targets are met.
    pub fn met(&self) -> bool {
        let f = &self.all;
        f.confident_percent >= WANTED_CONFIDENT_PERCENT
            && f.wrong_confident_percent < WANTED_WRONG_PERCENT
            && f.auc_unoccluded.is_some_and(|v| v >= WANTED_AUC_UNOCCLUDED)
            && f.auc_occluded.is_none_or(|v| v >= WANTED_AUC_OCCLUDED)
    }

    /// The table for people.
    pub fn table(&self) -> String {
        let mut out = String::from(
            "                 frames  confident   AUC free  AUC occl.  wrong, sure   losses  recovered   \
             mm   deg   ms\n",
        );
        let all = Group { name: "all".into(), figures: self.all };
        for g in self.objects.iter().chain(&self.kinds).chain([&all]) {
            let f = &g.figures;
            let n = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.1}"));
            // Writing into a String cannot fail.
            let _ = writeln!(
                out,
                "{:16}{:7}{:9.1} %{:11}{:11}{:10.2} %{:9}{:11}{:>7}{:>6}{:>5}",
                g.name,
                f.frames,
                f.confident_percent,
                n(f.auc_unoccluded),
                n(f.auc_occluded),
                f.wrong_confident_percent,
                f.losses,
                f.recoveries,
                n(f.median_translation_mm),
                n(f.median_rotation_deg),
                n(f.ms_per_frame)
            );
        }
        let _ = writeln!(
            out,
            "wanted: confident >= {WANTED_CONFIDENT_PERCENT} % of unoccluded frames, wrong while sure < \
             {WANTED_WRONG_PERCENT} %, AUC >= {WANTED_AUC_UNOCCLUDED} unoccluded, >= \
             {WANTED_AUC_OCCLUDED} occluded: {}",
            if self.met() { "met" } else { "NOT met" }
        );
        out
    }
}
