//! Depth modality: measured points against the tangent planes of the visible surface.

use super::occlusion::Occlusion;
use super::surface::SurfacePoint;
use super::system::System;
use crate::frame::RgbdFrame;
use crate::view::pixel;
use nalgebra::{Point3, Vector3};
use tdv_geometry::Pose;

/// A surface point and the measured point (camera frame) found for it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair {
    model: Point3<f64>,
    normal: Vector3<f64>,
    measured: Point3<f64>,
}

/// Finds a measured point for each surface point within `reach` (m). `search`: the nearest one in a
/// window (first iteration, large motion); else the one behind the same pixel, averaged over 3x3.
pub(crate) fn find_pairs(
    frame: &RgbdFrame,
    points: &[SurfacePoint],
    pose: &Pose,
    occlusion: &Occlusion,
    reach: f64,
    search: bool,
    pairs: &mut Vec<Pair>,
) {
    pairs.clear();
    for s in points {
        let p = pose * s.point;
        if occlusion.hides(frame, &p) {
            continue;
        }
        let found = if search { nearest(frame, &p, reach) } else { straight(frame, &p, reach) };
        if let Some(measured) = found {
            pairs.push(Pair { model: s.point, normal: s.normal, measured });
        }
    }
}

fn nearest(frame: &RgbdFrame, p: &Point3<f64>, reach: f64) -> Option<Point3<f64>> {
    let k = &frame.intrinsics;
    let (u, v) = k.project(p)?;
    let r = reach * k.fx / p.z;
    let step = (0.006 * k.fx / p.z).max(1.0);
    let n = (r / step) as i32;
    let mut best: Option<(f64, Point3<f64>)> = None;
    for j in -n..=n {
        for i in -n..=n {
            let x = pixel(u + f64::from(i) * step);
            let y = pixel(v + f64::from(j) * step);
            if let Some(q) = frame.point(x, y) {
                let d = (q - p).norm_squared();
                if d < reach * reach && best.as_ref().is_none_or(|b| d < b.0) {
                    best = Some((d, q));
                }
            }
        }
    }
    best.map(|b| b.1)
}

fn straight(frame: &RgbdFrame, p: &Point3<f64>, reach: f64) -> Option<Point3<f64>> {
    let k = &frame.intrinsics;
    let (u, v) = k.project(p)?;
    let (x, y) = (pixel(u), pixel(v));
    let middle = frame.depth_at(x, y)?;
    let (mut sum, mut n) = (Vector3::zeros(), 0.0);
    for dy in -1..=1 {
        for dx in -1..=1 {
            if let Some(z) = frame.depth_at(x + dx, y + dy)
                && (z - middle).abs() < 0.012 * middle
            {
                sum += k.unproject(f64::from(x + dx), f64::from(y + dy), f64::from(z)).coords;
                n += 1.0;
            }
        }
    }
    let q = Point3::from(sum / n);
    ((q - p).norm() < reach).then_some(q)
}

/// Adds the pairs' gradient and Hessian. `sigma`: standard deviation (m) of a pair at one metre;
/// `cutoff`: pairs off by more (m) are ignored.
pub(crate) fn accumulate(
    pairs: &[Pair],
    pose: &Pose,
    sigma: f64,
    cutoff: f64,
    system: &mut System,
) {
    let back = pose.inverse();
    for pair in pairs {
        let p = back * pair.measured;
        let e = pair.normal.dot(&(pair.model - p));
        if e.abs() > cutoff {
            continue;
        }
        let s = 1.0 / (sigma * pair.measured.z.max(0.3));
        // Tukey: an edge pixel or a finger is not to be averaged in.
        let w = s * s * (1.0 - (e / cutoff).powi(2)).powi(2);
        system.add(&p.coords.cross(&pair.normal), &pair.normal, -w * e, w);
    }
}
