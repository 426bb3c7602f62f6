//! Pixels that may belong to an object: what stands above the table plane, thin things by their colour,
//! and how well each group fits a catalogue entry.

use crate::catalogue::{ObjectModel, Resting};
use crate::color::TableColors;
use crate::frame::RgbdFrame;
use crate::points::PointMap;
use crate::table::TablePlane;
use nalgebra::{Point3, Vector3};

/// Lowest point (m) above the table that counts as an object without help from colour.
const TALL_M: f64 = 0.012;
/// Lowest smoothed height (m) of a thin object whose colour differs from the table's.
const THIN_M: f64 = 0.0025;
/// Height (m) of an object that is looked for by its colour alone, and of the cells that may be its.
const FLAT_M: f64 = 0.009;
const FLAT_BAND_M: f32 = 0.012;
/// Highest point (m) above the table that is looked at.
const CEILING_M: f64 = 0.45;
/// A mask grows over gaps of so many pixels,
const GROW_PX: i32 = 2;
/// and not onto surfaces that are nearer or farther than its edge by this (m).
const GROW_M: f32 = 0.06;
/// What the height's fit never falls below: an object may be held.
const HELD: f64 = 0.15;
/// Least part of an object's cells that has its main colour.
const MAIN_SHARE: f64 = 0.15;
/// Fewest cells of a group.
const MIN_CELLS: usize = 40;

/// A connected group of image cells above the table.
#[derive(Debug, Clone)]
pub struct Cluster {
    /// Indices into the cells of the scene's map, ascending.
    pub cells: Vec<u32>,
    /// Mean of its points (camera frame, m).
    pub centroid: Point3<f64>,
    /// Height (m) below which 98 % of its points lie, and 2 %.
    pub top: f64,
    /// See `top`.
    pub bottom: f64,
    /// Largest extent in the table plane (m, 2nd to 98th percentile along the principal direction).
    pub length: f64,
    /// Extent across it (m).
    pub width: f64,
}

/// Everything the mask stage derives once per frame, for all objects.
#[derive(Debug)]
pub struct Scene {
    /// Organised points, stride 2.
    pub map: PointMap,
    /// The plane they stand on.
    pub table: TablePlane,
    /// Height (m) of every cell, averaged over 3x3 neighbours of the same surface; NaN in holes.
    heights: Vec<f32>,
    /// Mean colour of every cell.
    colors: Vec<[u8; 3]>,
    /// 0 = not an object, 1 = thin (by colour), 2 = tall.
    class: Vec<u8>,
    table_colors: TableColors,
}

impl Scene {
    /// Heights, colours and the object cells of a frame.
    pub fn new(frame: &RgbdFrame, table: TablePlane) -> Self {
        let map = PointMap::new(frame, 2);
        let (w, h) = (map.width, map.height);
        let raw: Vec<f32> = (0..w * h)
            .map(|i| map.point(i).map_or(f32::NAN, |p| table.height(&p) as f32))
            .collect();
        let colors = cell_colors(frame, &map);
        let on_plane = (0..w * h).filter(|i| raw[*i].abs() < 0.004).map(|i| colors[i]);
        let table_colors = TableColors::new(on_plane);
        let heights = smooth(&raw, w, h, 1);
        let wide = smooth(&raw, w, h, 2);
        let class = (0..w * h)
            .map(|i| {
                let Some(p) = map.point(i) else { return 0 };
                let height = f64::from(heights[i]);
                let noise = 0.0015 + 0.0025 * p.z * p.z;
                if height > CEILING_M {
                    0
                } else if height > TALL_M.max(3.0 * noise) {
                    2
                } else if f64::from(wide[i]) > THIN_M.max(0.6 * noise)
                    && table_colors.differs(colors[i])
                {
                    1
                } else {
                    0
                }
            })
            .collect();
        Self { map, table, heights, colors, class, table_colors }
    }

    /// Groups of neighbouring object cells.
    pub fn clusters(&self) -> Vec<Cluster> {
        self.groups(
            |i| self.class[i] > 0,
            |a, b| self.class[a] == self.class[b] || color_gap(self.colors[a], self.colors[b]) < 40,
        )
    }

    /// Groups of neighbouring object cells that have a colour of the model's palette; empty for a
    /// model without palette.
    pub fn colored_clusters(&self, model: &ObjectModel) -> Vec<Cluster> {
        if model.palette.is_empty() {
            return Vec::new();
        }
        let like = |i: usize| model.palette.fit(self.colors[i]) > 0.3;
        // What lies flat is hardly higher than the table's noise, and large enough to count among the
        // table's own colours: its colour has to do, if it is not really the table's.
        let level = |i: usize| self.heights[i].abs() < FLAT_BAND_M;
        let flat = model.size().z < FLAT_M && model.resting == Resting::Upright && {
            let (mut on, mut own) = (0_usize, 0_usize);
            for i in (0..self.class.len()).step_by(7).filter(|i| level(*i)) {
                on += 1;
                own += usize::from(like(i));
            }
            8 * own < on
        };
        let fits: Vec<bool> = (0..self.class.len())
            .map(|i| (self.class[i] > 0 || (flat && level(i))) && like(i))
            .collect();
        self.groups(|i| fits[i], |_, _| true)
    }

    fn groups(
        &self,
        member: impl Fn(usize) -> bool,
        joined: impl Fn(usize, usize) -> bool,
    ) -> Vec<Cluster> {
        let (w, h) = (self.map.width as i64, self.map.height as i64);
        let mut seen = vec![false; self.class.len()];
        let mut out = Vec::new();
        let mut stack = Vec::new();
        for start in 0..self.class.len() {
            if seen[start] || !member(start) {
                continue;
            }
            seen[start] = true;
            stack.push(start);
            let mut cells = Vec::new();
            while let Some(i) = stack.pop() {
                cells.push(i as u32);
                let Some(p) = self.map.point(i) else { continue };
                let (x, y) = (i as i64 % w, i as i64 / w);
                // Two cells far: a hole or a specular dot does not cut an object in two.
                for dy in -2..=2 {
                    for dx in -2..=2 {
                        let (nx, ny) = (x + dx, y + dy);
                        if nx < 0 || ny < 0 || nx >= w || ny >= h {
                            continue;
                        }
                        let j = (ny * w + nx) as usize;
                        if seen[j] || !member(j) {
                            continue;
                        }
                        let Some(q) = self.map.point(j) else { continue };
                        if (p - q).norm() < 0.01 + 0.015 * p.z && joined(i, j) {
                            seen[j] = true;
                            stack.push(j);
                        }
                    }
                }
            }
            if cells.len() >= MIN_CELLS {
                cells.sort_unstable();
                out.extend(self.describe(cells));
            }
        }
        out
    }

    fn describe(&self, cells: Vec<u32>) -> Option<Cluster> {
        let points: Vec<Point3<f64>> =
            cells.iter().filter_map(|i| self.map.point(*i as usize)).collect();
        let n = points.len() as f64;
        let centroid = Point3::from(points.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / n);
        let mut heights: Vec<f64> =
            cells.iter().map(|i| f64::from(self.heights[*i as usize])).collect();
        let (bottom, top) = percentiles(&mut heights)?;
        // Principal direction of the footprint in table coordinates.
        let flat: Vec<(f64, f64)> = points
            .iter()
            .map(|p| {
                let q = self.table.pose.inverse_transform_point(p);
                (q.x, q.y)
            })
            .collect();
        let c = self.table.pose.inverse_transform_point(&centroid);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (x, y) in &flat {
            let (dx, dy) = (x - c.x, y - c.y);
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
        }
        let a = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (s, k) = a.sin_cos();
        let extent = |dx: f64, dy: f64| {
            let mut v: Vec<f64> = flat.iter().map(|(x, y)| x * dx + y * dy).collect();
            percentiles(&mut v).map(|(lo, hi)| hi - lo)
        };
        let (length, width) = (extent(k, s)?, extent(-s, k)?);
        Some(Cluster { cells, centroid, top, bottom, length, width })
    }

    /// How well a cluster fits a model: size, height and colour, each 0..1, and their product.
    pub fn fit(&self, cluster: &Cluster, model: &ObjectModel) -> Fit {
        let soft = |x: f64, width: f64| (-0.5 * (x / width).powi(2)).exp();
        let size = model.size();
        let height = cluster.top;
        // Widest extent: the footprint's diagonal bounds what may be seen of the footprint.
        let (expected_height, flat) = match model.resting {
            Resting::Upright => (size.z, size.x.hypot(size.y).min(2.0 * model.radius)),
            Resting::Any => (0.6 * (size.min() + size.max()), 2.0 * model.radius),
        };
        let longest = match model.resting {
            Resting::Upright => size.x.max(size.y),
            Resting::Any => size.max(),
        };
        let over = (cluster.length - flat * 1.05).max(0.0) / flat;
        let under = (0.75 * longest - cluster.length).max(0.0) / longest;
        let fit_size = soft(over, 0.25) * soft(under, 0.25);
        let spread = match model.resting {
            Resting::Upright => 0.15 * size.z + 0.006,
            Resting::Any => 0.35 * size.max(),
        };
        // A held object is higher than it stands; never rule it out by height alone.
        let fit_height = HELD + (1.0 - HELD) * soft(height - expected_height, spread);
        let fit_color = if model.palette.is_empty() {
            1.0
        } else {
            // A few hundred cells tell as much as all.
            let step = cluster.cells.len().div_ceil(400);
            let some = cluster.cells.iter().step_by(step.max(1));
            let sum: f32 = some.clone().map(|i| model.palette.fit(self.colors[*i as usize])).sum();
            (f64::from(sum) / some.count().max(1) as f64 / 0.7).min(1.0)
        };
        Fit {
            size: fit_size,
            height: fit_height,
            color: fit_color,
            total: fit_size * fit_height * fit_color,
        }
    }

    /// Whether enough of a cluster has the colour that covers most of the model; true without palette.
    pub(crate) fn shows_main_color(&self, cluster: &Cluster, model: &ObjectModel) -> bool {
        let step = cluster.cells.len().div_ceil(400).max(1);
        let some = || cluster.cells.iter().step_by(step);
        let own = some().filter(|i| model.palette.is_main(self.colors[**i as usize])).count();
        model.palette.is_empty() || own as f64 > MAIN_SHARE * some().count() as f64
    }

    /// Full-resolution mask of a cluster of `model` over its bounding window grown by `margin` px.
    /// Thin parts such as a handle often have no depth: pixels that join the cluster and have the
    /// model's colours and not the table's belong to it too.
    pub fn mask(
        &self,
        cluster: &Cluster,
        margin: i32,
        frame: &RgbdFrame,
        model: &ObjectModel,
    ) -> Mask {
        self.mask_within(cluster, margin, frame, model, GROW_M)
    }

    /// As [`Self::mask`]; `reach` (m): how much nearer or farther than the edge of what was found a
    /// surface may be that is joined to it.
    pub(crate) fn mask_within(
        &self,
        cluster: &Cluster,
        margin: i32,
        frame: &RgbdFrame,
        model: &ObjectModel,
        reach: f32,
    ) -> Mask {
        let s = self.map.stride as i32;
        let xy = |i: &u32| (*i as i32 % self.map.width as i32, *i as i32 / self.map.width as i32);
        let (mut x0, mut y0, mut x1, mut y1) = (i32::MAX, i32::MAX, 0, 0);
        for i in &cluster.cells {
            let (x, y) = xy(i);
            x0 = x0.min(x * s);
            y0 = y0.min(y * s);
            x1 = x1.max(x * s + s);
            y1 = y1.max(y * s + s);
        }
        let size = (frame.intrinsics.width as i32, frame.intrinsics.height as i32);
        let (x0, y0) = ((x0 - margin).max(0), (y0 - margin).max(0));
        let (x1, y1) = ((x1 + margin).min(size.0), (y1 + margin).min(size.1));
        let (w, h) = ((x1 - x0).max(1) as u32, (y1 - y0).max(1) as u32);
        let mut mask = Mask { x0, y0, width: w, height: h, data: vec![false; (w * h) as usize] };
        // Pixels still to be looked around, each with the depth of the surface it joins.
        let mut edge = Vec::new();
        for i in &cluster.cells {
            let (x, y) = xy(i);
            let z = self.map.point(*i as usize).map_or(0.0, |p| p.z as f32);
            for v in y * s..y * s + s {
                for u in x * s..x * s + s {
                    if mask.set(u, v) {
                        edge.push((u, v, z));
                    }
                }
            }
        }
        while let Some((u, v, z)) = edge.pop() {
            for (du, dv) in
                (-GROW_PX..=GROW_PX).flat_map(|a| (-GROW_PX..=GROW_PX).map(move |b| (a, b)))
            {
                let (x, y) = (u + du, v + dv);
                if x < x0 || y < y0 || x >= x1 || y >= y1 || mask.at(x, y) {
                    continue;
                }
                let near = frame.depth_at(x, y).is_none_or(|d| (d - z).abs() < reach);
                let c = frame.color.get_pixel(x as u32, y as u32).0;
                let own = model.palette.is_empty() || model.palette.fit(c) > 0.3;
                if near && own && self.table_colors.differs(c) && mask.set(x, y) {
                    edge.push((x, y, z));
                }
            }
        }
        mask
    }
}

/// How well a cluster fits a model; every part 0..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// Footprint against the mesh's bounds.
    pub size: f64,
    /// Top above the table against the mesh's height.
    pub height: f64,
    /// Colour against the palette; 1 without one.
    pub color: f64,
    /// Product of the three.
    pub total: f64,
}

impl Fit {
    /// Product of the three for what is known to stand on the table: the height counts in full.
    pub fn resting(&self) -> f64 {
        self.size * self.color * ((self.height - HELD) / (1.0 - HELD)).max(0.0)
    }
}

/// A window of the image with the pixels of one object.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Left column of the window.
    pub x0: i32,
    /// Top row of the window.
    pub y0: i32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row-major, `width * height`.
    pub data: Vec<bool>,
}

impl Mask {
    /// Adds an image pixel; false when it is outside the window or there already.
    fn set(&mut self, u: i32, v: i32) -> bool {
        let (x, y) = (u - self.x0, v - self.y0);
        if x < 0 || y < 0 || x >= self.width as i32 || y >= self.height as i32 {
            return false;
        }
        let slot = &mut self.data[(y * self.width as i32 + x) as usize];
        !std::mem::replace(slot, true)
    }

    /// Whether image pixel (u, v) belongs to the object; false outside the window.
    #[inline]
    pub fn at(&self, u: i32, v: i32) -> bool {
        let (x, y) = (u - self.x0, v - self.y0);
        x >= 0
            && y >= 0
            && x < self.width as i32
            && y < self.height as i32
            && self.data[(y * self.width as i32 + x) as usize]
    }
}

fn percentiles(values: &mut [f64]) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let at = |q: f64| values[(q * last as f64).round() as usize];
    Some((at(0.02), at(0.98)))
}

fn color_gap(a: [u8; 3], b: [u8; 3]) -> i32 {
    (0..3).map(|k| (i32::from(a[k]) - i32::from(b[k])).abs()).sum()
}

/// Mean over neighbours whose height is within 15 mm, `reach` cells each way.
fn smooth(raw: &[f32], w: usize, h: usize, reach: usize) -> Vec<f32> {
    let mut out = vec![f32::NAN; raw.len()];
    for y in 0..h {
        for x in 0..w {
            let c = raw[y * w + x];
            // Only what may be an object or the table near it is worth the work.
            if !(-0.03..0.6).contains(&c) {
                out[y * w + x] = c;
                continue;
            }
            let (mut sum, mut n) = (0.0, 0.0);
            for yy in y.saturating_sub(reach)..=(y + reach).min(h - 1) {
                for xx in x.saturating_sub(reach)..=(x + reach).min(w - 1) {
                    let v = raw[yy * w + xx];
                    if (v - c).abs() < 0.015 {
                        sum += v;
                        n += 1.0;
                    }
                }
            }
            out[y * w + x] = sum / n;
        }
    }
    out
}

fn cell_colors(frame: &RgbdFrame, map: &PointMap) -> Vec<[u8; 3]> {
    let raw = frame.color.as_raw();
    let row = frame.color.width() as usize * 3;
    let mut out = Vec::with_capacity(map.points.len());
    for y in 0..map.height {
        for x in 0..map.width {
            let i = 2 * y * row + 2 * x * 3;
            let mut c = [0u8; 3];
            for (k, c) in c.iter_mut().enumerate() {
                let sum = u16::from(raw[i + k])
                    + u16::from(raw[i + 3 + k])
                    + u16::from(raw[i + row + k])
                    + u16::from(raw[i + row + 3 + k]);
                *c = (sum / 4) as u8;
            }
            out.push(c);
        }
    }
    out
}
