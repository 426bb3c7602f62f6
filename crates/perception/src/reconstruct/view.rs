use crate::frame::RgbdFrame;
use crate::segment::Mask;
use nalgebra::Point3;
use tdv_geometry::Pose;
use tdv_rendering::Intrinsics;

/// What is not known to be empty: as if far inside (m).
pub(super) const UNKNOWN: f64 = 1.0;

/// Masks reach beyond the true outline by about this (px).
const WIDE_PX: f32 = 0.4;
/// Width (px) of the ring inside the outline whose readings are not believed.
const RIM_PX: f32 = 1.6;

/// How far (px) the readings lie that speak for a pixel without one, and by how much (m) it may stand
/// before them.
const CLOSE_PX: i32 = 4;
const BEFORE: f64 = 0.002;

/// A window of one frame with the outline of the object.
#[derive(Debug)]
pub(super) struct View {
    /// Camera of the window.
    pub k: Intrinsics,
    pub t_camera_object: Pose,
    /// Smoothed depth (m), 0 where there is none; row-major.
    depth: Vec<f32>,
    /// Where there is no depth: the nearest reading (m) close by, 0 where there is none either.
    front: Vec<f32>,
    /// sRGB.
    color: Vec<[u8; 3]>,
    /// Distance (px) to the outline, positive inside.
    outline: Vec<f32>,
}

impl View {
    pub fn new(frame: &RgbdFrame, mask: &Mask, t_camera_object: Pose) -> Self {
        let k = frame.intrinsics.crop(mask.x0, mask.y0, mask.width, mask.height);
        let (w, h) = (mask.width as i32, mask.height as i32);
        let pixels = || (0..h).flat_map(|y| (0..w).map(move |x| (x + mask.x0, y + mask.y0)));
        let color = pixels().map(|(u, v)| frame.color.get_pixel(u as u32, v as u32).0).collect();
        let inside: Vec<bool> = pixels().map(|(u, v)| mask.at(u, v)).collect();
        let whole = fill_holes(&inside, w as usize, h as usize);
        let outline: Vec<f32> =
            signed_distance(&whole, w as usize, h as usize).iter().map(|d| d - WIDE_PX).collect();
        // At the outline a reading may be of what lies behind: only the outline itself counts there.
        let depth: Vec<f32> = pixels()
            .zip(&outline)
            .map(|((u, v), rim)| if *rim > RIM_PX { smooth(frame, mask, u, v) } else { 0.0 })
            .collect();
        let front = nearest_close_by(&depth, w, h);
        Self { k, t_camera_object, depth, front, color, outline }
    }

    /// Takes `t_old_new` as the object's new frame.
    pub fn move_frame(&mut self, t_old_new: &Pose) {
        self.t_camera_object *= t_old_new;
    }

    /// Measured points of the object (object frame, m).
    pub fn points(&self) -> Vec<Point3<f64>> {
        let to_object = self.t_camera_object.inverse();
        let w = self.k.width as usize;
        (0..self.depth.len())
            // Readings at the outline mix two surfaces.
            .filter(|i| self.depth[*i] > 0.0 && self.outline[*i] > 1.5)
            .map(|i| {
                let (u, v) = ((i % w) as f64, (i / w) as f64);
                to_object * self.k.unproject(u, v, f64::from(self.depth[i]))
            })
            .collect()
    }

    /// Direction of sight towards a point, in the object frame.
    pub fn sight(&self, p: &Point3<f64>) -> nalgebra::Vector3<f64> {
        let eye = self.t_camera_object.inverse() * Point3::origin();
        (p - eye).normalize()
    }

    /// How far (m) a point of the object frame is from being proved empty: negative before the measured
    /// surface or outside the outline, [`UNKNOWN`] where nothing was measured.
    pub fn inside(&self, p: &Point3<f64>) -> f64 {
        let q = self.t_camera_object * p;
        let Some((u, v)) = self.k.project(&q) else { return UNKNOWN };
        let (w, h) = (self.k.width as usize, self.k.height as usize);
        if u < 0.0 || v < 0.0 || u > (w - 1) as f64 || v > (h - 1) as f64 {
            return -0.05;
        }
        let (x, y) = (u as usize, v as usize);
        let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let (x1, y1) = ((x + 1).min(w - 1), (y + 1).min(h - 1));
        let corners = [y * w + x, y * w + x1, y1 * w + x, y1 * w + x1];
        let mix = |v: [f32; 4]| {
            let top = v[0] + fx * (v[1] - v[0]);
            let bottom = v[2] + fx * (v[3] - v[2]);
            f64::from(top + fy * (bottom - top))
        };
        let rim = mix(corners.map(|i| self.outline[i])) * q.z / self.k.fx;
        let z = corners.map(|i| self.depth[i]);
        let nearest = usize::from(fx > 0.5) + 2 * usize::from(fy > 0.5);
        let near = z[nearest];
        if near <= 0.0 {
            // Surfaces turn away from the camera at the outline: nothing stands far before the readings
            // beside it. Without this a fin would stay along every line of sight through the rim.
            let front = f64::from(self.front[corners[nearest]]);
            let before = if front > 0.0 { q.z - (front - BEFORE) } else { UNKNOWN };
            return rim.min(before).min(UNKNOWN);
        }
        let one = z.iter().all(|d| (d - near).abs() < 0.008);
        let surface = if one { mix(z) } else { f64::from(near) };
        rim.min(q.z - surface)
    }

    /// Colour where a surface point is seen, if it is.
    pub fn color(&self, p: &Point3<f64>, normal: &nalgebra::Vector3<f64>) -> Option<[u8; 3]> {
        if self.sight(p).dot(normal) > -0.15 {
            return None;
        }
        let q = self.t_camera_object * p;
        let (u, v) = self.k.project(&q)?;
        if !self.k.contains(u, v) {
            return None;
        }
        let i = v.round() as usize * self.k.width as usize + u.round() as usize;
        let z = *self.depth.get(i)?;
        let here = z <= 0.0 || (f64::from(z) - q.z).abs() < 0.008;
        (here && *self.outline.get(i)? > 1.5).then(|| self.color[i])
    }
}

/// Mean of the readings of the object in 3x3 that are one surface with the middle one.
fn smooth(frame: &RgbdFrame, mask: &Mask, u: i32, v: i32) -> f32 {
    let Some(z) = frame.depth_at(u, v).filter(|_| mask.at(u, v)) else { return 0.0 };
    let (mut sum, mut n) = (0.0, 0.0);
    for dv in -1..=1 {
        for du in -1..=1 {
            if let Some(d) = frame.depth_at(u + du, v + dv)
                && mask.at(u + du, v + dv)
                && (d - z).abs() < 0.005
            {
                sum += d;
                n += 1.0;
            }
        }
    }
    sum / n
}

/// For every pixel without a reading the least one within [`CLOSE_PX`].
fn nearest_close_by(depth: &[f32], w: i32, h: i32) -> Vec<f32> {
    let mut out = vec![0.0; depth.len()];
    for y in 0..h {
        for x in 0..w {
            let i = (y * w + x) as usize;
            if depth[i] > 0.0 {
                continue;
            }
            let mut least = f32::MAX;
            for v in (y - CLOSE_PX).max(0)..=(y + CLOSE_PX).min(h - 1) {
                for u in (x - CLOSE_PX).max(0)..=(x + CLOSE_PX).min(w - 1) {
                    let z = depth[(v * w + u) as usize];
                    if z > 0.0 {
                        least = least.min(z);
                    }
                }
            }
            if least < f32::MAX {
                out[i] = least;
            }
        }
    }
    out
}

/// Gaps of the mask that do not reach the window's border belong to it, unless they are large (the
/// inside of a handle).
fn fill_holes(inside: &[bool], w: usize, h: usize) -> Vec<bool> {
    const LARGEST: usize = 12;
    let mut out = inside.to_vec();
    let mut seen = inside.to_vec();
    for start in 0..inside.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let (mut group, mut next) = (vec![start], 0);
        while let Some(&i) = group.get(next) {
            next += 1;
            let (x, y) = (i % w, i / w);
            let mut visit = |j: usize| {
                if !seen[j] {
                    seen[j] = true;
                    group.push(j);
                }
            };
            if x > 0 {
                visit(i - 1);
            }
            if x + 1 < w {
                visit(i + 1);
            }
            if y > 0 {
                visit(i - w);
            }
            if y + 1 < h {
                visit(i + w);
            }
        }
        if group.len() <= LARGEST {
            group.into_iter().for_each(|i| out[i] = true);
        }
    }
    out
}

/// Distance (px) to the border between inside and outside, positive inside: two sweeps of nearest
/// points each way (8SSED).
fn signed_distance(inside: &[bool], w: usize, h: usize) -> Vec<f32> {
    let to = |goal: bool| -> Vec<f32> {
        const FAR: i32 = 10_000;
        let mut at: Vec<(i32, i32)> =
            inside.iter().map(|i| if *i == goal { (0, 0) } else { (FAR, FAR) }).collect();
        let square = |o: (i32, i32)| o.0 * o.0 + o.1 * o.1;
        let relax = |at: &mut Vec<(i32, i32)>, x: usize, y: usize, dx: i32, dy: i32| {
            let (nx, ny) = (x as i32 + dx, y as i32 + dy);
            if nx < 0 || ny < 0 || nx >= w as i32 || ny >= h as i32 {
                return;
            }
            let o = at[ny as usize * w + nx as usize];
            let candidate = (o.0 + dx, o.1 + dy);
            let here = &mut at[y * w + x];
            if square(candidate) < square(*here) {
                *here = candidate;
            }
        };
        for y in 0..h {
            for x in 0..w {
                for (dx, dy) in [(-1, 0), (0, -1), (-1, -1), (1, -1)] {
                    relax(&mut at, x, y, dx, dy);
                }
            }
            for x in (0..w).rev() {
                relax(&mut at, x, y, 1, 0);
            }
        }
        for y in (0..h).rev() {
            for x in (0..w).rev() {
                for (dx, dy) in [(1, 0), (0, 1), (1, 1), (-1, 1)] {
                    relax(&mut at, x, y, dx, dy);
                }
            }
            for x in 0..w {
                relax(&mut at, x, y, -1, 0);
            }
        }
        at.iter().map(|o| (square(*o).min(FAR * FAR) as f32).sqrt()).collect()
    };
    let (out, into) = (to(false), to(true));
    // The border runs half a pixel from the last pixel's middle.
    inside.iter().enumerate().map(|(i, s)| if *s { out[i] - 0.5 } else { 0.5 - into[i] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_the_rim_of_a_disc() {
        let (w, h) = (61, 51);
        let r = |i: usize| ((i % w) as f32 - 30.0).hypot((i / w) as f32 - 25.0);
        let inside: Vec<bool> = (0..w * h).map(|i| r(i) < 15.0).collect();
        for (i, d) in signed_distance(&inside, w, h).iter().enumerate() {
            assert!((d - (15.0 - r(i))).abs() < 0.9, "{i}: {d} {}", 15.0 - r(i));
        }
    }
}
