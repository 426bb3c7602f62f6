//! One transformer block with modulated norms and gated residuals, forward and backward.

use super::FEED_FORWARD;
use super::layout::Linear;
use crate::kernels::{
    AttentionShape, LayerNormShape, add, attention, attention_backward, bias_gelu, column_sums,
    gated_add, gated_add_backward, gelu_backward, layer_norm_modulate,
    layer_norm_modulate_backward, matmul, matmul_bias, matmul_nt, matmul_tn,
};

/// A block's weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlockSlots {
    pub qkv: Linear,
    pub out: Linear,
    pub up: Linear,
    pub down: Linear,
}

/// What a block's forward pass leaves for its backward pass; `rows = batch * tokens`.
pub(crate) struct Block {
    tokens: usize,
    d: usize,
    heads: usize,
    /// Input `[rows, d]`, written by whoever comes before.
    pub x: Vec<f32>,
    /// `[batch, 6 d]`: shift, scale, gate of the attention, then of the feed-forward half.
    pub modulation: Vec<f32>,
    stats1: Vec<[f32; 2]>,
    a1: Vec<f32>,
    qkv: Vec<f32>,
    heads_out: Vec<f32>,
    projected: Vec<f32>,
    middle: Vec<f32>,
    stats2: Vec<[f32; 2]>,
    a2: Vec<f32>,
    u: Vec<f32>,
    h: Vec<f32>,
    fed: Vec<f32>,
}

/// Buffers of the backward pass, shared by all blocks.
pub(crate) struct Scratch {
    row: Vec<f32>,
    wide: Vec<f32>,
    attention: Vec<f32>,
    /// Gradient of the block's modulation `[batch, 6 d]`.
    pub dmodulation: Vec<f32>,
}

impl Scratch {
    pub fn new(batch: usize, tokens: usize, d: usize, heads: usize) -> Self {
        let shape = AttentionShape { batch, tokens, heads, head: d / heads };
        Self {
            row: vec![0.0; batch * tokens * d],
            wide: vec![0.0; batch * tokens * FEED_FORWARD * d],
            attention: vec![0.0; shape.scratch()],
            dmodulation: vec![0.0; batch * 6 * d],
        }
    }
}

/// `y = x W + b` over `rows` rows.
pub(crate) fn linear(l: &Linear, p: &[f32], x: &[f32], y: &mut [f32], rows: usize) {
    matmul_bias(x, l.weight.of(p), l.bias.of(p), y, [rows, l.inputs, l.outputs]);
}

/// Accumulates the gradients of the weights of [`linear`] and, if given, of its input.
pub(crate) fn linear_backward(
    l: &Linear,
    p: &[f32],
    grads: &mut [f32],
    x: &[f32],
    dy: &[f32],
    rows: usize,
    dx: Option<(&mut [f32], bool)>,
) {
    let dy = &dy[..rows * l.outputs];
    column_sums(dy, l.bias.of_mut(grads));
    weights_backward(l, p, grads, x, dy, rows, dx);
}

/// As [`linear_backward`] without the bias.
fn weights_backward(
    l: &Linear,
    p: &[f32],
    grads: &mut [f32],
    x: &[f32],
    dy: &[f32],
    rows: usize,
    dx: Option<(&mut [f32], bool)>,
) {
    matmul_tn(x, dy, l.weight.of_mut(grads), [rows, l.inputs, l.outputs]);
    if let Some((dx, accumulate)) = dx {
        matmul_nt(dy, l.weight.of(p), dx, [rows, l.outputs, l.inputs], accumulate);
    }
}

impl Block {
    pub fn new(batch: usize, tokens: usize, d: usize, heads: usize) -> Self {
        let rows = batch * tokens;
        let zeros = |width: usize| vec![0.0; rows * width];
        Self {
            tokens,
            d,
            heads,
            x: zeros(d),
            modulation: vec![0.0; batch * 6 * d],
            stats1: vec![[0.0; 2]; rows],
            a1: zeros(d),
            qkv: zeros(3 * d),
            heads_out: zeros(d),
            projected: zeros(d),
            middle: zeros(d),
            stats2: vec![[0.0; 2]; rows],
            a2: zeros(d),
            u: zeros(FEED_FORWARD * d),
            h: zeros(FEED_FORWARD * d),
            fed: zeros(d),
        }
    }

    fn norm(&self, batch: usize, at: usize) -> LayerNormShape {
        LayerNormShape { batch, tokens: self.tokens, d: self.d, stride: 6 * self.d, at }
    }

    fn attention_shape(&self, batch: usize) -> AttentionShape {
        let head = self.d / self.heads;
        AttentionShape { batch, tokens: self.tokens, heads: self.heads, head }
    }

    /// `self.x` and `self.modulation` to `out[rows, d]`.
    pub fn forward(
        &mut self,
        s: &BlockSlots,
        p: &[f32],
        batch: usize,
        scratch: &mut Scratch,
        out: &mut [f32],
    ) {
        let (d, n) = (self.d, self.tokens);
        let rows = batch * n;
        let m = &self.modulation;
        let norm = self.norm(batch, 0);
        layer_norm_modulate(norm, &self.x, m, &mut self.a1, &mut self.stats1);
        linear(&s.qkv, p, &self.a1, &mut self.qkv, rows);
        let shape = self.attention_shape(batch);
        attention(shape, &self.qkv, &mut self.heads_out, &mut scratch.attention);
        linear(&s.out, p, &self.heads_out, &mut self.projected, rows);
        let middle = &mut self.middle[..rows * d];
        gated_add(n, d, &self.x, &self.projected, m, 6 * d, 2 * d, middle);
        let norm = self.norm(batch, 3 * d);
        layer_norm_modulate(norm, &self.middle, m, &mut self.a2, &mut self.stats2);
        let wide = rows * s.up.outputs;
        matmul(&self.a2, s.up.weight.of(p), &mut self.u, [rows, d, s.up.outputs], false);
        bias_gelu(&mut self.u[..wide], s.up.bias.of(p), &mut self.h[..wide]);
        linear(&s.down, p, &self.h, &mut self.fed, rows);
        let out = &mut out[..rows * d];
        gated_add(n, d, &self.middle, &self.fed, m, 6 * d, 5 * d, out);
    }

    /// `dx[rows, d]` holds the gradient of the output and becomes that of the input; the gradient of
    /// the modulation is left in `scratch.dmodulation`.
    pub fn backward(
        &self,
        s: &BlockSlots,
        p: &[f32],
        grads: &mut [f32],
        batch: usize,
        scratch: &mut Scratch,
        dx: &mut [f32],
    ) {
        let (d, n) = (self.d, self.tokens);
        let rows = batch * n;
        let dx = &mut dx[..rows * d];
        let m = &self.modulation;
        let Scratch { row, wide, attention: attention_scratch, dmodulation: dm } = scratch;
        let row = &mut row[..rows * d];
        // Feed-forward half.
        gated_add_backward(n, d, dx, &self.fed, m, 6 * d, 5 * d, row, dm);
        let dh = &mut wide[..rows * s.up.outputs];
        linear_backward(&s.down, p, grads, &self.h, row, rows, Some((&mut *dh, false)));
        gelu_backward(&self.u, dh, s.up.bias.of_mut(grads));
        weights_backward(&s.up, p, grads, &self.a2, dh, rows, Some((&mut *row, false)));
        let norm = self.norm(batch, 3 * d);
        layer_norm_modulate_backward(norm, &self.middle, m, &self.stats2, row, dx, dm);
        // Attention half.
        gated_add_backward(n, d, dx, &self.projected, m, 6 * d, 2 * d, row, dm);
        let dheads = &mut wide[..rows * d];
        linear_backward(&s.out, p, grads, &self.heads_out, row, rows, Some((&mut *dheads, false)));
        let (dheads, rest) = wide.split_at_mut(rows * d);
        let dqkv = &mut rest[..rows * 3 * d];
        let shape = self.attention_shape(batch);
        attention_backward(shape, &self.qkv, dheads, dqkv, attention_scratch);
        linear_backward(&s.qkv, p, grads, &self.a1, dqkv, rows, Some((&mut *row, false)));
        let norm = self.norm(batch, 0);
        layer_norm_modulate_backward(norm, &self.x, m, &self.stats1, row, dx, dm);
    }
}

/// Sums the per-sample gradients of an encoder block's norms into their shared weights.
pub(crate) fn norms_backward(dmodulation: &[f32], d: usize, batch: usize, dnorms: &mut [f32]) {
    let (first, second) = dnorms.split_at_mut(2 * d);
    for m in dmodulation.chunks_exact(6 * d).take(batch) {
        add(&m[..2 * d], first);
        add(&m[3 * d..5 * d], second);
    }
}
