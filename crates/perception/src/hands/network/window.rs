//! The geometry of a sliding window over an NHWC image: convolution, depthwise, pooling.

use super::error::Flaw;

/// How a kernel moves over an image. Checked once, so that the kernels may index freely.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub in_h: usize,
    pub in_w: usize,
    pub out_h: usize,
    pub out_w: usize,
    pub kernel_h: usize,
    pub kernel_w: usize,
    pub stride_h: usize,
    pub stride_w: usize,
    pub pad_top: usize,
    pub pad_left: usize,
}

/// Output size and padding before the first element along one axis.
fn axis(input: usize, kernel: usize, stride: usize, same: bool) -> Result<(usize, usize), Flaw> {
    if kernel == 0 || stride == 0 || input == 0 {
        return Err(Flaw::malformed("a window with a size or a stride of zero"));
    }
    if same {
        let output = input.div_ceil(stride);
        let padding = ((output - 1) * stride + kernel).saturating_sub(input);
        Ok((output, padding / 2))
    } else if kernel > input {
        Err(Flaw::malformed(format!("a window of {kernel} over {input} elements")))
    } else {
        Ok(((input - kernel) / stride + 1, 0))
    }
}

impl Window {
    /// `image` and `kernel` are (height, width); `same` chooses TFLite's SAME padding over VALID.
    pub(super) fn new(
        image: (usize, usize),
        kernel: (usize, usize),
        stride: (usize, usize),
        same: bool,
    ) -> Result<Self, Flaw> {
        let (out_h, pad_top) = axis(image.0, kernel.0, stride.0, same)?;
        let (out_w, pad_left) = axis(image.1, kernel.1, stride.1, same)?;
        Ok(Self {
            in_h: image.0,
            in_w: image.1,
            out_h,
            out_w,
            kernel_h: kernel.0,
            kernel_w: kernel.1,
            stride_h: stride.0,
            stride_w: stride.1,
            pad_top,
            pad_left,
        })
    }

    /// Kernel rows that lie inside the image for output row `y`, and the image row of kernel row 0
    /// shifted by the padding (so that image row = start + kernel row - pad_top).
    pub(super) fn rows(&self, y: usize) -> std::ops::Range<usize> {
        inside(y * self.stride_h, self.pad_top, self.kernel_h, self.in_h)
    }

    /// The same along x.
    pub(super) fn columns(&self, x: usize) -> std::ops::Range<usize> {
        inside(x * self.stride_w, self.pad_left, self.kernel_w, self.in_w)
    }

    /// Whether the window is a single pixel moved by one: a plain matrix product.
    pub(super) fn is_pointwise(&self) -> bool {
        (self.kernel_h, self.kernel_w, self.stride_h, self.stride_w) == (1, 1, 1, 1)
    }
}

fn inside(start: usize, pad: usize, kernel: usize, size: usize) -> std::ops::Range<usize> {
    pad.saturating_sub(start)..kernel.min((size + pad).saturating_sub(start))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_padding_puts_the_odd_pixel_behind() {
        let window = Window::new((192, 192), (5, 5), (2, 2), true).unwrap();
        assert_eq!((window.out_h, window.pad_top), (96, 1));
        assert_eq!(window.rows(0), 1..5);
        assert_eq!(window.rows(95), 0..3);
        let window = Window::new((224, 224), (3, 3), (2, 2), true).unwrap();
        assert_eq!((window.out_w, window.pad_left), (112, 0));
        assert_eq!(window.columns(111), 0..2);
    }

    #[test]
    fn valid_padding_stays_inside() {
        let window = Window::new((5, 7), (2, 3), (2, 2), false).unwrap();
        assert_eq!((window.out_h, window.out_w), (2, 3));
        assert_eq!(window.columns(2), 0..3);
        assert!(Window::new((2, 2), (3, 3), (1, 1), false).is_err());
        assert!(Window::new((2, 2), (1, 1), (0, 1), true).is_err());
    }
}
