//! Region modality: where along each outline normal the colours change from object to surroundings
//! (Stoiber et al., ICG/SRT3D).

use super::histogram::{Counts, Histograms, cell};
use super::occlusion::Occlusion;
use super::surface::OutlinePoint;
use super::system::System;
use crate::frame::RgbdFrame;
use crate::view::pixel;
use nalgebra::{Point3, RowVector3, Vector3};
use tdv_geometry::Pose;

/// Segments over which the step function is laid.
const FUNCTION: usize = 8;
/// Positions of the step that are compared.
const POSITIONS: usize = 12;
const SEGMENTS: usize = FUNCTION + POSITIONS - 1;
/// Amplitude of the smoothed step.
const AMPLITUDE: f64 = 0.43;
/// Slope of the smoothed step, in segments.
const SLOPE: f64 = 0.5;
/// Most of the weight of one line when the posterior jumps by one position.
const LOCAL_GAIN: f64 = 1.3;

/// A line laid over the image at an outline point.
#[derive(Debug, Clone)]
pub(crate) struct Line {
    point: Point3<f64>,
    centre: (f64, f64),
    normal: (f64, f64),
    /// Segments per pixel along the normal.
    rate: f64,
    /// Probability of each position of the edge.
    distribution: [f64; POSITIONS],
    mean: f64,
    variance: f64,
}

/// Least variance (segments^2) that the smoothed step can tell.
fn min_variance() -> f64 {
    (1.0 / (2.0 * (2.0 * AMPLITUDE).atanh().powi(2))).max(SLOPE)
}

/// Foreground probability of the step function at its `FUNCTION` places.
fn step_function() -> [f64; FUNCTION] {
    std::array::from_fn(|i| {
        let x = i as f64 - (FUNCTION as f64 - 1.0) / 2.0;
        0.5 - AMPLITUDE * (x / (2.0 * SLOPE)).tanh()
    })
}

/// Lays lines at `scale` px per segment; outline points that are hidden, leave the image or have less
/// than three segments beside them are left out.
pub(crate) fn lay_lines(
    frame: &RgbdFrame,
    outline: &[OutlinePoint],
    pose: &Pose,
    colors: &Histograms,
    occlusion: &Occlusion,
    scale: u32,
    lines: &mut Vec<Line>,
) {
    lines.clear();
    let k = &frame.intrinsics;
    let (w, h) = (k.width as i32, k.height as i32);
    let raw = frame.color.as_raw();
    let step = step_function();
    let pixels = SEGMENTS * scale as usize;
    let half = (pixels as f64 - 1.0) / 2.0;
    for o in outline {
        let p = pose * o.point;
        let Some((u, v)) = k.project(&p) else { continue };
        let n = pose.rotation * o.normal;
        let norm = n.x.hypot(n.y);
        if norm < 0.3 {
            continue;
        }
        let (nu, nv) = (n.x / norm, n.y / norm);
        let main = nu.abs().max(nv.abs());
        let rate = main / f64::from(scale);
        if o.inside_px.min(o.outside_px) * rate < 3.0 || occlusion.hides(frame, &p) {
            continue;
        }
        let (du, dv) = (nu / main, nv / main);
        let (u0, v0) = (u - half * du, v - half * dv);
        let (u1, v1) = (u + half * du, v + half * dv);
        let inside = |u: f64, v: f64| {
            u >= 0.0 && v >= 0.0 && u < f64::from(w) - 1.0 && v < f64::from(h) - 1.0
        };
        if !inside(u0, v0) || !inside(u1, v1) {
            continue;
        }
        let mut foreground = [0.0f64; SEGMENTS];
        for (s, out) in foreground.iter_mut().enumerate() {
            let (mut f, mut b) = (1.0f32, 1.0f32);
            for i in 0..scale as usize {
                let d = (s * scale as usize + i) as f64;
                let (x, y) = (pixel(u0 + d * du) as usize, pixel(v0 + d * dv) as usize);
                let c = 3 * (y * w as usize + x);
                let q = colors.posterior(&raw[c..c + 3]);
                f *= q;
                b *= 1.0 - q;
            }
            *out = f64::from(f / (f + b).max(1e-30));
        }
        let mut distribution = [0.0f64; POSITIONS];
        let mut sum = 0.0;
        for (j, d) in distribution.iter_mut().enumerate() {
            let mut product = 1.0;
            for i in 0..FUNCTION {
                let f = foreground[j + i];
                product *= f * step[i] + (1.0 - f) * (1.0 - step[i]);
            }
            *d = product;
            sum += product;
        }
        if sum < 1e-30 {
            continue;
        }
        let mut mean = 0.0;
        for (j, d) in distribution.iter_mut().enumerate() {
            *d /= sum;
            mean += *d * j as f64;
        }
        let spread: f64 =
            distribution.iter().enumerate().map(|(j, d)| d * (j as f64 - mean).powi(2)).sum();
        lines.push(Line {
            point: o.point,
            centre: (u, v),
            normal: (nu, nv),
            rate,
            distribution,
            mean: mean - (POSITIONS as f64 - 1.0) / 2.0,
            variance: spread.max(min_variance()),
        });
    }
}

/// Adds the lines' gradient and Hessian. `sigma_px`: standard deviation of the edge in pixels;
/// `global`: pull towards the mean of the distribution, else along its local slope.
pub(crate) fn accumulate(
    frame: &RgbdFrame,
    lines: &[Line],
    pose: &Pose,
    sigma_px: f64,
    global: bool,
    system: &mut System,
) {
    let k = &frame.intrinsics;
    let r = pose.rotation.to_rotation_matrix();
    for line in lines {
        let p = pose * line.point;
        let Some((u, v)) = k.project(&p) else { continue };
        let (nu, nv) = line.normal;
        let offset = ((u - line.centre.0) * nu + (v - line.centre.1) * nv) * line.rate;
        let pull = if global {
            (line.mean - offset) / line.variance
        } else {
            let at = offset + (POSITIONS as f64 + 1.0) / 2.0;
            if at < 1.0 || at >= POSITIONS as f64 {
                continue;
            }
            let j = at as usize;
            let (a, b) = (line.distribution[j - 1].max(1e-12), line.distribution[j].max(1e-12));
            (b.ln() - a.ln()) * LOCAL_GAIN / line.variance
        };
        let g = RowVector3::new(
            nu * k.fx / p.z,
            nv * k.fy / p.z,
            -(nu * p.x * k.fx + nv * p.y * k.fy) / (p.z * p.z),
        ) * line.rate;
        let t: Vector3<f64> = (g * r.matrix()).transpose();
        let a = line.point.coords.cross(&t);
        let w = min_variance() / (line.rate * line.rate * sigma_px * sigma_px);
        system.add(&a, &t, w * pull, w / line.variance);
    }
}

/// Counts colours on both sides of the outline, up to 20 px away, as the current pose sees them.
pub(crate) fn count_colors(
    frame: &RgbdFrame,
    outline: &[OutlinePoint],
    pose: &Pose,
    occlusion: &Occlusion,
    counts: &mut Counts,
) {
    let k = &frame.intrinsics;
    let (w, h) = (k.width as i32, k.height as i32);
    let raw = frame.color.as_raw();
    for o in outline {
        let p = pose * o.point;
        let Some((u, v)) = k.project(&p) else { continue };
        let n = pose.rotation * o.normal;
        let norm = n.x.hypot(n.y);
        if norm < 0.3 || occlusion.hides(frame, &p) {
            continue;
        }
        let (nu, nv) = (n.x / norm, n.y / norm);
        for (sign, limit, hist) in [
            (-1.0, o.inside_px.min(20.0), &mut counts.foreground),
            (1.0, o.outside_px.min(20.0), &mut counts.background),
        ] {
            let mut d = 1.5;
            while d < limit {
                let (x, y) = (pixel(u + sign * d * nu), pixel(v + sign * d * nv));
                if x < 0 || y < 0 || x >= w || y >= h {
                    break;
                }
                // A finger before the object has the object's place but not its colour.
                if sign < 0.0 && occlusion.covered(frame, x, y) {
                    d += 1.0;
                    continue;
                }
                let c = 3 * (y * w + x) as usize;
                hist[cell(&raw[c..c + 3])] += 1.0;
                d += 1.0;
            }
        }
    }
}
