//! Reading the frames: what is refused, what is left out, what is bridged.

use super::{ParseConfig, ParseReport, RepairKind};
use crate::filter::{deflip, robust_mean};
use crate::{DemonstrationError, FrameObservation, canonical_reference};
use tdv_geometry::{Pose, Symmetry, pose_distance};

/// Frame index, pose, weight.
pub(super) type Seen = (usize, Pose, f64);

pub(super) fn check(frames: &[FrameObservation], need: usize) -> Result<(), DemonstrationError> {
    if frames.len() < need.max(2) {
        return Err(DemonstrationError::TooFewFrames { have: frames.len(), need: need.max(2) });
    }
    for (index, w) in frames.windows(2).enumerate() {
        if w[1].stamp <= w[0].stamp {
            let stamp = w[1].stamp.0;
            return Err(DemonstrationError::StampsOutOfOrder { index: index + 1, stamp });
        }
    }
    for (frame, f) in frames.iter().enumerate() {
        for (name, (pose, confidence)) in &f.objects {
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            if !numbers.chain([confidence]).all(|v| v.is_finite()) {
                let what = format!("pose or confidence of '{name}'");
                return Err(DemonstrationError::NotFinite { frame, what });
            }
            let norm = pose.rotation.norm();
            if (norm - 1.0).abs() > 1e-3 {
                let name = name.clone();
                return Err(DemonstrationError::NotARotation { frame, name, norm });
            }
        }
        if let Some(joints) = &f.hand
            && let Some(j) = joints.iter().position(|p| !p.coords.iter().all(|v| v.is_finite()))
        {
            return Err(DemonstrationError::NotFinite { frame, what: format!("hand joint {j}") });
        }
    }
    Ok(())
}

/// Usable poses of an object, and the frames dropped for lack of confidence.
fn usable(frames: &[FrameObservation], name: &str, min: f64) -> (Vec<Seen>, Vec<usize>) {
    let (mut seen, mut dropped) = (Vec::new(), Vec::new());
    for (i, f) in frames.iter().enumerate() {
        if let Some((pose, confidence)) = f.objects.get(name) {
            if *confidence >= min {
                seen.push((i, *pose, confidence.clamp(0.0, 1.0)));
            } else {
                dropped.push(i);
            }
        }
    }
    (seen, dropped)
}

fn note_dropped(report: &mut ParseReport, name: &str, dropped: &[usize], min: f64) {
    report.note_frames(
        RepairKind::LowConfidence,
        name,
        dropped,
        dropped.len() as f64,
        "frames",
        format!("poses with a confidence below {min} left out"),
    );
}

pub(super) fn object(
    frames: &[FrameObservation],
    name: &str,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<Vec<Seen>, DemonstrationError> {
    let (seen, dropped) = usable(frames, name, config.min_confidence);
    if seen.len() < config.min_frames.max(1) {
        return Err(DemonstrationError::ObjectMissing {
            name: name.to_string(),
            seen: seen.len(),
            frames: frames.len(),
            min_confidence: config.min_confidence,
            need: config.min_frames.max(1),
        });
    }
    note_dropped(report, name, &dropped, config.min_confidence);
    Ok(seen)
}

/// `T_base_reference`: the robust mean over the recording, in its canonical orientation. If it was
/// moved, the later half counts, for that is where the object is put.
pub(super) fn reference(
    frames: &[FrameObservation],
    name: &str,
    symmetry: &Symmetry,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<Pose, DemonstrationError> {
    let (seen, dropped) = usable(frames, name, config.min_confidence);
    let need = (config.min_frames / 3).max(3);
    let missing = || DemonstrationError::ReferenceMissing {
        name: name.to_string(),
        seen: seen.len(),
        frames: frames.len(),
        need,
    };
    if seen.len() < need {
        return Err(missing());
    }
    note_dropped(report, name, &dropped, config.min_confidence);
    let mut poses: Vec<Pose> = seen.iter().map(|s| s.1).collect();
    let near = poses[0].rotation;
    deflip(&mut poses, symmetry, &near);
    let half = poses.len() / 2;
    let (early, late) = (robust_mean(&poses[..half.max(1)]), robust_mean(&poses[half..]));
    let (Some(early), Some(late)) = (early, late) else { return Err(missing()) };
    let shift = pose_distance(&early.0, &late.0).0;
    let (mean, spread, _) = if shift > config.reference_shift {
        report.note(
            RepairKind::ReferenceMoved,
            name,
            seen.len(),
            shift,
            "m",
            "it is elsewhere in the second half of the recording: that half counts",
        );
        late
    } else {
        robust_mean(&poses).ok_or_else(missing)?
    };
    let fixed = canonical_reference(&mean, symmetry);
    report.note(
        RepairKind::ReferenceFixed,
        name,
        seen.len(),
        spread,
        "m",
        format!(
            "one pose from {} frames (median spread {:.1} mm, canonical orientation turned by {:.1} deg)",
            seen.len(),
            1000.0 * spread,
            pose_distance(&fixed, &mean).1.to_degrees()
        ),
    );
    Ok(fixed)
}

/// Reports stretches without the object; refuses those that are too long.
pub(super) fn bridge(
    seen: &[Seen],
    times: &[f64],
    what: &str,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<(), DemonstrationError> {
    let mut frames = Vec::new();
    let mut longest = 0.0f64;
    for w in seen.windows(2) {
        let (a, b) = (w[0].0, w[1].0);
        if b == a + 1 {
            continue;
        }
        let seconds = times[b] - times[a];
        if seconds > config.max_gap {
            return Err(DemonstrationError::GapTooLong {
                what: what.to_string(),
                frame: a + 1,
                seconds,
                allowed: config.max_gap,
            });
        }
        longest = longest.max(seconds);
        frames.extend(a + 1..b);
    }
    let text = "frames without the object bridged; magnitude is the longest gap";
    report.note_frames(RepairKind::GapFilled, what, &frames, longest, "s", text);
    Ok(())
}
