use std::path::{Path, PathBuf};

use super::convolution::Scratch;
use super::error::{Flaw, NetworkError};
use super::kernels;
use super::model::Model;
use super::plan::{Op, Plan, Step};

/// Most values that the activations of a network may hold together (256 MB).
const MAX_ACTIVATIONS: usize = 1 << 26;

/// A TFLite network, ready to run on the calling thread.
///
/// Not shareable between threads while it runs ([`Network::run`] takes `&mut self`): the buffers
/// are its own. The same input always gives the same bits on the same machine.
pub struct Network {
    path: PathBuf,
    plan: Plan,
    /// Which buffer holds a tensor while it is needed.
    slots: Vec<usize>,
    buffers: Vec<Vec<f32>>,
    scratch: Scratch,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Network {
    /// Reads and checks a `.tflite` file.
    ///
    /// # Errors
    /// [`NetworkError`] if the file cannot be read, is damaged, or holds an operator, type or
    /// shape that this interpreter does not support.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let bytes = std::fs::read(path)
            .map_err(|source| NetworkError::Read { path: path.to_path_buf(), source })?;
        Self::parse(&bytes, path)
    }

    /// The same from memory; `path` is for messages only.
    ///
    /// # Errors
    /// As [`Network::load`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, NetworkError> {
        Self::assemble(bytes, path).map_err(|flaw| flaw.at(path))
    }

    fn assemble(bytes: &[u8], path: &Path) -> Result<Self, Flaw> {
        let plan = Plan::new(&Model::parse(bytes)?)?;
        let (slots, sizes) = assign(&plan);
        if sizes.iter().sum::<usize>() > MAX_ACTIVATIONS {
            return Err(Flaw::unsupported("a network with that large activations"));
        }
        let buffers = sizes.into_iter().map(|size| vec![0.0; size]).collect();
        Ok(Self { path: path.to_path_buf(), plan, slots, buffers, scratch: Vec::new() })
    }

    /// Refuses the network unless it has one input of shape `input` and, among its outputs, each
    /// of `outputs` (name and shape). Gives the outputs' numbers for [`Network::output`].
    ///
    /// # Errors
    /// [`NetworkError::Interface`] naming what differs.
    pub fn expect<const N: usize>(
        &self,
        input: &[usize],
        outputs: [(&str, &[usize]); N],
    ) -> Result<[usize; N], NetworkError> {
        let other = |what| NetworkError::Interface { path: self.path.clone(), what };
        let shapes = self.plan.inputs.iter().map(|tensor| &self.plan.shapes[*tensor][..]);
        let shapes: Vec<&[usize]> = shapes.collect();
        if shapes != [input] {
            return Err(other(format!("its inputs have the shapes {shapes:?} and not {input:?}")));
        }
        let mut found = [0; N];
        for (place, (name, shape)) in found.iter_mut().zip(outputs) {
            *place = self
                .plan
                .outputs
                .iter()
                .position(|tensor| self.plan.names[*tensor] == name)
                .ok_or_else(|| other(format!("it has no output {name:?}")))?;
            let actual = &self.plan.shapes[self.plan.outputs[*place]];
            if actual != shape {
                return Err(other(format!("its output {name:?} has the shape {actual:?}")));
            }
        }
        Ok(found)
    }

    /// The buffer of the first input, to be filled before [`Network::run`]; row-major (NHWC).
    /// Its content is not kept over a run.
    pub fn input_mut(&mut self) -> &mut [f32] {
        let Some(tensor) = self.plan.inputs.first().copied() else { return &mut [] };
        let size = self.plan.shapes[tensor].iter().product();
        &mut self.buffers[self.slots[tensor]][..size]
    }

    /// Output number `index` of the last run; empty if there is no such output.
    #[must_use]
    pub fn output(&self, index: usize) -> &[f32] {
        let Some(tensor) = self.plan.outputs.get(index).copied() else { return &[] };
        &self.buffers[self.slots[tensor]][..self.plan.shapes[tensor].iter().product()]
    }

    /// Runs all operators.
    pub fn run(&mut self) {
        for step in &self.plan.steps {
            // Taken out for the time of the step, so that the inputs can be borrowed beside it.
            let slot = self.slots[step.output];
            let mut output = std::mem::take(&mut self.buffers[slot]);
            let size = self.plan.shapes[step.output].iter().product();
            let inputs = Inputs { plan: &self.plan, slots: &self.slots, buffers: &self.buffers };
            perform(step, &inputs, &mut output[..size], &mut self.scratch);
            self.buffers[slot] = output;
        }
    }
}

struct Inputs<'a> {
    plan: &'a Plan,
    slots: &'a [usize],
    buffers: &'a [Vec<f32>],
}

impl Inputs<'_> {
    fn get(&self, tensor: usize) -> &[f32] {
        &self.buffers[self.slots[tensor]][..self.plan.shapes[tensor].iter().product()]
    }
}

fn perform(step: &Step, inputs: &Inputs<'_>, output: &mut [f32], scratch: &mut Scratch) {
    let first = inputs.get(step.inputs[0]);
    match &step.op {
        Op::Convolution(convolution) => {
            let residual = step.inputs.get(1).map(|tensor| inputs.get(*tensor));
            convolution.run(first, residual, output, scratch);
        }
        Op::Depthwise(depthwise) => depthwise.run(first, output),
        Op::MaxPool { window, channels } => kernels::max_pool(window, *channels, first, output),
        Op::Add(activation) => {
            output.copy_from_slice(first);
            kernels::add_in_place(output, inputs.get(step.inputs[1]));
            activation.apply(output);
        }
        Op::Prelu(activation) => {
            output.copy_from_slice(first);
            activation.apply(output);
        }
        Op::Pad { from, to, before } => kernels::pad(*from, *to, *before, first, output),
        Op::Resize { from, to, sampling } => {
            kernels::resize(*from, *to, *sampling, first, output);
        }
        Op::Logistic => {
            output.iter_mut().zip(first).for_each(|(out, x)| *out = kernels::logistic(*x));
        }
        Op::Mean { channels } => kernels::mean(*channels, first, output),
        Op::Copy => output.copy_from_slice(first),
        Op::Concatenation { inner } => {
            let row: usize = inner.iter().sum();
            let mut before = 0;
            for (tensor, width) in step.inputs.iter().zip(inner) {
                let parts = inputs.get(*tensor).chunks_exact(*width);
                for (out, part) in output.chunks_exact_mut(row).zip(parts) {
                    out[before..before + width].copy_from_slice(part);
                }
                before += width;
            }
        }
    }
}

/// Gives every tensor a buffer; buffers are reused as soon as their last reader is done. The
/// network's outputs keep theirs. Returns the buffer of each tensor and the buffers' sizes.
fn assign(plan: &Plan) -> (Vec<usize>, Vec<usize>) {
    let mut last_read = vec![0; plan.shapes.len()];
    for (i, step) in plan.steps.iter().enumerate() {
        last_read[step.output] = i;
        for tensor in &step.inputs {
            last_read[*tensor] = i;
        }
    }
    for tensor in &plan.outputs {
        last_read[*tensor] = plan.steps.len();
    }
    let mut slots = vec![0; plan.shapes.len()];
    let mut pool = Pool::default();
    let mut live: Vec<usize> = Vec::new();
    for tensor in &plan.inputs {
        slots[*tensor] = pool.take(plan.shapes[*tensor].iter().product());
        live.push(*tensor);
    }
    for (i, step) in plan.steps.iter().enumerate() {
        slots[step.output] = pool.take(plan.shapes[step.output].iter().product());
        live.push(step.output);
        live.retain(|tensor| {
            let dead = last_read[*tensor] <= i;
            if dead {
                pool.free.push(slots[*tensor]);
            }
            !dead
        });
    }
    (slots, pool.sizes)
}

/// Buffers by number: their sizes and which of them are free.
#[derive(Default)]
struct Pool {
    sizes: Vec<usize>,
    free: Vec<usize>,
}

impl Pool {
    /// The smallest free buffer that is large enough, else the largest one made larger, else a new
    /// one.
    fn take(&mut self, size: usize) -> usize {
        self.free.sort_by_key(|slot| self.sizes[*slot]);
        let fitting = self.free.iter().position(|slot| self.sizes[*slot] >= size);
        let slot = match fitting.or(self.free.len().checked_sub(1)) {
            Some(index) => self.free.remove(index),
            None => {
                self.sizes.push(0);
                self.sizes.len() - 1
            }
        };
        self.sizes[slot] = self.sizes[slot].max(size);
        slot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_and_damaged_files_are_named() {
        let error = Network::load(Path::new("/nowhere/palm.tflite")).unwrap_err();
        assert!(error.to_string().contains("/nowhere/palm.tflite"));
        assert!(error.to_string().contains("fetch_hand_models.sh"));
        let error = Network::parse(b"not a network at all", Path::new("x.tflite")).unwrap_err();
        assert!(matches!(error, NetworkError::Malformed { .. }), "{error}");
    }
}
