//! The arithmetic: f32, NHWC, one thread. Sizes were checked when the plan was made.

use super::window::Window;

/// What follows an operator's sum, element by element.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Activation {
    Linear,
    Relu,
    Relu6,
    /// Negative values are multiplied by their channel's factor.
    Prelu(Vec<f32>),
}

impl Activation {
    /// `values` += `bias` (+ `residual`), then the activation; `channels` values per pixel.
    fn finish(&self, values: &mut [f32], bias: &[f32], residual: Option<&[f32]>) {
        if let Some(residual) = residual {
            add_in_place(values, residual);
        }
        for pixel in values.chunks_exact_mut(bias.len()) {
            match self {
                Self::Linear => pixel.iter_mut().zip(bias).for_each(|(v, b)| *v += b),
                Self::Relu => pixel.iter_mut().zip(bias).for_each(|(v, b)| *v = (*v + b).max(0.0)),
                Self::Relu6 => {
                    pixel.iter_mut().zip(bias).for_each(|(v, b)| *v = (*v + b).clamp(0.0, 6.0));
                }
                Self::Prelu(slopes) => {
                    for ((value, bias), slope) in pixel.iter_mut().zip(bias).zip(slopes) {
                        let sum = *value + bias;
                        *value = if sum >= 0.0 { sum } else { sum * slope };
                    }
                }
            }
        }
    }

    /// The activation alone.
    pub(super) fn apply(&self, values: &mut [f32]) {
        match self {
            Self::Linear => {}
            Self::Relu => values.iter_mut().for_each(|v| *v = v.max(0.0)),
            Self::Relu6 => values.iter_mut().for_each(|v| *v = v.clamp(0.0, 6.0)),
            Self::Prelu(slopes) => {
                for pixel in values.chunks_exact_mut(slopes.len()) {
                    for (value, slope) in pixel.iter_mut().zip(slopes) {
                        *value = if *value >= 0.0 { *value } else { *value * slope };
                    }
                }
            }
        }
    }
}

pub(super) fn add_in_place(values: &mut [f32], other: &[f32]) {
    values.iter_mut().zip(other).for_each(|(a, b)| *a += b);
}

/// `out` (m x n) = `a` (m x k) * `b`^T, where `b` is (n x k); all row-major.
fn product(out: &mut [f32], a: &[f32], b: &[f32], m: usize, n: usize, k: usize) {
    assert!(out.len() >= m * n && a.len() >= m * k && b.len() >= n * k);
    // SAFETY: the assertion above guarantees that every element addressed by these sizes and
    // strides lies within the three slices; `out` is borrowed mutably, so they do not overlap.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            n as isize,
            false,
            a.as_ptr(),
            1,
            k as isize,
            b.as_ptr(),
            k as isize,
            1,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// Pixels handled at a time, so that a block is still in the cache when bias and activation follow.
fn block(channels: usize) -> usize {
    (16_384 / channels.max(1)).max(96)
}

/// Convolution. `weights` is (out channel, kernel row, kernel column, in channel) as stored.
pub(super) struct Convolution {
    pub window: Window,
    pub in_channels: usize,
    pub weights: Vec<f32>,
    pub bias: Vec<f32>,
    pub activation: Activation,
}

impl Convolution {
    /// `residual`, of the output's size, is added before the activation. `scratch` grows as needed.
    pub(super) fn run(
        &self,
        input: &[f32],
        residual: Option<&[f32]>,
        output: &mut [f32],
        scratch: &mut Vec<f32>,
    ) {
        let window = &self.window;
        let channels = self.bias.len();
        let patch = window.kernel_h * window.kernel_w * self.in_channels;
        let pixels = window.out_h * window.out_w;
        let block = block(channels);
        for first in (0..pixels).step_by(block) {
            let count = block.min(pixels - first);
            let out = &mut output[first * channels..(first + count) * channels];
            if window.is_pointwise() {
                let rows = &input[first * patch..(first + count) * patch];
                product(out, rows, &self.weights, count, channels, patch);
            } else {
                scratch.clear();
                scratch.resize(count * patch, 0.0);
                for (row, pixel) in scratch.chunks_exact_mut(patch).zip(first..) {
                    self.gather(input, pixel, row);
                }
                product(out, scratch, &self.weights, count, channels, patch);
            }
            let residual = residual.map(|all| &all[first * channels..(first + count) * channels]);
            self.activation.finish(out, &self.bias, residual);
        }
    }

    /// Copies the input patch of one output pixel; padding stays zero.
    fn gather(&self, input: &[f32], pixel: usize, row: &mut [f32]) {
        let window = &self.window;
        let (y, x) = (pixel / window.out_w, pixel % window.out_w);
        let columns = window.columns(x);
        let image_x = x * window.stride_w + columns.start - window.pad_left;
        let length = columns.len() * self.in_channels;
        for ky in window.rows(y) {
            let image_y = y * window.stride_h + ky - window.pad_top;
            let from = (image_y * window.in_w + image_x) * self.in_channels;
            let to = (ky * window.kernel_w + columns.start) * self.in_channels;
            row[to..to + length].copy_from_slice(&input[from..from + length]);
        }
    }
}

/// Depthwise convolution with one filter per channel; `weights` is (row, column, channel).
pub(super) struct Depthwise {
    pub window: Window,
    pub weights: Vec<f32>,
    pub bias: Vec<f32>,
    pub activation: Activation,
}

impl Depthwise {
    pub(super) fn run(&self, input: &[f32], output: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the processor has just been asked for both features.
            unsafe { self.sum_avx2(input, output) };
            self.activation.apply(output);
            return;
        }
        self.sum::<false>(input, output);
        self.activation.apply(output);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn sum_avx2(&self, input: &[f32], output: &mut [f32]) {
        self.sum::<true>(input, output);
    }

    #[inline(always)]
    fn sum<const FMA: bool>(&self, input: &[f32], output: &mut [f32]) {
        let window = &self.window;
        let channels = self.bias.len();
        for (pixel, out) in output.chunks_exact_mut(channels).enumerate() {
            let (y, x) = (pixel / window.out_w, pixel % window.out_w);
            let mut first = 0;
            while first + 32 <= channels {
                self.lane::<FMA, 32>(input, (y, x), first, out);
                first += 32;
            }
            while first + 8 <= channels {
                self.lane::<FMA, 8>(input, (y, x), first, out);
                first += 8;
            }
            while first < channels {
                self.lane::<FMA, 1>(input, (y, x), first, out);
                first += 1;
            }
        }
    }

    /// `LANES` channels of one pixel, summed in registers.
    #[inline(always)]
    fn lane<const FMA: bool, const LANES: usize>(
        &self,
        input: &[f32],
        (y, x): (usize, usize),
        first: usize,
        out: &mut [f32],
    ) {
        let window = &self.window;
        let channels = self.bias.len();
        let columns = window.columns(x);
        let mut sum = [0.0f32; LANES];
        sum.copy_from_slice(&self.bias[first..first + LANES]);
        for ky in window.rows(y) {
            let image_y = y * window.stride_h + ky - window.pad_top;
            let image_x = x * window.stride_w + columns.start - window.pad_left;
            let from = (image_y * window.in_w + image_x) * channels;
            let tap = (ky * window.kernel_w + columns.start) * channels;
            let length = columns.len() * channels;
            let pixels = input[from..from + length].chunks_exact(channels);
            let taps = self.weights[tap..tap + length].chunks_exact(channels);
            for (pixel, tap) in pixels.zip(taps) {
                let (pixel, tap) = (&pixel[first..first + LANES], &tap[first..first + LANES]);
                for lane in 0..LANES {
                    sum[lane] = if FMA {
                        pixel[lane].mul_add(tap[lane], sum[lane])
                    } else {
                        pixel[lane] * tap[lane] + sum[lane]
                    };
                }
            }
        }
        out[first..first + LANES].copy_from_slice(&sum);
    }
}

/// Maximum over each window.
pub(super) fn max_pool(window: &Window, channels: usize, input: &[f32], output: &mut [f32]) {
    for (pixel, out) in output.chunks_exact_mut(channels).enumerate() {
        let (y, x) = (pixel / window.out_w, pixel % window.out_w);
        out.fill(f32::NEG_INFINITY);
        for ky in window.rows(y) {
            let image_y = y * window.stride_h + ky - window.pad_top;
            for kx in window.columns(x) {
                let image_x = x * window.stride_w + kx - window.pad_left;
                let from = (image_y * window.in_w + image_x) * channels;
                let pixel = &input[from..from + channels];
                out.iter_mut().zip(pixel).for_each(|(a, b)| *a = a.max(*b));
            }
        }
    }
}

/// Sizes (height, width, channels) of an image.
pub(super) type Size = (usize, usize, usize);

/// Zero padding; `before` is (rows, columns, channels) put before the image.
pub(super) fn pad(from: Size, to: Size, before: Size, input: &[f32], output: &mut [f32]) {
    output.fill(0.0);
    for y in 0..from.0 {
        for x in 0..from.1 {
            let source = (y * from.1 + x) * from.2;
            let target = ((y + before.0) * to.1 + x + before.1) * to.2 + before.2;
            output[target..target + from.2].copy_from_slice(&input[source..source + from.2]);
        }
    }
}

/// Which source positions stand for the output's, in TFLite's three conventions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sampling {
    /// Corner pixels coincide.
    AlignCorners,
    /// Pixel areas coincide.
    HalfPixel,
    /// Upper left corners of the first pixels coincide.
    Legacy,
}

impl Sampling {
    /// Lower and upper source index and the upper one's weight for output index `i`.
    fn at(self, i: usize, from: usize, to: usize) -> (usize, usize, f32) {
        let scale = match self {
            Self::AlignCorners if to > 1 => (from - 1) as f32 / (to - 1) as f32,
            _ => from as f32 / to as f32,
        };
        let position = match self {
            Self::HalfPixel => ((i as f32 + 0.5) * scale - 0.5).max(0.0),
            _ => i as f32 * scale,
        };
        let low = (position as usize).min(from - 1);
        (low, (low + 1).min(from - 1), position - low as f32)
    }
}

/// Bilinear resampling.
pub(super) fn resize(from: Size, to: Size, sampling: Sampling, input: &[f32], output: &mut [f32]) {
    let channels = from.2;
    for (pixel, out) in output.chunks_exact_mut(channels).enumerate() {
        let (y0, y1, v) = sampling.at(pixel / to.1, from.0, to.0);
        let (x0, x1, u) = sampling.at(pixel % to.1, from.1, to.1);
        let at = |y: usize, x: usize| &input[(y * from.1 + x) * channels..][..channels];
        let (a, b, c, d) = (at(y0, x0), at(y0, x1), at(y1, x0), at(y1, x1));
        for (i, out) in out.iter_mut().enumerate() {
            let top = a[i] + (b[i] - a[i]) * u;
            let bottom = c[i] + (d[i] - c[i]) * u;
            *out = top + (bottom - top) * v;
        }
    }
}

/// `output` = `weights` (rows x inputs) * `input` + `bias`, for each of the input's rows.
pub(super) fn fully_connected(weights: &[f32], bias: &[f32], input: &[f32], output: &mut [f32]) {
    let (n, k) = (bias.len(), weights.len() / bias.len());
    product(output, input, weights, input.len() / k, n, k);
    Activation::Linear.finish(output, bias, None);
}

/// Logistic function, stable for large arguments of either sign.
pub(super) fn logistic(x: f32) -> f32 {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// Mean over the pixels of an image, channel by channel.
pub(super) fn mean(channels: usize, input: &[f32], output: &mut [f32]) {
    output.fill(0.0);
    for pixel in input.chunks_exact(channels) {
        add_in_place(output, pixel);
    }
    let scale = channels as f32 / input.len() as f32;
    output.iter_mut().for_each(|value| *value *= scale);
}
