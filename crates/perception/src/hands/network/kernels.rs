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
    /// Applies it in place; values are (pixel, channel).
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

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 7919) % 1009) as f32 / 504.5 - 1.0).collect()
    }

    #[test]
    fn depthwise_equals_the_definition() {
        for (channels, kernel, stride) in [(45, 5, 1), (24, 3, 2), (3, 2, 1)] {
            let window = Window::new((9, 7), (kernel, kernel), (stride, stride), true).unwrap();
            let (input, weights) = (numbers(63 * channels), numbers(kernel * kernel * channels));
            let mut expected = Vec::new();
            for pixel in 0..window.out_h * window.out_w {
                let (y, x) = (pixel / window.out_w, pixel % window.out_w);
                for c in 0..channels {
                    let mut sum = 0.5;
                    for ky in window.rows(y) {
                        for kx in window.columns(x) {
                            let iy = y * stride + ky - window.pad_top;
                            let ix = x * stride + kx - window.pad_left;
                            sum += input[(iy * 7 + ix) * channels + c]
                                * weights[(ky * kernel + kx) * channels + c];
                        }
                    }
                    expected.push(sum);
                }
            }
            let bias = vec![0.5; channels];
            let layer = Depthwise { window, weights, bias, activation: Activation::Linear };
            let (mut output, mut portable) = (vec![0.0; expected.len()], vec![0.0; expected.len()]);
            layer.run(&input, &mut output);
            layer.sum::<false>(&input, &mut portable);
            for ((a, b), expected) in output.iter().zip(&portable).zip(&expected) {
                assert!((a - expected).abs() < 1e-4 && (b - expected).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn pooling_padding_mean_and_logistic() {
        let image = [1.0, 10.0, 5.0, 20.0, 3.0, 0.0, 4.0, -1.0];
        let window = Window::new((2, 2), (2, 2), (2, 2), true).unwrap();
        let mut out = [0.0; 2];
        max_pool(&window, 2, &image, &mut out);
        assert_eq!(out, [5.0, 20.0]);
        mean(2, &image, &mut out);
        assert_eq!(out, [3.25, 7.25]);
        let mut padded = [9.0; 9];
        pad((1, 2, 1), (3, 3, 1), (1, 0, 0), &[1.0, 2.0], &mut padded);
        assert_eq!(padded, [0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(logistic(0.0), 0.5);
        assert!(logistic(-200.0) >= 0.0 && logistic(200.0) <= 1.0);
    }

    #[test]
    fn the_three_ways_to_resample() {
        let line = |sampling| {
            let mut out = [0.0; 4];
            resize((1, 2, 1), (1, 4, 1), sampling, &[0.0, 1.0], &mut out);
            out
        };
        assert_eq!(line(Sampling::Legacy), [0.0, 0.5, 1.0, 1.0]);
        assert_eq!(line(Sampling::HalfPixel), [0.0, 0.25, 0.75, 1.0]);
        let corners = line(Sampling::AlignCorners);
        assert!((corners[1] - 1.0 / 3.0).abs() < 1e-6 && corners[3] == 1.0);
    }
}
