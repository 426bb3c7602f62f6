use super::symmetry::Assumed;
use super::view::View;
use crate::frame::{FARTHEST_M, RgbdFrame};
use nalgebra::Point3;
use tdv_geometry::Pose;

/// Values are cut off here (m): the surface only needs what is near it.
const FAR: f64 = 0.03;

/// How far each corner of a grid is inside (m), and how many later views see through it.
#[derive(Debug)]
pub(super) struct Field {
    pub size: [usize; 3],
    /// Lower corner (object frame, m).
    pub low: Point3<f64>,
    /// Distance of neighbouring corners (m).
    pub step: f64,
    pub inside: Vec<f32>,
    pub through: Vec<u16>,
}

impl Field {
    /// The shape that the view and its images under the symmetry leave standing; `None` if it is empty.
    pub fn new(view: &View, assumed: &Assumed, cells: usize) -> Option<Self> {
        let points = view.points();
        let images = assumed.images();
        // Everything measured, and its images, lies in here.
        let (mut reach, mut top) = ([0.0_f64; 2], 0.0_f64);
        for p in &points {
            for image in &images {
                let q = image * p;
                reach = [reach[0].max(q.x.abs()), reach[1].max(q.y.abs())];
            }
            top = top.max(p.z);
        }
        if points.is_empty() || top < 0.001 {
            return None;
        }
        let longest = (2.0 * reach[0].max(reach[1])).max(top);
        let step = longest / cells.max(8) as f64;
        // The unseen side may reach a little farther than what is seen.
        let low = Point3::new(-reach[0] * 1.1, -reach[1] * 1.1, 0.0)
            - nalgebra::Vector3::repeat(2.0 * step);
        let count = |extent: f64| (extent / step).ceil() as usize + 5;
        let size = [count(2.2 * reach[0]), count(2.2 * reach[1]), count(top * 1.05)];
        let total = size.iter().product();
        let mut out = Self { size, low, step, inside: vec![0.0; total], through: vec![0; total] };
        let mut values = Vec::with_capacity(images.len());
        // One image of many may be wrong by noise: the second smallest decides for round things.
        let rank = images.len() / 16;
        for i in 0..total {
            let p = out.corner(i);
            values.clear();
            values.extend(images.iter().map(|image| view.inside(&(image * p))));
            values.sort_by(f64::total_cmp);
            // It stands on the table.
            let v = values[rank].min(p.z).clamp(-FAR, FAR);
            out.inside[i] = v as f32;
        }
        out.keep_largest();
        out.inside.iter().any(|v| *v > 0.0).then_some(out)
    }

    pub fn corner(&self, i: usize) -> Point3<f64> {
        let [w, h, _] = self.size;
        let at = [i % w, i / w % h, i / (w * h)];
        Point3::new(
            self.low.x + at[0] as f64 * self.step,
            self.low.y + at[1] as f64 * self.step,
            self.low.z + at[2] as f64 * self.step,
        )
    }

    /// Whether a corner is solid after the later views.
    pub fn value(&self, i: usize, votes: u16) -> f32 {
        if self.through[i] >= votes {
            self.inside[i].min(-0.3 * self.step as f32)
        } else {
            self.inside[i]
        }
    }

    pub fn see_through(&mut self, frame: &RgbdFrame, t_camera_object: &Pose, margin: f64) {
        for i in 0..self.inside.len() {
            if self.inside[i] <= 0.0 {
                continue;
            }
            let q = t_camera_object * self.corner(i);
            let Some((u, v)) = frame.intrinsics.project(&q) else { continue };
            let (u, v) = (u.round() as i32, v.round() as i32);
            // All nine readings around must be behind: an outline is never exact.
            let behind = (-1..=1).all(|dv| {
                (-1..=1).all(|du| {
                    frame.depth_at(u + du, v + dv).is_some_and(|z| {
                        z < FARTHEST_M && f64::from(z) > q.z + margin + 0.004 * q.z * q.z
                    })
                })
            });
            if behind {
                self.through[i] = self.through[i].saturating_add(1);
            }
        }
    }

    /// Leaves the largest piece only: crumbs come from noise.
    fn keep_largest(&mut self) {
        let [w, h, d] = self.size;
        let mut piece = vec![0_u32; self.inside.len()];
        let (mut best, mut most, mut number) = (0, 0, 0);
        for start in 0..piece.len() {
            if piece[start] != 0 || self.inside[start] <= 0.0 {
                continue;
            }
            number += 1;
            piece[start] = number;
            let (mut stack, mut count) = (vec![start], 0);
            while let Some(i) = stack.pop() {
                count += 1;
                let at = [i % w, i / w % h, i / (w * h)];
                for (k, (stride, size)) in [(1, w), (w, h), (w * h, d)].into_iter().enumerate() {
                    let near =
                        [(at[k] > 0).then(|| i - stride), (at[k] + 1 < size).then(|| i + stride)];
                    for j in near.into_iter().flatten() {
                        if piece[j] == 0 && self.inside[j] > 0.0 {
                            piece[j] = number;
                            stack.push(j);
                        }
                    }
                }
            }
            if count > most {
                (most, best) = (count, number);
            }
        }
        for (v, p) in self.inside.iter_mut().zip(&piece) {
            if *v > 0.0 && *p != best {
                *v = -1e-4;
            }
        }
    }
}
