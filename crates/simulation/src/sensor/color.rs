use super::noise::{Gaussian, Tape, hash, key};
use serde::{Deserialize, Serialize};
use tdv_rendering::RgbImage;

/// Imperfections of the colour image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ColorNoise {
    /// Whether anything is done at all.
    pub enabled: bool,
    /// Weight of each direct neighbour in the lens blur, horizontally and vertically (0..0.33).
    pub blur: f64,
    /// Read noise (grey levels).
    pub read: f64,
    /// Shot noise: variance per grey level.
    pub shot: f64,
    /// Loss of light in the corners (share).
    pub vignette: f64,
    /// Standard deviation of the exposure, fixed for a seed (share).
    pub gain: f64,
    /// Standard deviation of the white balance of red and blue, fixed for a seed (share).
    pub balance: f64,
    /// Standard deviation of the exposure from frame to frame (share).
    pub flicker: f64,
}

impl Default for ColorNoise {
    fn default() -> Self {
        Self {
            enabled: true,
            blur: 0.14,
            read: 1.5,
            shot: 0.03,
            vignette: 0.12,
            gain: 0.05,
            balance: 0.03,
            flicker: 0.004,
        }
    }
}

/// Buffers kept from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    column: Vec<u16>,
    row: Vec<f32>,
    tape: Tape,
}

impl ColorNoise {
    pub(super) fn apply(
        &self,
        exact: &RgbImage,
        (seed, frame): (u64, u64),
        scratch: &mut Scratch,
        out: &mut RgbImage,
    ) {
        if out.dimensions() != exact.dimensions() {
            *out = RgbImage::new(exact.width(), exact.height());
        }
        let (w, h) = (exact.width() as usize, exact.height() as usize);
        if !self.enabled || w == 0 || h == 0 {
            out.copy_from_slice(exact.as_raw());
            return;
        }
        let table = Gaussian::table();
        let draw = |frame: u64, purpose: u32| table.at(key(seed, frame, purpose));
        let exposure = 1.0 + self.gain as f32 * draw(0, 11) + self.flicker as f32 * draw(frame, 14);
        let balance = self.balance as f32;
        let gains = [
            exposure * (1.0 + balance * draw(0, 12)),
            exposure,
            exposure * (1.0 + balance * draw(0, 13)),
        ];
        // Blur in integers: the three weights add up to 256 each way.
        let side = (self.blur.clamp(0.0, 1.0 / 3.0) * 256.0).round() as u16;
        let middle = 256 - 2 * side;
        let stride = 3 * w;
        let source = exact.as_raw();
        scratch.column.resize(stride, 0);
        scratch.row.resize(stride, 0.0);
        let row_key = key(seed, frame, 10);
        let corner = (w as f32 * w as f32 + h as f32 * h as f32) / 4.0;
        let loss = self.vignette as f32 / corner;
        let (read, shot) = ((self.read * self.read) as f32, self.shot as f32);
        // What the columns have in common, channel by channel.
        let gain: Vec<f32> = (0..stride).map(|i| gains[i % 3]).collect();
        let dark: Vec<f32> = (0..stride)
            .map(|i| {
                let dx = (i / 3) as f32 - (w as f32 - 1.0) / 2.0;
                loss * dx * dx
            })
            .collect();
        for (y, target) in out.chunks_exact_mut(stride).enumerate() {
            let at = |y: usize| &source[y * stride..(y + 1) * stride];
            let (above, here, below) = (at(y.saturating_sub(1)), at(y), at((y + 1).min(h - 1)));
            for (((c, a), m), b) in scratch.column.iter_mut().zip(above).zip(here).zip(below) {
                *c = side * (u16::from(*a) + u16::from(*b)) + middle * u16::from(*m);
            }
            let column = &scratch.column;
            let across = |l: u16, m: u16, r: u16| {
                let sum = u32::from(side) * (u32::from(l) + u32::from(r))
                    + u32::from(middle) * u32::from(m);
                sum as i32 as f32 * (1.0 / 65536.0)
            };
            for k in 0..3 {
                let last = stride - 3 + k;
                scratch.row[k] = across(column[k], column[k], column[(k + 3).min(last)]);
                scratch.row[last] =
                    across(column[last.saturating_sub(3).max(k)], column[last], column[last]);
            }
            if stride >= 6 {
                let inner = &mut scratch.row[3..stride - 3];
                for (((slot, l), m), r) in
                    inner.iter_mut().zip(column).zip(&column[3..]).zip(&column[6..])
                {
                    *slot = across(*l, *m, *r);
                }
            }
            let dy = y as f32 - (h as f32 - 1.0) / 2.0;
            let light = 1.0 - loss * dy * dy;
            let noise = scratch.tape.row(hash(row_key ^ y as u32), stride);
            for ((((to, value), gain), dark), n) in
                target.iter_mut().zip(&scratch.row).zip(&gain).zip(&dark).zip(noise)
            {
                let v = value * gain * (light - dark);
                let noisy = v + n * (read + shot * v).sqrt();
                // Above 2^23 a float's last bits are a whole number: rounding without branches.
                *to = (noisy.clamp(0.0, 255.0) + 8_388_608.0).to_bits() as u8;
            }
        }
    }
}
