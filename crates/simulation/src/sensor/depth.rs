use super::noise::{Gaussian, Patches, hash, key, unit};
use serde::{Deserialize, Serialize};
use tdv_rendering::{DepthImage, Intrinsics, Rendered};

/// Imperfections of the depth image; the table in [`crate::sensor`] says what each does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNoise {
    /// Whether anything but quantisation is done at all.
    pub enabled: bool,
    /// Distance of the two imagers (m).
    pub baseline: f64,
    /// Standard deviation of the matched disparity (px).
    pub subpixel: f64,
    /// Share of the noise variance that neighbouring pixels have in common (0..1).
    pub shared: f64,
    /// Size of the patches with common noise (px).
    pub patch: usize,
    /// A step between neighbouring pixels counts as an edge from this change of disparity on (px).
    pub edge_step: f64,
    /// Reach of an edge's effects (px).
    pub edge_reach: usize,
    /// Share of lost readings within that reach.
    pub edge_loss: f64,
    /// Share of readings between the two sides within that reach.
    pub flying: f64,
    /// Standard deviation of the sideways displacement within that reach (px).
    pub lateral: f64,
    /// Cosine of the viewing angle below which readings begin to be lost...
    pub grazing_begin: f64,
    /// ...and below which all are.
    pub grazing_end: f64,
    /// Share of the area lost in patches.
    pub patch_loss: f64,
    /// Size of those patches (px).
    pub loss_patch: usize,
    /// Nearest and farthest reading (m).
    pub range: [f64; 2],
}

impl Default for DepthNoise {
    fn default() -> Self {
        Self {
            enabled: true,
            baseline: 0.050,
            subpixel: 0.08,
            shared: 0.3,
            patch: 6,
            edge_step: 0.4,
            edge_reach: 2,
            edge_loss: 0.45,
            flying: 0.12,
            lateral: 0.8,
            grazing_begin: 0.40,
            grazing_end: 0.10,
            patch_loss: 0.055,
            loss_patch: 8,
            range: [0.17, 6.0],
        }
    }
}

/// Buffers kept from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    beside_edge: Vec<bool>,
    shared: Vec<f32>,
    lost: Vec<f32>,
}

impl DepthNoise {
    /// Standard deviation (m) of a reading at distance `z` (m) with focal length `fx` (px).
    pub fn sigma(&self, z: f64, fx: f64) -> f64 {
        self.subpixel * z * z / (fx * self.baseline)
    }

    pub(super) fn apply(
        &self,
        camera: &Intrinsics,
        exact: &Rendered,
        (seed, frame): (u64, u64),
        scratch: &mut Scratch,
        out: &mut DepthImage,
    ) {
        let (w, h) = (camera.width as usize, camera.height as usize);
        let z = &exact.depth.data;
        (out.width, out.height) = (camera.width, camera.height);
        out.data.resize(w * h, 0.0);
        if !self.enabled {
            for (to, from) in out.data.iter_mut().zip(z) {
                *to = quantise(*from);
            }
            return;
        }
        let fb = (camera.fx * self.baseline) as f32;
        self.find_edges(z, w, fb, &mut scratch.beside_edge);
        let noise = Noise {
            table: Gaussian::table(),
            own: (1.0 - self.shared as f32).max(0.0).sqrt(),
            common: (self.shared as f32).max(0.0).sqrt(),
            per_square: self.sigma(1.0, camera.fx) as f32,
            lost_above: two_sided(self.patch_loss as f32),
        };
        scratch.shared.resize(w, 0.0);
        scratch.lost.resize(w, 0.0);
        let mut shared = Patches::new(w, self.patch, key(seed, frame, 1));
        let mut lost = Patches::new(w, self.loss_patch, key(seed, frame, 2));
        let pixel_key = key(seed, frame, 3);
        let near_far = self.range.map(|v| v as f32);
        let rays_x: Vec<f32> =
            (0..w).map(|x| ((x as f64 - camera.cx) / camera.fx) as f32).collect();
        for y in 0..h {
            shared.row(y, &mut scratch.shared);
            lost.row(y, &mut scratch.lost);
            let ray_y = ((y as f64 - camera.cy) / camera.fy) as f32;
            // Smallest column in the second imager of anything further right: what lies to the
            // right of it there is hidden.
            let mut hidden_from = f32::MAX;
            for x in (0..w).rev() {
                let i = y * w + x;
                let here = z[i];
                if here <= 0.0 {
                    out.data[i] = 0.0;
                    continue;
                }
                let bits = hash(pixel_key ^ i as u32);
                let second = x as f32 - fb / here;
                let hidden = second > hidden_from;
                hidden_from = hidden_from.min(second);
                let n = &exact.normals[i];
                let across = n[0] * rays_x[x] + n[1] * ray_y + n[2];
                let square = across * across;
                let ray = rays_x[x] * rays_x[x] + ray_y * ray_y + 1.0;
                let begin = self.grazing_begin as f32;
                let grazing = square < begin * begin * ray && {
                    let cos = square.sqrt() / ray.sqrt();
                    let end = self.grazing_end as f32;
                    unit(bits >> 16) < (begin - cos) / (begin - end).max(1e-6)
                };
                let beside = scratch.beside_edge[i];
                if grazing
                    || scratch.lost[x].abs() > noise.lost_above
                    || (hidden && unit(bits >> 12) < 0.9)
                    || (beside && unit(hash(bits)) < self.edge_loss as f32)
                {
                    out.data[i] = 0.0;
                    continue;
                }
                let source = if beside { self.displaced(z, (w, h), (x, y), bits) } else { here };
                let sigma = noise.per_square * source * source;
                let own = noise.table.at(bits);
                let read = source + sigma * (noise.own * own + noise.common * scratch.shared[x]);
                let valid = read > near_far[0] && read < near_far[1];
                out.data[i] = if valid { quantise(read) } else { 0.0 };
            }
        }
    }

    /// Marks pixels within reach of a step in disparity.
    fn find_edges(&self, z: &[f32], w: usize, fb: f32, beside: &mut Vec<bool>) {
        beside.clear();
        beside.resize(z.len(), false);
        if w == 0 {
            return;
        }
        let h = z.len() / w;
        let reach = self.edge_reach;
        let step = self.edge_step as f32 / fb;
        // |1/a - 1/b| > step, without the divisions; a missing neighbour (0) is a step too.
        let edge = |a: f32, b: f32| (a - b).abs() > step * a * b && a + b > 0.0;
        let mut mark = |x: usize, y: usize| {
            for yy in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                let row = yy * w;
                beside[row + x.saturating_sub(reach)..row + (x + reach + 1).min(w)].fill(true);
            }
        };
        for y in 0..h {
            let row = &z[y * w..(y + 1) * w];
            for x in 1..w {
                if edge(row[x - 1], row[x]) {
                    mark(x, y);
                }
            }
            if y > 0 {
                let above = &z[(y - 1) * w..y * w];
                for x in 0..w {
                    if edge(above[x], row[x]) {
                        mark(x, y);
                    }
                }
            }
        }
    }

    /// Depth read beside an edge: that of a pixel nearby, or something between the two sides.
    fn displaced(
        &self,
        z: &[f32],
        (w, h): (usize, usize),
        (x, y): (usize, usize),
        bits: u32,
    ) -> f32 {
        let table = Gaussian::table();
        let more = hash(bits ^ 0x5bd1_e995);
        let pick = |scale: f32| {
            let dx = (table.at(more) * scale).round() as i64;
            let dy = (table.at(more >> 10) * scale).round() as i64;
            let xx = (x as i64 + dx).clamp(0, w as i64 - 1) as usize;
            let yy = (y as i64 + dy).clamp(0, h as i64 - 1) as usize;
            let there = z[yy * w + xx];
            if there > 0.0 { there } else { z[y * w + x] }
        };
        let lateral = self.lateral as f32;
        let near = pick(lateral);
        if unit(hash(more)) < self.flying as f32 {
            let far = pick(-2.0 * lateral.max(0.5));
            near + (far - near) * unit(hash(more ^ 0xa5a5))
        } else {
            near
        }
    }
}

/// Constants of one frame.
struct Noise {
    table: &'static Gaussian,
    own: f32,
    common: f32,
    per_square: f32,
    lost_above: f32,
}

/// Whole millimetres. (A cast truncates; `round` is a library call on the baseline processor.)
fn quantise(z: f32) -> f32 {
    (z * 1000.0 + 0.5) as i32 as f32 / 1000.0
}

/// The value that a standard normal number exceeds in size with the given probability.
fn two_sided(share: f32) -> f32 {
    if share <= 0.0 {
        return f32::MAX;
    }
    let table = Gaussian::table();
    let mut sizes: Vec<f32> = (0..1024).map(|i| table.at(i).abs()).collect();
    sizes.sort_by(f32::total_cmp);
    let index = ((1.0 - share.min(1.0)) * 1024.0) as usize;
    sizes[index.min(1023)]
}
