//! Layer normalisation without own weights, followed by `x (1 + scale) + shift` with one shift and
//! scale per sample.

use super::dispatch;
use super::math::{dot, fma, sum};

const EPS: f32 = 1e-6;

/// Sizes of a modulated layer norm over `x[batch, tokens, d]`.
#[derive(Debug, Clone, Copy)]
pub struct LayerNormShape {
    /// Samples.
    pub batch: usize,
    /// Rows per sample, which share the modulation.
    pub tokens: usize,
    /// Width of a row.
    pub d: usize,
    /// Distance between the samples' modulations.
    pub stride: usize,
    /// Where the `d` shifts start within a sample's modulation; the `d` scales follow them.
    pub at: usize,
}

dispatch! {
    /// `y = xh (1 + scale) + shift` with `xh = (x - mean) rstd`; `stats[row] = [mean, rstd]`.
    pub fn layer_norm_modulate(
        s: LayerNormShape, x: &[f32], modulation: &[f32], y: &mut [f32], stats: &mut [[f32; 2]],
    ) = forward
}

#[inline(always)]
fn forward<const FMA: bool>(
    s: LayerNormShape,
    x: &[f32],
    modulation: &[f32],
    y: &mut [f32],
    stats: &mut [[f32; 2]],
) {
    let rows = s.batch * s.tokens;
    for ((row, (x, y)), stat) in
        x.chunks_exact(s.d).zip(y.chunks_exact_mut(s.d)).enumerate().zip(stats).take(rows)
    {
        let m = &modulation[(row / s.tokens) * s.stride + s.at..][..2 * s.d];
        let (shift, scale) = m.split_at(s.d);
        let mean = sum(x) / s.d as f32;
        // The centred values, kept in y, so that the variance does not cancel.
        for (y, x) in y.iter_mut().zip(x) {
            *y = x - mean;
        }
        let rstd = 1.0 / (dot::<FMA>(y, y) / s.d as f32 + EPS).sqrt();
        for ((y, shift), scale) in y.iter_mut().zip(shift).zip(scale) {
            *y = fma::<FMA>(*y * rstd, 1.0 + scale, *shift);
        }
        *stat = [mean, rstd];
    }
}

dispatch! {
    /// Given `g = dL/dy`, adds `dL/dx` to `dx` and writes `dL/dshift`, `dL/dscale` (sums over a
    /// sample's rows) at their place in `dmodulation`.
    pub fn layer_norm_modulate_backward(
        s: LayerNormShape, x: &[f32], modulation: &[f32], stats: &[[f32; 2]], g: &[f32],
        dx: &mut [f32], dmodulation: &mut [f32],
    ) = backward
}

#[inline(always)]
fn backward<const FMA: bool>(
    s: LayerNormShape,
    x: &[f32],
    modulation: &[f32],
    stats: &[[f32; 2]],
    g: &[f32],
    dx: &mut [f32],
    dmodulation: &mut [f32],
) {
    let d = s.d;
    for sample in 0..s.batch {
        let scale = &modulation[sample * s.stride + s.at + d..][..d];
        let (dshift, dscale) = dmodulation[sample * s.stride + s.at..][..2 * d].split_at_mut(d);
        dshift.fill(0.0);
        dscale.fill(0.0);
        for row in sample * s.tokens..(sample + 1) * s.tokens {
            let (x, g) = (&x[row * d..][..d], &g[row * d..][..d]);
            let dx = &mut dx[row * d..][..d];
            let [mean, rstd] = stats[row];
            let (mut sum_gy, mut sum_gy_xh) = ([0.0f32; 16], [0.0f32; 16]);
            for c in (0..d).step_by(16) {
                for i in 0..16.min(d - c) {
                    let j = c + i;
                    let xh = (x[j] - mean) * rstd;
                    let gy = g[j] * (1.0 + scale[j]);
                    sum_gy[i] += gy;
                    sum_gy_xh[i] = fma::<FMA>(gy, xh, sum_gy_xh[i]);
                    dshift[j] += g[j];
                    dscale[j] = fma::<FMA>(g[j], xh, dscale[j]);
                }
            }
            let mean_gy = sum(&sum_gy) / d as f32;
            let mean_gy_xh = sum(&sum_gy_xh) / d as f32;
            for j in 0..d {
                let xh = (x[j] - mean) * rstd;
                let gy = g[j] * (1.0 + scale[j]);
                dx[j] += rstd * fma::<FMA>(-xh, mean_gy_xh, gy - mean_gy);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check;

    #[test]
    fn gradients_match_differences() {
        let s = LayerNormShape { batch: 2, tokens: 3, d: 16, stride: 40, at: 4 };
        let (x, m) = (check::random(96, 1), check::random(80, 2));
        let w = check::random(96, 3);
        let run = |x: &[f32], m: &[f32]| {
            let (mut y, mut stats) = (vec![0.0; 96], vec![[0.0; 2]; 6]);
            layer_norm_modulate(s, x, m, &mut y, &mut stats);
            (check::dot(&y, &w), stats)
        };
        let (_, stats) = run(&x, &m);
        let (mut dx, mut dm) = (vec![0.0; 96], vec![0.0; 80]);
        layer_norm_modulate_backward(s, &x, &m, &stats, &w, &mut dx, &mut dm);
        check::gradient("x", &x, &dx, |x| run(x, &m).0);
        check::gradient("modulation", &m, &dm, |m| run(&x, m).0);
    }
}
