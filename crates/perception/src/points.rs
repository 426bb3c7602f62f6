//! The organised point map: depth averaged over small blocks, with points and normals in the camera frame.

use crate::frame::{RgbdFrame, usable};
use nalgebra::{Point3, Vector3};

/// Points on a regular grid of the image, `stride` pixels apart. Row-major, `width * height` cells.
#[derive(Debug, Clone)]
pub struct PointMap {
    /// Pixels per cell.
    pub stride: u32,
    /// Cells per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Camera-frame points (m); `z == 0` marks a hole.
    pub points: Vec<[f32; 3]>,
}

impl PointMap {
    /// Averages each `stride x stride` block over the readings that lie within 1.5 % of its nearest
    /// majority, so that blocks across an edge do not mix two surfaces.
    pub fn new(frame: &RgbdFrame, stride: u32) -> Self {
        let stride = stride.max(1);
        let k = &frame.intrinsics;
        let (width, height) = ((k.width / stride) as usize, (k.height / stride) as usize);
        let mut points = vec![[0.0f32; 3]; width * height];
        let half = (stride as f32 - 1.0) / 2.0;
        let row = k.width as usize;
        let (fx, fy, cx, cy) = (k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32);
        // Coarse maps look at a 2x2 patch of the block only.
        let patch = stride.min(2) as usize;
        for y in 0..height {
            for x in 0..width {
                let (u0, v0) = (x * stride as usize, y * stride as usize);
                let mut values = [0.0f32; 4];
                let mut n = 0;
                for dv in 0..patch {
                    for du in 0..patch {
                        if let Some(z) = usable(frame.depth.data[(v0 + dv) * row + u0 + du]) {
                            values[n] = z;
                            n += 1;
                        }
                    }
                }
                if n == 0 {
                    continue;
                }
                let values = &mut values[..n];
                values.sort_by(f32::total_cmp);
                let middle = values[(n - 1) / 2];
                let (mut sum, mut count) = (0.0, 0.0);
                for v in values.iter() {
                    if (v - middle).abs() < 0.015 * middle {
                        sum += v;
                        count += 1.0;
                    }
                }
                let z = sum / count;
                let off = if stride <= 2 { half } else { 0.5 };
                let (u, v) = (u0 as f32 + off, v0 as f32 + off);
                points[y * width + x] = [(u - cx) / fx * z, (v - cy) / fy * z, z];
            }
        }
        Self { stride, width, height, points }
    }

    /// The point of a cell, if it has one.
    #[inline]
    pub fn point(&self, index: usize) -> Option<Point3<f64>> {
        let p = self.points[index];
        (p[2] > 0.0).then(|| Point3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])))
    }

    /// Surface normal (camera frame, towards the camera) from central differences `reach` cells wide;
    /// `None` at holes and depth edges.
    pub fn normal(&self, x: usize, y: usize, reach: usize) -> Option<Vector3<f64>> {
        if x < reach || y < reach || x + reach >= self.width || y + reach >= self.height {
            return None;
        }
        let at = |x: usize, y: usize| self.point(y * self.width + x);
        let c = at(x, y)?;
        let (l, r, t, b) =
            (at(x - reach, y)?, at(x + reach, y)?, at(x, y - reach)?, at(x, y + reach)?);
        let gate = 0.02 + 0.02 * c.z;
        if [l, r, t, b].iter().any(|p| (p - c).norm() > gate) {
            return None;
        }
        let n = (r - l).cross(&(b - t)).try_normalize(1e-12)?;
        Some(if n.dot(&c.coords) > 0.0 { -n } else { n })
    }

    /// Number of cells with a point.
    pub fn valid(&self) -> usize {
        self.points.iter().filter(|p| p[2] > 0.0).count()
    }
}
