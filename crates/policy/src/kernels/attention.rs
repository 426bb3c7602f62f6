//! Full (non-causal) multi-head self-attention on packed projections, softmax(q k^T / sqrt(dh)) v.
//! The backward pass recomputes the probabilities instead of storing them.

use super::dispatch;
use super::math::{axpy, dot, exp};

/// Sizes of `qkv[batch, tokens, 3, heads, head]` and of the result `[batch, tokens, heads, head]`.
#[derive(Debug, Clone, Copy)]
pub struct AttentionShape {
    /// Samples.
    pub batch: usize,
    /// Tokens per sample.
    pub tokens: usize,
    /// Heads.
    pub heads: usize,
    /// Width of one head.
    pub head: usize,
}

impl AttentionShape {
    /// Floats of scratch that the two kernels need.
    pub fn scratch(&self) -> usize {
        let s = self.tokens;
        2 * s * s + 2 * self.head * s
    }
}

dispatch! {
    /// `out = softmax(q k^T / sqrt(head)) v`; `scratch` as [`AttentionShape::scratch`] says.
    pub fn attention(s: AttentionShape, qkv: &[f32], out: &mut [f32], scratch: &mut [f32]) = forward
}

/// Transposes rows `0..tokens` of one head (`at` apart by `stride`) into `to[head][tokens]`.
#[inline(always)]
fn transpose(from: &[f32], stride: usize, to: &mut [f32], tokens: usize, head: usize) {
    for (t, row) in from.chunks(stride).take(tokens).enumerate() {
        for c in 0..head {
            to[c * tokens + t] = row[c];
        }
    }
}

/// One row of `q k^T * scale` from the transposed keys, then its softmax if asked.
#[inline(always)]
fn row_product<const FMA: bool>(q: &[f32], kt: &[f32], scale: f32, row: &mut [f32]) {
    row.fill(0.0);
    for (c, q) in q.iter().enumerate() {
        axpy::<FMA>(q * scale, &kt[c * row.len()..][..row.len()], row);
    }
}

#[inline(always)]
fn softmax<const FMA: bool>(row: &mut [f32]) {
    let mut max = f32::NEG_INFINITY;
    for v in row.iter() {
        max = if *v > max { *v } else { max };
    }
    for v in row.iter_mut() {
        *v = exp::<FMA>(*v - max);
    }
    let r = 1.0 / super::math::sum(row);
    for v in row.iter_mut() {
        *v *= r;
    }
}

#[inline(always)]
fn forward<const FMA: bool>(s: AttentionShape, qkv: &[f32], out: &mut [f32], scratch: &mut [f32]) {
    let (n, dh, d) = (s.tokens, s.head, s.heads * s.head);
    let scale = 1.0 / (dh as f32).sqrt();
    let (kt, rest) = scratch.split_at_mut(dh * n);
    let row = &mut rest[..n];
    for b in 0..s.batch {
        let qkv = &qkv[b * n * 3 * d..][..n * 3 * d];
        let out = &mut out[b * n * d..][..n * d];
        for h in 0..s.heads {
            transpose(&qkv[d + h * dh..], 3 * d, kt, n, dh);
            for t in 0..n {
                row_product::<FMA>(&qkv[t * 3 * d + h * dh..][..dh], kt, scale, row);
                softmax::<FMA>(row);
                let o = &mut out[t * d + h * dh..][..dh];
                o.fill(0.0);
                for (j, p) in row.iter().enumerate() {
                    axpy::<FMA>(*p, &qkv[j * 3 * d + 2 * d + h * dh..][..dh], o);
                }
            }
        }
    }
}

dispatch! {
    /// Given `g = dL/dout`, writes `dqkv = dL/dqkv`.
    pub fn attention_backward(
        s: AttentionShape, qkv: &[f32], g: &[f32], dqkv: &mut [f32], scratch: &mut [f32],
    ) = backward
}

#[inline(always)]
fn backward<const FMA: bool>(
    s: AttentionShape,
    qkv: &[f32],
    g: &[f32],
    dqkv: &mut [f32],
    scratch: &mut [f32],
) {
    let (n, dh, d) = (s.tokens, s.head, s.heads * s.head);
    let scale = 1.0 / (dh as f32).sqrt();
    let (kt, rest) = scratch.split_at_mut(dh * n);
    let (vt, rest) = rest.split_at_mut(dh * n);
    let (p, rest) = rest.split_at_mut(n);
    let dp = &mut rest[..n];
    dqkv[..s.batch * n * 3 * d].fill(0.0);
    for b in 0..s.batch {
        let qkv = &qkv[b * n * 3 * d..][..n * 3 * d];
        let dqkv = &mut dqkv[b * n * 3 * d..][..n * 3 * d];
        let g = &g[b * n * d..][..n * d];
        for h in 0..s.heads {
            let (q_at, k_at, v_at) = (h * dh, d + h * dh, 2 * d + h * dh);
            transpose(&qkv[k_at..], 3 * d, kt, n, dh);
            transpose(&qkv[v_at..], 3 * d, vt, n, dh);
            for t in 0..n {
                let q = &qkv[t * 3 * d + q_at..][..dh];
                let go = &g[t * d + h * dh..][..dh];
                row_product::<FMA>(q, kt, scale, p);
                softmax::<FMA>(p);
                row_product::<FMA>(go, vt, 1.0, dp);
                let inner = dot::<FMA>(p, dp);
                for (dp, p) in dp.iter_mut().zip(p.iter()) {
                    *dp = p * (*dp - inner) * scale;
                }
                for j in 0..n {
                    axpy::<FMA>(p[j], go, &mut dqkv[j * 3 * d + v_at..][..dh]);
                    axpy::<FMA>(dp[j], q, &mut dqkv[j * 3 * d + k_at..][..dh]);
                    axpy::<FMA>(
                        dp[j],
                        &qkv[j * 3 * d + k_at..][..dh],
                        &mut dqkv[t * 3 * d + q_at..][..dh],
                    );
                }
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
        let s = AttentionShape { batch: 2, tokens: 5, heads: 2, head: 4 };
        let n = 2 * 5 * 3 * 8;
        let (x, w) = (check::random(n, 1), check::random(n / 3, 2));
        let mut scratch = vec![0.0; s.scratch()];
        let mut dx = vec![7.0; n];
        attention_backward(s, &x, &w, &mut dx, &mut scratch);
        check::gradient("qkv", &x, &dx, |x| {
            let mut y = vec![0.0; n / 3];
            attention(s, x, &mut y, &mut scratch);
            check::dot(&y, &w)
        });
    }
}
