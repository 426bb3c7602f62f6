//! From anywhere to the first pose of a hand's path, which is not bent itself.

use super::check::{TIP, above_table};
use crate::ObjectShape;
use crate::path::round_corners;
use tdv_geometry::Pose;

/// Half width (m) over which corners are rounded.
const ROUND: f64 = 0.03;

/// `start` -> up -> above the path's begin -> down to it -> the path, exactly. `reference`: what stands at
/// the origin and is not to be swept on the way.
pub(super) fn lead_in(
    path: &[Pose],
    start: &Pose,
    reference: &ObjectShape,
    margin: f64,
) -> Result<Vec<Pose>, String> {
    let Some(first) = path.first() else { return Ok(Vec::new()) };
    let (a, b) = (start.translation.vector, first.translation.vector);
    let along = b - a;
    // Nearest horizontal distance of the straight way to the reference's axis.
    let flat = along.x.hypot(along.y);
    let at = if flat > 1e-9 {
        (-(a.x * along.x + a.y * along.y) / (flat * flat)).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let near = (a.x + at * along.x).hypot(a.y + at * along.y) < reference.radius + 0.06;
    let clear = reference.top() + margin + TIP;
    let safe = if near { clear } else { f64::NEG_INFINITY };
    let raised = |p: &Pose| {
        let mut q = *p;
        q.translation.z = q.translation.z.max(safe).max(a.z.min(b.z));
        q
    };
    let corners = [*start, raised(start), raised(first), *first];
    let mut out = round_corners(&corners, ROUND, 0.01);
    out.extend(path.iter().skip(1).copied());
    above_table(&out, reference.bottom)?;
    Ok(out)
}
