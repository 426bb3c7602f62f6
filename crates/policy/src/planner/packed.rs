//! A linear layer whose weights are laid out for few rows: panels of 32 columns, read in order.

use crate::kernels::{SimdLevel, simd_level};
use crate::network::Linear;

const PANEL: usize = 32;

/// `y = x W + b` for a handful of rows.
pub(crate) struct PackedLinear {
    inputs: usize,
    outputs: usize,
    /// `[panels][inputs][32]`, padded with zeros.
    weights: Vec<[f32; PANEL]>,
    bias: Vec<[f32; PANEL]>,
    level: SimdLevel,
}

impl PackedLinear {
    /// Packs a layer out of the flat parameters.
    pub fn new(l: &Linear, flat: &[f32]) -> Self {
        Self::pack(l.weight.of(flat), l.bias.of(flat), l.inputs, l.outputs, simd_level())
    }

    fn pack(w: &[f32], b: &[f32], inputs: usize, outputs: usize, level: SimdLevel) -> Self {
        let panels = outputs.div_ceil(PANEL);
        let mut weights = vec![[0.0; PANEL]; panels * inputs];
        let mut bias = vec![[0.0; PANEL]; panels];
        for p in 0..panels {
            let n = PANEL.min(outputs - p * PANEL);
            bias[p][..n].copy_from_slice(&b[p * PANEL..][..n]);
            for k in 0..inputs {
                weights[p * inputs + k][..n].copy_from_slice(&w[k * outputs + p * PANEL..][..n]);
            }
        }
        Self { inputs, outputs, weights, bias, level }
    }

    /// `x[rows, inputs]` to `y[rows, outputs]`.
    pub fn apply(&self, x: &[f32], y: &mut [f32], rows: usize) {
        assert!(x.len() >= rows * self.inputs && y.len() >= rows * self.outputs, "sizes");
        let x = &x[..rows * self.inputs];
        for (p, bias) in self.bias.iter().enumerate() {
            let w = &self.weights[p * self.inputs..][..self.inputs];
            let width = PANEL.min(self.outputs - p * PANEL);
            let mut row = 0;
            while row < rows {
                let tall = if rows - row >= 8 {
                    8
                } else if rows - row >= 4 {
                    4
                } else {
                    1
                };
                let mut tile = [[0.0; PANEL]; 8];
                let x = &x[row * self.inputs..][..tall * self.inputs];
                match tall {
                    8 => self.tile::<8>(x, w, bias, &mut tile),
                    4 => self.tile::<4>(x, w, bias, &mut tile),
                    _ => self.tile::<1>(x, w, bias, &mut tile),
                }
                for (i, t) in tile.iter().take(tall).enumerate() {
                    y[(row + i) * self.outputs + p * PANEL..][..width].copy_from_slice(&t[..width]);
                }
                row += tall;
            }
        }
    }

    #[inline]
    fn tile<const R: usize>(
        &self,
        x: &[f32],
        w: &[[f32; PANEL]],
        bias: &[f32; PANEL],
        tile: &mut [[f32; PANEL]; 8],
    ) {
        #[cfg(target_arch = "x86_64")]
        match self.level {
            // SAFETY: the level was detected on this processor.
            SimdLevel::Avx512 => return unsafe { x86::tile_avx512::<R>(x, w, bias, tile) },
            // SAFETY: as above.
            SimdLevel::Avx2 => return unsafe { x86::tile_avx2::<R>(x, w, bias, tile) },
            SimdLevel::Baseline => {}
        }
        plain::<R>(x, w, bias, tile);
    }
}

/// The same in plain loops, for any processor.
fn plain<const R: usize>(
    x: &[f32],
    w: &[[f32; PANEL]],
    bias: &[f32; PANEL],
    tile: &mut [[f32; PANEL]; 8],
) {
    for r in 0..R {
        let mut acc = *bias;
        for (x, w) in x[r * w.len()..].iter().zip(w) {
            for (a, w) in acc.iter_mut().zip(w) {
                *a += x * w;
            }
        }
        tile[r] = acc;
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::PANEL;
    use std::arch::x86_64::*;

    /// `R` rows by 32 columns, two 16-lane accumulators per row.
    #[target_feature(enable = "avx512f")]
    pub fn tile_avx512<const R: usize>(
        x: &[f32],
        w: &[[f32; PANEL]],
        bias: &[f32; PANEL],
        tile: &mut [[f32; PANEL]; 8],
    ) {
        let inputs = w.len();
        assert!(x.len() >= R * inputs && R <= 8);
        // SAFETY: every pointer stays inside its slice or array: `k < w.len()`, `r < R <= 8`, and
        // both halves of a 32-wide row are read and written.
        unsafe {
            let (b0, b1) = (_mm512_loadu_ps(bias.as_ptr()), _mm512_loadu_ps(bias.as_ptr().add(16)));
            let (mut low, mut high) = ([b0; R], [b1; R]);
            for (k, w) in w.iter().enumerate().map(|(k, row)| (k, row.as_ptr())) {
                let (w0, w1) = (_mm512_loadu_ps(w), _mm512_loadu_ps(w.add(16)));
                for r in 0..R {
                    let v = _mm512_set1_ps(*x.as_ptr().add(r * inputs + k));
                    low[r] = _mm512_fmadd_ps(v, w0, low[r]);
                    high[r] = _mm512_fmadd_ps(v, w1, high[r]);
                }
            }
            for r in 0..R {
                _mm512_storeu_ps(tile[r].as_mut_ptr(), low[r]);
                _mm512_storeu_ps(tile[r].as_mut_ptr().add(16), high[r]);
            }
        }
    }

    /// `R` rows by 32 columns in two passes of 16, two 8-lane accumulators per row; more than four
    /// rows are done in two halves, which is what 16 registers hold.
    #[target_feature(enable = "avx2,fma")]
    pub fn tile_avx2<const R: usize>(
        x: &[f32],
        w: &[[f32; PANEL]],
        bias: &[f32; PANEL],
        tile: &mut [[f32; PANEL]; 8],
    ) {
        if R == 8 {
            half::<4>(x, 0, w, bias, tile);
            half::<4>(x, 4, w, bias, tile);
        } else {
            half::<R>(x, 0, w, bias, tile);
        }
    }

    #[target_feature(enable = "avx2,fma")]
    fn half<const R: usize>(
        x: &[f32],
        first: usize,
        w: &[[f32; PANEL]],
        bias: &[f32; PANEL],
        tile: &mut [[f32; PANEL]; 8],
    ) {
        let inputs = w.len();
        assert!(x.len() >= (first + R) * inputs && first + R <= 8);
        for c in [0, 16] {
            // SAFETY: `c + 16 <= 32`, `k < inputs`, and the rows were checked above.
            unsafe {
                let b = bias.as_ptr().add(c);
                let (mut low, mut high) = ([_mm256_loadu_ps(b); R], [_mm256_loadu_ps(b.add(8)); R]);
                for (k, w) in w.iter().enumerate().map(|(k, row)| (k, row.as_ptr().add(c))) {
                    let (w0, w1) = (_mm256_loadu_ps(w), _mm256_loadu_ps(w.add(8)));
                    for r in 0..R {
                        let v = _mm256_set1_ps(*x.as_ptr().add((first + r) * inputs + k));
                        low[r] = _mm256_fmadd_ps(v, w0, low[r]);
                        high[r] = _mm256_fmadd_ps(v, w1, high[r]);
                    }
                }
                for r in 0..R {
                    let t = tile[first + r].as_mut_ptr().add(c);
                    _mm256_storeu_ps(t, low[r]);
                    _mm256_storeu_ps(t.add(8), high[r]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check::random;
    use crate::kernels::matmul;

    #[test]
    fn every_level_agrees_with_the_matrix_product() {
        let best = simd_level();
        let levels: &[SimdLevel] = match best {
            SimdLevel::Avx512 => &[SimdLevel::Avx512, SimdLevel::Avx2, SimdLevel::Baseline],
            SimdLevel::Avx2 => &[SimdLevel::Avx2, SimdLevel::Baseline],
            SimdLevel::Baseline => &[SimdLevel::Baseline],
        };
        for (rows, k, n) in [(16, 64, 192), (10, 9, 64), (13, 64, 9), (1, 32, 33)] {
            let (x, w, b) = (random(rows * k, 1), random(k * n, 2), random(n, 3));
            let mut want: Vec<f32> = b.iter().copied().cycle().take(rows * n).collect();
            matmul(&x, &w, &mut want, [rows, k, n], true);
            for level in levels {
                let mut y = vec![0.0; rows * n];
                PackedLinear::pack(&w, &b, k, n, *level).apply(&x, &mut y, rows);
                for (a, b) in y.iter().zip(&want) {
                    assert!((a - b).abs() < 1e-5, "{level:?} {rows}x{k}x{n}");
                }
            }
        }
    }
}
