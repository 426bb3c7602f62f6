//! Import of a real recording: the parse of one human RGB-D video from dexmv-sim (Apache-2.0), a mustard
//! bottle (YCB 006) carried by hand. The file `dexmv_mustard.json` holds 21 hand joints and the bottle's
//! pose per frame, raw and noisy, in the camera that saw the bottle.
//!
//! What the recording does not say is assumed, what is broken is repaired, and both are reported:
//! - **Rate**: not stored, 30 Hz assumed.
//! - **Rotations**: orthonormal to 7e-3 only; made orthonormal.
//! - **Flips**: the bottle's rotation about its long axis jumps by over 30 deg in most steps at rest. It is
//!   steady only at the end, so every pose takes the yaw nearest to the end's: the long axis is kept, the
//!   turn about it is not believed.
//! - **Table**: neither gravity nor a table frame is given. The bottle stands at the start, so its long
//!   axis there is the table's normal, and the plane lies under its bottom.
//! - **Place in front of the robot**: free. The disc stands where the path ends, its centre at
//!   [`ImportOptions::disc`], and the bottle's last yaw is zero in base_link.
//! - **Release and retreat**: not recorded; added.
//!
//! Everything else (smoothing, both ends set upright on the table, the grasp fitted to the gripper) is
//! what [`crate::parse`] does to any recording.

use crate::filter::robust_mean;
use crate::{
    Demonstration, DemonstrationError, FrameObservation, ParseConfig, ParseReport, RepairKind,
    Task, TaskKind, file, parse,
};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::nalgebra::{Matrix3, Point3, Vector3};
use tdv_geometry::{Pose, Stamp, Symmetry, pose_from_xyz_rpy, rotation_from_matrix};

/// How the recording is set before the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportOptions {
    /// Frames per second.
    pub rate: f64,
    /// Centre of the added disc (m, base_link).
    pub disc: [f64; 2],
    /// How the frames are parsed.
    pub parse: ParseConfig,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self { rate: 30.0, disc: [0.45, -0.24], parse: ParseConfig::default() }
    }
}

/// An imported recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The recording in base_link, de-flipped but not smoothed, disc included.
    pub frames: Vec<FrameObservation>,
    /// The demonstration.
    pub demonstration: Demonstration,
    /// Every repair and assumption, those of the import first.
    pub report: ParseReport,
}

/// The parts of the file that are read.
#[derive(Deserialize)]
struct Recording {
    frame_ids: Vec<i64>,
    joints_m_object_camera: Vec<Vec<[f64; 3]>>,
    #[serde(rename = "T_object_camera_object")]
    object: Vec<[[f64; 4]; 4]>,
}

/// The bottle's name where the task does not speak of it.
const BOTTLE: &str = "bottle";
/// Largest deviation from orthonormal that counts as rounding.
const ORTHONORMAL: f64 = 0.02;

/// The catalogue's bottle in the frame of the YCB mesh, which lies near the middle of the bottle and is
/// turned against its oval: middle of the underside (m) ...
const CATALOGUE_XYZ: [f64; 3] = [-0.0011, -0.0022, -0.0839];
/// ... and x along the long axis of the oval (rad), both measured on the mesh's vertices.
const CATALOGUE_YAW: f64 = -0.300;

/// Reads the recording (the file, or the folder that holds it) and turns it into a demonstration of `task` (its moving object is the bottle of
/// the catalogue, its reference object the disc).
///
/// # Errors
/// [`DemonstrationError::Io`], [`DemonstrationError::Format`] naming the frame, and what
/// [`crate::parse`] gives.
pub fn import(
    path: &Path,
    task: &Task,
    options: &ImportOptions,
) -> Result<Imported, DemonstrationError> {
    let inside = path.join("dexmv_mustard.json");
    let path = if path.is_dir() { inside.as_path() } else { path };
    let text = file::read(path)?;
    let format = |reason| DemonstrationError::Format { path: path.to_path_buf(), reason };
    let raw: Recording = serde_json::from_str(&text).map_err(|e| format(e.to_string()))?;
    let mut notes = ParseReport::default();
    let (poses, joints) = read(&raw, &mut notes).map_err(format)?;
    let (frames, mut report) = to_frames(&raw, poses, joints, task, options, notes)?;
    let (demonstration, parsed) = parse(&frames, task, &options.parse)?;
    let mut repairs = std::mem::take(&mut report.repairs);
    report = parsed;
    repairs.append(&mut report.repairs);
    report.repairs = repairs;
    Ok(Imported { frames, demonstration, report })
}

type Read = (Vec<Pose>, Vec<[Point3<f64>; 21]>);

fn read(raw: &Recording, notes: &mut ParseReport) -> Result<Read, String> {
    let n = raw.frame_ids.len();
    if raw.object.len() != n || raw.joints_m_object_camera.len() != n {
        return Err(format!(
            "{n} frame_ids, {} bottle poses and {} hands: the file is cut off or damaged",
            raw.object.len(),
            raw.joints_m_object_camera.len()
        ));
    }
    let mut worst = 0.0f64;
    let mut poses = Vec::with_capacity(n);
    for (i, m) in raw.object.iter().enumerate() {
        let r = Matrix3::from_fn(|a, b| m[a][b]);
        worst = worst.max((r.transpose() * r - Matrix3::identity()).abs().max());
        let rotation = rotation_from_matrix(&r, ORTHONORMAL)
            .map_err(|e| format!("T_object_camera_object of frame {i}: {e}"))?;
        let mesh = Pose::from_parts([m[0][3], m[1][3], m[2][3]].into(), rotation);
        poses.push(mesh * pose_from_xyz_rpy(CATALOGUE_XYZ, [0.0, 0.0, CATALOGUE_YAW]));
    }
    let text = "rotation matrices made orthonormal; magnitude is the largest deviation of a column product";
    notes.note(RepairKind::Orthonormalised, "bottle", n, worst, "", text);
    let joints = raw
        .joints_m_object_camera
        .iter()
        .enumerate()
        .map(|(i, j)| {
            let j: [[f64; 3]; 21] = j.as_slice().try_into().map_err(|_| {
                format!("joints_m_object_camera of frame {i} has {} joints, expected 21", j.len())
            })?;
            Ok(j.map(|p| Point3::new(p[0], p[1], p[2])))
        })
        .collect::<Result<_, String>>()?;
    Ok((poses, joints))
}

fn to_frames(
    raw: &Recording,
    mut poses: Vec<Pose>,
    joints: Vec<[Point3<f64>; 21]>,
    task: &Task,
    options: &ImportOptions,
    mut notes: ParseReport,
) -> Result<(Vec<FrameObservation>, ParseReport), DemonstrationError> {
    let n = poses.len();
    // A hand task follows the hand alone: the bottle still says where the table is.
    let hand_task = task.kind == TaskKind::Hand;
    let name = if hand_task { BOTTLE.to_string() } else { task.moving_object.clone() };
    if n < 30 {
        return Err(DemonstrationError::TooFewFrames { have: n, need: 30 });
    }
    let bottom = match task.moving_shape() {
        Some(shape) => shape.bottom,
        None if hand_task => 0.0,
        None => {
            return Err(DemonstrationError::Invalid {
                what: format!("task '{}'", task.name),
                problems: vec![format!("objects has no entry for '{name}'")],
            });
        }
    };
    let none = || DemonstrationError::TooFewFrames { have: n, need: 30 };

    // De-flip: only the end, where the hand is still and the bottle near, has a steady yaw.
    let (end, ..) = robust_mean(&poses[n - 15..]).ok_or_else(none)?;
    let symmetry = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
    let jumps = poses
        .windows(2)
        .filter(|w| w[0].rotation.angle_to(&w[1].rotation) > 30f64.to_radians())
        .count();
    let (mut changed, mut largest) = (0, 0.0f64);
    for p in &mut poses {
        let q = symmetry.nearest(p, &end.rotation);
        let angle = q.rotation.angle_to(&p.rotation).to_degrees();
        changed += usize::from(angle > 1.0);
        largest = largest.max(angle);
        *p = q;
    }
    notes.note(
        RepairKind::Deflipped,
        &name,
        changed,
        largest,
        "deg",
        format!(
            "{jumps} steps turn by over 30 deg about the long axis: every pose takes the yaw nearest to the \
             end's, the only steady one"
        ),
    );

    // Table: the long axis of the bottle while it has not moved.
    let (first, ..) = robust_mean(&poses[..n / 5]).ok_or_else(none)?;
    let moved = poses
        .iter()
        .position(|p| (p.translation.vector - first.translation.vector).norm() > 0.03)
        .unwrap_or(n);
    let (rest, spread, tilt) = robust_mean(&poses[..moved.max(10).min(n)]).ok_or_else(none)?;
    let up = rest.rotation * Vector3::z();
    notes.note(
        RepairKind::Assumed,
        "table",
        moved,
        tilt.to_degrees(),
        "deg",
        format!(
            "neither gravity nor table frame is recorded: the table's normal is the long axis of the resting \
             bottle (frames 0..{moved}, median deviation {:.1} deg, {:.1} mm), its plane lies under the \
             bottle's bottom",
            tilt.to_degrees(),
            1000.0 * spread
        ),
    );

    // base_link: z along the normal, x along the bottle's last x axis, the disc where the path ends.
    let x = end.rotation * Vector3::x();
    let x = (x - up * x.dot(&up)).try_normalize(1e-6).ok_or_else(none)?;
    let turn = crate::path::from_axes(&x, &up.cross(&x), &up).inverse();
    let bottom = rest.translation.vector + up * bottom;
    let under = turn * end.translation.vector;
    let shift =
        Vector3::new(options.disc[0] - under.x, options.disc[1] - under.y, -(turn * bottom).z);
    let base = Pose::from_parts(shift.into(), turn);
    notes.note(
        RepairKind::Assumed,
        "base_link",
        n,
        0.0,
        "",
        format!(
            "the recording has no robot: the disc's centre is set to ({:.2}, {:.2}) and the bottle's last yaw \
             to zero in base_link",
            options.disc[0], options.disc[1]
        ),
    );
    notes.note(
        RepairKind::Assumed,
        &task.reference_object,
        n,
        0.0,
        "",
        "there is no reference object in the recording: a flat disc is put where the path ends",
    );
    let text = format!("the frame rate is not stored, {} Hz assumed", options.rate);
    notes.note(RepairKind::Assumed, "stamps", n, options.rate, "Hz", text);

    let disc = Pose::translation(options.disc[0], options.disc[1], 0.0);
    let first_id = raw.frame_ids.first().copied().unwrap_or(0);
    let frames = poses
        .iter()
        .zip(&joints)
        .zip(&raw.frame_ids)
        .map(|((pose, hand), id)| FrameObservation {
            stamp: Stamp::from_secs((id - first_id) as f64 / options.rate),
            objects: BTreeMap::from([
                (name.clone(), (base * pose, 1.0)),
                (task.reference_object.clone(), (disc, 1.0)),
            ]),
            hand: Some(hand.map(|p| base * p)),
        })
        .collect();
    Ok((frames, notes))
}

#[cfg(test)]
mod tests;
