//! Where each parameter lies in the one flat vector that holds them all.

use super::FEED_FORWARD;
use super::block::BlockSlots;
use crate::normaliser::POSE_DIM;
use crate::rng::{Stream, stream};
use crate::{PolicyConfig, PolicyError};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A range of the flat vector.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slot {
    pub offset: usize,
    pub len: usize,
}

impl Slot {
    pub fn of<'a>(&self, flat: &'a [f32]) -> &'a [f32] {
        &flat[self.offset..self.offset + self.len]
    }

    pub fn of_mut<'a>(&self, flat: &'a mut [f32]) -> &'a mut [f32] {
        &mut flat[self.offset..self.offset + self.len]
    }
}

/// `y = x W + b`, the weights as `[inputs, outputs]`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Linear {
    pub weight: Slot,
    pub bias: Slot,
    pub inputs: usize,
    pub outputs: usize,
}

#[derive(Debug, Clone, Copy)]
pub(crate) enum Init {
    Zero,
    /// Uniform with the bound of Glorot and Bengio 2010.
    Xavier,
    Normal(f32),
}

/// One named tensor of the network.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Its name in a checkpoint.
    pub name: String,
    /// Its shape; linear weights are `[inputs, outputs]`.
    pub shape: Vec<usize>,
    /// Whether weight decay applies.
    pub decay: bool,
    pub(crate) slot: Slot,
    init: Init,
}

/// What the data decides about the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dimensions {
    /// Number of procedures.
    pub procedures: usize,
    /// Length of the text embedding; 0 for none (its token then is a zero vector).
    pub text: usize,
}

/// The parameters of a network of a given size.
#[derive(Debug, Clone)]
pub struct Architecture {
    /// The configuration it was made from.
    pub config: PolicyConfig,
    /// What the data decided.
    pub dimensions: Dimensions,
    parameters: Vec<Parameter>,
    len: usize,
    pub(crate) history: [Linear; 2],
    pub(crate) text: Option<Linear>,
    pub(crate) procedures: Slot,
    pub(crate) positions: Slot,
    pub(crate) modalities: Slot,
    /// Norms `[shift1, scale1, shift2, scale2]` and the block.
    pub(crate) encoder: Vec<(Slot, BlockSlots)>,
    pub(crate) time: [Linear; 2],
    pub(crate) pose_in: Linear,
    pub(crate) horizon_positions: Slot,
    /// Modulation `[shift1, scale1, gate1, shift2, scale2, gate2]` and the block.
    pub(crate) decoder: Vec<(Linear, BlockSlots)>,
    pub(crate) final_modulation: Linear,
    pub(crate) output: Linear,
}

/// Lays out named tensors one after the other.
#[derive(Debug, Default)]
pub(crate) struct Builder {
    pub parameters: Vec<Parameter>,
    pub len: usize,
}

impl Builder {
    pub fn tensor(&mut self, name: String, shape: &[usize], decay: bool, init: Init) -> Slot {
        let slot = Slot { offset: self.len, len: shape.iter().product() };
        self.len += slot.len;
        self.parameters.push(Parameter { name, shape: shape.to_vec(), decay, slot, init });
        slot
    }

    pub fn linear(&mut self, name: &str, inputs: usize, outputs: usize, init: Init) -> Linear {
        let weight = self.tensor(format!("{name}.weight"), &[inputs, outputs], true, init);
        let bias = self.tensor(format!("{name}.bias"), &[outputs], false, Init::Zero);
        Linear { weight, bias, inputs, outputs }
    }

    fn block(&mut self, name: &str, d: usize) -> BlockSlots {
        BlockSlots {
            qkv: self.linear(&format!("{name}.qkv"), d, 3 * d, Init::Xavier),
            out: self.linear(&format!("{name}.out"), d, d, Init::Xavier),
            up: self.linear(&format!("{name}.up"), d, FEED_FORWARD * d, Init::Xavier),
            down: self.linear(&format!("{name}.down"), FEED_FORWARD * d, d, Init::Xavier),
        }
    }
}

impl Architecture {
    /// Lays out the parameters.
    ///
    /// # Errors
    /// [`PolicyError::Config`].
    pub fn new(config: &PolicyConfig, dimensions: Dimensions) -> Result<Self, PolicyError> {
        config.validate()?;
        if dimensions.procedures == 0 || dimensions.procedures > 4096 || dimensions.text > 1 << 16 {
            let problem = format!("{dimensions:?} is outside of what the network can take");
            return Err(PolicyError::Config { problems: vec![problem] });
        }
        let (d, c) = (config.d_model, config);
        let mut b = Builder::default();
        let small = Init::Normal(0.02);
        let history = [
            b.linear("history.0", POSE_DIM, d, Init::Xavier),
            b.linear("history.1", d, d, Init::Xavier),
        ];
        let text =
            (dimensions.text > 0).then(|| b.linear("text", dimensions.text, d, Init::Xavier));
        // Unit variance keeps procedures apart from the first step on.
        let procedures =
            b.tensor("procedures".into(), &[dimensions.procedures, d], false, Init::Normal(1.0));
        let positions = b.tensor("positions".into(), &[c.history + 2, d], false, small);
        let modalities = b.tensor("modalities".into(), &[3, d], false, small);
        let encoder = (0..c.encoder_layers)
            .map(|i| {
                let name = format!("encoder.{i}");
                (b.tensor(format!("{name}.norms"), &[4, d], false, Init::Zero), b.block(&name, d))
            })
            .collect();
        let time = [b.linear("time.0", d, d, Init::Xavier), b.linear("time.1", d, d, Init::Xavier)];
        let pose_in = b.linear("pose_in", POSE_DIM, d, Init::Xavier);
        let horizon_positions = b.tensor("horizon_positions".into(), &[c.horizon, d], false, small);
        let decoder = (0..c.decoder_layers)
            .map(|i| {
                let name = format!("decoder.{i}");
                let modulation = b.linear(&format!("{name}.modulation"), d, 6 * d, Init::Zero);
                (modulation, b.block(&name, d))
            })
            .collect();
        let final_modulation = b.linear("final.modulation", d, 2 * d, Init::Zero);
        let output = b.linear("final.output", d, POSE_DIM, Init::Zero);
        Ok(Self {
            config: config.clone(),
            dimensions,
            parameters: b.parameters,
            len: b.len,
            history,
            text,
            procedures,
            positions,
            modalities,
            encoder,
            time,
            pose_in,
            horizon_positions,
            decoder,
            final_modulation,
            output,
        })
    }

    /// Number of weights.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Never true; for the lint's sake.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The named tensors in the order of the flat vector.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// The values of one tensor within a flat vector of [`Architecture::len`] numbers.
    pub fn values<'a>(&self, parameter: &Parameter, flat: &'a [f32]) -> &'a [f32] {
        parameter.slot.of(flat)
    }

    /// As [`Architecture::values`], to write.
    pub fn values_mut<'a>(&self, parameter: &Parameter, flat: &'a mut [f32]) -> &'a mut [f32] {
        parameter.slot.of_mut(flat)
    }

    /// Fresh weights; gates, modulations and the output are zero.
    pub fn initial(&self, seed: u64) -> Vec<f32> {
        initial(&self.parameters, self.len, stream(seed, Stream::Init))
    }
}

/// Fresh values of all parameters.
pub(crate) fn initial(parameters: &[Parameter], len: usize, mut rng: ChaCha8Rng) -> Vec<f32> {
    let mut flat = vec![0.0; len];
    for p in parameters {
        let values = p.slot.of_mut(&mut flat);
        match p.init {
            Init::Zero => {}
            Init::Xavier => {
                let bound = (6.0 / p.shape.iter().sum::<usize>() as f32).sqrt();
                values.iter_mut().for_each(|v| *v = rng.random_range(-bound..bound));
            }
            Init::Normal(std) => {
                values.iter_mut().for_each(|v| *v = std * rng.sample::<f32, _>(StandardNormal));
            }
        }
    }
    flat
}
