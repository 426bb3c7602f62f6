//! A linear layer whose weights are laid out for few rows: panels of 32 columns, read in order.

use crate::kernels::{SimdLevel, Start, Strided, WIDTH, panel, simd_level};
use crate::network::Linear;

/// Rows at a time of what does not fill a panel.
const NARROW: usize = 8;

/// `y = x W + b` for a handful of rows.
pub(crate) struct PackedLinear {
    inputs: usize,
    outputs: usize,
    /// `[panels][inputs][32]`, padded with zeros.
    weights: Vec<f32>,
    bias: Vec<f32>,
    level: SimdLevel,
}

impl PackedLinear {
    /// Packs a layer out of the flat parameters.
    pub fn new(l: &Linear, flat: &[f32]) -> Self {
        Self::pack(l.weight.of(flat), l.bias.of(flat), l.inputs, l.outputs, simd_level())
    }

    fn pack(w: &[f32], bias: &[f32], inputs: usize, outputs: usize, level: SimdLevel) -> Self {
        let mut weights = vec![0.0; outputs.div_ceil(WIDTH) * inputs * WIDTH];
        for (p, panel) in weights.chunks_exact_mut(inputs * WIDTH).enumerate() {
            let n = WIDTH.min(outputs - p * WIDTH);
            for (k, row) in panel.chunks_exact_mut(WIDTH).enumerate() {
                row[..n].copy_from_slice(&w[k * outputs + p * WIDTH..][..n]);
            }
        }
        Self { inputs, outputs, weights, bias: bias.to_vec(), level }
    }

    /// `x[rows, inputs]` to `y[rows, outputs]`.
    pub fn apply(&self, x: &[f32], y: &mut [f32], rows: usize) {
        let (k, n) = (self.inputs, self.outputs);
        assert!(x.len() >= rows * k && y.len() >= rows * n, "sizes");
        let y = &mut y[..rows * n];
        let a = Strided { data: x, row: k, column: 1 };
        let panels = self.weights.chunks_exact(k * WIDTH).zip(self.bias.chunks(WIDTH));
        for (p, (w, bias)) in panels.enumerate() {
            let (y, start) = (&mut y[p * WIDTH..], Start::Row(bias));
            if bias.len() == WIDTH {
                // While a panel is used the next one comes out of the outer cache.
                panel::<2, true>(self.level, [rows, k], a, w, WIDTH, y, n, start);
                continue;
            }
            let mut sums = [0.0; NARROW * WIDTH];
            for (i, y) in y.chunks_mut(NARROW * n).enumerate() {
                let count = NARROW.min(rows - i * NARROW);
                let a = Strided { data: &x[i * NARROW * k..], ..a };
                let zero = Start::Zero;
                panel::<2, false>(self.level, [count, k], a, w, WIDTH, &mut sums, WIDTH, zero);
                for (y, sums) in y.chunks_mut(n).zip(sums.chunks_exact(WIDTH)) {
                    for ((y, s), b) in y.iter_mut().zip(sums).zip(bias) {
                        *y = s + b;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check::random;
    use crate::kernels::{levels, matmul};

    #[test]
    fn every_level_agrees_with_the_matrix_product() {
        for (rows, k, n) in [(16, 64, 192), (10, 9, 64), (13, 64, 9), (1, 32, 33), (7, 5, 64)] {
            let (x, w, b) = (random(rows * k, 1), random(k * n, 2), random(n, 3));
            let mut want: Vec<f32> = b.iter().copied().cycle().take(rows * n).collect();
            matmul(&x, &w, &mut want, [rows, k, n], true);
            for level in levels() {
                let mut y = vec![0.0; rows * n];
                PackedLinear::pack(&w, &b, k, n, level).apply(&x, &mut y, rows);
                for (a, b) in y.iter().zip(&want) {
                    assert!((a - b).abs() < 1e-5, "{level:?} {rows}x{k}x{n}");
                }
            }
        }
    }
}
