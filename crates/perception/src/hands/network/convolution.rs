//! Convolution as a matrix product, with weights packed once at load time.
//!
//! The output is computed in tiles of [`ROWS`] pixels x [`LANES`] channels that stay in vector
//! registers; bias, residual and activation are applied before a tile is stored.

use super::kernels::Activation;
use super::window::Window;

/// Channels of a tile: two AVX registers.
const LANES: usize = 16;
/// Pixels of a tile: with two registers each, what sixteen registers hold beside the operands.
const ROWS: usize = 6;
/// Tiles that are packed together: as many as stay in the second-level cache.
const TILES: usize = 24;

/// Working memory, kept from one run to the next.
pub(super) type Scratch = Vec<[f32; ROWS]>;

/// A convolution (or, with a window of one pixel, a fully connected layer).
pub(super) struct Convolution {
    window: Window,
    in_channels: usize,
    channels: usize,
    /// For each group of [`LANES`] output channels and each value of the patch, the weights of the
    /// group; missing channels are zero.
    weights: Vec<[f32; LANES]>,
    bias: Vec<[f32; LANES]>,
    after: After,
}

/// What follows the sum.
enum After {
    Linear,
    Relu,
    Relu6,
    Prelu(Vec<[f32; LANES]>),
}

/// Splits a list into groups of [`LANES`], the last one filled up with zeros.
fn grouped(values: &[f32]) -> Vec<[f32; LANES]> {
    let group = |part: &[f32]| std::array::from_fn(|i| part.get(i).copied().unwrap_or(0.0));
    values.chunks(LANES).map(group).collect()
}

impl Convolution {
    /// `weights` is (out channel, kernel row, kernel column, in channel) as the file stores it; the
    /// number of output channels is the length of `bias`.
    pub(super) fn new(
        window: Window,
        in_channels: usize,
        weights: &[f32],
        bias: &[f32],
        activation: &Activation,
    ) -> Self {
        let patch = window.kernel_h * window.kernel_w * in_channels;
        let rows: Vec<&[f32]> = weights.chunks_exact(patch).collect();
        let packed = rows
            .chunks(LANES)
            .flat_map(|group| {
                (0..patch).map(move |p| {
                    std::array::from_fn(|lane| group.get(lane).map_or(0.0, |row| row[p]))
                })
            })
            .collect();
        let mut convolution = Self {
            window,
            in_channels,
            channels: bias.len(),
            weights: packed,
            bias: grouped(bias),
            after: After::Linear,
        };
        convolution.activate(activation);
        convolution
    }

    /// Replaces the activation.
    pub(super) fn activate(&mut self, activation: &Activation) {
        self.after = match activation {
            Activation::Linear => After::Linear,
            Activation::Relu => After::Relu,
            Activation::Relu6 => After::Relu6,
            Activation::Prelu(slopes) => After::Prelu(grouped(slopes)),
        };
    }

    pub(super) fn is_linear(&self) -> bool {
        matches!(self.after, After::Linear)
    }

    /// `residual`, of the output's size, is added before the activation. `scratch` grows as needed.
    pub(super) fn run(
        &self,
        input: &[f32],
        residual: Option<&[f32]>,
        output: &mut [f32],
        scratch: &mut Scratch,
    ) {
        let patch = self.patch();
        let block = ROWS * TILES;
        scratch.resize(TILES * patch, [0.0; ROWS]);
        let pixels = output.len() / self.channels;
        for first in (0..pixels).step_by(block) {
            let count = block.min(pixels - first);
            for (tile, packed) in scratch.chunks_exact_mut(patch).enumerate() {
                let from = first + tile * ROWS;
                if from < first + count {
                    self.pack(input, from..(from + ROWS).min(first + count), packed);
                }
            }
            let range = first * self.channels..(first + count) * self.channels;
            let residual = residual.map(|all| &all[range.clone()]);
            self.multiply(scratch, residual, &mut output[range]);
        }
    }

    fn patch(&self) -> usize {
        self.window.kernel_h * self.window.kernel_w * self.in_channels
    }

    /// Puts the patches of up to [`ROWS`] output pixels side by side.
    fn pack(&self, input: &[f32], pixels: std::ops::Range<usize>, packed: &mut [[f32; ROWS]]) {
        let window = &self.window;
        let pointwise = window.is_pointwise();
        if !pointwise {
            packed.fill([0.0; ROWS]);
        }
        for (row, pixel) in pixels.enumerate() {
            if pointwise {
                let values = &input[pixel * self.in_channels..(pixel + 1) * self.in_channels];
                packed.iter_mut().zip(values).for_each(|(to, value)| to[row] = *value);
                continue;
            }
            let (y, x) = (pixel / window.out_w, pixel % window.out_w);
            let columns = window.columns(x);
            let image_x = x * window.stride_w + columns.start - window.pad_left;
            let length = columns.len() * self.in_channels;
            for ky in window.rows(y) {
                let image_y = y * window.stride_h + ky - window.pad_top;
                let from = (image_y * window.in_w + image_x) * self.in_channels;
                let to = (ky * window.kernel_w + columns.start) * self.in_channels;
                let values = &input[from..from + length];
                let packed = packed[to..to + length].iter_mut().zip(values);
                packed.for_each(|(to, value)| to[row] = *value);
            }
        }
    }

    fn multiply(&self, packed: &[[f32; ROWS]], residual: Option<&[f32]>, output: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the processor has just been asked for both features.
            unsafe { self.multiply_avx2(packed, residual, output) };
            return;
        }
        self.tiles(packed, residual, output, product);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn multiply_avx2(&self, packed: &[[f32; ROWS]], residual: Option<&[f32]>, output: &mut [f32]) {
        self.tiles(packed, residual, output, |packed, weights, bias| {
            product_avx2(packed, weights, bias)
        });
    }

    /// `product` computes one tile.
    #[inline(always)]
    fn tiles(
        &self,
        packed: &[[f32; ROWS]],
        residual: Option<&[f32]>,
        output: &mut [f32],
        product: impl Fn(&[[f32; ROWS]], &[[f32; LANES]], &[f32; LANES]) -> [[f32; LANES]; ROWS],
    ) {
        let patch = self.patch();
        let groups = self.weights.chunks_exact(patch).zip(&self.bias).enumerate();
        for (group, (weights, bias)) in groups {
            let first = group * LANES;
            let lanes = LANES.min(self.channels - first);
            let rows = output.chunks_mut(ROWS * self.channels);
            for (tile, (rows, packed)) in rows.zip(packed.chunks_exact(patch)).enumerate() {
                let mut sum = product(packed, weights, bias);
                let start = tile * ROWS * self.channels + first;
                for (row, (out, sum)) in
                    rows.chunks_exact_mut(self.channels).zip(&mut sum).enumerate()
                {
                    if let Some(residual) = residual {
                        let residual = &residual[start + row * self.channels..][..lanes];
                        sum.iter_mut().zip(residual).for_each(|(sum, value)| *sum += value);
                    }
                    self.after.apply(group, sum);
                    if lanes == LANES {
                        // A length known to the compiler: two stores instead of a call.
                        out[first..first + LANES].copy_from_slice(sum);
                    } else {
                        out[first..first + lanes].copy_from_slice(&sum[..lanes]);
                    }
                }
            }
        }
    }
}

impl After {
    #[inline(always)]
    fn apply(&self, group: usize, sum: &mut [f32; LANES]) {
        match self {
            Self::Linear => {}
            Self::Relu => sum.iter_mut().for_each(|v| *v = v.max(0.0)),
            Self::Relu6 => sum.iter_mut().for_each(|v| *v = v.clamp(0.0, 6.0)),
            Self::Prelu(slopes) => {
                for (value, slope) in sum.iter_mut().zip(&slopes[group]) {
                    *value = if *value >= 0.0 { *value } else { *value * slope };
                }
            }
        }
    }
}

/// One tile: for each of its pixels `bias` + sum over the patch of value * weights.
#[inline(always)]
fn product(
    packed: &[[f32; ROWS]],
    weights: &[[f32; LANES]],
    bias: &[f32; LANES],
) -> [[f32; LANES]; ROWS] {
    let mut sum = [*bias; ROWS];
    for (values, weights) in packed.iter().zip(weights) {
        for (sum, value) in sum.iter_mut().zip(values) {
            sum.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
        }
    }
    sum
}

/// The same with twelve AVX registers for the sums. Written out because the compiler does not keep
/// the portable form in registers.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
#[inline]
fn product_avx2(
    packed: &[[f32; ROWS]],
    weights: &[[f32; LANES]],
    bias: &[f32; LANES],
) -> [[f32; LANES]; ROWS] {
    use std::arch::x86_64::_mm256_storeu_ps;
    use std::arch::x86_64::{__m256, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_set1_ps};
    let halves = |values: &[f32; LANES]| -> [__m256; 2] {
        // SAFETY: unaligned loads of elements 0..8 and 8..16 of an array of 16.
        unsafe { [_mm256_loadu_ps(values.as_ptr()), _mm256_loadu_ps(values.as_ptr().add(8))] }
    };
    let mut sum = [halves(bias); ROWS];
    for (values, weights) in packed.iter().zip(weights) {
        let [low, high] = halves(weights);
        for (sum, value) in sum.iter_mut().zip(values) {
            let value = _mm256_set1_ps(*value);
            sum[0] = _mm256_fmadd_ps(value, low, sum[0]);
            sum[1] = _mm256_fmadd_ps(value, high, sum[1]);
        }
    }
    let mut out = [[0.0; LANES]; ROWS];
    for (out, [low, high]) in out.iter_mut().zip(sum) {
        // SAFETY: unaligned stores to elements 0..8 and 8..16 of an array of 16.
        unsafe {
            _mm256_storeu_ps(out.as_mut_ptr(), low);
            _mm256_storeu_ps(out.as_mut_ptr().add(8), high);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition, written down directly.
    fn reference(
        window: &Window,
        inc: usize,
        weights: &[f32],
        bias: &[f32],
        x: &[f32],
    ) -> Vec<f32> {
        let mut out = Vec::new();
        for pixel in 0..window.out_h * window.out_w {
            let (y, x0) = (pixel / window.out_w, pixel % window.out_w);
            for (channel, bias) in bias.iter().enumerate() {
                let mut sum = f64::from(*bias);
                for ky in window.rows(y) {
                    for kx in window.columns(x0) {
                        for c in 0..inc {
                            let iy = y * window.stride_h + ky - window.pad_top;
                            let ix = x0 * window.stride_w + kx - window.pad_left;
                            let w = ((channel * window.kernel_h + ky) * window.kernel_w + kx) * inc;
                            sum += f64::from(weights[w + c])
                                * f64::from(x[(iy * window.in_w + ix) * inc + c]);
                        }
                    }
                }
                out.push(sum as f32);
            }
        }
        out
    }

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 7919 + seed * 104_729) % 1009) as f32 / 504.5 - 1.0).collect()
    }

    #[test]
    fn it_equals_the_definition_for_awkward_sizes() {
        for (image, kernel, stride, same, inc, outc) in [
            ((7, 9), (3, 3), (2, 2), true, 3, 5),
            ((13, 5), (1, 1), (1, 1), true, 17, 33),
            ((6, 6), (2, 3), (1, 2), false, 4, 16),
            ((1, 1), (1, 1), (1, 1), true, 40, 1),
            ((31, 29), (5, 5), (2, 2), true, 3, 32),
        ] {
            let window = Window::new(image, kernel, stride, same).unwrap();
            let weights = numbers(outc * kernel.0 * kernel.1 * inc, 1);
            let (bias, input) = (numbers(outc, 2), numbers(image.0 * image.1 * inc, 3));
            let mut expected = reference(&window, inc, &weights, &bias, &input);
            let residual = numbers(expected.len(), 4);
            let slopes = numbers(outc, 5);
            let layer =
                Convolution::new(window, inc, &weights, &bias, &Activation::Prelu(slopes.clone()));
            let (mut output, mut portable) = (vec![0.0; expected.len()], vec![0.0; expected.len()]);
            let mut scratch = Vec::new();
            layer.run(&input, Some(&residual), &mut output, &mut scratch);
            for (i, (value, residual)) in expected.iter_mut().zip(&residual).enumerate() {
                *value += residual;
                *value = if *value >= 0.0 { *value } else { *value * slopes[i % outc] };
            }
            for (value, expected) in output.iter().zip(&expected) {
                assert!((value - expected).abs() < 1e-4, "{value} {expected} for {image:?}");
            }
            // The path without special instructions, on what fits into one block.
            if expected.len() / outc <= ROWS * TILES {
                layer.tiles(&scratch, Some(&residual), &mut portable, product);
                for (value, expected) in portable.iter().zip(&expected) {
                    assert!((value - expected).abs() < 1e-4, "{value} {expected} for {image:?}");
                }
            }
        }
    }

    #[test]
    fn activations_cut_off() {
        let window = Window::new((1, 3), (1, 1), (1, 1), true).unwrap();
        let input = [-1.0, 2.0, 9.0];
        for (activation, expected) in [
            (Activation::Linear, [-1.0, 2.0, 9.0]),
            (Activation::Relu, [0.0, 2.0, 9.0]),
            (Activation::Relu6, [0.0, 2.0, 6.0]),
        ] {
            let layer = Convolution::new(window.clone(), 1, &[1.0], &[0.0], &activation);
            let mut output = [0.0; 3];
            layer.run(&input, None, &mut output, &mut Vec::new());
            assert_eq!(output, expected);
        }
    }
}
