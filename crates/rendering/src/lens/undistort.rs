use super::Lens;
use crate::{DepthImage, Intrinsics, RgbImage};

/// Takes the distortion out of images of one camera; the pixel map is computed once.
///
/// The images keep size, focal lengths and principal point: the result is what a pinhole camera of the
/// same intrinsics sees, black and without depth where the lens did not look.
#[derive(Debug, Clone)]
pub struct Undistorter {
    intrinsics: Intrinsics,
    lens: Lens,
    /// Source pixel of every pixel; NaN where there is none.
    map: Vec<[f32; 2]>,
}

impl Undistorter {
    /// For images of a camera with these intrinsics behind this lens.
    pub fn new(intrinsics: Intrinsics, lens: Lens) -> Self {
        let mut map = Vec::with_capacity(intrinsics.width as usize * intrinsics.height as usize);
        for v in 0..intrinsics.height {
            for u in 0..intrinsics.width {
                let ray = intrinsics.ray(f64::from(u), f64::from(v));
                let source = lens
                    .distort(ray.x, ray.y)
                    .map(|(x, y)| {
                        (intrinsics.fx * x + intrinsics.cx, intrinsics.fy * y + intrinsics.cy)
                    })
                    .filter(|(x, y)| intrinsics.contains(*x, *y));
                map.push(source.map_or([f32::NAN; 2], |(x, y)| [x as f32, y as f32]));
            }
        }
        Self { intrinsics, lens, map }
    }

    /// The camera of the results, and of what goes in but for the lens.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The lens.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Colour between the four nearest pixels. An image of another size comes back as it is, so that
    /// whoever checks sizes can name it.
    pub fn color(&self, image: &RgbImage) -> RgbImage {
        if image.dimensions() != (self.intrinsics.width, self.intrinsics.height) {
            return image.clone();
        }
        let raw = image.as_raw();
        let mut out = RgbImage::new(self.intrinsics.width, self.intrinsics.height);
        for (pixel, source) in out.as_mut().chunks_exact_mut(3).zip(&self.map) {
            let Some(Nearest { four, fx, fy }) = self.nearest(*source) else { continue };
            for (k, p) in pixel.iter_mut().enumerate() {
                *p = (between(four.map(|i| f32::from(raw[3 * i + k])), fx, fy) + 0.5) as u8;
            }
        }
        out
    }

    /// Depth along the optical axis, which the lens does not change: between the four nearest readings
    /// where they are one surface, else the nearest reading, so that no edge is smeared.
    pub fn depth(&self, image: &DepthImage) -> DepthImage {
        if (image.width, image.height) != (self.intrinsics.width, self.intrinsics.height)
            || image.data.len() != self.map.len()
        {
            return image.clone();
        }
        let mut out = DepthImage::new(self.intrinsics.width, self.intrinsics.height);
        for (z, source) in out.data.iter_mut().zip(&self.map) {
            let Some(Nearest { four, fx, fy }) = self.nearest(*source) else { continue };
            let four = four.map(|i| image.data[i]);
            let near = four[usize::from(fx > 0.5) + 2 * usize::from(fy > 0.5)];
            let one_surface = near > 0.0 && four.iter().all(|d| (d - near).abs() < 0.01 * near);
            *z = if one_surface { between(four, fx, fy) } else { near };
        }
        out
    }

    /// The pixels about a place of the image; none about NaN.
    fn nearest(&self, [x, y]: [f32; 2]) -> Option<Nearest> {
        if x.is_nan() {
            return None;
        }
        let (w, h) = (self.intrinsics.width as usize, self.intrinsics.height as usize);
        let (x, y) = (x.clamp(0.0, (w - 1) as f32), y.clamp(0.0, (h - 1) as f32));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
        let four = [y0 * w + x0, y0 * w + x1, y1 * w + x0, y1 * w + x1];
        Some(Nearest { four, fx: x - x0 as f32, fy: y - y0 as f32 })
    }
}

/// The four pixels about a place, row by row, and the parts of a pixel from the first one to it.
struct Nearest {
    four: [usize; 4],
    fx: f32,
    fy: f32,
}

/// The value between four, row by row.
fn between(four: [f32; 4], fx: f32, fy: f32) -> f32 {
    let top = four[0] + fx * (four[1] - four[0]);
    let bottom = four[2] + fx * (four[3] - four[2]);
    top + fy * (bottom - top)
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: Intrinsics =
        Intrinsics { width: 320, height: 240, fx: 250.0, fy: 252.0, cx: 161.0, cy: 118.0 };

    /// What the pinhole sees at a pixel: soft stripes and a tilted plane.
    fn scene(u: f64, v: f64) -> ([u8; 3], f32) {
        let c = [128.0 + 90.0 * (u / 9.0).sin(), 128.0 + 90.0 * (v / 11.0).cos(), 60.0 + u / 4.0];
        (c.map(|v| v.clamp(0.0, 255.0) as u8), (0.8 + 0.0006 * u + 0.0004 * v) as f32)
    }

    #[test]
    fn a_distorted_view_becomes_the_pinholes_view() {
        for (model, d) in super::super::tests::LENSES {
            let lens = Lens::from_coefficients(model, d).unwrap();
            let (mut color, mut depth) = (RgbImage::new(320, 240), DepthImage::new(320, 240));
            for v in 0..240 {
                for u in 0..320 {
                    let (x, y) = ((f64::from(u) - K.cx) / K.fx, (f64::from(v) - K.cy) / K.fy);
                    let Some((x, y)) = lens.undistort(x, y) else { continue };
                    let (c, z) = scene(K.fx * x + K.cx, K.fy * y + K.cy);
                    color.put_pixel(u, v, image::Rgb(c));
                    depth.data[(v * 320 + u) as usize] = z;
                }
            }
            let un = Undistorter::new(K, lens);
            let (flat, z) = (un.color(&color), un.depth(&depth));
            let (mut seen, mut worst, mut off) = (0, 0.0_f32, 0_u32);
            for v in 20..220_u32 {
                for u in 20..300_u32 {
                    let have = z.data[(v * 320 + u) as usize];
                    if have == 0.0 {
                        continue;
                    }
                    let (c, want) = scene(f64::from(u), f64::from(v));
                    seen += 1;
                    worst = worst.max((have - want).abs());
                    let p = flat.get_pixel(u, v).0;
                    off = off.max((0..3).map(|k| u32::from(p[k].abs_diff(c[k]))).max().unwrap());
                }
            }
            assert!(seen > 45_000, "{model}: {seen}");
            assert!(worst < 5e-4 && off <= 5, "{model}: depth off {worst}, colour off {off}");
        }
    }

    #[test]
    fn edges_are_not_smeared_and_other_sizes_pass_by() {
        let lens = Lens::from_coefficients("plumb_bob", &[-0.2, 0.05, 0.0, 0.0, 0.0]).unwrap();
        let un = Undistorter::new(K, lens);
        let mut step = DepthImage::new(320, 240);
        for (i, z) in step.data.iter_mut().enumerate() {
            *z = if i % 320 < 100 { 0.5 } else { 1.0 };
        }
        assert!(un.depth(&step).data.iter().all(|z| [0.0, 0.5, 1.0].contains(z)));
        let small = DepthImage::new(16, 12);
        assert_eq!(un.depth(&small), small);
    }
}
