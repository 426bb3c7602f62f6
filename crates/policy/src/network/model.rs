//! The whole network over a preallocated workspace.

use super::block::{Block, Scratch, linear, linear_backward, norms_backward};
use super::layout::Architecture;
use crate::kernels::{
    LayerNormShape, add, add_rows, bias_gelu, column_sums, fill_rows, gelu_backward,
    layer_norm_modulate, layer_norm_modulate_backward, matmul, matmul_tn, silu, silu_backward,
};
use crate::normaliser::POSE_DIM;

/// Part of a training batch; each slice holds `len` samples.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// Samples.
    pub len: usize,
    /// Normalised histories `[len, history, 9]`.
    pub history: &'a [f32],
    /// Procedure of each sample.
    pub procedure: &'a [usize],
    /// Noisy trajectories `[len, horizon, 9]`.
    pub noisy: &'a [f32],
    /// Diffusion step of each sample.
    pub step: &'a [usize],
    /// Text embeddings of the tasks `[tasks, text]`, if the network takes one.
    pub text: Option<&'a [f32]>,
    /// Task of each sample, a row of `text`.
    pub task: &'a [usize],
}

/// Cosine and sine features of a diffusion step.
pub(crate) fn time_features(k: usize, out: &mut [f32]) {
    let half = out.len() / 2;
    let (cos, sin) = out.split_at_mut(half);
    for j in 0..half {
        let angle = k as f64 * (-(j as f64) * 1e4f64.ln() / (half - 1) as f64).exp();
        cos[j] = angle.cos() as f32;
        sin[j] = angle.sin() as f32;
    }
}

/// Every intermediate value of up to `capacity` samples, allocated once.
pub struct Workspace {
    capacity: usize,
    history_u: Vec<f32>,
    history_h: Vec<f32>,
    history_out: Vec<f32>,
    /// One per task, `[tasks, d]`.
    text_tokens: Vec<f32>,
    encoder: Vec<Block>,
    encoder_scratch: Scratch,
    encoded: Vec<f32>,
    features: Vec<f32>,
    time_u: Vec<f32>,
    time_h: Vec<f32>,
    /// `e + t` and `silu(e + t)`, `[batch, d]`.
    condition_u: Vec<f32>,
    condition: Vec<f32>,
    decoder: Vec<Block>,
    decoder_scratch: Scratch,
    decoded: Vec<f32>,
    final_modulation: Vec<f32>,
    final_stats: Vec<[f32; 2]>,
    final_a: Vec<f32>,
    /// Network output `[batch, horizon, 9]`.
    pub output: Vec<f32>,
    doutput: Vec<f32>,
    dx: Vec<f32>,
    dcondition: Vec<f32>,
    small: Vec<f32>,
}

impl Workspace {
    /// Buffers for `capacity` samples.
    pub fn new(a: &Architecture, capacity: usize) -> Self {
        let (c, d) = (&a.config, a.config.d_model);
        let (tokens, heads) = (c.history + 2, c.heads);
        let zeros = |n: usize| vec![0.0; capacity * n];
        let blocks = |count: usize, tokens: usize| {
            (0..count).map(|_| Block::new(capacity, tokens, d, heads)).collect::<Vec<_>>()
        };
        Self {
            capacity,
            history_u: zeros(c.history * d),
            history_h: zeros(c.history * d),
            history_out: zeros(c.history * d),
            text_tokens: vec![0.0; d],
            encoder: blocks(c.encoder_layers, tokens),
            encoder_scratch: Scratch::new(capacity, tokens, d, heads),
            encoded: zeros(tokens * d),
            features: zeros(d),
            time_u: zeros(d),
            time_h: zeros(d),
            condition_u: zeros(d),
            condition: zeros(d),
            decoder: blocks(c.decoder_layers, c.horizon),
            decoder_scratch: Scratch::new(capacity, c.horizon, d, heads),
            decoded: zeros(c.horizon * d),
            final_modulation: zeros(2 * d),
            final_stats: vec![[0.0; 2]; capacity * c.horizon],
            final_a: zeros(c.horizon * d),
            output: zeros(c.horizon * POSE_DIM),
            doutput: zeros(c.horizon * POSE_DIM),
            dx: zeros(tokens.max(c.horizon) * d),
            dcondition: zeros(d),
            small: zeros(tokens.max(c.horizon) * d),
        }
    }

    /// The network's output, left in `self.output`.
    ///
    /// # Panics
    /// When the batch is larger than the workspace or its slices are too short.
    pub fn forward(&mut self, a: &Architecture, p: &[f32], b: &Batch) {
        assert!(b.len <= self.capacity, "batch {} over capacity {}", b.len, self.capacity);
        self.encode(a, p, b);
        self.embed_time(a, p, b);
        self.decode(a, p, b);
    }

    fn encode(&mut self, a: &Architecture, p: &[f32], b: &Batch) {
        let (h, d) = (a.config.history, a.config.d_model);
        let (tokens, rows) = (h + 2, b.len * h);
        let [first, second] = &a.history;
        matmul(b.history, first.weight.of(p), &mut self.history_u, [rows, POSE_DIM, d], false);
        let wide = rows * d;
        bias_gelu(&mut self.history_u[..wide], first.bias.of(p), &mut self.history_h[..wide]);
        linear(second, p, &self.history_h, &mut self.history_out, rows);
        self.text_tokens.fill(0.0);
        if let (Some(l), Some(text)) = (&a.text, b.text) {
            let tasks = text.len() / l.inputs;
            self.text_tokens.resize(tasks * d, 0.0);
            linear(l, p, text, &mut self.text_tokens, tasks);
        }
        let (positions, modalities) = (a.positions.of(p), a.modalities.of(p));
        let x = &mut self.encoder[0].x;
        for i in 0..b.len {
            let x = &mut x[i * tokens * d..][..tokens * d];
            x.copy_from_slice(positions);
            add(&self.history_out[i * h * d..][..h * d], &mut x[..h * d]);
            add_rows(&modalities[..d], &mut x[..h * d]);
            let (text, procedure) = x[h * d..].split_at_mut(d);
            if let Some(l) = &a.text
                && b.text.is_some()
            {
                add(&self.text_tokens[b.task[i] * l.outputs..][..d], text);
            }
            add(&modalities[d..2 * d], text);
            add(&a.procedures.of(p)[b.procedure[i] * d..][..d], procedure);
            add(&modalities[2 * d..], procedure);
        }
        for i in 0..self.encoder.len() {
            let (norms, slots) = &a.encoder[i];
            let n = norms.of(p);
            let (block, rest) = self.encoder[i..].split_at_mut(1);
            let block = &mut block[0];
            for m in block.modulation.chunks_exact_mut(6 * d).take(b.len) {
                m[..2 * d].copy_from_slice(&n[..2 * d]);
                m[2 * d..3 * d].fill(1.0);
                m[3 * d..5 * d].copy_from_slice(&n[2 * d..]);
                m[5 * d..].fill(1.0);
            }
            let out = rest.first_mut().map_or(&mut self.encoded, |next| &mut next.x);
            block.forward(slots, p, b.len, &mut self.encoder_scratch, out);
        }
        // Mean over the tokens.
        let e = &mut self.condition_u[..b.len * d];
        e.fill(0.0);
        for (e, x) in e.chunks_exact_mut(d).zip(self.encoded.chunks_exact(tokens * d)) {
            column_sums(x, e);
            e.iter_mut().for_each(|v| *v /= tokens as f32);
        }
    }

    fn embed_time(&mut self, a: &Architecture, p: &[f32], b: &Batch) {
        let d = a.config.d_model;
        let n = b.len * d;
        for (f, k) in self.features.chunks_exact_mut(d).zip(&b.step[..b.len]) {
            time_features(*k, f);
        }
        linear(&a.time[0], p, &self.features, &mut self.time_u, b.len);
        silu(&self.time_u[..n], &mut self.time_h[..n]);
        // Adds t to e.
        add_rows(a.time[1].bias.of(p), &mut self.condition_u[..n]);
        let w = a.time[1].weight.of(p);
        matmul(&self.time_h, w, &mut self.condition_u, [b.len, d, d], true);
        silu(&self.condition_u[..n], &mut self.condition[..n]);
    }

    fn decode(&mut self, a: &Architecture, p: &[f32], b: &Batch) {
        let (n, d) = (a.config.horizon, a.config.d_model);
        let rows = b.len * n;
        let x = &mut self.decoder[0].x[..rows * d];
        fill_rows(a.horizon_positions.of(p), x);
        add_rows(a.pose_in.bias.of(p), x);
        matmul(b.noisy, a.pose_in.weight.of(p), x, [rows, POSE_DIM, d], true);
        for i in 0..self.decoder.len() {
            let (modulation, slots) = &a.decoder[i];
            let (block, rest) = self.decoder[i..].split_at_mut(1);
            let block = &mut block[0];
            linear(modulation, p, &self.condition, &mut block.modulation, b.len);
            let out = rest.first_mut().map_or(&mut self.decoded, |next| &mut next.x);
            block.forward(slots, p, b.len, &mut self.decoder_scratch, out);
        }
        linear(&a.final_modulation, p, &self.condition, &mut self.final_modulation, b.len);
        let norm = LayerNormShape { batch: b.len, tokens: n, d, stride: 2 * d, at: 0 };
        layer_norm_modulate(
            norm,
            &self.decoded,
            &self.final_modulation,
            &mut self.final_a,
            &mut self.final_stats,
        );
        linear(&a.output, p, &self.final_a, &mut self.output, rows);
    }

    /// After [`Workspace::forward`] of the same batch: the weighted squared error
    /// `sum weight[c] (output - target)^2`, its gradient added to `grads`. `weights` holds one weight
    /// per number of a pose (divide by the number of samples there).
    pub fn backward(
        &mut self,
        a: &Architecture,
        p: &[f32],
        b: &Batch,
        target: &[f32],
        weights: &[f32; POSE_DIM],
        grads: &mut [f32],
    ) -> f64 {
        let (n, d) = (a.config.horizon, a.config.d_model);
        let rows = b.len * n;
        let mut loss = 0.0f64;
        for ((g, o), t) in self.doutput[..rows * POSE_DIM]
            .chunks_exact_mut(POSE_DIM)
            .zip(self.output.chunks_exact(POSE_DIM))
            .zip(target.chunks_exact(POSE_DIM))
        {
            for c in 0..POSE_DIM {
                let e = o[c] - t[c];
                loss += f64::from(weights[c] * e * e);
                g[c] = 2.0 * weights[c] * e;
            }
        }
        self.dcondition[..b.len * d].fill(0.0);
        self.decode_backward(a, p, b, grads, rows);
        silu_backward(&self.condition_u[..b.len * d], &mut self.dcondition[..b.len * d]);
        self.time_backward(a, p, b, grads);
        self.encode_backward(a, p, b, grads);
        loss
    }

    fn decode_backward(
        &mut self,
        a: &Architecture,
        p: &[f32],
        b: &Batch,
        grads: &mut [f32],
        rows: usize,
    ) {
        let (n, d) = (a.config.horizon, a.config.d_model);
        let g = &mut self.small[..rows * d];
        linear_backward(
            &a.output,
            p,
            grads,
            &self.final_a,
            &self.doutput,
            rows,
            Some((&mut *g, false)),
        );
        let norm = LayerNormShape { batch: b.len, tokens: n, d, stride: 2 * d, at: 0 };
        let dx = &mut self.dx[..rows * d];
        dx.fill(0.0);
        let dm = &mut self.decoder_scratch.dmodulation;
        layer_norm_modulate_backward(
            norm,
            &self.decoded,
            &self.final_modulation,
            &self.final_stats,
            g,
            dx,
            dm,
        );
        let into = Some((&mut self.dcondition[..], true));
        linear_backward(&a.final_modulation, p, grads, &self.condition, dm, b.len, into);
        for (block, (modulation, slots)) in self.decoder.iter().zip(&a.decoder).rev() {
            block.backward(slots, p, grads, b.len, &mut self.decoder_scratch, dx);
            let dm = &self.decoder_scratch.dmodulation;
            let into = Some((&mut self.dcondition[..], true));
            linear_backward(modulation, p, grads, &self.condition, dm, b.len, into);
        }
        column_sums(dx, a.horizon_positions.of_mut(grads));
        linear_backward(&a.pose_in, p, grads, b.noisy, dx, rows, None);
    }

    /// `dcondition` holds the gradient of `e + t`.
    fn time_backward(&mut self, a: &Architecture, p: &[f32], b: &Batch, grads: &mut [f32]) {
        let n = b.len * a.config.d_model;
        let g = &mut self.small[..n];
        let into = Some((&mut *g, false));
        linear_backward(&a.time[1], p, grads, &self.time_h, &self.dcondition, b.len, into);
        silu_backward(&self.time_u[..n], g);
        linear_backward(&a.time[0], p, grads, &self.features, g, b.len, None);
    }

    fn encode_backward(&mut self, a: &Architecture, p: &[f32], b: &Batch, grads: &mut [f32]) {
        let (h, d) = (a.config.history, a.config.d_model);
        let (tokens, rows) = (h + 2, b.len * h);
        let dx = &mut self.dx[..b.len * tokens * d];
        for (dx, de) in dx.chunks_exact_mut(tokens * d).zip(self.dcondition.chunks_exact(d)) {
            fill_rows(de, dx);
        }
        dx.iter_mut().for_each(|v| *v /= tokens as f32);
        for (block, (norms, slots)) in self.encoder.iter().zip(&a.encoder).rev() {
            block.backward(slots, p, grads, b.len, &mut self.encoder_scratch, dx);
            let dm = &self.encoder_scratch.dmodulation;
            norms_backward(dm, d, b.len, norms.of_mut(grads));
        }
        column_sums(dx, a.positions.of_mut(grads));
        let dtext = &mut self.text_tokens;
        dtext.fill(0.0);
        for (i, dx) in dx.chunks_exact(tokens * d).enumerate() {
            let modalities = a.modalities.of_mut(grads);
            column_sums(&dx[..h * d], &mut modalities[..d]);
            add(&dx[h * d..][..d], &mut modalities[d..2 * d]);
            add(&dx[(h + 1) * d..], &mut modalities[2 * d..]);
            if b.text.is_some() {
                add(&dx[h * d..][..d], &mut dtext[b.task[i] * d..][..d]);
            }
            add(&dx[(h + 1) * d..], &mut a.procedures.of_mut(grads)[b.procedure[i] * d..][..d]);
            self.history_out[i * h * d..][..h * d].copy_from_slice(&dx[..h * d]);
        }
        if let (Some(l), Some(text)) = (&a.text, b.text) {
            linear_backward(l, p, grads, text, dtext, text.len() / l.inputs, None);
        }
        let [first, second] = &a.history;
        let g = &mut self.small[..rows * d];
        let dy = &self.history_out;
        linear_backward(second, p, grads, &self.history_h, dy, rows, Some((&mut *g, false)));
        gelu_backward(&self.history_u, g, first.bias.of_mut(grads));
        matmul_tn(b.history, g, first.weight.of_mut(grads), [rows, POSE_DIM, d]);
    }
}
