//! The part of a frame that a pose is compared with, at low resolution, and the comparison itself.

use crate::catalogue::ObjectModel;
use crate::frame::RgbdFrame;
use crate::segment::Mask;
use crate::view::Painter;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use tdv_geometry::Pose;
use tdv_rendering::Intrinsics;

/// Depth and mask around an object, resampled to a small image.
#[derive(Debug, Clone)]
pub(crate) struct Target {
    pub k: Intrinsics,
    depth: Vec<f32>,
    mask: Vec<bool>,
}

/// Depth difference (m) at which agreement ends, for a surface at `z` metres.
fn tolerance(z: f32) -> f32 {
    0.008 + 0.005 * z * z
}

impl Target {
    /// `pixels`: longer side of the small image.
    pub fn new(frame: &RgbdFrame, mask: &Mask, pixels: f64) -> Self {
        let factor = (pixels / f64::from(mask.width.max(mask.height))).min(1.0);
        let k = frame.intrinsics.crop(mask.x0, mask.y0, mask.width, mask.height).scaled(factor);
        let n = (k.width * k.height) as usize;
        let (mut depth, mut flags) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for y in 0..k.height {
            for x in 0..k.width {
                let u = ((f64::from(x) + 0.5) / factor - 0.5).round() as i32 + mask.x0;
                let v = ((f64::from(y) + 0.5) / factor - 0.5).round() as i32 + mask.y0;
                depth.push(frame.depth_at(u, v).unwrap_or(0.0));
                flags.push(mask.at(u, v));
            }
        }
        Self { k, depth, mask: flags }
    }

    /// Mean of the measured points inside the mask (camera frame, m).
    pub fn centroid(&self) -> Option<Point3<f64>> {
        let mut sum = Vector3::zeros();
        let mut n = 0.0;
        for (i, (z, m)) in self.depth.iter().zip(&self.mask).enumerate() {
            if *m && *z > 0.0 {
                sum += self.point(i, *z).coords;
                n += 1.0;
            }
        }
        (n >= 4.0).then(|| Point3::from(sum / n))
    }

    fn point(&self, i: usize, z: f32) -> Point3<f64> {
        let (u, v) = (i as u32 % self.k.width, i as u32 / self.k.width);
        self.k.unproject(f64::from(u), f64::from(v), f64::from(z))
    }

    /// Agreement of a pose with the measurement, 0..1: every pixel of rendering and mask counts one;
    /// full marks where both are there and the depths agree, half where the depth agrees outside the
    /// mask, none where the camera looks through the rendered object or the mask is not covered.
    /// Pixels behind something nearer do not count.
    pub fn score(&self, painter: &mut Painter, model: &ObjectModel, pose: &Pose) -> f64 {
        painter.draw(&self.k, model, pose);
        let (mut sum, mut weight, mut drawn, mut hidden) = (0.0f32, 0.0f32, 0u32, 0u32);
        for ((r, d), m) in painter.out.depth.data.iter().zip(&self.depth).zip(&self.mask) {
            if *r > 0.0 {
                drawn += 1;
                if *d == 0.0 {
                    // A hole says less than a reading, but its colour has put it into the mask or not.
                    weight += 0.6;
                    sum += if *m { 0.6 } else { 0.2 };
                    continue;
                }
                let tol = tolerance(*r);
                let diff = d - r;
                if diff < -2.0 * tol && !m {
                    hidden += 1;
                    continue;
                }
                weight += 1.0;
                let s = (1.0 - (diff / tol).powi(2)).max(0.0);
                sum += if *m { s } else { 0.5 * s };
            } else if *m {
                weight += 1.0;
            }
        }
        if drawn == 0 || weight == 0.0 {
            return 0.0;
        }
        // A pose that explains everything by hiding has explained nothing.
        let visible = 1.0 - hidden as f32 / drawn as f32;
        f64::from(sum / weight * (visible / 0.4).min(1.0))
    }

    /// Projective point-to-plane ICP from `pose`: measured points against the rendered surface at the
    /// same pixel, within `reach` metres. Returns the moved pose; the input when too few points pair up.
    pub fn icp(
        &self,
        painter: &mut Painter,
        model: &ObjectModel,
        mut pose: Pose,
        reach: f64,
        iterations: usize,
    ) -> Pose {
        for _ in 0..iterations {
            painter.draw(&self.k, model, &pose);
            let centre = pose * model.centre();
            let mut h = Matrix6::<f64>::zeros();
            let mut g = Vector6::<f64>::zeros();
            let mut pairs = 0;
            for (i, r) in painter.out.depth.data.iter().enumerate() {
                let d = self.depth[i];
                if *r <= 0.0 || d <= 0.0 {
                    continue;
                }
                let p = self.point(i, *r);
                let q = self.point(i, d);
                let n = painter.out.normals[i].map(f64::from);
                let n = Vector3::from(n);
                let e = n.dot(&(q - p));
                // Far outside the mask it is another surface that merely stands close by.
                let reach = if self.mask[i] { reach } else { 0.4 * reach };
                // A grazing surface carries more noise than shape.
                let facing = -n.dot(&p.coords.normalize());
                if e.abs() > reach || (q - p).norm() > 2.0 * reach || facing < 0.2 {
                    continue;
                }
                let w = (1.0 - (e / reach).powi(2)).powi(2);
                let a = (p - centre).cross(&n);
                let j = Vector6::new(a.x, a.y, a.z, n.x, n.y, n.z);
                h += j * j.transpose() * w;
                g += j * (w * e);
                pairs += 1;
            }
            if pairs < 12 {
                break;
            }
            // Directions that the visible surface does not determine stay where they are.
            for k in 0..3 {
                h[(k, k)] += 1e-3 * model.radius * model.radius * f64::from(pairs);
                h[(k + 3, k + 3)] += 1e-3 * f64::from(pairs);
            }
            let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
            pose = move_about(&pose, &centre, &step);
            if step.norm() < 1e-5 {
                break;
            }
        }
        pose
    }
}

/// `pose` turned about `centre` (camera frame) by the first three numbers (rad) and shifted by the last (m).
pub(crate) fn move_about(pose: &Pose, centre: &Point3<f64>, step: &Vector6<f64>) -> Pose {
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let shift = Vector3::new(step[3], step[4], step[5]);
    let t = turn * (pose.translation.vector - centre.coords) + centre.coords + shift;
    Pose::from_parts(t.into(), turn * pose.rotation)
}
