//! The network said once more in plain candle operations, differentiated by candle. Slow, and the
//! measure of the hand-written passes: tests compare outputs and gradients with it.
//!
//! Norm and softmax are composed of elementary operations because several of candle's fused layers
//! silently cut the gradient.

use crate::POSE_DIM;
use crate::network::{Architecture, Batch, time_features};
use candle_core::{D, Device, Result, Tensor, Var};
use std::collections::BTreeMap;

/// The parameters as candle variables.
pub struct CandleNetwork {
    architecture: Architecture,
    vars: BTreeMap<String, Var>,
}

impl CandleNetwork {
    /// Copies a flat parameter vector into variables.
    ///
    /// # Errors
    /// Of candle.
    pub fn new(architecture: &Architecture, flat: &[f32]) -> Result<Self> {
        let vars = architecture
            .parameters()
            .iter()
            .map(|p| {
                let values = architecture.values(p, flat);
                let tensor = Tensor::from_slice(values, p.shape.as_slice(), &Device::Cpu)?;
                Ok((p.name.clone(), Var::from_tensor(&tensor)?))
            })
            .collect::<Result<_>>()?;
        Ok(Self { architecture: architecture.clone(), vars })
    }

    /// The variable of a parameter.
    pub fn var(&self, name: &str) -> Option<&Var> {
        self.vars.get(name)
    }

    fn get(&self, name: &str) -> Result<&Tensor> {
        self.vars
            .get(name)
            .map(Var::as_tensor)
            .ok_or_else(|| candle_core::Error::Msg(format!("no parameter {name}")))
    }

    fn linear(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        x.broadcast_matmul(self.get(&format!("{name}.weight"))?)?
            .broadcast_add(self.get(&format!("{name}.bias"))?)
    }

    fn norm(x: &Tensor, shift: &Tensor, scale: &Tensor) -> Result<Tensor> {
        let x = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let rms = (x.sqr()?.mean_keepdim(D::Minus1)? + 1e-6)?.sqrt()?;
        x.broadcast_div(&rms)?.broadcast_mul(&(scale + 1.0)?)?.broadcast_add(shift)
    }

    fn gelu(x: &Tensor) -> Result<Tensor> {
        let inner = ((x + (x * (x * x)?)? * 0.044715)? * (2.0 / std::f64::consts::PI).sqrt())?;
        (x * 0.5)? * (inner.tanh()? + 1.0)?
    }

    fn block(
        &self,
        name: &str,
        x: &Tensor,
        m: &[Tensor],
        gates: Option<[&Tensor; 2]>,
    ) -> Result<Tensor> {
        let (b, n, d) = x.dims3()?;
        let heads = self.architecture.config.heads;
        let dh = d / heads;
        let gated = |y: Tensor, i: usize| match gates {
            Some(g) => y.broadcast_mul(g[i]),
            None => Ok(y),
        };
        let qkv = self.linear(&format!("{name}.qkv"), &Self::norm(x, &m[0], &m[1])?)?;
        let qkv = qkv.reshape((b, n, 3, heads, dh))?;
        let part = |i: usize| qkv.narrow(2, i, 1)?.squeeze(2)?.transpose(1, 2)?.contiguous();
        let (q, k, v) = (part(0)?, part(1)?, part(2)?);
        let scores = (q.matmul(&k.t()?.contiguous()?)? / (dh as f64).sqrt())?;
        let e = scores.broadcast_sub(&scores.max_keepdim(D::Minus1)?.detach())?.exp()?;
        let attention = e.broadcast_div(&e.sum_keepdim(D::Minus1)?)?.matmul(&v)?;
        let attention = attention.transpose(1, 2)?.contiguous()?.reshape((b, n, d))?;
        let x = (x + gated(self.linear(&format!("{name}.out"), &attention)?, 0)?)?;
        let up = self.linear(&format!("{name}.up"), &Self::norm(&x, &m[2], &m[3])?)?;
        let fed = self.linear(&format!("{name}.down"), &Self::gelu(&up)?)?;
        &x + gated(fed, 1)?
    }

    /// Network output `[batch, horizon, 9]`.
    ///
    /// # Errors
    /// Of candle.
    pub fn forward(&self, batch: &Batch) -> Result<Tensor> {
        let (c, device) = (&self.architecture.config, &Device::Cpu);
        let (b, h, n, d) = (batch.len, c.history, c.horizon, c.d_model);
        let history = Tensor::from_slice(batch.history, (b, h, POSE_DIM), device)?;
        let tokens =
            self.linear("history.1", &Self::gelu(&self.linear("history.0", &history)?)?)?;
        let width = self.architecture.dimensions.text;
        let text = match batch.text {
            Some(t) if width > 0 => {
                let table = Tensor::from_slice(t, (t.len() / width, width), device)?;
                let tasks: Vec<u32> = batch.task.iter().map(|t| *t as u32).collect();
                self.linear("text", &table)?
                    .index_select(&Tensor::from_vec(tasks, b, device)?, 0)?
            }
            _ => Tensor::zeros((b, d), candle_core::DType::F32, device)?,
        };
        let text = text.unsqueeze(1)?;
        let ids: Vec<u32> = batch.procedure.iter().map(|p| *p as u32).collect();
        let ids = Tensor::from_vec(ids, b, device)?;
        let procedure = self.get("procedures")?.index_select(&ids, 0)?.unsqueeze(1)?;
        let modalities = self.get("modalities")?;
        let modality = |i: usize| modalities.narrow(0, i, 1);
        let tokens = Tensor::cat(
            &[
                &tokens.broadcast_add(&modality(0)?)?,
                &text.broadcast_add(&modality(1)?)?,
                &procedure.broadcast_add(&modality(2)?)?,
            ],
            1,
        )?;
        let mut x = tokens.broadcast_add(self.get("positions")?)?;
        for i in 0..c.encoder_layers {
            let norms = self.get(&format!("encoder.{i}.norms"))?;
            let m = (0..4).map(|j| norms.narrow(0, j, 1)).collect::<Result<Vec<_>>>()?;
            x = self.block(&format!("encoder.{i}"), &x, &m, None)?;
        }
        let e = x.mean(1)?;
        let mut features = vec![0.0; b * d];
        for (f, k) in features.chunks_exact_mut(d).zip(batch.step) {
            time_features(*k, f);
        }
        let t = self.linear("time.0", &Tensor::from_vec(features, (b, d), device)?)?;
        let t = self.linear("time.1", &t.silu()?)?;
        let condition = (e + t)?.silu()?;
        let noisy = Tensor::from_slice(batch.noisy, (b, n, POSE_DIM), device)?;
        let mut x =
            self.linear("pose_in", &noisy)?.broadcast_add(self.get("horizon_positions")?)?;
        for i in 0..c.decoder_layers {
            let name = format!("decoder.{i}");
            let m = self.linear(&format!("{name}.modulation"), &condition)?;
            let m =
                (0..6).map(|j| m.narrow(1, j * d, d)?.unsqueeze(1)).collect::<Result<Vec<_>>>()?;
            let norms = [m[0].clone(), m[1].clone(), m[3].clone(), m[4].clone()];
            x = self.block(&name, &x, &norms, Some([&m[2], &m[5]]))?;
        }
        let m = self.linear("final.modulation", &condition)?;
        let (shift, scale) = (m.narrow(1, 0, d)?.unsqueeze(1)?, m.narrow(1, d, d)?.unsqueeze(1)?);
        self.linear("final.output", &Self::norm(&x, &shift, &scale)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PolicyConfig;
    use crate::kernels::check::random;
    use crate::network::{Dimensions, Workspace};

    fn config() -> PolicyConfig {
        PolicyConfig {
            history: 5,
            horizon: 7,
            d_model: 32,
            decoder_layers: 2,
            ..PolicyConfig::small()
        }
    }

    /// Outputs within 1e-5 and gradients within 1e-4 relative of candle's, on random weights in which
    /// nothing is zero; and every parameter has a gradient.
    #[test]
    fn output_and_gradients_equal_candle() {
        for text in [0, 12] {
            let a = Architecture::new(&config(), Dimensions { procedures: 2, text }).unwrap();
            let mut flat = a.initial(1);
            for (v, r) in flat.iter_mut().zip(random(a.len(), 2)) {
                *v += 0.15 * r;
            }
            let (h, noisy, target) =
                (random(3 * 5 * 9, 3), random(3 * 7 * 9, 4), random(3 * 7 * 9, 5));
            // Two tasks.
            let embedding = random(2 * 12, 6);
            let batch = Batch {
                len: 3,
                history: &h,
                procedure: &[0, 1, 0],
                noisy: &noisy,
                step: &[0, 57, 99],
                text: (text > 0).then_some(&embedding[..]),
                task: &[1, 0, 1],
            };
            let candle = CandleNetwork::new(&a, &flat).unwrap();
            let out = candle.forward(&batch).unwrap();
            let expected: Vec<f32> = out.flatten_all().unwrap().to_vec1().unwrap();
            // The workspace is larger than the batch on purpose.
            let mut w = Workspace::new(&a, 4);
            w.forward(&a, &flat, &batch);
            for (got, want) in w.output.iter().zip(&expected) {
                assert!((got - want).abs() < 1e-5, "{got} {want}");
            }
            let mut weights = [1.0 / (3.0 * 7.0 * 9.0); POSE_DIM];
            weights[0] *= 2.0;
            let mut grads = vec![0.0; a.len()];
            let loss = w.backward(&a, &flat, &batch, &target, &weights, &mut grads);
            let t = Tensor::from_slice(&target, (3, 7, POSE_DIM), &Device::Cpu).unwrap();
            let weight = Tensor::from_slice(&weights, (1, 1, POSE_DIM), &Device::Cpu).unwrap();
            let l = (out - t).unwrap().sqr().unwrap().broadcast_mul(&weight).unwrap();
            let l = l.sum_all().unwrap();
            assert!((f64::from(l.to_scalar::<f32>().unwrap()) - loss).abs() < 1e-5 * loss);
            let store = l.backward().unwrap();
            let mut worst = 0.0f32;
            for p in a.parameters() {
                let got = a.values(p, &grads);
                let var = candle.var(&p.name).unwrap();
                let want: Vec<f32> =
                    store.get(var).unwrap().flatten_all().unwrap().to_vec1().unwrap();
                let size = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                assert!(size.is_finite() && size > 1e-7, "{} has no gradient in candle", p.name);
                let off =
                    got.iter().zip(&want).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / size;
                worst = worst.max(off);
                assert!(off < 1e-4, "{}: gradient off by {off}", p.name);
            }
            println!("text {text}: worst relative gradient difference {worst:.1e}");
        }
    }

    /// The same gradients against central differences along random directions, in every tensor.
    #[test]
    fn gradients_match_differences() {
        let a = Architecture::new(&config(), Dimensions { procedures: 2, text: 8 }).unwrap();
        let mut flat = a.initial(1);
        for (v, r) in flat.iter_mut().zip(random(a.len(), 2)) {
            *v += 0.1 * r;
        }
        let (h, noisy, target, text) =
            (random(90, 3), random(126, 4), random(126, 5), random(8, 6));
        let batch = Batch {
            len: 2,
            history: &h,
            procedure: &[1, 0],
            noisy: &noisy,
            step: &[3, 80],
            text: Some(&text),
            task: &[0, 0],
        };
        let mut w = Workspace::new(&a, 2);
        let weights = [1.0; POSE_DIM];
        let mut grads = vec![0.0; a.len()];
        w.forward(&a, &flat, &batch);
        w.backward(&a, &flat, &batch, &target, &weights, &mut grads);
        let mut unused = vec![0.0; a.len()];
        for (i, p) in a.parameters().iter().enumerate() {
            let direction = random(a.values(p, &flat).len(), 100 + i as u64);
            let norm = direction.iter().map(|v| v * v).sum::<f32>().sqrt();
            let slope: f64 = a
                .values(p, &grads)
                .iter()
                .zip(&direction)
                .map(|(g, v)| f64::from(g * v / norm))
                .sum();
            let mut loss = |step: f32| {
                let mut moved = flat.clone();
                for (v, r) in a.values_mut(p, &mut moved).iter_mut().zip(&direction) {
                    *v += step * r / norm;
                }
                w.forward(&a, &moved, &batch);
                w.backward(&a, &moved, &batch, &target, &weights, &mut unused)
            };
            let h = 1e-2;
            let numeric = (loss(h) - loss(-h)) / (2.0 * f64::from(h));
            assert!(
                (numeric - slope).abs() < 0.02 * (numeric.abs() + 1.0),
                "{}: {slope} against {numeric}",
                p.name
            );
        }
    }
}
