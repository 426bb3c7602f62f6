//! FoundationPose's two networks. Input of both: what the camera saw (B) and what the hypothesis would
//! look like (A), `[N, 6, S, S]` each: colour 0..1, then xyz relative to the hypothesis in radii.
//! S is 160; any multiple of 8 works. The released networks have width 64; the width is read from the
//! weights.

use crate::layers::{BasicBlock, Conv, EncoderLayer, Linear, SelfAttention, position_code};
use crate::{FoundationError, Weights};
use candle_core::Tensor;

/// Attention heads, in both networks.
const HEADS: usize = 4;
/// Channels of each input: colour and xyz.
pub const CHANNELS: usize = 6;

/// Two images to tokens.
#[derive(Debug)]
struct Encoder {
    stem: (Conv, Conv, BasicBlock, BasicBlock),
    pair: (BasicBlock, BasicBlock, Conv, BasicBlock, BasicBlock),
    width: usize,
}

impl Encoder {
    /// `single` and `pair`: names of the two parts, `encodeA` and `encodeAB` in the refiner.
    fn load(w: &Weights, single: &str, pair: &str) -> Result<Self, FoundationError> {
        let first = format!("{single}.0.layers.0.weight");
        let c = *w.get(&first)?.dims().first().unwrap_or(&0);
        if c == 0 || (8 * c) % HEADS != 0 {
            return Err(w.wrong(&first, format!("has {c} output channels; {HEADS} heads need 8 n")));
        }
        let conv = |at: String, shape| {
            Conv::load(w, (&format!("{at}.layers.0"), &format!("{at}.layers.1")), shape)
        };
        let block = |at: String, width| BasicBlock::load(w, &at, width);
        Ok(Self {
            stem: (
                conv(format!("{single}.0"), (CHANNELS, c, 7, 2))?,
                conv(format!("{single}.1"), (c, 2 * c, 3, 2))?,
                block(format!("{single}.2"), 2 * c)?,
                block(format!("{single}.3"), 2 * c)?,
            ),
            pair: (
                block(format!("{pair}.0"), 4 * c)?,
                block(format!("{pair}.1"), 4 * c)?,
                conv(format!("{pair}.2"), (4 * c, 8 * c, 3, 2))?,
                block(format!("{pair}.3"), 8 * c)?,
                block(format!("{pair}.4"), 8 * c)?,
            ),
            width: 8 * c,
        })
    }

    /// `[N, (S/8)^2, width]`.
    fn forward(&self, a: &Tensor, b: &Tensor) -> Result<Tensor, FoundationError> {
        if a.dims() != b.dims() || a.rank() != 4 || a.dim(1)? != CHANNELS {
            return Err(FoundationError::input(
                "crops",
                format!("have shapes {:?} and {:?}; both must be [N, 6, S, S]", a.dims(), b.dims()),
            ));
        }
        let n = a.dim(0)?;
        let x = self.stem.0.forward(&Tensor::cat(&[a, b], 0)?)?.relu()?;
        let x = self.stem.1.forward(&x)?.relu()?;
        let x = self.stem.3.forward(&self.stem.2.forward(&x)?)?;
        let x = Tensor::cat(&[x.narrow(0, 0, n)?, x.narrow(0, n, n)?], 1)?;
        let x = self.pair.1.forward(&self.pair.0.forward(&x)?)?;
        let x = self.pair.2.forward(&x)?.relu()?;
        let x = self.pair.4.forward(&self.pair.3.forward(&x)?)?;
        let x = x.flatten_from(2)?.transpose(1, 2)?;
        let code = position_code(x.dim(1)?, self.width, x.device())?;
        Ok(x.broadcast_add(&code)?)
    }
}

/// Says how a hypothesis has to move to fit what was seen.
#[derive(Debug)]
pub struct RefineNet {
    encoder: Encoder,
    translation: (EncoderLayer, Linear),
    rotation: (EncoderLayer, Linear),
}

impl RefineNet {
    /// # Errors
    /// [`FoundationError::Tensor`] naming what does not fit.
    pub fn new(w: &Weights) -> Result<Self, FoundationError> {
        let encoder = Encoder::load(w, "encodeA", "encodeAB")?;
        let head = |name: &str| -> Result<_, FoundationError> {
            Ok((
                EncoderLayer::load(w, &format!("{name}.0"), encoder.width, HEADS)?,
                Linear::load(w, &format!("{name}.1"), encoder.width, 3)?,
            ))
        };
        Ok(Self { translation: head("trans_head")?, rotation: head("rot_head")?, encoder })
    }

    /// Raw outputs `[N, 3]` for translation and rotation.
    ///
    /// # Errors
    /// [`FoundationError::Input`] for images of another shape.
    pub fn forward(&self, a: &Tensor, b: &Tensor) -> Result<(Tensor, Tensor), FoundationError> {
        let tokens = self.encoder.forward(a, b)?;
        let head = |(layer, out): &(EncoderLayer, Linear)| -> Result<Tensor, FoundationError> {
            Ok(out.forward(&layer.forward(&tokens)?)?.mean(1)?)
        };
        Ok((head(&self.translation)?, head(&self.rotation)?))
    }
}

/// Ranks hypotheses against each other.
#[derive(Debug)]
pub struct ScoreNet {
    encoder: Encoder,
    tokens: SelfAttention,
    hypotheses: SelfAttention,
    out: Linear,
}

impl ScoreNet {
    /// # Errors
    /// [`FoundationError::Tensor`] naming what does not fit.
    pub fn new(w: &Weights) -> Result<Self, FoundationError> {
        let encoder = Encoder::load(w, "encoderA", "encoderAB")?;
        Ok(Self {
            tokens: SelfAttention::load(w, "att", encoder.width, HEADS)?,
            hypotheses: SelfAttention::load(w, "att_cross", encoder.width, HEADS)?,
            out: Linear::load(w, "linear", encoder.width, 1)?,
            encoder,
        })
    }

    /// One feature `[N, width]` for each hypothesis; may be called on parts of the set.
    ///
    /// # Errors
    /// [`FoundationError::Input`] for images of another shape.
    pub fn features(&self, a: &Tensor, b: &Tensor) -> Result<Tensor, FoundationError> {
        Ok(self.tokens.forward(&self.encoder.forward(a, b)?)?.mean(1)?)
    }

    /// Scores `[N]` from the features of the whole set. Only their order means anything.
    ///
    /// # Errors
    /// A width that does not fit.
    pub fn compare(&self, features: &Tensor) -> Result<Tensor, FoundationError> {
        let x = self.hypotheses.forward(&features.unsqueeze(0)?)?;
        Ok(self.out.forward(&x)?.flatten_all()?)
    }
}
