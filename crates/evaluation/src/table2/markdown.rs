//! The table for people: Markdown in the paper's layout, and a plot of success against demonstrations.

use super::{CellResult, Level, PolicyKind, Table2Report};
use crate::plot::escape;
use std::fmt::Write as _;

fn percent(r: f64) -> f64 {
    100.0 * r
}

/// Successes as "rate [interval] (successes/trials)".
fn figures(rate: f64, ci: [f64; 2], successes: usize, trials: usize) -> String {
    if trials == 0 {
        return "-".into();
    }
    format!(
        "{:.0} % [{:.0}, {:.0}] ({successes}/{trials})",
        percent(rate),
        percent(ci[0]),
        percent(ci[1])
    )
}

fn drawn(c: &CellResult) -> String {
    figures(c.rate, c.ci95, c.successes, c.trials)
}

fn points(c: &CellResult) -> String {
    match c.points13.trials {
        0 => "-".into(),
        n => format!("{}/{n}", c.points13.successes),
    }
}

fn distinct<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut out = Vec::new();
    for item in items {
        if !out.contains(&item) {
            out.push(item);
        }
    }
    out
}

impl Table2Report {
    /// The whole table in Markdown.
    pub fn markdown(&self) -> String {
        let mut out = String::from(
            "Success by task, demonstrations and level. PG: the position of the object varies, PoG: \
             position and yaw.\nEach entry: share of successes from drawn starts [95 % Wilson interval] \
             (successes/trials); 13 fixed points.\nAnother simulator and other objects than the paper's: \
             its figures do not compare and are not shown.\n",
        );
        let tasks = distinct(self.cells.iter().map(|c| c.task.clone()));
        let groups = distinct(
            self.cells
                .iter()
                .filter(|c| c.arm == "ordinary")
                .map(|c| (c.policy, c.disturbed, c.poses.clone())),
        );
        for (policy, disturbed, poses) in groups {
            let pushed = if disturbed { ", an object pushed in mid-run" } else { "" };
            let _ = writeln!(out, "\n### {}{pushed} (poses: {poses})\n", policy.name());
            let _ = write!(out, "| level | demonstrations |");
            tasks.iter().for_each(|t| {
                let _ = write!(out, " {t} | 13 points |");
            });
            let _ = writeln!(out, "\n|---|---|{}", "---|---|".repeat(tasks.len()));
            let of = |c: &&CellResult| {
                (c.policy, c.disturbed, &c.poses) == (policy, disturbed, &poses)
                    && c.arm == "ordinary"
            };
            let mut rows = distinct(self.cells.iter().filter(of).map(|c| (c.level, c.demos)));
            rows.sort_unstable();
            for (level, demos) in rows {
                let _ = write!(out, "| {} | {demos} |", level.name());
                for task in &tasks {
                    let found = self
                        .cells
                        .iter()
                        .filter(of)
                        .find(|c| (&c.task, c.level, c.demos) == (task, level, demos));
                    let (a, b) = found.map_or(("-".into(), "-".into()), |c| (drawn(c), points(c)));
                    let _ = write!(out, " {a} | {b} |");
                }
                out.push('\n');
            }
        }
        self.arms(&mut out);
        self.causes(&mut out);
        out
    }

    fn arms(&self, out: &mut String) {
        if self.cells.iter().all(|c| c.arm == "ordinary") {
            return;
        }
        let _ = writeln!(
            out,
            "\n### Ablations\n\n| task | arm | demonstrations | level | pushed | drawn starts | \
             13 points | plan ms | median s |\n|---|---|---|---|---|---|---|---|---|"
        );
        let learned = |c: &&CellResult| c.policy == PolicyKind::Learned;
        for c in self.cells.iter().filter(learned) {
            let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.1}"));
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                c.task,
                c.arm,
                c.demos,
                c.level.name(),
                if c.disturbed { "yes" } else { "no" },
                drawn(c),
                points(c),
                number(c.plan_ms),
                number(c.median[2])
            );
        }
    }

    fn causes(&self, out: &mut String) {
        if self.cells.iter().all(|c| c.causes.is_empty()) {
            return;
        }
        let _ =
            writeln!(out, "\n### Why trials failed (all starts)\n\n| cell | reasons |\n|---|---|");
        for c in self.cells.iter().filter(|c| !c.causes.is_empty()) {
            let reasons: Vec<String> =
                c.causes.iter().map(|(why, n)| format!("{n} x {why}")).collect();
            let _ = writeln!(
                out,
                "| {} {} {} {}{}{} | {} |",
                c.task,
                c.policy.name(),
                c.demos,
                c.level.name(),
                if c.disturbed { " pushed" } else { "" },
                if c.arm == "ordinary" { String::new() } else { format!(" {}", c.arm) },
                reasons.join(", ")
            );
        }
    }

    /// Success of the learned policy against the number of demonstrations, undisturbed, with intervals; a
    /// curve per task and level. The numbers of demonstrations stand at equal distances.
    pub fn svg(&self) -> String {
        const COLORS: [&str; 8] = [
            "#1f6fb4", "#d9662b", "#2c8f4a", "#8a4fb0", "#b03a48", "#5c6b7a", "#b58900", "#0f8b8d",
        ];
        let (w, h, left, right, top, bottom) = (640.0, 360.0, 60.0, 190.0, 34.0, 46.0);
        let of = |c: &&CellResult| {
            c.policy == PolicyKind::Learned && !c.disturbed && c.arm == "ordinary" && c.trials > 0
        };
        let mut demos = distinct(self.cells.iter().filter(of).map(|c| c.demos));
        demos.sort_unstable();
        let curves: Vec<(String, Level, String)> = distinct(
            self.cells.iter().filter(of).map(|c| (c.task.clone(), c.level, c.poses.clone())),
        );
        let step = (w - left - right) / demos.len().max(1) as f64;
        let y = |rate: f64| top + (1.0 - rate) * (h - top - bottom);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"system-ui,sans-serif\" font-size=\"12\"><rect width=\"{w}\" height=\"{h}\" \
             fill=\"#fff\"/><text x=\"{left}\" y=\"20\" font-weight=\"600\">Success from drawn starts, 95 % \
             intervals</text>"
        );
        for k in 0..=5 {
            let (rate, x1) = (0.2 * f64::from(k), w - right);
            let _ = write!(
                out,
                "<line x1=\"{left}\" x2=\"{x1}\" y1=\"{0:.1}\" y2=\"{0:.1}\" stroke=\"#d7dee6\"/>\
                 <text x=\"{1}\" y=\"{2:.1}\" text-anchor=\"end\">{3:.0} %</text>",
                y(rate),
                left - 6.0,
                y(rate) + 4.0,
                percent(rate)
            );
        }
        for (i, n) in demos.iter().enumerate() {
            let x = left + (i as f64 + 0.5) * step;
            let _ = write!(
                out,
                "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{n}</text>",
                h - bottom + 18.0
            );
        }
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">demonstrations made of one</text>",
            0.5 * (left + w - right),
            h - 8.0
        );
        for (k, curve) in curves.iter().enumerate() {
            let color = COLORS[k % COLORS.len()];
            // Side by side, so that the intervals do not cover each other.
            let aside = (k as f64 - 0.5 * (curves.len() - 1) as f64) * 9.0;
            let mut line = String::new();
            for c in self.cells.iter().filter(of) {
                if (&c.task, c.level, &c.poses) != (&curve.0, curve.1, &curve.2) {
                    continue;
                }
                let i = demos.iter().position(|d| *d == c.demos).unwrap_or(0);
                let x = left + (i as f64 + 0.5) * step + aside;
                let _ = write!(line, "{x:.1},{:.1} ", y(c.rate));
                let _ = write!(
                    out,
                    "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"{color}\"/>\
                     <circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{color}\"/>",
                    y(c.ci95[0]),
                    y(c.ci95[1]),
                    y(c.rate)
                );
            }
            let dash = if curve.1 == Level::PoG { " stroke-dasharray=\"5 3\"" } else { "" };
            let seen = if curve.2 == "truth" { "" } else { ", perceived" };
            let _ = write!(
                out,
                "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\"{dash} \
                 points=\"{line}\"/><text x=\"{}\" y=\"{}\" fill=\"{color}\">{} {}{seen}</text>",
                w - right + 10.0,
                top + 8.0 + 17.0 * k as f64,
                escape(&curve.0),
                curve.1.name()
            );
        }
        out.push_str("</svg>");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::super::{Level, PolicyKind, Table2Report, TrialRecord};

    #[test]
    fn every_cell_is_in_the_table_and_the_plot() {
        let mut records = Vec::new();
        for demos in [1, 15, 50] {
            for level in [Level::PG, Level::PoG] {
                for trial in 0..33 {
                    let success = trial * 50 < demos * 33;
                    records.push(TrialRecord { demos, level, ..record(trial, success) });
                }
            }
        }
        let policy = PolicyKind::StraightLine;
        records.push(TrialRecord { policy, disturbed: true, demos: 1, ..record(20, false) });
        records.push(TrialRecord { arm: "history_1".into(), ..record(20, true) });
        let report = Table2Report::new(records);
        let text = report.markdown();
        for words in [
            "| PG | 50 | 100 % [84, 100] (20/20) | 13/13 |",
            "| PoG | 1 | 0 % [0, 16] (0/20) | 1/13 |",
            "straight_line, an object pushed in mid-run",
            "| cup_on_coaster | history_1 | 50 | PG | no | 100 % [21, 100] (1/1) |",
            "32 x let go off the target",
        ] {
            assert!(text.contains(words), "{words} not in:\n{text}");
        }
        let svg = report.svg();
        assert_eq!(svg.matches("<circle").count(), 6);
        assert!(!svg.contains("NaN") && svg.ends_with("</svg>"));
        assert!(Table2Report::default().svg().ends_with("</svg>"));
    }
}
