//! Cheap random fields: hashes instead of a generator, so that any pixel can be drawn alone.

use std::sync::LazyLock;

/// Mixes 32 bits until every input bit reaches every output bit.
pub(crate) fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A key out of seed, frame number and the purpose of the numbers.
pub(crate) fn key(seed: u64, frame: u64, purpose: u32) -> u32 {
    let mut k = hash(purpose.wrapping_add(0x9e37_79b9));
    for part in [seed as u32, (seed >> 32) as u32, frame as u32, (frame >> 32) as u32] {
        k = hash(k.rotate_left(5) ^ part.wrapping_mul(0x85eb_ca6b));
    }
    k
}

/// Uniform in 0..1 from 16 bits of a hash.
pub(crate) fn unit(bits: u32) -> f32 {
    (bits & 0xffff) as f32 / 65536.0
}

/// Standard normal numbers by table: 1024 equally likely values of unit variance (the largest is
/// about 3.4).
pub(crate) struct Gaussian([f32; 1024]);

impl Gaussian {
    /// The table, made once.
    pub(crate) fn table() -> &'static Self {
        static TABLE: LazyLock<Gaussian> = LazyLock::new(Gaussian::build);
        &TABLE
    }

    fn build() -> Self {
        // Walk the distribution function and note where it passes each quantile.
        let mut out = [0.0_f32; 1024];
        let (mut x, mut below, step) = (-6.0_f64, 0.0_f64, 1e-4);
        let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
        for (i, slot) in out.iter_mut().enumerate() {
            let quantile = (i as f64 + 0.5) / 1024.0;
            while below < quantile {
                below += density(x + 0.5 * step) * step;
                x += step;
            }
            *slot = x as f32;
        }
        let variance = out.iter().map(|v| v * v).sum::<f32>() / 1024.0;
        Self(out.map(|v| v / variance.sqrt()))
    }

    /// From the lowest ten bits of a hash.
    pub(crate) fn at(&self, bits: u32) -> f32 {
        self.0[(bits & 1023) as usize]
    }
}

/// A long row of standard normal numbers, read from places picked by hash: as good for an image as one
/// draw a pixel, and without a hash for each.
#[derive(Debug, Default)]
pub(crate) struct Tape(Vec<f32>);

/// Places from which a tape is read.
const STARTS: usize = 1 << 18;

impl Tape {
    /// `width` numbers from the place that the hash picks.
    pub(crate) fn row(&mut self, bits: u32, width: usize) -> &[f32] {
        let table = Gaussian::table();
        let have = self.0.len() as u32;
        self.0.extend((have..(STARTS + width) as u32).map(|i| table.at(hash(i ^ 0x7a3e))));
        let start = bits as usize % STARTS;
        &self.0[start..start + width]
    }
}

/// A standard normal field that is smooth over patches of `cell` pixels: normal numbers on a coarse
/// grid, interpolated, and rescaled so that every pixel has unit variance.
pub(crate) struct Patches {
    cell: usize,
    key: u32,
    /// Interpolation weights within a cell.
    weights: Vec<[f32; 2]>,
    /// The grid's rows above and below the last row asked for, interpolated across, and the number of
    /// the upper one.
    rows: [Vec<f32>; 2],
    upper: Option<usize>,
}

impl Patches {
    pub(crate) fn new(width: usize, cell: usize, key: u32) -> Self {
        let cell = cell.max(1);
        let weights = (0..cell)
            .map(|i| {
                let t = i as f32 / cell as f32;
                let norm = ((1.0 - t) * (1.0 - t) + t * t).sqrt();
                [(1.0 - t) / norm, t / norm]
            })
            .collect();
        let rows = [vec![0.0; width], vec![0.0; width]];
        Self { cell, key, weights, rows, upper: None }
    }

    /// The field along row `y`.
    pub(crate) fn row(&mut self, y: usize, out: &mut [f32]) {
        let cy = y / self.cell;
        if self.upper != Some(cy) {
            if self.upper.is_some_and(|u| u + 1 == cy) {
                self.rows.swap(0, 1);
            } else {
                self.across(cy, 0);
            }
            self.across(cy + 1, 1);
            self.upper = Some(cy);
        }
        let [a, b] = self.weights[y % self.cell];
        for ((slot, above), below) in out.iter_mut().zip(&self.rows[0]).zip(&self.rows[1]) {
            *slot = a * above + b * below;
        }
    }

    /// Interpolates row `cy` of the grid.
    fn across(&mut self, cy: usize, into: usize) {
        let table = Gaussian::table();
        let node = |cx: usize| table.at(hash(self.key ^ hash((cy as u32) << 16 ^ cx as u32)));
        let mut left = node(0);
        for (cx, chunk) in self.rows[into].chunks_mut(self.cell).enumerate() {
            let right = node(cx + 1);
            for (slot, w) in chunk.iter_mut().zip(&self.weights) {
                *slot = w[0] * left + w[1] * right;
            }
            left = right;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_have_unit_variance_and_the_stated_reach() {
        let (w, h) = (600, 300);
        let mut field = Patches::new(w, 6, key(3, 4, 5));
        let mut all = vec![0.0; w * h];
        for (y, row) in all.chunks_mut(w).enumerate() {
            field.row(y, row);
        }
        let n = (w * h) as f32;
        let mean = all.iter().sum::<f32>() / n;
        let variance = all.iter().map(|v| v * v).sum::<f32>() / n;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        let lag = |d: usize| all.windows(d + 1).map(|v| v[0] * v[d]).sum::<f32>() / (n * variance);
        assert!(lag(1) > 0.8 && lag(20).abs() < 0.05, "{} {}", lag(1), lag(20));
    }

    #[test]
    fn the_tape_has_unit_variance_and_rows_differ() {
        let mut tape = Tape::default();
        let (a, b) = (tape.row(hash(1), 1920).to_vec(), tape.row(hash(2), 1920).to_vec());
        assert_eq!(a, tape.row(hash(1), 1920));
        let n = tape.0.len() as f32;
        let mean = tape.0.iter().sum::<f32>() / n;
        let variance = tape.0.iter().map(|v| v * v).sum::<f32>() / n;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.01, "{mean} {variance}");
        let common = a.iter().zip(&b).map(|(a, b)| a * b).sum::<f32>() / 1920.0;
        assert!(common.abs() < 0.1, "{common}");
    }

    #[test]
    fn hashes_are_uniform_and_keys_differ() {
        let n = 100_000;
        let mean = (0..n).map(|i| unit(hash(i))).sum::<f32>() / n as f32;
        assert!((mean - 0.5).abs() < 0.005);
        let table = Gaussian::table();
        let neighbours = (0..n)
            .map(|i| table.at(hash(key(1, 2, 3) ^ i)) * table.at(hash(key(1, 2, 3) ^ (i + 1))))
            .sum::<f32>()
            / n as f32;
        assert!(neighbours.abs() < 0.015, "{neighbours}");
        let keys = [key(1, 0, 0), key(0, 1, 0), key(0, 0, 1), key(1 << 40, 0, 0), key(0, 0, 0)];
        for (i, a) in keys.iter().enumerate() {
            assert!(keys[..i].iter().all(|b| a != b));
        }
    }
}
