//! The figures of a run as data and as a table.

use super::Answer;
use crate::percentile;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// What is asked of the text-to-mask stage: right answers, percent.
pub const WANTED_RIGHT_PERCENT: f64 = 95.0;
/// Mean overlap with what is there, a missing mask counting as none.
pub const WANTED_IOU: f64 = 0.85;
/// Milliseconds of processor time from the pictures to the mask, median.
pub const WANTED_MS: f64 = 15.0;

/// Figures of one group of answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Which.
    pub name: String,
    /// Sentences.
    pub asked: usize,
    /// Right answers.
    pub right: usize,
    /// Mean intersection over union where the object is there, a missing mask counting 0.
    pub mean_iou: Option<f64>,
}

impl Group {
    fn of<'a>(name: &str, answers: impl Iterator<Item = &'a Answer>) -> Self {
        let all: Vec<&Answer> = answers.collect();
        let ious: Vec<f64> = all.iter().filter_map(|a| a.iou).collect();
        Self {
            name: name.to_owned(),
            asked: all.len(),
            right: all.iter().filter(|a| a.right).count(),
            mean_iou: (!ious.is_empty()).then(|| ious.iter().sum::<f64>() / ious.len() as f64),
        }
    }

    /// Right answers, percent.
    pub fn right_percent(&self) -> f64 {
        100.0 * self.right as f64 / self.asked.max(1) as f64
    }
}

/// A whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TextMaskReport {
    /// Over everything.
    pub all: Group,
    /// By way of asking, then by whether the object is there.
    pub kinds: Vec<Group>,
    /// By the object meant.
    pub objects: Vec<Group>,
    /// Milliseconds of processor time from the pictures to the mask: median, 95th percentile, most.
    pub ms: [f64; 3],
    /// One by one.
    pub answers: Vec<Answer>,
}

impl TextMaskReport {
    /// Sums up.
    pub fn new(answers: Vec<Answer>) -> Self {
        let mut kinds: Vec<Group> = super::Asked::ALL
            .into_iter()
            .map(|kind| {
                let name = format!("by {kind:?}").to_lowercase();
                Group::of(&name, answers.iter().filter(|a| a.asked == kind))
            })
            .collect();
        kinds.push(Group::of("there", answers.iter().filter(|a| a.target.is_some())));
        kinds.push(Group::of("absent", answers.iter().filter(|a| a.target.is_none())));
        let mut names: Vec<&String> = answers.iter().filter_map(|a| a.target.as_ref()).collect();
        names.sort();
        names.dedup();
        let objects = names
            .into_iter()
            .map(|n| Group::of(n, answers.iter().filter(|a| a.target.as_ref() == Some(n))))
            .collect();
        let mut times: Vec<f64> = answers.iter().map(|a| a.ms).collect();
        times.sort_by(f64::total_cmp);
        let ms = [0.5, 0.95, 1.0].map(|q| percentile(&times, q).unwrap_or(f64::NAN));
        Self { all: Group::of("all", answers.iter()), kinds, objects, ms, answers }
    }

    /// Whether all that is wanted is reached.
    pub fn met(&self) -> bool {
        self.all.right_percent() >= WANTED_RIGHT_PERCENT
            && self.all.mean_iou.is_some_and(|v| v >= WANTED_IOU)
            && self.ms[0] < WANTED_MS
    }

    /// The table for people, and every wrong answer.
    pub fn table(&self) -> String {
        let mut out = String::from("                 asked   right            mean IoU\n");
        // Writing into a String cannot fail.
        for g in self.objects.iter().chain(&self.kinds).chain([&self.all]) {
            let iou = g.mean_iou.map_or("-".to_owned(), |v| format!("{v:.3}"));
            let _ = writeln!(
                out,
                "{:16}{:6}{:8}  {:5.1} %{iou:>12}",
                g.name,
                g.asked,
                g.right,
                g.right_percent()
            );
        }
        for a in self.answers.iter().filter(|a| !a.right) {
            let target = a.target.as_deref().unwrap_or("nothing");
            let said = match (&a.given, a.iou) {
                (Some(g), Some(iou)) => format!("mask of the {g}, IoU {iou:.2}"),
                (Some(g), None) => format!("mask of the {g}"),
                (None, _) => a.reason.clone(),
            };
            let _ = writeln!(out, "wrong: {} {:?} means {target}: {said}", a.scene, a.text);
        }
        let [median, p95, most] = self.ms;
        let _ = writeln!(
            out,
            "processor time: median {median:.1} ms, p95 {p95:.1} ms, most {most:.1} ms"
        );
        let _ = writeln!(
            out,
            "wanted: right >= {WANTED_RIGHT_PERCENT} %, mean IoU >= {WANTED_IOU}, median under \
             {WANTED_MS} ms: {}",
            if self.met() { "met" } else { "NOT met" }
        );
        out
    }
}
