//! Where one procedure ends and the next begins: the hand opens or closes, or what moves pauses.

use crate::path::RHO;
use crate::{DemonstrationError, GripperEnd, ProcedureSpec, Remapped};
use tdv_geometry::{Pose, twist_arc};

/// Least difference between open and closed hand (m between the tips of thumb and index).
const LEAST_CHANGE: f64 = 0.012;
/// A pause lies at least so long from other boundaries (s).
const APART: f64 = 0.3;
/// A pause is slower than this share of the median speed.
const SLOW: f64 = 0.35;

/// Frames in which the hand has just closed or just opened: its span crosses one and two thirds of the
/// way between its low and its high, so that noise in between is no event.
pub(super) fn grip_events(tools: &[Option<Remapped>]) -> Vec<(usize, GripperEnd)> {
    let spans: Vec<(usize, f64)> =
        tools.iter().enumerate().filter_map(|(i, t)| Some((i, t.as_ref()?.span))).collect();
    let smooth: Vec<(usize, f64)> = (0..spans.len())
        .map(|k| {
            let (a, b) = (k.saturating_sub(3), (k + 4).min(spans.len()));
            let mut v: Vec<f64> = spans[a..b].iter().map(|s| s.1).collect();
            v.sort_by(f64::total_cmp);
            (spans[k].0, v[v.len() / 2])
        })
        .collect();
    let mut sorted: Vec<f64> = smooth.iter().map(|s| s.1).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len() as f64) as usize).copied();
    let (Some(low), Some(high)) = (at(0.05), at(0.95)) else { return Vec::new() };
    if high - low < LEAST_CHANGE {
        return Vec::new();
    }
    let (closed, open) = (low + (high - low) / 3.0, low + (high - low) * 2.0 / 3.0);
    let mut is_open = smooth[0].1 > 0.5 * (low + high);
    let mut events = Vec::new();
    for (i, span) in smooth {
        if is_open && span < closed {
            is_open = false;
            events.push((i, GripperEnd::Close));
        } else if !is_open && span > open {
            is_open = true;
            events.push((i, GripperEnd::Open));
        }
    }
    events
}

/// `count` frames strictly within the path at which it pauses, in order.
pub(super) fn pauses(
    path: &[Pose],
    times: &[f64],
    count: usize,
    procedure: &str,
) -> Result<Vec<usize>, DemonstrationError> {
    let none =
        |reason: String| DemonstrationError::NoBoundary { procedure: procedure.into(), reason };
    if count == 0 {
        return Ok(Vec::new());
    }
    let n = path.len();
    if n < 8 {
        return Err(none(format!("{n} frames are too few to see a pause in")));
    }
    // Over about a tenth of a second to both sides.
    let speed = |i: usize| {
        let (a, b) = (i.saturating_sub(3), (i + 3).min(n - 1));
        twist_arc(&path[a], &path[b], RHO) / (times[b] - times[a]).max(1e-9)
    };
    let speeds: Vec<f64> = (0..n).map(speed).collect();
    let mut sorted = speeds.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[n / 2];
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| speeds[*a].total_cmp(&speeds[*b]));
    let mut cuts: Vec<usize> = Vec::new();
    for i in order {
        let free = [0, n - 1].iter().chain(&cuts).all(|c| (times[*c] - times[i]).abs() > APART);
        if free && speeds[i] < SLOW * median {
            cuts.push(i);
            if cuts.len() == count {
                cuts.sort_unstable();
                return Ok(cuts);
            }
        }
    }
    Err(none(format!("its end is not marked by a pause ({} of {count} pauses seen)", cuts.len())))
}

/// First and last frame of each procedure of the hand within `first..=last` (frames of `tools` and
/// `path`); neighbours share a frame.
pub(super) fn hand_bounds(
    tools: &[Option<Remapped>],
    path: &[Pose],
    times: &[f64],
    specs: &[ProcedureSpec],
    [first, last]: [usize; 2],
) -> Result<Vec<[usize; 2]>, DemonstrationError> {
    let events = grip_events(tools);
    let mut ends: Vec<Option<usize>> = Vec::new();
    let mut from = first;
    for (k, s) in specs.iter().enumerate() {
        let is_last = k + 1 == specs.len();
        let event = events.iter().find(|(i, e)| *i > from + 1 && *e == s.end);
        let end = match (s.end, event) {
            (GripperEnd::None, _) if !is_last => None,
            (GripperEnd::None, _) => Some(last),
            (_, Some((i, _))) => Some((*i).min(last)),
            // The recording may end before the hand is seen to open.
            (_, None) if is_last => Some(last),
            (e, None) => {
                let word = if e == GripperEnd::Close { "close" } else { "open" };
                return Err(DemonstrationError::NoBoundary {
                    procedure: s.name.clone(),
                    reason: format!("the hand is not seen to {word} after frame {from}"),
                });
            }
        };
        from = end.unwrap_or(from);
        ends.push(end);
    }
    // Ends without an event lie at pauses before the next that has one.
    let mut bounds = Vec::new();
    let (mut begin, mut k) = (first, 0);
    while k < ends.len() {
        let until = (k..ends.len()).find(|j| ends[*j].is_some()).unwrap_or(ends.len() - 1);
        let end = ends[until].unwrap_or(last);
        if end <= begin + 1 {
            return Err(DemonstrationError::NoBoundary {
                procedure: specs[until].name.clone(),
                reason: format!("it would end (frame {end}) where it begins (frame {begin})"),
            });
        }
        let cuts = pauses(&path[begin..=end], &times[begin..=end], until - k, &specs[k].name)?;
        let mut from = begin;
        for c in cuts.iter().map(|c| begin + c).chain([end]) {
            bounds.push([from, c]);
            from = c;
        }
        (begin, k) = (end, until + 1);
    }
    Ok(bounds)
}
