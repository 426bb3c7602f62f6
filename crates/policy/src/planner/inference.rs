//! The network for one sample: encoder once, modulation of all sampler steps at once, then only the
//! horizon's tokens per step. Nothing is allocated after construction.

use super::packed::PackedLinear;
use crate::kernels::{
    AttentionShape, LayerNormShape, add, attention, column_sums, gated_add, gelu,
    layer_norm_modulate, silu,
};
use crate::network::{Architecture, BlockSlots, FEED_FORWARD, time_features};
use crate::normaliser::POSE_DIM;

struct PackedBlock {
    qkv: PackedLinear,
    out: PackedLinear,
    up: PackedLinear,
    down: PackedLinear,
}

impl PackedBlock {
    fn new(s: &BlockSlots, flat: &[f32]) -> Self {
        let p = |l| PackedLinear::new(l, flat);
        Self { qkv: p(&s.qkv), out: p(&s.out), up: p(&s.up), down: p(&s.down) }
    }
}

/// Buffers of one block's pass.
struct Buffers {
    a: Vec<f32>,
    qkv: Vec<f32>,
    heads: Vec<f32>,
    y: Vec<f32>,
    wide: Vec<f32>,
    middle: Vec<f32>,
    stats: Vec<[f32; 2]>,
    attention: Vec<f32>,
}

/// The packed network and its state.
pub(crate) struct Inference {
    history: usize,
    horizon: usize,
    d: usize,
    heads: usize,
    history_in: [PackedLinear; 2],
    /// What is added to the tokens of a procedure: positions, modalities, text, procedure.
    tokens: Vec<Vec<f32>>,
    encoder: Vec<(Vec<f32>, PackedBlock)>,
    /// Embedding `t` of every diffusion step `[K, d]`.
    times: Vec<f32>,
    pose_in: PackedLinear,
    horizon_positions: Vec<f32>,
    decoder: Vec<(PackedLinear, PackedBlock)>,
    final_modulation: PackedLinear,
    output: PackedLinear,
    // State of a plan.
    buffers: Buffers,
    x: Vec<f32>,
    e: Vec<f32>,
    condition: Vec<f32>,
    modulations: Vec<Vec<f32>>,
    final_modulations: Vec<f32>,
    prepared: usize,
    /// The last output `[horizon, 9]`.
    pub result: Vec<f32>,
}

impl Inference {
    pub fn new(a: &Architecture, flat: &[f32], text: Option<&[f32]>) -> Self {
        let (c, d) = (&a.config, a.config.d_model);
        let packed = |l| PackedLinear::new(l, flat);
        let modalities = a.modalities.of(flat);
        let h = c.history;
        let tokens = (0..a.dimensions.procedures)
            .map(|s| {
                let mut t = a.positions.of(flat).to_vec();
                for row in t[..h * d].chunks_exact_mut(d) {
                    add(&modalities[..d], row);
                }
                if let (Some(l), Some(text)) = (&a.text, text) {
                    let mut y = vec![0.0; d];
                    packed(l).apply(text, &mut y, 1);
                    add(&y, &mut t[h * d..(h + 1) * d]);
                }
                add(&modalities[d..2 * d], &mut t[h * d..(h + 1) * d]);
                add(&modalities[2 * d..], &mut t[(h + 1) * d..]);
                add(&a.procedures.of(flat)[s * d..][..d], &mut t[(h + 1) * d..]);
                t
            })
            .collect();
        let encoder = a
            .encoder
            .iter()
            .map(|(norms, slots)| {
                let n = norms.of(flat);
                let ones = vec![1.0; d];
                let m = [&n[..2 * d], &ones, &n[2 * d..], &ones].concat();
                (m, PackedBlock::new(slots, flat))
            })
            .collect();
        let steps = c.train_steps;
        let (mut f, mut u, mut times) =
            (vec![0.0; steps * d], vec![0.0; steps * d], vec![0.0; steps * d]);
        for (k, f) in f.chunks_exact_mut(d).enumerate() {
            time_features(k, f);
        }
        packed(&a.time[0]).apply(&f, &mut u, steps);
        silu(&u, &mut f);
        packed(&a.time[1]).apply(&f, &mut times, steps);
        let rows = (h + 2).max(c.horizon);
        let shape = AttentionShape { batch: 1, tokens: rows, heads: c.heads, head: d / c.heads };
        Self {
            history: h,
            horizon: c.horizon,
            d,
            heads: c.heads,
            history_in: [packed(&a.history[0]), packed(&a.history[1])],
            tokens,
            encoder,
            times,
            pose_in: packed(&a.pose_in),
            horizon_positions: a.horizon_positions.of(flat).to_vec(),
            decoder: a
                .decoder
                .iter()
                .map(|(m, s)| (packed(m), PackedBlock::new(s, flat)))
                .collect(),
            final_modulation: packed(&a.final_modulation),
            output: packed(&a.output),
            buffers: Buffers {
                a: vec![0.0; rows * d],
                qkv: vec![0.0; rows * 3 * d],
                heads: vec![0.0; rows * d],
                y: vec![0.0; rows * d],
                wide: vec![0.0; rows * FEED_FORWARD * d],
                middle: vec![0.0; rows * d],
                stats: vec![[0.0; 2]; rows],
                attention: vec![0.0; shape.scratch()],
            },
            x: vec![0.0; rows * d],
            e: vec![0.0; d],
            condition: vec![0.0; steps * d],
            modulations: a.decoder.iter().map(|_| vec![0.0; steps * 6 * d]).collect(),
            final_modulations: vec![0.0; steps * 2 * d],
            prepared: 0,
            result: vec![0.0; c.horizon * POSE_DIM],
        }
    }

    /// Encodes a normalised history `[history, 9]` and modulates the given diffusion steps.
    pub fn prepare(&mut self, history: &[f32], procedure: usize, steps: &[usize]) {
        let (d, h) = (self.d, self.history);
        let tokens = h + 2;
        let b = &mut self.buffers;
        self.history_in[0].apply(history, &mut b.wide, h);
        gelu(&mut b.wide[..h * d]);
        self.history_in[1].apply(&b.wide, &mut b.y, h);
        let x = &mut self.x[..tokens * d];
        x.copy_from_slice(&self.tokens[procedure]);
        add(&b.y[..h * d], &mut x[..h * d]);
        for (m, block) in &self.encoder {
            pass(block, m, tokens, d, self.heads, b, x);
        }
        self.e.fill(0.0);
        column_sums(x, &mut self.e);
        self.e.iter_mut().for_each(|v| *v /= tokens as f32);
        let n = steps.len();
        let (sum, condition) = (&mut self.modulations[0], &mut self.condition);
        for (row, k) in sum.chunks_exact_mut(d).zip(steps) {
            row.copy_from_slice(&self.times[k * d..][..d]);
            add(&self.e, row);
        }
        silu(&sum[..n * d], &mut condition[..n * d]);
        for ((layer, _), m) in self.decoder.iter().zip(&mut self.modulations) {
            layer.apply(condition, m, n);
        }
        self.final_modulation.apply(condition, &mut self.final_modulations, n);
        self.prepared = n;
    }

    /// Denoises `noisy[horizon, 9]` at the `i`-th prepared step; the output is in `self.result`.
    pub fn denoise(&mut self, i: usize, noisy: &[f32]) {
        debug_assert!(i < self.prepared);
        let (d, n) = (self.d, self.horizon);
        let b = &mut self.buffers;
        let x = &mut self.x[..n * d];
        self.pose_in.apply(noisy, x, n);
        add(&self.horizon_positions, x);
        for ((_, block), m) in self.decoder.iter().zip(&self.modulations) {
            pass(block, &m[i * 6 * d..][..6 * d], n, d, self.heads, b, x);
        }
        let norm = LayerNormShape { batch: 1, tokens: n, d, stride: 2 * d, at: 0 };
        let m = &self.final_modulations[i * 2 * d..][..2 * d];
        layer_norm_modulate(norm, x, m, &mut b.a, &mut b.stats);
        self.output.apply(&b.a, &mut self.result, n);
    }
}

/// One block in place on `x[n, d]`.
fn pass(
    block: &PackedBlock,
    m: &[f32],
    n: usize,
    d: usize,
    heads: usize,
    b: &mut Buffers,
    x: &mut [f32],
) {
    let norm = |at| LayerNormShape { batch: 1, tokens: n, d, stride: 6 * d, at };
    layer_norm_modulate(norm(0), x, m, &mut b.a, &mut b.stats);
    block.qkv.apply(&b.a, &mut b.qkv, n);
    let shape = AttentionShape { batch: 1, tokens: n, heads, head: d / heads };
    attention(shape, &b.qkv, &mut b.heads, &mut b.attention);
    block.out.apply(&b.heads, &mut b.y, n);
    gated_add(n, d, x, &b.y, m, 6 * d, 2 * d, &mut b.middle[..n * d]);
    layer_norm_modulate(norm(3 * d), &b.middle, m, &mut b.a, &mut b.stats);
    block.up.apply(&b.a, &mut b.wide, n);
    gelu(&mut b.wide[..n * FEED_FORWARD * d]);
    block.down.apply(&b.wide, &mut b.y, n);
    gated_add(n, d, &b.middle, &b.y, m, 6 * d, 5 * d, x);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PolicyConfig;
    use crate::kernels::check::random;
    use crate::network::{Batch, Dimensions};
    use crate::reference::CandleNetwork;

    #[test]
    fn equals_candle() {
        let config = PolicyConfig { decoder_layers: 2, ..PolicyConfig::small() };
        let a = Architecture::new(&config, Dimensions { procedures: 2, text: 6 }).unwrap();
        let mut flat = a.initial(1);
        for (v, r) in flat.iter_mut().zip(random(a.len(), 2)) {
            *v += 0.05 * r;
        }
        let text = random(6, 5);
        let candle = CandleNetwork::new(&a, &flat).unwrap();
        let mut fast = Inference::new(&a, &flat, Some(&text));
        for procedure in [0, 1] {
            let (history, noisy) = (random(72, 3), random(144, 4));
            let steps = [99, 40, 0];
            fast.prepare(&history, procedure, &steps);
            for (i, k) in steps.iter().enumerate() {
                fast.denoise(i, &noisy);
                let batch = Batch {
                    len: 1,
                    history: &history,
                    procedure: &[procedure],
                    noisy: &noisy,
                    step: &[*k],
                    text: Some(&text),
                    task: &[0],
                };
                let want = candle.forward(&batch).unwrap().flatten_all().unwrap();
                for (a, b) in fast.result.iter().zip(want.to_vec1::<f32>().unwrap()) {
                    assert!((a - b).abs() < 1e-5, "{a} {b}");
                }
            }
        }
    }
}
