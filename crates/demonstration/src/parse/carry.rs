//! The carried object's path: where it rests, and the way between.

use super::{ParseConfig, ParseReport, RepairKind};
use crate::keyframe::Keyframes;
use crate::path::arcs;
use crate::warp::lift_first;
use crate::{DemonstrationError, ObjectShape, TargetYaw};
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{Pose, pose_distance, smooth_step, yaw_of};

/// Height (m) within which an object is set down straight.
const SET_DOWN: f64 = 0.015;

/// What is carried, and where to.
pub(super) struct Carry<'a> {
    pub name: &'a str,
    pub shape: &'a ObjectShape,
    /// `T_base_reference` of the last procedure.
    pub reference: &'a Pose,
    pub reference_shape: &'a ObjectShape,
    pub target_yaw: TargetYaw,
    /// It is let go at the end.
    pub lands: bool,
}

impl Carry<'_> {
    /// `T_base_object` at the start and `T_reference_object` at the end, standing if the object stands.
    pub(super) fn rest_ends(
        &self,
        start: &Pose,
        end: &Pose,
        config: &ParseConfig,
        report: &mut ParseReport,
    ) -> Result<(Pose, Pose), DemonstrationError> {
        let Self { name, shape, reference, reference_shape, .. } = self;
        let mut first = *start;
        let mut last = reference.inverse() * end;
        if shape.stands {
            first = stand(&first, -shape.bottom, "start", name, config, report)?;
        }
        if shape.stands && self.lands {
            let beside = last.translation.x.hypot(last.translation.y);
            let surface = if beside < reference_shape.radius + 0.5 * shape.radius {
                reference_shape.top()
            } else {
                reference_shape.bottom
            };
            last = stand(&last, surface - shape.bottom, "end", name, config, report)?;
        }
        if let TargetYaw::Fixed(deg) = self.target_yaw {
            let turn = deg.to_radians() - yaw_of(&last.rotation);
            let turn = turn.sin().atan2(turn.cos());
            last.rotation =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * last.rotation;
            report.note(
                RepairKind::YawFixed,
                name,
                1,
                turn.to_degrees(),
                "deg",
                format!("the task fixes the yaw of the target at {deg} deg"),
            );
        }
        Ok((first, last))
    }

    /// `T_reference_object` from lift to set-down, a pose per frame.
    pub(super) fn path(
        &self,
        smoothed: &[Pose],
        times: &[f64],
        keys: &Keyframes,
        ends: &(Pose, Pose),
        report: &mut ParseReport,
    ) -> Vec<Pose> {
        let Self { shape, reference, reference_shape, .. } = self;
        let inverse = reference.inverse();
        let path: Vec<Pose> =
            smoothed[keys.onset..=keys.settled].iter().map(|p| inverse * p).collect();
        let times = &times[keys.onset..=keys.settled];
        let mut path = pin_ends(&path, &(inverse * ends.0), &ends.1);
        report.carried = path.windows(2).map(|w| pose_distance(&w[0], &w[1]).0).sum();

        if shape.stands {
            let mut raised = 0.0f64;
            let mut frames = Vec::new();
            let (first, last) = (path[0], path[path.len() - 1]);
            for (i, p) in path.iter_mut().enumerate() {
                let floor = if self.lands {
                    floor_under(p, &first, &last, reference_shape)
                } else {
                    reference_shape.bottom
                };
                let lift = floor - crate::generate::lowest(p, shape);
                if lift > 1e-4 && i > 0 && i < times.len() - 1 {
                    p.translation.z += lift;
                    raised = raised.max(lift);
                    frames.push(keys.onset + i);
                }
            }
            let text = "raised so that the object goes neither through the table nor through the reference";
            report.note_frames(RepairKind::Raised, "path", &frames, raised, "m", text);
        }
        if self.lands {
            set_down(&mut path, report);
        }
        path
    }
}

/// Sets a pose upright (smallest turn) and its height to `z`.
fn stand(
    pose: &Pose,
    z: f64,
    which: &str,
    name: &str,
    config: &ParseConfig,
    report: &mut ParseReport,
) -> Result<Pose, DemonstrationError> {
    let up = pose.rotation * Vector3::z();
    let turn = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_else(|| {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    });
    let tilt = turn.angle().to_degrees();
    if tilt > config.max_upright_deg {
        return Err(DemonstrationError::Invalid {
            what: "demonstration".into(),
            problems: vec![format!(
                "'{name}' is tilted by {tilt:.0} deg at the {which} of its path, at most {:.0} deg can be \
                 set upright; if it does not stand there, say `stands: false` in the task",
                config.max_upright_deg
            )],
        });
    }
    report.note(
        RepairKind::SetUpright,
        name,
        1,
        tilt,
        "deg",
        format!("set upright at the {which}, the correction fades out along the path"),
    );
    report.note(
        RepairKind::SetOnSurface,
        name,
        1,
        z - pose.translation.z,
        "m",
        format!("set onto the surface at the {which}, the correction fades out along the path"),
    );
    let mut out = Pose::from_parts(pose.translation, turn * pose.rotation);
    out.translation.z = z;
    Ok(out)
}

/// Height of what is under the object: near either end it is what it stands on.
fn floor_under(p: &Pose, first: &Pose, last: &Pose, reference: &ObjectShape) -> f64 {
    let apart =
        |q: &Pose| (p.translation.x - q.translation.x).hypot(p.translation.y - q.translation.y);
    if apart(last) < reference.radius.min(0.5 * apart(first)) {
        reference.top()
    } else {
        reference.bottom
    }
}

/// The path with exact ends; the corrections fade over the first and the last 40 % of its length.
pub(super) fn pin_ends(path: &[Pose], first: &Pose, last: &Pose) -> Vec<Pose> {
    let arcs = arcs(path);
    let total = arcs.last().copied().unwrap_or(0.0).max(1e-9);
    let (Some(a), Some(b)) = (path.first(), path.last()) else { return Vec::new() };
    let shift = |from: &Pose, to: &Pose| to.translation.vector - from.translation.vector;
    let turn = |from: &Pose, to: &Pose| (to.rotation * from.rotation.inverse()).scaled_axis();
    let (sa, sb, ta, tb) = (shift(a, first), shift(b, last), turn(a, first), turn(b, last));
    let mut out: Vec<Pose> = path
        .iter()
        .zip(&arcs)
        .map(|(p, s)| {
            let u = s / total;
            let (wa, wb) = (1.0 - smooth_step(u / 0.4), smooth_step((u - 0.6) / 0.4));
            let exp = |v: Vector3<f64>| UnitQuaternion::from_scaled_axis(v);
            let rotation = exp(tb * wb) * exp(ta * wa) * p.rotation;
            Pose::from_parts((p.translation.vector + sa * wa + sb * wb).into(), rotation)
        })
        .collect();
    let n = out.len();
    out[0] = *first;
    out[n - 1] = *last;
    out
}

/// Makes the last [`SET_DOWN`] metres of height vertical, if they are not: the end of the path is what
/// every generated trajectory copies.
fn set_down(path: &mut Vec<Pose>, report: &mut ParseReport) {
    let Some(last) = path.last().copied() else { return };
    let sideways = |path: &[Pose]| {
        let low = path.iter().rev().take_while(|p| p.translation.z - last.translation.z < SET_DOWN);
        low.map(|p| {
            (p.translation.x - last.translation.x).hypot(p.translation.y - last.translation.y)
        })
        .fold(0.0, f64::max)
    };
    let before = sideways(path);
    if before < 0.004 {
        return;
    }
    let reversed: Vec<Pose> = path.iter().rev().copied().collect();
    let (mut held, done) = lift_first(&reversed, SET_DOWN, 0.3);
    if done.is_none() {
        return;
    }
    held.reverse();
    let n = held.len();
    held[n - 1] = last;
    let after = sideways(&held);
    report.note(
        RepairKind::SetDown,
        "path",
        1,
        before - after,
        "m",
        format!(
            "sideways motion in the last {:.0} mm of height reduced from {:.0} to {:.0} mm",
            1000.0 * SET_DOWN,
            1000.0 * before,
            1000.0 * after
        ),
    );
    *path = held;
}
