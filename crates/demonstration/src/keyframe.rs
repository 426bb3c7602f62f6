//! When the hand grasps and when it lets go: from the distance between fingertips and object, and
//! from the object's motion with the hand.

use crate::DemonstrationError;
use crate::filter::{FilterConfig, Sample, smooth};
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{Point3, UnitQuaternion, Vector3};

/// Settings of [`detect`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeyframeConfig {
    /// An object that ends and stays nearer to its start than this did not move (m).
    pub min_motion: f64,
    /// Least distance from rest that counts as off it (m); twice the jitter at rest if that is more.
    pub off_rest: f64,
    /// Least tolerance of the distance between fingertips and object while held (m).
    pub hold_tolerance: f64,
    /// Share of the carry in which the object must keep its distance to the fingertips.
    pub min_evidence: f64,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self { min_motion: 0.03, off_rest: 0.008, hold_tolerance: 0.015, min_evidence: 0.5 }
    }
}

/// Frame indices of the demonstration's events.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Keyframes {
    /// First frame with the fingers where they stay on the object.
    pub contact: usize,
    /// Last frame of the object at rest before it is carried.
    pub onset: usize,
    /// First frame of the object at rest after it.
    pub settled: usize,
    /// First frame with the fingers off the object again; none if the recording ends before.
    pub release: Option<usize>,
    /// Jitter of the resting object's position (m, median).
    pub jitter: f64,
    /// Distance between fingertips and object's origin while held (m, median).
    pub hold_distance: f64,
    /// Share of the carry in which that distance was kept (of the frames that show a hand).
    pub evidence: f64,
}

impl Keyframes {
    /// As frames of a recording in which the looked-at part begins at frame `offset`.
    pub(crate) fn moved(mut self, offset: usize) -> Self {
        self.contact += offset;
        self.onset += offset;
        self.settled += offset;
        self.release = self.release.map(|r| r + offset);
        self
    }
}

fn median_point(points: impl Iterator<Item = Point3<f64>> + Clone) -> Option<Point3<f64>> {
    let component = |k: usize| {
        let mut v: Vec<f64> = points.clone().map(|p| p[k]).collect();
        median(&mut v)
    };
    Some(Point3::new(component(0)?, component(1)?, component(2)?))
}

fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let k = values.len() / 2;
    Some(*values.select_nth_unstable_by(k, f64::total_cmp).1)
}

/// Finds the events. `times` (s) of all frames; `object`: position of the moving object, none where it
/// was not seen; `tips`: middle of the fingertips, none without a hand. Jitter of 2-9 mm and missing
/// frames are expected.
///
/// # Errors
/// [`DemonstrationError::TooFewFrames`], [`DemonstrationError::ObjectNeverMoves`],
/// [`DemonstrationError::NoGrasp`].
pub fn detect(
    name: &str,
    times: &[f64],
    object: &[Option<Point3<f64>>],
    tips: &[Option<Point3<f64>>],
    config: &KeyframeConfig,
) -> Result<Keyframes, DemonstrationError> {
    let n = times.len().min(object.len()).min(tips.len());
    let seen = object[..n].iter().flatten().count();
    if seen < 8 {
        return Err(DemonstrationError::TooFewFrames { have: seen, need: 8 });
    }
    let samples: Vec<Sample> = (0..n)
        .filter_map(|i| {
            let pose = Pose::from_parts(object[i]?.into(), UnitQuaternion::identity());
            Some(Sample { time: times[i], pose, weight: 1.0 })
        })
        .collect();
    let filter = FilterConfig { sigma: 0.06, robust_rounds: 2 };
    let path: Vec<Point3<f64>> = smooth(&samples, &times[..n], &filter)
        .iter()
        .map(|p| Point3::from(p.translation.vector))
        .collect();

    let window = (n / 10).max(4).min(n / 2);
    let mut rest_window = 0..window;
    let (mut onset, mut threshold, mut jitter) = (0, 0.0, 0.0);
    // Twice: the second time with everything before the motion as the resting place.
    for _ in 0..2 {
        let raw = object[rest_window.clone()].iter().flatten().copied();
        let rest = median_point(raw.clone()).unwrap_or(path[0]);
        jitter = median(&mut raw.map(|p| (p - rest).norm()).collect::<Vec<_>>()).unwrap_or(0.0);
        threshold = config.off_rest.max(2.0 * jitter);
        let away: Vec<f64> = path.iter().map(|p| (p - rest).norm()).collect();
        let moved = away.iter().copied().fold(0.0, f64::max);
        if moved < config.min_motion.max(2.0 * threshold) {
            return Err(DemonstrationError::ObjectNeverMoves {
                name: name.to_string(),
                moved,
                need: config.min_motion.max(2.0 * threshold),
            });
        }
        let far = away.iter().position(|d| *d > (2.5 * threshold).max(0.5 * config.min_motion));
        let far = far.unwrap_or(n - 1);
        onset = (0..far).rev().find(|i| away[*i] < threshold).unwrap_or(0);
        rest_window = 0..onset.max(window.min(3)).max(1);
    }
    let end_window = n - window..n;
    let end = median_point(object[end_window].iter().flatten().copied()).unwrap_or(path[n - 1]);
    // Medians of what was seen: at the very end, where little is to be smoothed with, the path is no guide.
    let around = |i: usize| {
        let seen = object[i.saturating_sub(3)..(i + 4).min(n)].iter().flatten().copied();
        median_point(seen).unwrap_or(path[i])
    };
    let settled = (onset..n).rev().find(|i| (around(*i) - end).norm() > threshold);
    let settled = settled.map_or(onset + 1, |i| i + 1).min(n - 1);

    // How far the fingertips are from the object while it is carried.
    let gap = |i: usize| tips[i].map(|t| (t - path[i]).norm());
    let carry: Vec<f64> = (onset + 1..settled).filter_map(gap).collect();
    let Some(hold_distance) = median(&mut carry.clone()) else {
        return Err(DemonstrationError::NoGrasp {
            reason: format!("no hand is seen while '{name}' moves (frames {onset} to {settled})"),
        });
    };
    let deviation: Vec<f64> = carry.iter().map(|g| (g - hold_distance).abs()).collect();
    let spread = 1.4826 * median(&mut deviation.clone()).unwrap_or(0.0);
    let tolerance = config.hold_tolerance.max(2.0 * spread).min(0.05);
    let kept = deviation.iter().filter(|d| **d <= tolerance).count();
    let evidence = kept as f64 / carry.len() as f64;
    let with_hand = moves_together(&path, tips, onset, settled);
    if evidence < config.min_evidence || with_hand.is_some_and(|r| r < 0.5) || hold_distance > 0.25
    {
        return Err(DemonstrationError::NoGrasp {
            reason: format!(
                "'{name}' moves (frames {onset} to {settled}), but not with the hand: the fingertips are \
                 {:.0} mm from it, steady in {:.0} % of the frames",
                1000.0 * hold_distance,
                100.0 * evidence
            ),
        });
    }
    let on_object = |i: usize| gap(i).map(|g| g <= hold_distance + tolerance);
    // Backwards from the motion while the fingers are on the object; one bad frame does not end it.
    let mut contact = onset;
    let mut misses = 0;
    for i in (0..=onset).rev() {
        match on_object(i) {
            Some(true) => (contact, misses) = (i, 0),
            Some(false) => misses += 1,
            None => {}
        }
        if misses >= 2 {
            break;
        }
    }
    // The last stretch of frames off the object is the retreat.
    let mut release = None;
    for i in (settled..n).rev() {
        match on_object(i) {
            Some(false) => release = Some(i),
            Some(true) => break,
            None => {}
        }
    }
    Ok(Keyframes { contact, onset, settled, release, jitter, hold_distance, evidence })
}

/// How well the hand's displacement during the carry matches the object's, 1 = the same; none if no hand
/// is seen near both ends of it.
fn moves_together(
    path: &[Point3<f64>],
    tips: &[Option<Point3<f64>>],
    onset: usize,
    settled: usize,
) -> Option<f64> {
    let first = (onset..settled).find(|i| tips[*i].is_some())?;
    let last = (first..=settled.min(tips.len() - 1)).rev().find(|i| tips[*i].is_some())?;
    let object: Vector3<f64> = path[last] - path[first];
    if object.norm() < 0.03 {
        return None;
    }
    let hand = tips[last]? - tips[first]?;
    Some(1.0 - (hand - object).norm() / object.norm())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};
    use tdv_geometry::smooth_step;

    /// Contact at 50, carry from 58 to 100, release at 112; 150 frames at 30 Hz.
    fn scene(
        noise: f64,
        seed: u64,
    ) -> (Vec<f64>, Vec<Option<Point3<f64>>>, Vec<Option<Point3<f64>>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let n = Normal::new(0.0, noise).unwrap();
        let mut jitter =
            || Vector3::new(n.sample(&mut rng), n.sample(&mut rng), n.sample(&mut rng));
        let (mut object, mut tips) = (vec![], vec![]);
        for i in 0..150 {
            let i = f64::from(i);
            let s = smooth_step((i - 58.0) / 42.0);
            let o = Point3::new(0.35 * s, 0.1 * s, 0.15 * (std::f64::consts::PI * s).sin());
            let approach = 0.4 * (1.0 - smooth_step(i / 50.0));
            let retreat = 0.3 * smooth_step((i - 110.0) / 30.0);
            let t = o + Vector3::new(0.0, 0.0, 0.05 + approach + retreat);
            object.push(Some(o + jitter()));
            tips.push(Some(t + jitter()));
        }
        ((0..150).map(|i| f64::from(i) / 30.0).collect(), object, tips)
    }

    #[test]
    fn events_within_a_few_frames_under_noise() {
        for (noise, seed, slack) in [(0.0, 1, 7), (0.002, 2, 7), (0.004, 3, 8), (0.005, 4, 9)] {
            let (t, o, h) = scene(noise, seed);
            let k = detect("mug", &t, &o, &h, &KeyframeConfig::default()).unwrap();
            let near = |a: usize, b: usize| a.abs_diff(b) <= slack;
            // 15 mm above the object counts as contact already: the quintic ends slowly.
            assert!(near(k.contact, 41) && near(k.onset, 64), "{noise}: {k:?}");
            assert!(near(k.settled, 96) && near(k.release.unwrap(), 118), "{noise}: {k:?}");
            assert!(k.evidence > 0.9 && (k.hold_distance - 0.05).abs() < 0.01);
        }
    }

    #[test]
    fn missing_frames_and_no_release() {
        let (t, mut o, mut h) = scene(0.003, 7);
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        for i in 0..150 {
            if rng.random::<f64>() < 0.25 {
                o[i] = None;
            }
            if rng.random::<f64>() < 0.25 || (70..90).contains(&i) {
                h[i] = None;
            }
        }
        let k = detect("mug", &t, &o, &h, &KeyframeConfig::default()).unwrap();
        assert!(k.contact.abs_diff(41) < 10 && k.settled.abs_diff(96) < 10, "{k:?}");
        let cut =
            detect("mug", &t[..108], &o[..108], &h[..108], &KeyframeConfig::default()).unwrap();
        assert_eq!(cut.release, None);
    }

    #[test]
    fn what_is_no_grasp_is_an_error() {
        let (t, o, h) = scene(0.003, 1);
        let still = vec![o[0]; 150];
        let c = KeyframeConfig::default();
        assert!(matches!(
            detect("mug", &t, &still, &h, &c),
            Err(DemonstrationError::ObjectNeverMoves { .. })
        ));
        let away = vec![Some(Point3::new(1.0, 1.0, 1.0)); 150];
        assert!(matches!(
            detect("mug", &t, &o, &away, &c),
            Err(DemonstrationError::NoGrasp { .. })
        ));
        assert!(matches!(
            detect("mug", &t, &o, &vec![None; 150], &c),
            Err(DemonstrationError::NoGrasp { .. })
        ));
        assert!(matches!(
            detect("mug", &t[..1], &o[..1], &h[..1], &c),
            Err(DemonstrationError::TooFewFrames { .. })
        ));
    }
}
