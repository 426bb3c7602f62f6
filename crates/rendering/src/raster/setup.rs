//! First pass: vertices to the camera, triangles to the visibility buffer.

use super::base::Base;
use super::{Instance, NEAR, Renderer};
use crate::Intrinsics;

/// One vertex on the screen: column, row (px), inverse depth (1/m).
type Screen = [f64; 3];

impl Renderer {
    /// Fills `inv_z`, `visible` (0 = nothing but the base, else index into `drawn` plus one) and
    /// `drawn` (instance, triangle).
    pub(super) fn visibility(
        &mut self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        base: Option<&Base>,
    ) {
        let pixels = camera.width as usize * camera.height as usize;
        if let Some(base) = base {
            self.inv_z.clone_from(&base.inv_z);
        } else {
            self.inv_z.clear();
            self.inv_z.resize(pixels, 0.0);
        }
        self.visible.clear();
        self.visible.resize(pixels, 0);
        self.camera.clear();
        self.normals.clear();
        self.screen.clear();
        self.bases.clear();
        self.drawn.clear();
        let mut target = Target {
            width: i64::from(camera.width),
            height: i64::from(camera.height),
            inv_z: &mut self.inv_z,
            visible: &mut self.visible,
        };
        for (index, instance) in scene.iter().enumerate() {
            let base = self.camera.len();
            self.bases.push(base);
            let finite = instance.pose.translation.vector.iter().all(|v| v.is_finite())
                && instance.pose.rotation.coords.iter().all(|v| v.is_finite());
            if !finite {
                continue;
            }
            let mesh = instance.mesh;
            transform(instance, &mut self.camera, &mut self.normals);
            let camera_points = &self.camera[base..];
            self.screen.extend(camera_points.iter().map(|p| project(camera, &p.map(f64::from))));
            let screen = &self.screen[base..];
            let count = screen.len() as u32;
            for (number, t) in mesh.triangles.iter().enumerate() {
                if t[0] >= count || t[1] >= count || t[2] >= count {
                    continue;
                }
                let s = t.map(|i| screen[i as usize]);
                let id = self.drawn.len() as u32 + 1;
                let hit = if s.iter().all(|v| v[2] > 0.0) {
                    target.triangle(&s, id, self.cull_backfaces)
                } else if s.iter().all(|v| v[2] <= 0.0) {
                    false
                } else {
                    let p = t.map(|i| camera_points[i as usize].map(f64::from));
                    let mut hit = false;
                    for part in clip_near(&p) {
                        let s = part.map(|v| project(camera, &v));
                        hit |= target.triangle(&s, id, self.cull_backfaces);
                    }
                    hit
                };
                if hit {
                    self.drawn.push((index as u32, number as u32));
                }
            }
        }
    }
}

/// Vertices and normals in the camera frame.
fn transform(instance: &Instance<'_>, points: &mut Vec<[f32; 3]>, normals: &mut Vec<[f32; 3]>) {
    let m = instance.pose.to_homogeneous();
    let r: [[f32; 4]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)] as f32));
    points.extend(instance.mesh.positions.iter().map(|p| -> [f32; 3] {
        std::array::from_fn(|i| r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + r[i][3])
    }));
    let rotate = |n: &[f32; 3]| -> [f32; 3] {
        std::array::from_fn(|i| r[i][0] * n[0] + r[i][1] * n[1] + r[i][2] * n[2])
    };
    // A mesh without normals is shaded flat: zeros here make the second pass take the face's.
    let have = instance.mesh.normals.len() == instance.mesh.positions.len();
    if have {
        normals.extend(instance.mesh.normals.iter().map(rotate));
    } else {
        normals.resize(points.len(), [0.0; 3]);
    }
}

/// Column, row and inverse depth; an inverse depth of 0 marks a vertex before the near plane.
fn project(camera: &Intrinsics, p: &[f64; 3]) -> Screen {
    if p[2] >= NEAR {
        let inverse = 1.0 / p[2];
        [camera.fx * p[0] * inverse + camera.cx, camera.fy * p[1] * inverse + camera.cy, inverse]
    } else {
        [0.0; 3]
    }
}

/// The part of a triangle beyond the near plane, as at most two triangles.
fn clip_near(p: &[[f64; 3]; 3]) -> impl Iterator<Item = [[f64; 3]; 3]> {
    let mut polygon: [[f64; 3]; 4] = [[0.0; 3]; 4];
    let mut n = 0;
    let mut add = |v: [f64; 3]| {
        if n < 4 {
            polygon[n] = v;
            n += 1;
        }
    };
    for k in 0..3 {
        let (a, b) = (p[k], p[(k + 1) % 3]);
        if a[2] >= NEAR {
            add(a);
        }
        if (a[2] >= NEAR) != (b[2] >= NEAR) {
            let t = (NEAR - a[2]) / (b[2] - a[2]);
            add([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), NEAR]);
        }
    }
    let count = n;
    (2..count).map(move |k| [polygon[0], polygon[k - 1], polygon[k]])
}

/// The visibility buffer being filled.
struct Target<'a> {
    width: i64,
    height: i64,
    inv_z: &'a mut [f32],
    visible: &'a mut [u32],
}

impl Target<'_> {
    /// Draws one triangle. A pixel belongs to it if its centre does; centres on an edge belong to the
    /// triangle on the right or below, so that neighbours neither overlap nor leave gaps. Returns
    /// whether any pixel was won.
    fn triangle(&mut self, s: &[Screen; 3], id: u32, cull: bool) -> bool {
        let min = |k: usize| s[0][k].min(s[1][k]).min(s[2][k]);
        let max = |k: usize| s[0][k].max(s[1][k]).max(s[2][k]);
        let first = (min(1).ceil() as i64).max(0);
        let last = (max(1).ceil() as i64).min(self.height);
        if first >= last || max(0) < 0.0 || min(0) > (self.width - 1) as f64 {
            return false;
        }
        let (x10, y10) = (s[1][0] - s[0][0], s[1][1] - s[0][1]);
        let (x20, y20) = (s[2][0] - s[0][0], s[2][1] - s[0][1]);
        let area = x10 * y20 - x20 * y10;
        // The image's v axis points down: what is counter-clockwise from outside has negative area.
        if !(area.abs() > 1e-12) || (cull && area > 0.0) {
            return false;
        }
        let (w10, w20) = (s[1][2] - s[0][2], s[2][2] - s[0][2]);
        let du = (w10 * y20 - w20 * y10) / area;
        let dv = (w20 * x10 - w10 * x20) / area;
        // Endpoints ordered the same way for both triangles of an edge: bit-identical crossings.
        let [mut a, mut b, mut c] = *s;
        let below = |p: &Screen, q: &Screen| (p[1], p[0]) > (q[1], q[0]);
        if below(&a, &b) {
            std::mem::swap(&mut a, &mut b);
        }
        if below(&b, &c) {
            std::mem::swap(&mut b, &mut c);
        }
        if below(&a, &b) {
            std::mem::swap(&mut a, &mut b);
        }
        let slope = |p: &Screen, q: &Screen| {
            let dy = q[1] - p[1];
            if dy > 0.0 { (q[0] - p[0]) / dy } else { 0.0 }
        };
        let (long, upper, lower) = (slope(&a, &c), slope(&a, &b), slope(&b, &c));
        let step = du as f32;
        let mut hit = false;
        for y in first..last {
            let yf = y as f64;
            let x0 = a[0] + (yf - a[1]) * long;
            let x1 =
                if yf < b[1] { a[0] + (yf - a[1]) * upper } else { b[0] + (yf - b[1]) * lower };
            let start = (x0.min(x1).ceil() as i64).max(0);
            let end = (x0.max(x1).ceil() as i64).min(self.width);
            if start >= end {
                continue;
            }
            let w = (s[0][2] + du * (start as f64 - s[0][0]) + dv * (yf - s[0][1])) as f32;
            let row = (y * self.width) as usize;
            let range = row + start as usize..row + end as usize;
            let depths = &mut self.inv_z[range.clone()];
            let numbers = &mut self.visible[range];
            for (i, (z, n)) in depths.iter_mut().zip(numbers).enumerate() {
                let here = w + step * i as f32;
                if here > *z {
                    *z = here;
                    *n = id;
                    hit = true;
                }
            }
        }
        hit
    }
}
