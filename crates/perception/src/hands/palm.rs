//! Where in the image is a palm? The palm detection network with its anchors.

use std::path::Path;

use image::RgbImage;

use super::network::{Network, NetworkError};
use super::warp::{Border, Window};

/// Side of the network's input.
const SIZE: usize = 192;
/// Anchors: 24 x 24 places with 2 each, then 12 x 12 places with 6 each.
const GRIDS: [(usize, usize); 2] = [(24, 2), (12, 6)];
const ANCHORS: usize = 24 * 24 * 2 + 12 * 12 * 6;
/// Values per anchor: box centre, box size, seven key points.
const VALUES: usize = 18;
/// Two boxes that overlap by more than this (intersection over union) show the same palm.
const SAME_PALM: f64 = 0.3;

/// A palm in image pixels (centres at integer coordinates).
#[derive(Clone, Debug, PartialEq)]
pub struct Palm {
    /// The network's score, 0..1.
    pub score: f64,
    /// Centre of the square box round the palm (u, v).
    pub centre: (f64, f64),
    /// Size of the box (width, height).
    pub size: (f64, f64),
    /// Wrist, MCP joints of index, middle, ring and little finger, thumb CMC and MCP.
    pub keypoints: [(f64, f64); 7],
}

impl Palm {
    /// The window that shows the whole hand upright: the wrist at the bottom, the fingers above.
    #[must_use]
    pub fn hand_window(&self) -> Window {
        let (wrist, middle) = (self.keypoints[0], self.keypoints[2]);
        // The clockwise angle from "up" to the direction wrist -> middle finger.
        let angle = (middle.0 - wrist.0).atan2(wrist.1 - middle.1);
        let upright = Window { centre: self.centre, side: 0.0, angle };
        // The fingers add as much above the palm as half its box; then room on every side.
        let (dx, dy) = upright.turn(0.0, -0.5 * self.size.1);
        Window {
            centre: (self.centre.0 + dx, self.centre.1 + dy),
            side: 2.6 * self.size.0.max(self.size.1),
            angle,
        }
    }

    fn overlap(&self, other: &Self) -> f64 {
        let along = |a: f64, wa: f64, b: f64, wb: f64| {
            ((a + wa / 2.0).min(b + wb / 2.0) - (a - wa / 2.0).max(b - wb / 2.0)).max(0.0)
        };
        let common = along(self.centre.0, self.size.0, other.centre.0, other.size.0)
            * along(self.centre.1, self.size.1, other.centre.1, other.size.1);
        let union = self.size.0 * self.size.1 + other.size.0 * other.size.1 - common;
        if union > 0.0 { common / union } else { 0.0 }
    }
}

/// The palm detection network.
#[derive(Debug)]
pub struct PalmDetector {
    network: Network,
    boxes: usize,
    scores: usize,
    anchors: Vec<(f64, f64)>,
}

impl PalmDetector {
    /// Loads `palm_detection_full.tflite`.
    ///
    /// # Errors
    /// [`NetworkError`] if the file is missing, damaged or another network.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let network = Network::load(path)?;
        let [boxes, scores] = network.expect(
            &[1, SIZE, SIZE, 3],
            [("Identity", &[1, ANCHORS, VALUES]), ("Identity_1", &[1, ANCHORS, 1])],
        )?;
        Ok(Self { network, boxes, scores, anchors: anchors() })
    }

    /// All palms scored at least `threshold` (0..1), best first, overlapping ones merged.
    pub fn detect(&mut self, image: &RgbImage, threshold: f64) -> Vec<Palm> {
        let (width, height) = (f64::from(image.width()), f64::from(image.height()));
        // The whole image in the middle of a square.
        let square =
            Window { centre: (width / 2.0, height / 2.0), side: width.max(height), angle: 0.0 };
        square.sample(image, SIZE, Border::Zero, self.network.input_mut());
        self.network.run();
        let boxes = self.network.output(self.boxes).chunks_exact(VALUES);
        let scores = self.network.output(self.scores);
        let mut palms: Vec<Palm> = Vec::new();
        for ((values, logit), anchor) in boxes.zip(scores).zip(&self.anchors) {
            let score = 1.0 / (1.0 + f64::from(-logit.clamp(-100.0, 100.0)).exp());
            if score >= threshold {
                palms.push(decode(values, score, *anchor, &square));
            }
        }
        merged(palms)
    }
}

/// Anchor centres in input sides.
fn anchors() -> Vec<(f64, f64)> {
    let mut anchors = Vec::with_capacity(ANCHORS);
    for (n, repeat) in GRIDS {
        for place in 0..n * n {
            let centre = |i: usize| (i as f64 + 0.5) / n as f64;
            anchors.extend([(centre(place % n), centre(place / n))].repeat(repeat));
        }
    }
    anchors
}

fn decode(values: &[f32], score: f64, anchor: (f64, f64), square: &Window) -> Palm {
    let value = |i: usize| f64::from(values[i]) / SIZE as f64;
    let point = |i: usize| square.to_image(anchor.0 + value(i), anchor.1 + value(i + 1));
    Palm {
        score,
        centre: point(0),
        size: (value(2) * square.side, value(3) * square.side),
        keypoints: std::array::from_fn(|k| point(4 + 2 * k)),
    }
}

/// Non-maximum suppression that averages: each palm is the mean, weighted by score, of the
/// detections that overlap its best one. Steadier than taking the best one alone.
fn merged(mut palms: Vec<Palm>) -> Vec<Palm> {
    palms.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept = Vec::new();
    while let Some(best) = palms.first().cloned() {
        let (same, rest): (Vec<_>, Vec<_>) =
            palms.into_iter().partition(|palm| *palm == best || palm.overlap(&best) > SAME_PALM);
        palms = rest;
        let total: f64 = same.iter().map(|palm| palm.score).sum();
        let mean = |point: &dyn Fn(&Palm) -> (f64, f64)| {
            same.iter().fold((0.0, 0.0), |sum, palm| {
                let (weight, value) = (palm.score / total, point(palm));
                (sum.0 + weight * value.0, sum.1 + weight * value.1)
            })
        };
        kept.push(Palm {
            score: best.score,
            centre: mean(&|palm| palm.centre),
            size: mean(&|palm| palm.size),
            keypoints: std::array::from_fn(|k| mean(&|palm| palm.keypoints[k])),
        });
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn palm(score: f64, u: f64) -> Palm {
        Palm { score, centre: (u, 50.0), size: (20.0, 20.0), keypoints: [(u, 50.0); 7] }
    }

    #[test]
    fn anchors_cover_the_input_in_both_grids() {
        let anchors = anchors();
        assert_eq!(anchors.len(), ANCHORS);
        assert_eq!(anchors[1], (0.5 / 24.0, 0.5 / 24.0));
        assert_eq!(anchors[2], (1.5 / 24.0, 0.5 / 24.0));
        assert_eq!(anchors[ANCHORS - 1], (11.5 / 12.0, 11.5 / 12.0));
    }

    #[test]
    fn overlapping_detections_become_one_weighted_palm() {
        let kept = merged(vec![palm(0.6, 103.0), palm(0.9, 100.0), palm(0.7, 300.0)]);
        assert_eq!(kept.len(), 2);
        assert!((kept[0].centre.0 - (0.9 * 100.0 + 0.6 * 103.0) / 1.5).abs() < 1e-9);
        assert_eq!(kept[0].score, 0.9);
        assert_eq!(kept[1].centre.0, 300.0);
        assert!(merged(Vec::new()).is_empty());
    }

    #[test]
    fn the_window_follows_the_hand() {
        let mut palm = palm(1.0, 100.0);
        palm.keypoints[0] = (90.0, 50.0);
        palm.keypoints[2] = (110.0, 50.0);
        let window = palm.hand_window();
        assert!((window.angle - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!((window.centre.0 - 110.0).abs() < 1e-9 && (window.centre.1 - 50.0).abs() < 1e-9);
        assert!((window.side - 52.0).abs() < 1e-9);
    }
}
