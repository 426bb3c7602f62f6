//! One demonstrated path bent so that it starts somewhere else.
//!
//! Notation: everything in the reference (goal) frame, z up; `P_i`, `O_i` position and orientation of the
//! demonstration, `E` its last position, a hat for the generated path. `v = E - P_0`.

mod comparators;

pub use comparators::{warp_dmp, warp_rigid};

use crate::path::arcs;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{Pose, smooth_step};

/// Settings of [`warp_repaired`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WarpConfig {
    /// Last fraction of the path (SE(3) arc length) that is kept exactly.
    pub alpha: f64,
    /// Fraction of the path up to which the change of start is carried in full.
    pub fade_from: f64,
    /// The horizontal scale is kept within these.
    pub scale: [f64; 2],
    /// Horizontal start distance (m) below which there is no direction to turn and scale by.
    pub min_radius: f64,
}

impl Default for WarpConfig {
    fn default() -> Self {
        Self { alpha: 0.25, fade_from: 0.0, scale: [1.0 / 3.0, 3.0], min_radius: 0.03 }
    }
}

/// How a path was bent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WarpRule {
    /// Section 3.2 of the paper.
    Paper,
    /// Turned and scaled about the goal's vertical, fading out.
    LogPolar,
    /// Only the difference of the starts, fading out: the demonstration or the new start stands
    /// (nearly) above the goal.
    OffsetFade,
    /// A straight line into the kept last part, see [`warp_rigid`].
    Rigid,
    /// A dynamic movement primitive, see [`warp_dmp`].
    Dmp,
}

/// A bent path.
#[derive(Debug, Clone, PartialEq)]
pub struct Warp {
    /// As many poses as the demonstration has.
    pub poses: Vec<Pose>,
    /// Which rule applied.
    pub rule: WarpRule,
    /// Horizontal scale used.
    pub scale: f64,
    /// Angle about the vertical (rad).
    pub angle: f64,
}

fn horizontal(v: &Vector3<f64>) -> f64 {
    v.x.hypot(v.y)
}

/// Angle from `a` to `b` about z, in (-170, 190] deg: starts straight opposite to the demonstrated one
/// all go round the same way.
fn signed_angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let r = b.y.atan2(b.x) - a.y.atan2(a.x);
    let r = r.sin().atan2(r.cos());
    if r <= -170f64.to_radians() { r + std::f64::consts::TAU } else { r }
}

fn about_z(v: &Vector3<f64>, angle: f64, scale: f64) -> Vector3<f64> {
    let (s, c) = angle.sin_cos();
    Vector3::new(scale * (c * v.x - s * v.y), scale * (s * v.x + c * v.y), v.z)
}

/// The paper's warp, literally: `P^_i = P^_0 + k Rz(r) (P_i - P_0)` with `k = |v^_xy| / |v_xy|` and `r` the
/// signed angle between `v` and `v^`; `O^_i = slerp(O^_0, O_c, i/c)` up to `c = ceil((1-alpha)(T-1))`, the
/// demonstrated orientation after it. Its end misses the goal by `|k v_z - v^_z|`.
///
/// # Errors
/// A sentence when the demonstration starts above its end, so that `k` is undefined.
pub fn warp_paper(demo: &[Pose], start: &Pose, alpha: f64) -> Result<Warp, String> {
    let (Some(first), Some(last)) = (demo.first(), demo.last()) else {
        return Err("empty demonstration".into());
    };
    let v = last.translation.vector - first.translation.vector;
    let w = last.translation.vector - start.translation.vector;
    if horizontal(&v) < 1e-6 {
        return Err("the demonstration starts straight above its end: no scale".into());
    }
    let scale = horizontal(&w) / horizontal(&v);
    let angle = if horizontal(&w) < 1e-9 { 0.0 } else { signed_angle(&v, &w) };
    let c = ((1.0 - alpha) * (demo.len() - 1) as f64).ceil() as usize;
    let poses = demo
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let mut d = about_z(&(p.translation.vector - first.translation.vector), angle, scale);
            d.z *= scale;
            let rotation = if i < c {
                let t = i as f64 / c as f64;
                tdv_geometry::interpolate(start, &demo[c], t).rotation
            } else {
                p.rotation
            };
            Pose::from_parts((start.translation.vector + d).into(), rotation)
        })
        .collect();
    Ok(Warp { poses, rule: WarpRule::Paper, scale, angle })
}

/// The repaired warp ("log-polar fade"). With `u` the fraction of the SE(3) arc and the weight
/// `w = 1 - S5((u - fade_from) / (1 - alpha - fade_from))`, the demonstration's cylindrical coordinates
/// about `E` become `rho k^w`, `phi + w r`, `z`; what is left of the start's difference is added with
/// weight `w`; `O^_i = O_i Exp(w Log(O_0^T O^_0))`. So the start is exact, the last `alpha` is the
/// demonstration, heights are not scaled. Where there is no direction to turn or scale by (demonstration
/// or new start nearly above the goal) only the difference fades, see [`WarpRule::OffsetFade`]. An empty
/// demonstration gives an empty path.
pub fn warp_repaired(demo: &[Pose], start: &Pose, config: &WarpConfig) -> Warp {
    let (Some(first), Some(last)) = (demo.first(), demo.last()) else {
        return Warp { poses: Vec::new(), rule: WarpRule::OffsetFade, scale: 1.0, angle: 0.0 };
    };
    let end = last.translation.vector;
    let v = end - first.translation.vector;
    let w = end - start.translation.vector;
    let extent = demo.iter().map(|p| horizontal(&(p.translation.vector - end))).fold(0.0, f64::max);
    let polar = horizontal(&v) >= config.min_radius.max(0.1 * extent)
        && horizontal(&w) >= config.min_radius;
    let (scale, angle) = if polar {
        let k = horizontal(&w) / horizontal(&v);
        (k.clamp(config.scale[0], config.scale[1]), signed_angle(&v, &w))
    } else {
        (1.0, 0.0)
    };
    let bend = |p: &Vector3<f64>, weight: f64| {
        end + about_z(&(p - end), weight * angle, scale.powf(weight))
    };
    let residual = start.translation.vector - bend(&first.translation.vector, 1.0);
    let turn = Turn::between(&first.rotation, &start.rotation);
    let weights = fade(demo, config);
    let mut poses: Vec<Pose> = demo
        .iter()
        .zip(&weights)
        .map(|(p, w)| {
            if *w == 0.0 {
                return *p;
            }
            let position = bend(&p.translation.vector, *w) + residual * *w;
            Pose::from_parts(position.into(), turn.apply(&p.rotation, *w))
        })
        .collect();
    poses[0] = *start;
    let rule = if polar { WarpRule::LogPolar } else { WarpRule::OffsetFade };
    Warp { poses, rule, scale, angle }
}

/// The weight `w` of every sample: 1 up to `fade_from`, 0 in the last `alpha`, monotone.
pub(crate) fn fade(demo: &[Pose], config: &WarpConfig) -> Vec<f64> {
    let arcs = arcs(demo);
    let total = arcs.last().copied().unwrap_or(0.0);
    let from = config.fade_from.clamp(0.0, (0.8 - config.alpha).max(0.0));
    arcs.iter()
        .map(|s| {
            let u = if total > 0.0 { s / total } else { 1.0 };
            1.0 - smooth_step((u - from) / (1.0 - config.alpha - from))
        })
        .collect()
}

/// A change of orientation that can be applied in part.
struct Turn {
    body: Vector3<f64>,
    yaw: f64,
    rest: Vector3<f64>,
}

impl Turn {
    /// In the body frame; beyond 170 deg, where the axis is ill-conditioned, as a yaw about the
    /// reference's z followed by the small rest.
    fn between(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>) -> Self {
        let body = (from.inverse() * to).scaled_axis();
        if body.norm() <= 170f64.to_radians() {
            return Self { body, yaw: 0.0, rest: Vector3::zeros() };
        }
        let world = to * from.inverse();
        let mut yaw = 2.0 * world.k.atan2(world.w);
        yaw = yaw.sin().atan2(yaw.cos());
        if yaw <= -170f64.to_radians() {
            yaw += std::f64::consts::TAU;
        }
        let twist = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Self { body: Vector3::zeros(), yaw, rest: (world * twist.inverse()).scaled_axis() }
    }

    fn apply(&self, rotation: &UnitQuaternion<f64>, weight: f64) -> UnitQuaternion<f64> {
        let exp = |w: &Vector3<f64>| UnitQuaternion::from_scaled_axis(w * weight);
        exp(&self.rest)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw * weight)
            * rotation
            * exp(&self.body)
    }
}

/// The path with its sideways motion and its turning held back until the frame has risen by `lift`: for
/// `g(u) = u S5((u - u0)/(u1 - u0))` position in the plane and orientation are taken at `g(u)`, height
/// at `u`. `u0` is where 30 % of `lift` is reached, `u1` the last 30 % of what lies before the kept part
/// `alpha`. Also returns the fraction from which on a warp may fade. A path that never rises by `lift`
/// is returned as it is, with `None`.
pub(crate) fn lift_first(demo: &[Pose], lift: f64, alpha: f64) -> (Vec<Pose>, Option<f64>) {
    let arcs = arcs(demo);
    let (Some(first), Some(total)) = (demo.first(), arcs.last().copied()) else {
        return (Vec::new(), None);
    };
    let z0 = first.translation.z;
    let crossing = |h: f64| {
        demo.iter().position(|p| p.translation.z - z0 >= h).map(|i| arcs[i] / total.max(1e-9))
    };
    let (Some(u0), Some(u_lift)) = (crossing(0.3 * lift), crossing(lift)) else {
        return (demo.to_vec(), None);
    };
    let u1 = u0.max(u_lift) + 0.7 * (1.0 - alpha - u_lift);
    if lift <= 0.0 || u_lift > 0.6 * (1.0 - alpha) {
        return (demo.to_vec(), None);
    }
    let held: Vec<Pose> = demo
        .iter()
        .zip(&arcs)
        .map(|(p, s)| {
            let u = s / total;
            let g = if u >= u1 { u } else { u * smooth_step((u - u0) / (u1 - u0)) };
            let mut q = if g == u { *p } else { crate::path::at_arc(demo, &arcs, g * total) };
            // Before the lift the hand's jitter may go below the start.
            q.translation.z = if u < u_lift { p.translation.z.max(z0) } else { p.translation.z };
            q
        })
        .collect();
    let new_arcs = crate::path::arcs(&held);
    let new_total = new_arcs.last().copied().unwrap_or(1.0).max(1e-9);
    let from = held
        .iter()
        .position(|p| p.translation.z - z0 >= lift)
        .map_or(0.0, |i| new_arcs[i] / new_total);
    (held, Some(from))
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
