//! Small SVG plots without a plotting library.

use std::fmt::Write as _;

/// A named curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Legend text.
    pub name: String,
    /// CSS colour.
    pub color: String,
    /// x, y.
    pub points: Vec<(f64, f64)>,
}

/// Curves over a common axis.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinePlot {
    /// Title.
    pub title: String,
    /// Axis label with its unit.
    pub x_label: String,
    /// Axis label with its unit.
    pub y_label: String,
    /// Logarithmic y axis; values of 0 or less are left out.
    pub log_y: bool,
    /// The curves.
    pub series: Vec<Series>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 64.0;
const BOTTOM: f64 = 44.0;
const TOP: f64 = 30.0;
const RIGHT: f64 = 16.0;

pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Round steps (1, 2, 5 times a power of ten) that cut the range into at most `n` parts.
fn ticks(low: f64, high: f64, n: usize) -> Vec<f64> {
    let raw = (high - low) / n as f64;
    if !(raw.is_finite() && raw > 0.0) {
        return vec![low];
    }
    let power = 10f64.powf(raw.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw).unwrap_or(raw);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    (low <= high).then(|| if high > low { (low, high) } else { (low - 0.5, high + 0.5) })
}

impl LinePlot {
    /// The plot as an SVG element; says so when there is nothing to plot.
    pub fn svg(&self) -> String {
        let value = |y: f64| if self.log_y { y.log10() } else { y };
        let usable = |p: &&(f64, f64)| p.0.is_finite() && value(p.1).is_finite();
        let all = || self.series.iter().flat_map(|s| s.points.iter().filter(usable));
        let mut out = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\
             <text x=\"{LEFT}\" y=\"18\" class=\"title\">{}</text>",
            escape(&self.title),
            escape(&self.title)
        );
        let (Some((x0, x1)), Some((y0, y1))) =
            (range(all().map(|p| p.0)), range(all().map(|p| value(p.1))))
        else {
            out.push_str("<text x=\"80\" y=\"160\">no data</text></svg>");
            return out;
        };
        let sx = |x: f64| LEFT + (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
        let sy = |y: f64| HEIGHT - BOTTOM - (y - y0) / (y1 - y0) * (HEIGHT - BOTTOM - TOP);
        for t in ticks(x0, x1, 8) {
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{1}\" y2=\"{2}\"/>\
                 <text class=\"tick\" x=\"{0:.1}\" y=\"{3}\" text-anchor=\"middle\">{4}</text>",
                sx(t),
                TOP,
                HEIGHT - BOTTOM,
                HEIGHT - BOTTOM + 16.0,
                tick_text(t)
            );
        }
        for t in ticks(y0, y1, 5) {
            let label = if self.log_y { format!("1e{}", tick_text(t)) } else { tick_text(t) };
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{1:.1}\" y2=\"{1:.1}\"/>\
                 <text class=\"tick\" x=\"{2}\" y=\"{3:.1}\" text-anchor=\"end\">{label}</text>",
                WIDTH - RIGHT,
                sy(t),
                LEFT - 6.0,
                sy(t) + 4.0
            );
        }
        for (i, s) in self.series.iter().enumerate() {
            let points: String = s
                .points
                .iter()
                .filter(usable)
                .map(|p| format!("{:.1},{:.1} ", sx(p.0), sy(value(p.1))))
                .collect();
            let _ = write!(
                out,
                "<polyline fill=\"none\" stroke=\"{0}\" points=\"{points}\"/>\
                 <text x=\"{1}\" y=\"18\" fill=\"{0}\" text-anchor=\"end\">{2}</text>",
                escape(&s.color),
                WIDTH - RIGHT - 110.0 * i as f64,
                escape(&s.name)
            );
        }
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text></svg>",
            (LEFT + WIDTH - RIGHT) / 2.0,
            HEIGHT - 8.0,
            escape(&self.x_label),
            (TOP + HEIGHT - BOTTOM) / 2.0,
            escape(&self.y_label)
        );
        out
    }
}

fn tick_text(v: f64) -> String {
    let text = format!("{v:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.to_owned() }
}

/// Paths seen along one axis, both axes at the same scale (metres).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TopView {
    /// Title.
    pub title: String,
    /// Axis label.
    pub x_label: String,
    /// Axis label.
    pub y_label: String,
    /// Thin background paths.
    pub background: Vec<Vec<(f64, f64)>>,
    /// Emphasised paths with legend.
    pub series: Vec<Series>,
}

impl TopView {
    /// The drawing as an SVG element.
    pub fn svg(&self) -> String {
        let size = 420.0;
        let all = || {
            self.background.iter().flatten().chain(self.series.iter().flat_map(|s| s.points.iter()))
        };
        let mut out = format!(
            "<svg viewBox=\"0 0 {size} {size}\" role=\"img\" aria-label=\"{0}\">\
             <text x=\"40\" y=\"18\" class=\"title\">{0}</text>",
            escape(&self.title)
        );
        let (Some((x0, x1)), Some((y0, y1))) =
            (range(all().map(|p| p.0)), range(all().map(|p| p.1)))
        else {
            out.push_str("<text x=\"80\" y=\"160\">no data</text></svg>");
            return out;
        };
        let span = (x1 - x0).max(y1 - y0);
        let (cx, cy) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
        let scale = (size - 80.0) / span;
        let sx = |x: f64| size / 2.0 + (x - cx) * scale;
        let sy = |y: f64| size / 2.0 - (y - cy) * scale;
        let (low, high) = (40.0, size - 40.0);
        for t in ticks(cx - span / 2.0, cx + span / 2.0, 6) {
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{low}\" y2=\"{high}\"/>\
                 <text class=\"tick\" x=\"{0:.1}\" y=\"{1}\" text-anchor=\"middle\">{2}</text>",
                sx(t),
                high + 15.0,
                tick_text(t)
            );
        }
        for t in ticks(cy - span / 2.0, cy + span / 2.0, 6) {
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{low}\" x2=\"{high}\" y1=\"{0:.1}\" y2=\"{0:.1}\"/>\
                 <text class=\"tick\" x=\"{1}\" y=\"{2:.1}\" text-anchor=\"end\">{3}</text>",
                sy(t),
                low - 4.0,
                sy(t) + 4.0,
                tick_text(t)
            );
        }
        let points = |p: &[(f64, f64)]| -> String {
            p.iter().map(|p| format!("{:.1},{:.1} ", sx(p.0), sy(p.1))).collect()
        };
        for path in &self.background {
            let _ = write!(out, "<polyline class=\"thin\" points=\"{}\"/>", points(path));
        }
        for (i, s) in self.series.iter().enumerate() {
            let _ = write!(
                out,
                "<polyline fill=\"none\" stroke=\"{0}\" stroke-width=\"2.5\" points=\"{1}\"/>\
                 <text x=\"{2}\" y=\"18\" text-anchor=\"end\" fill=\"{0}\">{3}</text>",
                escape(&s.color),
                points(&s.points),
                size - 8.0 - 100.0 * i as f64,
                escape(&s.name)
            );
        }
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(10 {}) rotate(-90)\" text-anchor=\"middle\">{}</text></svg>",
            size / 2.0,
            size - 6.0,
            escape(&self.x_label),
            size / 2.0,
            escape(&self.y_label)
        );
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(0.0, 1.0, 5), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(ticks(1.0, 1.0, 5), [1.0]);
    }

    #[test]
    fn hostile_names_and_empty_data_give_valid_svg() {
        let plot = LinePlot {
            title: "<a> & \"b\"".into(),
            series: vec![Series {
                name: "s".into(),
                color: "red".into(),
                points: vec![(0.0, f64::NAN), (1.0, -1.0)],
            }],
            log_y: true,
            ..Default::default()
        };
        let svg = plot.svg();
        assert!(svg.contains("&lt;a&gt;") && svg.contains("no data") && svg.ends_with("</svg>"));
        assert!(!TopView::default().svg().contains("NaN"));
    }
}
