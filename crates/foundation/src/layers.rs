//! The few layers that the pose networks are made of, for inference. Layouts and parameter names are
//! those of torch.nn, so that a converted state dict loads by name.

use crate::{FoundationError, Weights};
use candle_core::{D, Tensor};

type Result<T> = std::result::Result<T, FoundationError>;

/// torch's default, for batch and layer normalisation.
const EPS: f64 = 1e-5;

/// A square convolution with padding k/2; a batch normalisation behind it is folded into it.
#[derive(Debug)]
pub struct Conv {
    weight: Tensor,
    /// `[1, out, 1, 1]`
    bias: Tensor,
    padding: usize,
    stride: usize,
}

impl Conv {
    /// `conv` and `norm` are the names of the convolution and of its batch normalisation.
    ///
    /// # Errors
    /// [`FoundationError::Tensor`] naming what is missing or misshapen.
    pub fn load(
        w: &Weights,
        (conv, norm): (&str, &str),
        (input, output, kernel, stride): (usize, usize, usize, usize),
    ) -> Result<Self> {
        let weight = w.shaped(&format!("{conv}.weight"), &[output, input, kernel, kernel])?;
        let bias = w.shaped(&format!("{conv}.bias"), &[output])?;
        let of = |part: &str| w.shaped(&format!("{norm}.{part}"), &[output]);
        let factor = (of("weight")? / (of("running_var")? + EPS)?.sqrt()?)?;
        let bias = (((bias - of("running_mean")?)? * &factor)? + of("bias")?)?;
        Ok(Self {
            weight: weight.broadcast_mul(&factor.reshape((output, 1, 1, 1))?)?.contiguous()?,
            bias: bias.reshape((1, output, 1, 1))?,
            padding: kernel / 2,
            stride,
        })
    }

    /// `[B, in, H, W]` to `[B, out, ceil(H/stride), ceil(W/stride)]`.
    ///
    /// # Errors
    /// A channel count that does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = x.conv2d(&self.weight, self.padding, self.stride, 1, 1)?;
        Ok(y.broadcast_add(&self.bias)?)
    }
}

/// Two 3x3 convolutions with a shortcut past both.
#[derive(Debug)]
pub struct BasicBlock {
    first: Conv,
    second: Conv,
}

impl BasicBlock {
    /// # Errors
    /// As [`Conv::load`].
    pub fn load(w: &Weights, name: &str, width: usize) -> Result<Self> {
        let part = |i: u8| {
            let (conv, norm) = (format!("{name}.conv{i}"), format!("{name}.bn{i}"));
            Conv::load(w, (&conv, &norm), (width, width, 3, 1))
        };
        Ok(Self { first: part(1)?, second: part(2)? })
    }

    /// Same shape out as in.
    ///
    /// # Errors
    /// As [`Conv::forward`].
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = self.first.forward(x)?.relu()?;
        Ok((self.second.forward(&y)? + x)?.relu()?)
    }
}

/// `y = x W^T + b` on the last axis.
#[derive(Debug)]
pub struct Linear {
    /// `[in, out]`, contiguous.
    transposed: Tensor,
    bias: Tensor,
}

impl Linear {
    /// # Errors
    /// [`FoundationError::Tensor`].
    pub fn load(w: &Weights, name: &str, input: usize, output: usize) -> Result<Self> {
        let names = (format!("{name}.weight"), format!("{name}.bias"));
        Self::named(w, (&names.0, &names.1), input, output)
    }

    fn named(
        w: &Weights,
        (weight, bias): (&str, &str),
        input: usize,
        output: usize,
    ) -> Result<Self> {
        Ok(Self {
            transposed: w.shaped(weight, &[output, input])?.t()?.contiguous()?,
            bias: w.shaped(bias, &[output])?,
        })
    }

    /// `[.., in]` to `[.., out]`.
    ///
    /// # Errors
    /// A width that does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut shape = x.dims().to_vec();
        // One large product instead of one for each batch entry.
        let y = x.flatten_to(D::Minus2)?.contiguous()?.matmul(&self.transposed)?;
        if let Some(last) = shape.last_mut() {
            *last = self.bias.dim(0)?;
        }
        Ok(y.broadcast_add(&self.bias)?.reshape(shape)?)
    }
}

/// Multi-head self attention.
#[derive(Debug)]
pub struct SelfAttention {
    packed: Linear,
    out: Linear,
    heads: usize,
}

impl SelfAttention {
    /// # Errors
    /// [`FoundationError::Tensor`].
    pub fn load(w: &Weights, name: &str, width: usize, heads: usize) -> Result<Self> {
        let names = (format!("{name}.in_proj_weight"), format!("{name}.in_proj_bias"));
        Ok(Self {
            packed: Linear::named(w, (&names.0, &names.1), width, 3 * width)?,
            out: Linear::load(w, &format!("{name}.out_proj"), width, width)?,
            heads,
        })
    }

    /// `[B, N, width]`, same out.
    ///
    /// # Errors
    /// A width that does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (b, n, width) = x.dims3()?;
        let head = width / self.heads;
        let packed = self.packed.forward(x)?.reshape((b, n, 3, self.heads, head))?;
        let part = |i: usize| packed.narrow(2, i, 1)?.squeeze(2)?.transpose(1, 2)?.contiguous();
        let (q, k, v) = (part(0)?, part(1)?, part(2)?);
        let logits = (q.matmul(&k.t()?.contiguous()?)? / (head as f64).sqrt())?;
        let weights = softmax(&logits)?;
        let y = weights.matmul(&v)?.transpose(1, 2)?.reshape((b, n, width))?;
        self.out.forward(&y)
    }
}

/// Over the last axis.
fn softmax(x: &Tensor) -> Result<Tensor> {
    let e = x.broadcast_sub(&x.max_keepdim(D::Minus1)?)?.exp()?;
    Ok(e.broadcast_div(&e.sum_keepdim(D::Minus1)?)?)
}

#[derive(Debug)]
struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
}

impl LayerNorm {
    fn load(w: &Weights, name: &str, width: usize) -> Result<Self> {
        let of = |part: &str| w.shaped(&format!("{name}.{part}"), &[width]);
        Ok(Self { weight: of("weight")?, bias: of("bias")? })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let deviation = (x.sqr()?.mean_keepdim(D::Minus1)? + EPS)?.sqrt()?;
        let y = x.broadcast_div(&deviation)?;
        Ok(y.broadcast_mul(&self.weight)?.broadcast_add(&self.bias)?)
    }
}

/// One transformer encoder layer: post-norm, ReLU, feed-forward as wide as the tokens.
#[derive(Debug)]
pub struct EncoderLayer {
    attention: SelfAttention,
    inner: Linear,
    outer: Linear,
    norms: (LayerNorm, LayerNorm),
}

impl EncoderLayer {
    /// # Errors
    /// [`FoundationError::Tensor`].
    pub fn load(w: &Weights, name: &str, width: usize, heads: usize) -> Result<Self> {
        let norm = |i: u8| LayerNorm::load(w, &format!("{name}.norm{i}"), width);
        Ok(Self {
            attention: SelfAttention::load(w, &format!("{name}.self_attn"), width, heads)?,
            inner: Linear::load(w, &format!("{name}.linear1"), width, width)?,
            outer: Linear::load(w, &format!("{name}.linear2"), width, width)?,
            norms: (norm(1)?, norm(2)?),
        })
    }

    /// `[B, N, width]`, same out.
    ///
    /// # Errors
    /// A width that does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = self.norms.0.forward(&(x + self.attention.forward(x)?)?)?;
        let y = self.outer.forward(&self.inner.forward(&x)?.relu()?)?;
        self.norms.1.forward(&(x + y)?)
    }
}

/// The fixed position code `[1, tokens, width]`: sine in the even, cosine in the odd channels.
///
/// # Errors
/// Only when the device is out of memory.
pub fn position_code(tokens: usize, width: usize, device: &candle_core::Device) -> Result<Tensor> {
    let rate = -(10_000f64.ln()) / width as f64;
    let mut data = Vec::with_capacity(tokens * width);
    for t in 0..tokens {
        for c in 0..width {
            let angle = t as f64 * ((c / 2 * 2) as f64 * rate).exp();
            data.push(if c % 2 == 0 { angle.sin() } else { angle.cos() } as f32);
        }
    }
    Ok(Tensor::from_vec(data, (1, tokens, width), device)?)
}
