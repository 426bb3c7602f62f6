//! Why a generated path is refused.

use crate::ObjectShape;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Vector3;

/// How far the fingertips reach beyond the tcp (m): a 2F-85's end moves by 13.5 mm while closing.
pub(crate) const TIP: f64 = 0.015;

/// z of the lowest point (m) of an upright-cylinder object in the frame of `pose`'s parent.
pub(crate) fn lowest(pose: &Pose, shape: &ObjectShape) -> f64 {
    let up = pose.rotation * Vector3::z();
    let sine = (1.0 - up.z * up.z).max(0.0).sqrt();
    let low = if up.z >= 0.0 { shape.bottom } else { shape.top() };
    pose.translation.z + low * up.z - 0.6 * shape.radius * sine
}

pub(super) fn finite(path: &[Pose]) -> Result<(), String> {
    let ok = path.iter().all(|p| {
        p.translation.vector.iter().chain(p.rotation.coords.iter()).all(|v| v.is_finite())
    });
    if ok { Ok(()) } else { Err("not finite".into()) }
}

/// Whether an object that stands at `pose` would stand in its reference, both as cylinders.
pub(super) fn inside(pose: &Pose, moving: &ObjectShape, reference: &ObjectShape) -> bool {
    pose.translation.x.hypot(pose.translation.y) < reference.radius + 0.8 * moving.radius
        && lowest(pose, moving) < reference.top() - 0.002
}

/// Path of an object seen from its reference: not through the table, not dragged over it, not through
/// the reference. `from_rest`: the path starts standing on the table; `lands`: it ends standing, else it
/// may come into the reference near its end, as a spout does.
pub(super) fn carried(
    path: &[Pose],
    moving: &ObjectShape,
    reference: &ObjectShape,
    from_rest: bool,
    lands: bool,
) -> Result<(), String> {
    let (Some(first), Some(last)) = (path.first(), path.last()) else { return Ok(()) };
    let apart = |a: &Pose, b: &Pose| {
        (a.translation.x - b.translation.x).hypot(a.translation.y - b.translation.y)
    };
    let rest = lowest(first, moving);
    for p in path {
        let low = lowest(p, moving);
        if low < reference.bottom - 0.004 {
            return Err("below the table".into());
        }
        let to_goal = apart(p, last);
        if from_rest && apart(p, first) > 0.015 && to_goal > 0.03 && low < rest + 0.005 {
            return Err("dragged over the table".into());
        }
        let near = if lands { 0.03 } else { 0.10 };
        if to_goal > near && inside(p, moving, reference) {
            return Err("hits the reference object".into());
        }
    }
    Ok(())
}

/// Whether the gripper's fingers are above the table; its pose is seen from what stands there.
pub(super) fn fingers_above(pose: &Pose, table: f64) -> bool {
    let down = -(pose.rotation * Vector3::z()).z;
    pose.translation.z - TIP * down.max(0.0) >= table - 0.002
}

/// Path of the gripper seen from an object that stands on the table.
pub(super) fn above_table(path: &[Pose], table: f64) -> Result<(), String> {
    if path.iter().all(|p| fingers_above(p, table)) {
        Ok(())
    } else {
        Err("fingers below the table".into())
    }
}
