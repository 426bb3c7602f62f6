//! What the tracker takes from a drawing of the object: outline points with normals and surface points.

use crate::view::{Painter, Window, pixel};
use nalgebra::{Point3, Vector3};
use tdv_geometry::Pose;
use tdv_rendering::Intrinsics;

/// How far (px) the distances beside an outline point are followed.
const REACH_PX: i32 = 40;

/// A point of the silhouette's outline.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OutlinePoint {
    /// In the object frame (m).
    pub point: Point3<f64>,
    /// Outward normal in the image plane, turned into the object frame.
    pub normal: Vector3<f64>,
    /// Pixels to the next pixel that is not the object, going inward.
    pub inside_px: f64,
    /// Pixels to the next pixel that is the object again, going outward.
    pub outside_px: f64,
}

/// A visible point of the surface, object frame (m).
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
}

/// One drawing, in the terms of the object frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surface {
    pub outline: Vec<OutlinePoint>,
    pub points: Vec<SurfacePoint>,
}

impl Surface {
    /// From the painter's last drawing of `window` (intrinsics `k` of that window). At most about
    /// `lines` outline points and `points` surface points.
    pub fn sample(
        painter: &Painter,
        window: &Window,
        k: &Intrinsics,
        full: &Intrinsics,
        pose: &Pose,
        lines: usize,
        points: usize,
    ) -> Self {
        let (w, h) = (k.width as i32, k.height as i32);
        let depth = &painter.out.depth.data;
        let on = |x: i32, y: i32| {
            x >= 0 && y >= 0 && x < w && y < h && depth[(y * w + x) as usize] > 0.0
        };
        let back = pose.inverse();
        let mut border = Vec::new();
        let mut area = 0usize;
        for y in 0..h {
            for x in 0..w {
                if !on(x, y) {
                    continue;
                }
                area += 1;
                let (u, v) = (x + window.x0, y + window.y0);
                // Where the image cuts the object there is no outline.
                let cut =
                    u <= 0 || v <= 0 || u >= full.width as i32 - 1 || v >= full.height as i32 - 1;
                if !cut && !(on(x - 1, y) && on(x + 1, y) && on(x, y - 1) && on(x, y + 1)) {
                    border.push((x, y));
                }
            }
        }
        let mut out = Self::default();
        let stride = (border.len() as f64 / lines.max(1) as f64).max(1.0);
        let mut next = 0.5 * (stride - 1.0);
        for (i, (x, y)) in border.iter().enumerate() {
            if (i as f64) < next {
                continue;
            }
            next += stride;
            out.outline.extend(outline_point(*x, *y, &on, depth, w, k, &back));
        }
        let step = ((area as f64 / points.max(1) as f64).sqrt().floor() as i32).max(1);
        for y in (step / 2..h).step_by(step as usize) {
            for x in (step / 2..w).step_by(step as usize) {
                // Away from the outline: edge pixels of a depth camera mix two surfaces.
                if !(on(x, y) && on(x - 2, y) && on(x + 2, y) && on(x, y - 2) && on(x, y + 2)) {
                    continue;
                }
                let i = (y * w + x) as usize;
                let n = Vector3::from(painter.out.normals[i].map(f64::from));
                let p = k.unproject(f64::from(x), f64::from(y), f64::from(depth[i]));
                if -n.dot(&p.coords.normalize()) < 0.15 {
                    continue;
                }
                out.points.push(SurfacePoint { point: back * p, normal: back.rotation * n });
            }
        }
        out
    }
}

fn outline_point(
    x: i32,
    y: i32,
    on: &impl Fn(i32, i32) -> bool,
    depth: &[f32],
    w: i32,
    k: &Intrinsics,
    back: &Pose,
) -> Option<OutlinePoint> {
    let (mut nu, mut nv) = (0.0f64, 0.0f64);
    for dy in -3i32..=3 {
        for dx in -3i32..=3 {
            if !on(x + dx, y + dy) {
                let r = f64::from(dx * dx + dy * dy);
                nu += f64::from(dx) / r;
                nv += f64::from(dy) / r;
            }
        }
    }
    let norm = nu.hypot(nv);
    if norm < 0.5 {
        return None;
    }
    let (nu, nv) = (nu / norm, nv / norm);
    let walk = |sign: f64, until: bool| {
        for s in 1..REACH_PX {
            let d = sign * f64::from(s);
            let (px, py) = (f64::from(x) + d * nu, f64::from(y) + d * nv);
            if on(pixel(px), pixel(py)) == until {
                return f64::from(s);
            }
        }
        f64::from(REACH_PX)
    };
    let inside_px = walk(-1.0, false);
    // The first steps outward may still graze the own pixel's neighbours.
    let outside_px = {
        let start = 2.0;
        let far = (0..REACH_PX).find(|s| {
            let d = start + f64::from(*s);
            on(pixel(f64::from(x) + d * nu), pixel(f64::from(y) + d * nv))
        });
        far.map_or(f64::from(REACH_PX), |s| start + f64::from(s))
    };
    // The true edge lies between this pixel's centre and the next one along the main direction.
    let half = 0.5 * nu.abs().max(nv.abs());
    let z = f64::from(depth[(y * w + x) as usize]);
    let p = k.unproject(f64::from(x) + half * nu, f64::from(y) + half * nv, z);
    Some(OutlinePoint {
        point: back * p,
        normal: back.rotation * Vector3::new(nu, nv, 0.0),
        inside_px,
        outside_px,
    })
}
