//! The grasp pose, fitted to the gripper, and the way to it.

use super::carry::pin_ends;
use super::input::Seen;
use super::{GraspChange, ParseConfig, ParseReport, RepairKind, timed};
use crate::filter::{Sample, robust_mean, smooth};
use crate::keyframe::Keyframes;
use crate::{DemonstrationError, GraspConfig, Remapped, canonical_tool};
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{Pose, PoseTrajectory};

pub(super) fn tool_samples(
    tools: &[Option<Remapped>],
    times: &[f64],
    from: usize,
    to: usize,
) -> Vec<Sample> {
    (from..=to.min(tools.len() - 1))
        .filter_map(|i| {
            let t = tools[i]?;
            let weight = if t.valid { t.confidence } else { 0.1 };
            Some(Sample { time: times[i], pose: t.pose, weight })
        })
        .collect()
}

pub(super) fn check_gap(
    samples: &[Sample],
    config: &ParseConfig,
    what: &str,
) -> Result<(), DemonstrationError> {
    for (i, w) in samples.windows(2).enumerate() {
        let seconds = w[1].time - w[0].time;
        if seconds > config.max_gap {
            return Err(DemonstrationError::GapTooLong {
                what: what.to_string(),
                frame: i + 1,
                seconds,
                allowed: config.max_gap,
            });
        }
    }
    Ok(())
}

/// `T_object_tcp` and the object's width between the fingers, if the task knows it.
#[allow(clippy::too_many_arguments)]
pub(super) fn grasp(
    seen: &[Seen],
    smoothed: &[Pose],
    tools: &[Option<Remapped>],
    times: &[f64],
    keys: &Keyframes,
    rest: &Pose,
    config: &GraspConfig,
    report: &mut ParseReport,
) -> Result<(Pose, Option<f64>), DemonstrationError> {
    // From contact to a third of a second into the motion the hand sits still on the object.
    let until = times.partition_point(|t| *t <= times[keys.onset] + 0.3).min(keys.settled + 1);
    let relative: Vec<Pose> = (keys.contact..until)
        .filter_map(|i| {
            let tool = tools[i].filter(|t| t.valid)?;
            let object = if i <= keys.onset { *rest } else { smoothed[i] };
            Some(object.inverse() * tool.pose)
        })
        .collect();
    let Some((demonstrated, spread, turn)) = robust_mean(&relative) else {
        return Err(DemonstrationError::NoGrasp {
            reason: format!(
                "no trustworthy hand between contact (frame {}) and lift (frame {}); {} object poses",
                keys.contact,
                until,
                seen.len()
            ),
        });
    };
    report.note(
        RepairKind::Smoothed,
        "grasp",
        relative.len(),
        spread,
        "m",
        format!(
            "grasp pose averaged over {} frames; median deviation {:.1} mm, {:.1} deg",
            relative.len(),
            1000.0 * spread,
            turn.to_degrees()
        ),
    );
    let (fitted, width, change) = fit(&demonstrated, config)?;
    report.grasp_change = change;
    report.note_grasp(&change);
    Ok((canonical_tool(&fitted, &demonstrated).0, width))
}

/// The grasp nearest to `T_object_tcp` that the gripper can do; the object's z axis points up.
pub(super) fn fit(
    pose: &Pose,
    config: &GraspConfig,
) -> Result<(Pose, Option<f64>, GraspChange), DemonstrationError> {
    let (closing, approach) = (pose.rotation * Vector3::y(), pose.rotation * Vector3::z());
    let down = -Vector3::z();
    let mut change = GraspChange::default();
    let mut y = closing;
    let mut width = None;
    if !config.closing.is_empty() {
        let nearest = config
            .closing
            .iter()
            .filter(|c| c.width + config.clearance <= config.max_opening)
            .filter_map(|c| Some((Vector3::from(c.axis).try_normalize(1e-9)?, c.width)))
            .max_by(|a, b| a.0.dot(&closing).abs().total_cmp(&b.0.dot(&closing).abs()));
        let Some((axis, w)) = nearest else {
            return Err(DemonstrationError::GraspDoesNotFit {
                reason: format!("no closing axis is narrower than {} m", config.max_opening),
            });
        };
        y = axis * if axis.dot(&closing) < 0.0 { -1.0 } else { 1.0 };
        width = Some(w);
        change.closing_deg = y.angle(&closing).to_degrees();
        if change.closing_deg > config.max_turn_deg {
            return Err(DemonstrationError::GraspDoesNotFit {
                reason: format!(
                    "the demonstrated closing axis is {:.0} deg from the nearest allowed one, {:.0} deg are \
                     allowed (grasp.max_turn_deg)",
                    change.closing_deg, config.max_turn_deg
                ),
            });
        }
    }
    // The approach stays as near to the demonstrated as the closing axis and the tilt limit let it.
    let plane = |v: Vector3<f64>| v - y * v.dot(&y);
    let straight = plane(down);
    let mut z = plane(approach);
    if z.norm() < 0.2 {
        z = if straight.norm() > 0.2 { straight } else { approach };
    }
    z = z.normalize();
    let max_tilt = config.max_tilt_deg.to_radians();
    let tilt = z.angle(&down);
    if tilt > max_tilt && straight.norm() > 1e-6 {
        let straight = straight.normalize();
        let reach = max_tilt.max(straight.angle(&down)) - straight.angle(&down);
        let share = (reach / z.angle(&straight).max(1e-9)).min(1.0);
        let turn = UnitQuaternion::rotation_between(&straight, &z)
            .unwrap_or_else(|| UnitQuaternion::from_scaled_axis(y * std::f64::consts::PI));
        z = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * share) * straight;
    }
    z = (z - y * z.dot(&y)).normalize();
    change.approach_deg = z.angle(&approach).to_degrees();
    let rotation = crate::path::from_axes(&y.cross(&z), &y, &z);

    let mut p = pose.translation.vector;
    if config.centre {
        let off = Vector3::new(p.x, p.y, 0.0);
        // From above the axis goes through the tcp; from the side only the closing direction counts.
        let flat = Vector3::new(z.x, z.y, 0.0);
        let kept = if -z.z < 0.7 && flat.norm() > 1e-6 {
            let flat = flat.normalize();
            flat * off.dot(&flat)
        } else {
            Vector3::zeros()
        };
        change.sideways = (off - kept).norm();
        p -= off - kept;
    }
    if let Some([low, high]) = config.height {
        let z = p.z.clamp(low, high);
        change.height = z - p.z;
        p.z = z;
    }
    Ok((Pose::from_parts(p.into(), rotation), width, change))
}

/// `T_object_tcp` from the first hand to the grasp.
pub(super) fn reach(
    tools: &[Option<Remapped>],
    times: &[f64],
    keys: &Keyframes,
    rest: &Pose,
    grasp: &Pose,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<PoseTrajectory, DemonstrationError> {
    let samples = tool_samples(tools, times, 0, keys.contact);
    let seen: Vec<f64> = samples.iter().map(|s| s.time).collect();
    let enough = samples.iter().filter(|s| s.weight > 0.1).count() >= 3 && keys.contact >= 3;
    if !enough {
        report.note(
            RepairKind::ApproachAdded,
            "hand",
            samples.len(),
            0.10,
            "m",
            "the hand is not seen before contact: a straight approach of 0.10 m is added",
        );
        let before = grasp * Pose::translation(0.0, 0.0, -0.10);
        return timed(&[before, *grasp], &[0.0, 1.0], "reach");
    }
    check_gap(&samples, config, "the hand before the grasp")?;
    let first = seen[0];
    let span: Vec<f64> = times[..=keys.contact].iter().copied().filter(|t| *t >= first).collect();
    let path: Vec<Pose> =
        smooth(&samples, &span, &config.filter).iter().map(|p| rest.inverse() * p).collect();
    if span.len() > samples.len() {
        report.note(
            RepairKind::GapFilled,
            "hand",
            span.len() - samples.len(),
            0.0,
            "",
            "frames without a hand before the grasp bridged",
        );
    }
    let (last, _) = canonical_tool(&path[path.len() - 1], grasp);
    let flipped = last != path[path.len() - 1];
    let path: Vec<Pose> = if flipped {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        path.iter().map(|p| Pose::from_parts(p.translation, p.rotation * turn)).collect()
    } else {
        path
    };
    timed(&pin_ends(&path, &path[0], grasp), &span, "reach")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClosingAxis;
    use tdv_geometry::pose_from_xyz_rpy;

    fn config() -> GraspConfig {
        GraspConfig {
            closing: vec![
                ClosingAxis { axis: [1.0, 0.0, 0.0], width: 0.09 },
                ClosingAxis { axis: [0.0, 1.0, 0.0], width: 0.063 },
            ],
            max_tilt_deg: 0.0,
            centre: true,
            height: Some([0.05, 0.07]),
            ..Default::default()
        }
    }

    #[test]
    fn a_side_grasp_across_the_broad_side_becomes_one_from_above() {
        // approach +y, closing +x, 30 mm off the axis
        let pose = Pose::from_parts(
            [0.03, -0.02, 0.01].into(),
            crate::path::from_axes(&Vector3::z(), &Vector3::x(), &Vector3::y()),
        );
        let (g, width, change) = fit(&pose, &config()).unwrap();
        assert_eq!(width, Some(0.063));
        assert!((g.rotation * Vector3::z() + Vector3::z()).norm() < 1e-9);
        assert!((g.rotation * Vector3::y()).y.abs() > 1.0 - 1e-9);
        assert!(
            (change.closing_deg - 90.0).abs() < 1e-6 && (change.approach_deg - 90.0).abs() < 1e-6
        );
        assert!((change.height - 0.04).abs() < 1e-9 && g.translation.vector.xy().norm() < 1e-12);
        let tight = GraspConfig { max_turn_deg: 45.0, ..config() };
        assert!(matches!(fit(&pose, &tight), Err(DemonstrationError::GraspDoesNotFit { .. })));
    }

    #[test]
    fn tilt_is_limited_not_removed() {
        let pose = pose_from_xyz_rpy([0.0, 0.0, 0.06], [std::f64::consts::PI, 0.6, 0.0]);
        for limit in [0.0f64, 20.0, 180.0] {
            let c = GraspConfig { max_tilt_deg: limit, ..config() };
            let (g, ..) = fit(&pose, &c).unwrap();
            let tilt = (g.rotation * Vector3::z()).angle(&-Vector3::z()).to_degrees();
            assert!((tilt - limit.min(0.6f64.to_degrees())).abs() < 1e-4, "{limit}: {tilt}");
        }
        let free = GraspConfig::default();
        let (g, width, change) = fit(&pose, &free).unwrap();
        assert!(tdv_geometry::pose_distance(&g, &pose).1 < 1e-7 && width.is_none());
        assert!(change.height == 0.0 && change.sideways == 0.0);
    }
}
