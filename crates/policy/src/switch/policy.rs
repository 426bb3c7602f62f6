//! The classifier: history, text and procedure embedding to 128 to 64 to one logit.

use crate::kernels::{bias_gelu, gelu_backward, matmul, matmul_nt, matmul_tn};
use crate::network::{Builder, Init, Linear, Parameter, Slot, linear, linear_backward};
use crate::normaliser::{POSE_DIM, finite};
use crate::tasks::LearnedTask;
use crate::{Normaliser, PolicyError};
use std::collections::BTreeMap;
use tdv_geometry::Pose;

/// Numbers of a procedure's embedding.
const EMBEDDING: usize = 16;
const HIDDEN: [usize; 2] = [128, 64];

/// Where the classifier's parameters lie.
#[derive(Debug, Clone)]
pub(crate) struct SwitchLayout {
    pub history: usize,
    pub text: usize,
    pub parameters: Vec<Parameter>,
    pub len: usize,
    embedding: Slot,
    layers: [Linear; 3],
}

impl SwitchLayout {
    pub fn new(history: usize, text: usize, procedures: usize) -> Self {
        let mut b = Builder::default();
        let inputs = history * POSE_DIM + text + EMBEDDING;
        let embedding =
            b.tensor("procedures".into(), &[procedures, EMBEDDING], false, Init::Normal(1.0));
        let layers = [
            b.linear("layers.0", inputs, HIDDEN[0], Init::Xavier),
            b.linear("layers.1", HIDDEN[0], HIDDEN[1], Init::Xavier),
            b.linear("layers.2", HIDDEN[1], 1, Init::Xavier),
        ];
        let (parameters, len) = (b.parameters, b.len);
        Self { history, text, parameters, len, embedding, layers }
    }
}

/// Embeddings of the tasks, one after the other, and which of them each sample is about.
#[derive(Clone, Copy)]
pub(crate) struct Texts<'a> {
    pub table: &'a [f32],
    pub task: &'a [usize],
}

impl<'a> Texts<'a> {
    fn of(&self, sample: usize, width: usize) -> &'a [f32] {
        if width == 0 { &[] } else { &self.table[self.task[sample] * width..][..width] }
    }
}

/// Intermediate values of up to a number of samples.
#[derive(Debug, Clone)]
pub(crate) struct SwitchBuffers {
    x: Vec<f32>,
    u: [Vec<f32>; 2],
    h: [Vec<f32>; 2],
    pub logits: Vec<f32>,
    g: [Vec<f32>; 2],
    dx: Vec<f32>,
}

impl SwitchBuffers {
    pub fn new(l: &SwitchLayout, samples: usize) -> Self {
        let zeros = |n: usize| vec![0.0; samples * n];
        Self {
            x: zeros(l.layers[0].inputs),
            u: HIDDEN.map(zeros),
            h: HIDDEN.map(zeros),
            logits: zeros(1),
            g: HIDDEN.map(zeros),
            dx: zeros(l.layers[0].inputs),
        }
    }

    /// Logits of normalised histories `[n, history, 9]`.
    pub fn forward(
        &mut self,
        l: &SwitchLayout,
        p: &[f32],
        histories: &[f32],
        procedures: &[usize],
        text: Texts,
    ) {
        let (n, inputs, width) = (procedures.len(), l.layers[0].inputs, l.history * POSE_DIM);
        let rows = self.x.chunks_exact_mut(inputs).zip(histories.chunks_exact(width));
        for (i, ((x, h), s)) in rows.zip(procedures).enumerate() {
            x[..width].copy_from_slice(h);
            x[width..width + l.text].copy_from_slice(text.of(i, l.text));
            x[width + l.text..].copy_from_slice(&l.embedding.of(p)[s * EMBEDDING..][..EMBEDDING]);
        }
        for i in 0..2 {
            let layer = &l.layers[i];
            let x = if i == 0 { &self.x } else { &self.h[0] };
            matmul(x, layer.weight.of(p), &mut self.u[i], [n, layer.inputs, layer.outputs], false);
            let wide = n * layer.outputs;
            let (low, high) = self.h.split_at_mut(1);
            let h = if i == 0 { &mut low[0] } else { &mut high[0] };
            bias_gelu(&mut self.u[i][..wide], layer.bias.of(p), &mut h[..wide]);
        }
        linear(&l.layers[2], p, &self.h[1], &mut self.logits, n);
    }

    /// After [`SwitchBuffers::forward`]: `self.logits` holds the gradient of the loss by the logits;
    /// that by the parameters is added to `grads`.
    pub fn backward(
        &mut self,
        l: &SwitchLayout,
        p: &[f32],
        procedures: &[usize],
        grads: &mut [f32],
    ) {
        let n = procedures.len();
        let [first, second, last] = &l.layers;
        let [g0, g1] = &mut self.g;
        let (g0, g1) = (&mut g0[..n * HIDDEN[0]], &mut g1[..n * HIDDEN[1]]);
        linear_backward(last, p, grads, &self.h[1], &self.logits, n, Some((&mut *g1, false)));
        gelu_backward(&self.u[1], g1, second.bias.of_mut(grads));
        matmul_tn(&self.h[0], g1, second.weight.of_mut(grads), [n, HIDDEN[0], HIDDEN[1]]);
        matmul_nt(g1, second.weight.of(p), g0, [n, HIDDEN[1], HIDDEN[0]], false);
        gelu_backward(&self.u[0], g0, first.bias.of_mut(grads));
        matmul_tn(&self.x, g0, first.weight.of_mut(grads), [n, first.inputs, HIDDEN[0]]);
        matmul_nt(g0, first.weight.of(p), &mut self.dx, [n, HIDDEN[0], first.inputs], false);
        for (dx, s) in self.dx.chunks_exact(first.inputs).zip(procedures) {
            let e = &mut l.embedding.of_mut(grads)[s * EMBEDDING..][..EMBEDDING];
            for (e, g) in e.iter_mut().zip(&dx[first.inputs - EMBEDDING..]) {
                *e += g;
            }
        }
    }
}

/// The trained classifier of all procedures of a task. One that was taught several tasks judges one of
/// them at a time: the fields are those of that one, [`SwitchPolicy::choose`] takes another.
#[derive(Debug, Clone)]
pub struct SwitchPolicy {
    pub(crate) layout: SwitchLayout,
    pub(crate) weights: Vec<f32>,
    /// One per procedure.
    pub normalisers: Vec<Normaliser>,
    /// Task that it was trained for.
    pub task: String,
    /// Names of the procedures.
    pub procedures: Vec<String>,
    /// Mean last pose of each procedure, `T_reference_moving`.
    pub end_poses: Vec<Pose>,
    /// Embedding of the task's text, if it was trained with one.
    pub text_embedding: Option<Vec<f32>>,
    /// Seconds between the poses of a history.
    pub dt: f64,
    /// Hash of the data set.
    pub dataset_hash: String,
    /// The task in words.
    pub text: String,
    /// The other tasks that the same network knows.
    pub others: Vec<LearnedTask>,
    /// Figures of the training by name.
    pub metrics: BTreeMap<String, f64>,
    pub(crate) buffers: SwitchBuffers,
    pub(crate) encoded: Vec<f32>,
}

impl SwitchPolicy {
    /// A classifier with the tasks that it was taught; the first one is chosen.
    pub(crate) fn of(
        layout: SwitchLayout,
        weights: Vec<f32>,
        tasks: &[LearnedTask],
        dt: f64,
        metrics: BTreeMap<String, f64>,
    ) -> Result<Self, PolicyError> {
        let Some((first, others)) = tasks.split_first() else {
            return Err(PolicyError::Data { reason: "there is no task".into() });
        };
        let t = first.clone();
        Ok(Self {
            buffers: SwitchBuffers::new(&layout, 1),
            encoded: vec![0.0; layout.history * POSE_DIM],
            weights,
            normalisers: t.normalisers,
            task: t.task,
            text: t.text,
            procedures: t.procedures,
            end_poses: t.end_poses,
            text_embedding: t.text_embedding,
            dataset_hash: t.dataset_hash,
            others: others.to_vec(),
            dt,
            metrics,
            layout,
        })
    }

    /// Names of all tasks that the network knows, the chosen one first.
    pub fn tasks(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.task.as_str()).chain(self.others.iter().map(|t| t.task.as_str()))
    }

    /// The same network for another of its tasks.
    ///
    /// # Errors
    /// [`PolicyError::UnknownTask`] naming those that it knows.
    pub fn choose(mut self, task: &str) -> Result<Self, PolicyError> {
        if self.task == task {
            return Ok(self);
        }
        let Some(other) = self.others.iter_mut().find(|t| t.task == task) else {
            let known = self.tasks().map(str::to_owned).collect();
            return Err(PolicyError::UnknownTask { task: task.into(), known });
        };
        std::mem::swap(&mut self.task, &mut other.task);
        std::mem::swap(&mut self.text, &mut other.text);
        std::mem::swap(&mut self.text_embedding, &mut other.text_embedding);
        std::mem::swap(&mut self.procedures, &mut other.procedures);
        std::mem::swap(&mut self.normalisers, &mut other.normalisers);
        std::mem::swap(&mut self.end_poses, &mut other.end_poses);
        std::mem::swap(&mut self.dataset_hash, &mut other.dataset_hash);
        Ok(self)
    }

    /// Poses that a history must have.
    pub fn history_len(&self) -> usize {
        self.layout.history
    }

    /// Probability that the procedure is done, given the history (oldest first, `dt` apart,
    /// `T_reference_moving`).
    ///
    /// # Errors
    /// [`PolicyError::UnknownProcedure`], [`PolicyError::HistoryLength`], [`PolicyError::NotFinite`].
    pub fn probability(&mut self, procedure: usize, history: &[Pose]) -> Result<f32, PolicyError> {
        let count = self.normalisers.len();
        let Some(normaliser) = self.normalisers.get(procedure) else {
            return Err(PolicyError::UnknownProcedure { procedure, count });
        };
        if history.len() != self.layout.history {
            let (have, need) = (history.len(), self.layout.history);
            return Err(PolicyError::HistoryLength { have, need });
        }
        for (i, (pose, out)) in
            history.iter().zip(self.encoded.chunks_exact_mut(POSE_DIM)).enumerate()
        {
            finite(pose, || format!("pose {i} of the history"))?;
            out.copy_from_slice(&normaliser.encode(pose));
        }
        let text = Texts { table: self.text_embedding.as_deref().unwrap_or_default(), task: &[0] };
        self.buffers.forward(&self.layout, &self.weights, &self.encoded, &[procedure], text);
        Ok(1.0 / (1.0 + (-self.buffers.logits[0]).exp()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::check::{self, random};
    use crate::network::initial;
    use crate::rng::{Stream, stream};

    #[test]
    fn gradients_match_differences() {
        let l = SwitchLayout::new(2, 3, 2);
        let p = initial(&l.parameters, l.len, stream(1, Stream::Switch));
        let (h, table, w) = (random(3 * 18, 1), random(2 * 3, 2), random(3, 3));
        let text = Texts { table: &table, task: &[1, 0, 1] };
        let ids = [0, 1, 1];
        let mut b = SwitchBuffers::new(&l, 4);
        let mut grads = vec![0.0; l.len];
        b.forward(&l, &p, &h, &ids, text);
        b.logits[..3].copy_from_slice(&w);
        b.backward(&l, &p, &ids, &mut grads);
        for parameter in &l.parameters {
            let slot = parameter.slot;
            let g = slot.of(&grads);
            assert!(g.iter().any(|v| *v != 0.0), "{} has no gradient", parameter.name);
            // Every 37th coordinate of the large ones.
            let stride = if slot.len > 200 { 37 } else { 1 };
            let pick: Vec<usize> = (0..slot.len).step_by(stride).collect();
            let x: Vec<f32> = pick.iter().map(|i| slot.of(&p)[*i]).collect();
            let g: Vec<f32> = pick.iter().map(|i| g[*i]).collect();
            check::gradient(&parameter.name, &x, &g, |x| {
                let mut q = p.clone();
                for (i, v) in pick.iter().zip(x) {
                    slot.of_mut(&mut q)[*i] = *v;
                }
                b.forward(&l, &q, &h, &ids, text);
                check::dot(&b.logits[..3], &w)
            });
        }
    }
}
