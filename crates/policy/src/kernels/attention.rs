//! Full (non-causal) multi-head self-attention on packed projections, softmax(q k^T / sqrt(dh)) v.
//! The backward pass recomputes the probabilities instead of storing them.

use super::math::{dot, exp, max, sum};
use super::{Start, Strided, dispatch, panel, simd_level, transpose};

const LANES: usize = 16;

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
    /// Tokens rounded up to whole vectors.
    fn padded(&self) -> usize {
        self.tokens.next_multiple_of(LANES)
    }

    /// Floats of scratch that the two kernels need.
    pub fn scratch(&self) -> usize {
        let n = self.padded();
        2 * self.head * n + 4 * n * n
    }

    fn check(&self, qkv: &[f32], out: &[f32], scratch: &[f32]) {
        let rows = self.batch * self.tokens * self.heads * self.head;
        assert!(self.head.is_multiple_of(LANES), "heads are whole vectors wide");
        assert!(qkv.len() >= 3 * rows && out.len() >= rows && scratch.len() >= self.scratch());
    }
}

dispatch! {
    /// `out = softmax(q k^T / sqrt(head)) v`; `scratch` as [`AttentionShape::scratch`] says, and the
    /// width of a head a multiple of 16.
    pub fn attention(s: AttentionShape, qkv: &[f32], out: &mut [f32], scratch: &mut [f32]) = forward
}

/// `c[rows, columns] = a[rows, depth] b[depth, columns]`, all with own row distances, columns a
/// multiple of 16.
fn multiply(
    [rows, depth, columns]: [usize; 3],
    (a, a_row): (&[f32], usize),
    (b, b_row): (&[f32], usize),
    (c, c_row): (&mut [f32], usize),
) {
    let a = Strided { data: a, row: a_row, column: 1 };
    let level = simd_level();
    for at in (0..columns).step_by(2 * LANES) {
        let (b, c) = (&b[at..], &mut c[at..]);
        if at + 2 * LANES <= columns {
            panel::<2, false>(level, [rows, depth], a, b, b_row, c, c_row, Start::Zero);
        } else {
            panel::<1, false>(level, [rows, depth], a, b, b_row, c, c_row, Start::Zero);
        }
    }
}

/// Softmax of the first `n` values times `scale`; what pads the row becomes zero.
#[inline(always)]
fn softmax<const FMA: bool>(row: &mut [f32], n: usize, scale: f32) {
    let max = max(&row[..n]);
    for v in row.iter_mut() {
        *v = exp::<FMA>((*v - max) * scale);
    }
    row[n..].fill(0.0);
    let r = 1.0 / sum(row);
    for v in row.iter_mut() {
        *v *= r;
    }
}

#[inline(always)]
fn forward<const FMA: bool>(s: AttentionShape, qkv: &[f32], out: &mut [f32], scratch: &mut [f32]) {
    s.check(qkv, out, scratch);
    let (n, dh, d) = (s.tokens, s.head, s.heads * s.head);
    let np = s.padded();
    let scale = 1.0 / (dh as f32).sqrt();
    let level = simd_level();
    let (kt, rest) = scratch.split_at_mut(dh * np);
    let p = &mut rest[..n * np];
    kt.fill(0.0);
    for b in 0..s.batch {
        let qkv = &qkv[b * n * 3 * d..][..n * 3 * d];
        let out = &mut out[b * n * d..][..n * d];
        for h in 0..s.heads {
            let (q, k, v) = (&qkv[h * dh..], &qkv[d + h * dh..], &qkv[2 * d + h * dh..]);
            transpose(level, [n, dh], k, 3 * d, kt, np);
            multiply([n, dh, np], (q, 3 * d), (kt, np), (p, np));
            for row in p.chunks_exact_mut(np) {
                softmax::<FMA>(row, n, scale);
            }
            multiply([n, n, dh], (p, np), (v, 3 * d), (&mut out[h * dh..], d));
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
    s.check(qkv, g, scratch);
    let (n, dh, d) = (s.tokens, s.head, s.heads * s.head);
    let np = s.padded();
    let scale = 1.0 / (dh as f32).sqrt();
    let level = simd_level();
    let (kt, rest) = scratch.split_at_mut(dh * np);
    let (vt, rest) = rest.split_at_mut(dh * np);
    let (p, rest) = rest.split_at_mut(np * np);
    let (ds, rest) = rest.split_at_mut(np * np);
    let (pt, dst) = rest.split_at_mut(np * np);
    kt.fill(0.0);
    vt.fill(0.0);
    for b in 0..s.batch {
        let qkv = &qkv[b * n * 3 * d..][..n * 3 * d];
        let dqkv = &mut dqkv[b * n * 3 * d..][..n * 3 * d];
        let g = &g[b * n * d..][..n * d];
        for h in 0..s.heads {
            let (q_at, k_at, v_at) = (h * dh, d + h * dh, 2 * d + h * dh);
            let (q, k, v, g) = (&qkv[q_at..], &qkv[k_at..], &qkv[v_at..], &g[h * dh..]);
            transpose(level, [n, dh], k, 3 * d, kt, np);
            transpose(level, [n, dh], v, 3 * d, vt, np);
            multiply([n, dh, np], (q, 3 * d), (kt, np), (p, np));
            multiply([n, dh, np], (g, d), (vt, np), (ds, np));
            for (p, ds) in p.chunks_exact_mut(np).zip(ds.chunks_exact_mut(np)).take(n) {
                softmax::<FMA>(p, n, scale);
                let inner = dot::<FMA>(p, ds);
                for (ds, p) in ds.iter_mut().zip(p.iter()) {
                    *ds = p * (*ds - inner) * scale;
                }
            }
            transpose(level, [n, n], p, np, pt, np);
            transpose(level, [n, n], ds, np, dst, np);
            multiply([n, n, dh], (ds, np), (k, 3 * d), (&mut dqkv[q_at..], 3 * d));
            multiply([n, n, dh], (dst, np), (q, 3 * d), (&mut dqkv[k_at..], 3 * d));
            multiply([n, n, dh], (pt, np), (g, d), (&mut dqkv[v_at..], 3 * d));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check;

    #[test]
    fn gradients_match_differences() {
        let s = AttentionShape { batch: 2, tokens: 5, heads: 2, head: 16 };
        let n = 2 * 5 * 3 * 32;
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
