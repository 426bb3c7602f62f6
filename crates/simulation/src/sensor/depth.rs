use super::noise::{Gaussian, Patches, Tape, hash, key, unit};
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
    /// 1 within reach of an edge.
    beside_edge: Vec<u8>,
    /// 1 within reach of an edge of the same row.
    reached: Vec<u8>,
    edge: Vec<u8>,
    shared: Vec<f32>,
    lost: Vec<f32>,
    /// Column in the second imager.
    second: Vec<f32>,
    tape: Tape,
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
        self.find_edges(z, w, fb, scratch);
        let noise = Noise {
            own: (1.0 - self.shared as f32).max(0.0).sqrt(),
            common: (self.shared as f32).max(0.0).sqrt(),
            per_square: self.sigma(1.0, camera.fx) as f32,
            lost_above: two_sided(self.patch_loss as f32),
            range: self.range.map(|v| v as f32),
        };
        scratch.shared.resize(w, 0.0);
        scratch.lost.resize(w, 0.0);
        scratch.second.resize(w, 0.0);
        let mut shared = Patches::new(w, self.patch, key(seed, frame, 1));
        let mut lost = Patches::new(w, self.loss_patch, key(seed, frame, 2));
        let (pixel_key, row_key) = (key(seed, frame, 3), key(seed, frame, 4));
        let rays_x: Vec<f32> =
            (0..w).map(|x| ((x as f64 - camera.cx) / camera.fx) as f32).collect();
        for (y, out) in out.data.chunks_exact_mut(w).enumerate() {
            shared.row(y, &mut scratch.shared);
            lost.row(y, &mut scratch.lost);
            let ray_y = ((y as f64 - camera.cy) / camera.fy) as f32;
            let span = y * w..(y + 1) * w;
            let own = scratch.tape.row(hash(row_key ^ y as u32), w);
            let here = &z[span.clone()];
            noise.read(here, own, &scratch.shared, &scratch.lost, out);
            let drawn = |x: usize| unit(hash(pixel_key ^ (span.start + x) as u32) >> 16);
            self.lose_grazing(&exact.normals[span.clone()], &rays_x, ray_y, drawn, out);
            // What lies beside an edge is read anew, from a pixel nearby.
            for (x, beside) in scratch.beside_edge[span.clone()].iter().enumerate() {
                if *beside == 0 || out[x] == 0.0 {
                    continue;
                }
                let bits = hash(pixel_key ^ (span.start + x) as u32);
                out[x] = if unit(hash(bits)) < self.edge_loss as f32 {
                    0.0
                } else {
                    let source = self.displaced(z, (w, h), (x, y), bits);
                    noise.one(source, own[x], scratch.shared[x])
                };
            }
            // Right to left: what falls left of it in the second imager is hidden behind it there.
            for (x, (to, z)) in scratch.second.iter_mut().zip(here).enumerate() {
                *to = if *z > 0.0 { x as f32 - fb / z } else { f32::MAX };
            }
            let mut hidden_from = f32::MAX;
            for (x, second) in scratch.second.iter().enumerate().rev() {
                if *second > hidden_from {
                    let bits = hash(pixel_key ^ (span.start + x) as u32);
                    if unit(bits >> 12) < 0.9 {
                        out[x] = 0.0;
                    }
                } else {
                    hidden_from = *second;
                }
            }
        }
    }

    /// Loses readings of surfaces seen at a grazing angle; `drawn` gives a uniform number by column.
    fn lose_grazing(
        &self,
        normals: &[[f32; 3]],
        rays_x: &[f32],
        ray_y: f32,
        drawn: impl Fn(usize) -> f32,
        out: &mut [f32],
    ) {
        let (begin, end) = (self.grazing_begin as f32, self.grazing_end as f32);
        let above = ray_y * ray_y + 1.0;
        for (x, (n, ray_x)) in normals.iter().zip(rays_x).enumerate() {
            let across = n[0] * ray_x + n[1] * ray_y + n[2];
            let ray = ray_x * ray_x + above;
            if across * across < begin * begin * ray {
                let cos = across.abs() / ray.sqrt();
                if drawn(x) < (begin - cos) / (begin - end).max(1e-6) {
                    out[x] = 0.0;
                }
            }
        }
    }

    /// Marks pixels within reach of a step in disparity.
    fn find_edges(&self, z: &[f32], w: usize, fb: f32, scratch: &mut Scratch) {
        let Scratch { beside_edge, reached, edge, .. } = scratch;
        beside_edge.clear();
        beside_edge.resize(z.len(), 0);
        reached.clear();
        reached.resize(z.len(), 0);
        edge.resize(w, 0);
        if w == 0 {
            return;
        }
        let reach = self.edge_reach;
        let step = self.edge_step as f32 / fb;
        // |1/a - 1/b| > step, without the divisions; a missing neighbour (0) is a step too.
        let is_edge = |a: f32, b: f32| u8::from(((a - b).abs() > step * a * b) & (a + b > 0.0));
        for (y, row) in z.chunks_exact(w).enumerate() {
            let above = if y > 0 { &z[(y - 1) * w..y * w] } else { row };
            for ((e, a), b) in edge.iter_mut().zip(above).zip(row) {
                *e = is_edge(*a, *b);
            }
            for ((e, a), b) in edge[1..].iter_mut().zip(row).zip(&row[1..]) {
                *e |= is_edge(*a, *b);
            }
            let reached = &mut reached[y * w..(y + 1) * w];
            for d in 0..=reach.min(w - 1) {
                or(&mut reached[d..], edge);
                or(reached, &edge[d..]);
            }
        }
        for (y, row) in reached.chunks_exact(w).enumerate() {
            let h = z.len() / w;
            for yy in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                or(&mut beside_edge[yy * w..(yy + 1) * w], row);
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

/// Marks what is marked in `from`, as far as both go.
fn or(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to |= from;
    }
}

/// Constants of one frame.
struct Noise {
    own: f32,
    common: f32,
    per_square: f32,
    lost_above: f32,
    range: [f32; 2],
}

impl Noise {
    /// What is read at distance `z` (m) with standard normal numbers of the pixel and of its patch.
    fn one(&self, z: f32, own: f32, shared: f32) -> f32 {
        let read = z + self.per_square * z * z * (self.own * own + self.common * shared);
        // Bitwise: without branches the compiler does eight pixels at once.
        let valid = (z > 0.0) & (read > self.range[0]) & (read < self.range[1]);
        if valid { quantise(read) } else { 0.0 }
    }

    /// A row of readings; whole patches are lost where the field `lost` is extreme.
    fn read(&self, z: &[f32], own: &[f32], shared: &[f32], lost: &[f32], out: &mut [f32]) {
        for ((((to, z), own), shared), lost) in out.iter_mut().zip(z).zip(own).zip(shared).zip(lost)
        {
            let read = self.one(*z, *own, *shared);
            *to = if lost.abs() > self.lost_above { 0.0 } else { read };
        }
    }
}

/// Whole millimetres. Above 2^23 a float has no fraction left: adding it rounds, in one instruction.
fn quantise(z: f32) -> f32 {
    const ROUND: f32 = 8_388_608.0;
    ((z * 1000.0 + ROUND) - ROUND) / 1000.0
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
