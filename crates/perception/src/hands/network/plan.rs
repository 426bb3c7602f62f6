//! From the file's operators to steps that can be run without further checks: constants decoded,
//! shapes compared, simple followers (residual sum, PRELU) merged into the convolution before them.

use super::convolution::Convolution;
use super::error::Flaw;
use super::kernels::{Activation, Depthwise, Sampling, Size};
use super::model::{Element, Kind, Model, Operator};
use super::window::Window;

/// One operation; its tensors stand in [`Step`].
pub(super) enum Op {
    /// Inputs: the image and, possibly, a residual.
    Convolution(Convolution),
    Depthwise(Depthwise),
    MaxPool {
        window: Window,
        channels: usize,
    },
    Add(Activation),
    Prelu(Activation),
    Pad {
        from: Size,
        to: Size,
        before: Size,
    },
    Resize {
        from: Size,
        to: Size,
        sampling: Sampling,
    },
    Logistic,
    Mean {
        channels: usize,
    },
    Copy,
    /// Along an axis; `inner` is the number of values per outer index of each input.
    Concatenation {
        inner: Vec<usize>,
    },
}

/// An operation with the numbers of the tensors that it reads and writes.
pub(super) struct Step {
    pub op: Op,
    pub inputs: Vec<usize>,
    pub output: usize,
}

pub(super) struct Plan {
    pub steps: Vec<Step>,
    /// Shape of every tensor of the file.
    pub shapes: Vec<Vec<usize>>,
    pub names: Vec<String>,
    pub inputs: Vec<usize>,
    pub outputs: Vec<usize>,
}

fn activation(code: u8) -> Result<Activation, Flaw> {
    match code {
        0 => Ok(Activation::Linear),
        1 => Ok(Activation::Relu),
        3 => Ok(Activation::Relu6),
        other => Err(Flaw::unsupported(format!("the fused activation number {other}"))),
    }
}

/// Builds one step after the other; knows which float16 constants were "dequantized".
struct Planner<'m, 'a> {
    model: &'m Model<'a>,
    /// For each tensor the constant that a DEQUANTIZE copied into it.
    folded: Vec<Option<usize>>,
}

impl Planner<'_, '_> {
    fn shape(&self, tensor: usize) -> &[usize] {
        &self.model.tensors[tensor].shape
    }

    fn floats(&self, tensor: usize) -> Result<Vec<f32>, Flaw> {
        self.model.floats(self.folded[tensor].unwrap_or(tensor))
    }

    /// An activation of float type; a constant in its place is refused.
    fn activations(&self, operator: &Operator<'_>, count: usize) -> Result<Vec<usize>, Flaw> {
        let list = operator.inputs.get(..count).filter(|list| {
            list.iter().all(|tensor| {
                let tensor = (&self.model.tensors[*tensor], self.folded[*tensor]);
                tensor.0.element == Element::F32 && tensor.0.data.is_empty() && tensor.1.is_none()
            })
        });
        list.map(<[usize]>::to_vec).ok_or_else(|| {
            Flaw::unsupported(format!("{:?} of constants or of another type", operator.kind))
        })
    }

    fn input(&self, operator: &Operator<'_>, index: usize) -> Result<usize, Flaw> {
        let missing = || Flaw::malformed(format!("{:?} lacks an input", operator.kind));
        operator.inputs.get(index).copied().ok_or_else(missing)
    }

    /// (height, width, channels) of a batch of one.
    fn image(&self, tensor: usize) -> Result<Size, Flaw> {
        match *self.shape(tensor) {
            [1, height, width, channels] => Ok((height, width, channels)),
            ref shape => Err(Flaw::unsupported(format!("an image of shape {shape:?}"))),
        }
    }

    /// Window from options 0..=2 and a kernel size, checked against the output's shape.
    fn window(
        &self,
        operator: &Operator<'_>,
        kernel: (usize, usize),
        channels: usize,
    ) -> Result<Window, Flaw> {
        let options = self.options(operator)?;
        let same = options.byte(0, 0)? == 0;
        let stride = |id| -> Result<usize, Flaw> {
            usize::try_from(options.int(id, 0)?)
                .ok()
                .filter(|stride| *stride <= 64)
                .ok_or_else(|| Flaw::malformed("an absurd stride"))
        };
        if kernel.0 > 64 || kernel.1 > 64 {
            return Err(Flaw::unsupported(format!("a kernel of size {kernel:?}")));
        }
        let (height, width, _) = self.image(self.input(operator, 0)?)?;
        let window = Window::new((height, width), kernel, (stride(2)?, stride(1)?), same)?;
        self.expect(operator, &[1, window.out_h, window.out_w, channels])?;
        Ok(window)
    }

    fn options<'s>(&self, operator: &Operator<'s>) -> Result<super::flatbuffer::Table<'s>, Flaw> {
        let missing = || Flaw::malformed(format!("{:?} without options", operator.kind));
        operator.options.ok_or_else(missing)
    }

    fn output(&self, operator: &Operator<'_>) -> Result<usize, Flaw> {
        let [output] = operator.outputs[..] else {
            return Err(Flaw::malformed(format!("{:?} without one output", operator.kind)));
        };
        let tensor = &self.model.tensors[output];
        if tensor.element != Element::F32 || !tensor.data.is_empty() {
            return Err(Flaw::unsupported(format!("{:?} into {:?}", operator.kind, tensor.name)));
        }
        Ok(output)
    }

    fn expect(&self, operator: &Operator<'_>, shape: &[usize]) -> Result<(), Flaw> {
        let stored = self.shape(self.output(operator)?);
        if stored == shape {
            return Ok(());
        }
        let kind = operator.kind;
        Err(Flaw::malformed(format!("{kind:?} gives {shape:?}, the file says {stored:?}")))
    }

    fn bias(&self, operator: &Operator<'_>, channels: usize) -> Result<Vec<f32>, Flaw> {
        let bias = match operator.inputs.get(2) {
            Some(tensor) => self.floats(*tensor)?,
            None => vec![0.0; channels],
        };
        if bias.len() == channels && channels > 0 {
            return Ok(bias);
        }
        Err(Flaw::malformed(format!("{} biases for {channels} channels", bias.len())))
    }

    fn undilated(&self, operator: &Operator<'_>, first: usize) -> Result<(), Flaw> {
        let options = self.options(operator)?;
        if options.int(first, 1)? == 1 && options.int(first + 1, 1)? == 1 {
            return Ok(());
        }
        Err(Flaw::unsupported("a dilated convolution"))
    }

    fn op(&self, operator: &Operator<'_>) -> Result<(Op, Vec<usize>), Flaw> {
        let one = || self.activations(operator, 1);
        Ok(match operator.kind {
            Kind::Conv2d => (Op::Convolution(self.convolution(operator)?), one()?),
            Kind::DepthwiseConv2d => (Op::Depthwise(self.depthwise(operator)?), one()?),
            Kind::MaxPool2d => (self.max_pool(operator)?, one()?),
            Kind::FullyConnected => (self.fully_connected(operator)?, one()?),
            Kind::Pad => (self.pad(operator)?, one()?),
            Kind::ResizeBilinear => (self.resize(operator)?, one()?),
            Kind::Mean => (self.mean(operator)?, one()?),
            Kind::Add => {
                let inputs = self.activations(operator, 2)?;
                self.expect(operator, self.shape(inputs[0]))?;
                self.expect(operator, self.shape(inputs[1]))?;
                (Op::Add(activation(self.options(operator)?.byte(0, 0)?)?), inputs)
            }
            Kind::Prelu => {
                let inputs = one()?;
                self.expect(operator, self.shape(inputs[0]))?;
                let slopes = self.floats(self.input(operator, 1)?)?;
                let channels = self.shape(inputs[0]).last().copied().unwrap_or(1);
                if slopes.len() != channels || channels == 0 {
                    return Err(Flaw::unsupported("PRELU that is not per channel"));
                }
                (Op::Prelu(Activation::Prelu(slopes)), inputs)
            }
            Kind::Logistic => {
                let inputs = one()?;
                self.expect(operator, self.shape(inputs[0]))?;
                (Op::Logistic, inputs)
            }
            Kind::Reshape => {
                let inputs = one()?;
                let output = &self.model.tensors[self.output(operator)?];
                if output.elements() != self.model.tensors[inputs[0]].elements() {
                    return Err(Flaw::malformed("RESHAPE to another number of values"));
                }
                (Op::Copy, inputs)
            }
            Kind::Concatenation => {
                let inputs = self.activations(operator, operator.inputs.len())?;
                (self.concatenation(operator, &inputs)?, inputs)
            }
            Kind::Dequantize => return Err(Flaw::unsupported("DEQUANTIZE of an activation")),
        })
    }

    fn convolution(&self, operator: &Operator<'_>) -> Result<Convolution, Flaw> {
        let filter = self.input(operator, 1)?;
        let (_, _, in_channels) = self.image(self.input(operator, 0)?)?;
        let [channels, rows, columns, depth] = *self.shape(filter) else {
            return Err(Flaw::malformed("CONV_2D weights that are not four-dimensional"));
        };
        if depth != in_channels || depth == 0 {
            return Err(Flaw::unsupported(format!("{depth}-channel weights on {in_channels}")));
        }
        self.undilated(operator, 4)?;
        Ok(Convolution::new(
            self.window(operator, (rows, columns), channels)?,
            in_channels,
            &self.floats(filter)?,
            &self.bias(operator, channels)?,
            &activation(self.options(operator)?.byte(3, 0)?)?,
        ))
    }

    fn depthwise(&self, operator: &Operator<'_>) -> Result<Depthwise, Flaw> {
        let filter = self.input(operator, 1)?;
        let (_, _, in_channels) = self.image(self.input(operator, 0)?)?;
        let [1, rows, columns, channels] = *self.shape(filter) else {
            return Err(Flaw::malformed("DEPTHWISE_CONV_2D weights of a wrong shape"));
        };
        if channels != in_channels {
            return Err(Flaw::unsupported("DEPTHWISE_CONV_2D with a depth multiplier"));
        }
        self.undilated(operator, 5)?;
        Ok(Depthwise {
            window: self.window(operator, (rows, columns), channels)?,
            weights: self.floats(filter)?,
            bias: self.bias(operator, channels)?,
            activation: activation(self.options(operator)?.byte(4, 0)?)?,
        })
    }

    fn max_pool(&self, operator: &Operator<'_>) -> Result<Op, Flaw> {
        let options = self.options(operator)?;
        let size = |id| -> Result<usize, Flaw> {
            usize::try_from(options.int(id, 0)?).map_err(|_| Flaw::malformed("a negative size"))
        };
        if options.byte(5, 0)? != 0 {
            return Err(Flaw::unsupported("MAX_POOL_2D with an activation"));
        }
        let (_, _, channels) = self.image(self.input(operator, 0)?)?;
        if channels == 0 {
            return Err(Flaw::malformed("MAX_POOL_2D of no channels"));
        }
        Ok(Op::MaxPool { window: self.window(operator, (size(4)?, size(3)?), channels)?, channels })
    }

    fn fully_connected(&self, operator: &Operator<'_>) -> Result<Op, Flaw> {
        let (input, filter) = (self.input(operator, 0)?, self.input(operator, 1)?);
        let [rows, columns] = *self.shape(filter) else {
            return Err(Flaw::malformed("FULLY_CONNECTED weights that are not a matrix"));
        };
        let (options, output) = (self.options(operator)?, self.output(operator)?);
        let elements = |tensor: usize| self.model.tensors[tensor].elements();
        let fits = columns > 0
            && rows > 0
            && elements(input).is_multiple_of(columns)
            && elements(output) == elements(input) / columns * rows;
        if !fits || options.byte(1, 0)? != 0 {
            return Err(Flaw::malformed("FULLY_CONNECTED of wrong sizes"));
        }
        // The same as a convolution over a column of pixels with a window of one.
        let pixels = elements(input) / columns;
        Ok(Op::Convolution(Convolution::new(
            Window::new((pixels, 1), (1, 1), (1, 1), true)?,
            columns,
            &self.floats(filter)?,
            &self.bias(operator, rows)?,
            &activation(options.byte(0, 0)?)?,
        )))
    }

    fn pad(&self, operator: &Operator<'_>) -> Result<Op, Flaw> {
        let from = self.image(self.input(operator, 0)?)?;
        let amounts = self.model.integers(self.input(operator, 1)?)?;
        let amounts = amounts
            .iter()
            .map(|amount| usize::try_from(*amount).ok().filter(|amount| *amount < 1 << 16))
            .collect::<Option<Vec<_>>>();
        let Some([0, 0, top, bottom, left, right, front, back]) = amounts.as_deref() else {
            return Err(Flaw::unsupported("PAD of the batch, or of a negative or absurd amount"));
        };
        let to = (from.0 + top + bottom, from.1 + left + right, from.2 + front + back);
        self.expect(operator, &[1, to.0, to.1, to.2])?;
        Ok(Op::Pad { from, to, before: (*top, *left, *front) })
    }

    fn resize(&self, operator: &Operator<'_>) -> Result<Op, Flaw> {
        let options = self.options(operator)?;
        let from = self.image(self.input(operator, 0)?)?;
        let to = self.image(self.output(operator)?)?;
        if from.2 != to.2 || [from.0, from.1, from.2, to.0, to.1].contains(&0) {
            return Err(Flaw::malformed("RESIZE_BILINEAR of wrong sizes"));
        }
        let sampling = match (options.byte(2, 0)?, options.byte(3, 0)?) {
            (0, 0) => Sampling::Legacy,
            (0, _) => Sampling::HalfPixel,
            (_, 0) => Sampling::AlignCorners,
            _ => return Err(Flaw::malformed("RESIZE_BILINEAR with contradictory options")),
        };
        Ok(Op::Resize { from, to, sampling })
    }

    fn mean(&self, operator: &Operator<'_>) -> Result<Op, Flaw> {
        let (height, width, channels) = self.image(self.input(operator, 0)?)?;
        let mut axes = self.model.integers(self.input(operator, 1)?)?;
        axes.iter_mut().for_each(|axis| *axis = axis.rem_euclid(4));
        axes.sort_unstable();
        let output = &self.model.tensors[self.output(operator)?];
        if axes != [1, 2] || output.elements() != channels || height * width * channels == 0 {
            return Err(Flaw::unsupported("MEAN over anything but height and width"));
        }
        Ok(Op::Mean { channels })
    }

    fn concatenation(&self, operator: &Operator<'_>, inputs: &[usize]) -> Result<Op, Flaw> {
        let options = self.options(operator)?;
        if options.byte(1, 0)? != 0 {
            return Err(Flaw::unsupported("CONCATENATION with an activation"));
        }
        let output = self.shape(self.output(operator)?);
        let rank = output.len() as i32;
        let axis = options.int(0, 0)?;
        let axis = usize::try_from(if axis < 0 { axis.saturating_add(rank) } else { axis })
            .ok()
            .filter(|axis| *axis < output.len())
            .ok_or_else(|| Flaw::malformed("CONCATENATION along a missing axis"))?;
        let mut total = 0;
        let mut inner = Vec::new();
        for input in inputs {
            let shape = self.shape(*input);
            let alike = shape.len() == output.len()
                && (0..shape.len()).all(|i| i == axis || shape[i] == output[i]);
            if !alike {
                return Err(Flaw::malformed(format!("CONCATENATION of {shape:?} into {output:?}")));
            }
            total += shape[axis];
            inner.push(shape[axis..].iter().product());
        }
        if total != output[axis] || inner.is_empty() || inner.contains(&0) {
            return Err(Flaw::malformed("CONCATENATION of wrong sizes"));
        }
        Ok(Op::Concatenation { inner })
    }
}

impl Plan {
    /// Checks a model and turns it into steps.
    ///
    /// # Errors
    /// A [`Flaw`] naming the operator or tensor that is damaged or not supported.
    pub(super) fn new(model: &Model<'_>) -> Result<Self, Flaw> {
        let mut planner = Planner { model, folded: vec![None; model.tensors.len()] };
        let mut steps: Vec<Step> = Vec::new();
        // A tensor may be read once it is an input or some step has written it.
        let mut written = vec![false; model.tensors.len()];
        for input in &model.inputs {
            written[*input] = true;
        }
        for operator in &model.operators {
            if let (Kind::Dequantize, [from], [to]) =
                (operator.kind, &operator.inputs[..], &operator.outputs[..])
                && !model.tensors[*from].data.is_empty()
            {
                if model.tensors[*from].shape != model.tensors[*to].shape {
                    return Err(Flaw::malformed("DEQUANTIZE to another shape"));
                }
                planner.folded[*to] = Some(*from);
                continue;
            }
            let (op, inputs) = planner.op(operator)?;
            let output = planner.output(operator)?;
            if inputs.iter().any(|input| !written[*input]) || written[output] {
                return Err(Flaw::malformed(format!("{:?} is out of order", operator.kind)));
            }
            written[output] = true;
            steps.push(Step { op, inputs, output });
        }
        for tensor in &model.outputs {
            if !written[*tensor] {
                let name = &model.tensors[*tensor].name;
                return Err(Flaw::malformed(format!("nothing computes the output {name:?}")));
            }
        }
        for tensor in &model.inputs {
            let tensor = &model.tensors[*tensor];
            if tensor.element != Element::F32 || !tensor.data.is_empty() {
                return Err(Flaw::unsupported(format!("the input {:?}", tensor.name)));
            }
        }
        let plan = Self {
            steps,
            shapes: model.tensors.iter().map(|tensor| tensor.shape.clone()).collect(),
            names: model.tensors.iter().map(|tensor| tensor.name.clone()).collect(),
            inputs: model.inputs.clone(),
            outputs: model.outputs.clone(),
        };
        Ok(plan.merged())
    }

    /// Merges a residual sum and a PRELU into the convolution whose only reader they are.
    fn merged(mut self) -> Self {
        let mut readers = vec![0usize; self.shapes.len()];
        for tensor in self.steps.iter().flat_map(|step| &step.inputs).chain(&self.outputs) {
            readers[*tensor] += 1;
        }
        let mut steps: Vec<Step> = Vec::new();
        for step in std::mem::take(&mut self.steps) {
            match merge(steps.last_mut(), step, &readers) {
                Some(unmerged) => steps.push(unmerged),
                None => continue,
            }
        }
        self.steps = steps;
        self
    }
}

/// Tries to let `before` do the work of `step` too; gives `step` back if it cannot.
fn merge(before: Option<&mut Step>, mut step: Step, readers: &[usize]) -> Option<Step> {
    let Some(before) = before else { return Some(step) };
    let place = step.inputs.iter().position(|input| *input == before.output);
    let (Some(place), 1) = (place, readers[before.output]) else { return Some(step) };
    let linear = match &before.op {
        Op::Convolution(convolution) => convolution.is_linear(),
        Op::Depthwise(depthwise) => depthwise.activation == Activation::Linear,
        Op::Add(activation) => *activation == Activation::Linear,
        _ => false,
    };
    if !linear {
        return Some(step);
    }
    match (&mut before.op, &mut step.op) {
        (Op::Convolution(convolution), Op::Prelu(prelu)) => convolution.activate(prelu),
        (Op::Depthwise(Depthwise { activation, .. }) | Op::Add(activation), Op::Prelu(prelu)) => {
            std::mem::swap(activation, prelu);
        }
        (Op::Convolution(convolution), Op::Add(after)) if before.inputs.len() == 1 => {
            convolution.activate(after);
            before.inputs.push(step.inputs[1 - place]);
        }
        _ => return Some(step),
    }
    before.output = step.output;
    None
}
