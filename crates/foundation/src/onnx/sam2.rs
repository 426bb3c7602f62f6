//! SAM2: boxes to masks, and a mask from image to image.

use super::{Input, Net, Output};
use crate::FoundationError;
use crate::text_image::image::planes;
use crate::text_image::masks::{bounds, enlarged};
use std::path::Path;
use tdv_perception::backend::{BackendError, CutOut, FollowMask, PixelBox};
use tdv_perception::segment::Mask;
use tdv_rendering::RgbImage;

/// The image encoder's file in the model folder.
pub const ENCODER: &str = "sam2_encoder.onnx";
/// The mask decoder's file in the model folder.
pub const DECODER: &str = "sam2_decoder.onnx";
/// How to get the files.
pub const HINT: &str = "Fetch facebook/sam2.1-hiera-tiny (Apache-2.0) and run \
    launch_scripts/export_onnx.py --sam2";
const PIXELS: &str = "pixel_values";
const FEATURES: [&str; 3] = ["high_res_0", "high_res_1", "embedding"];
const BOXES: &str = "boxes";
const OUTPUTS: [&str; 3] = ["masks", "iou", "object"];
/// Share of its size by which the last mask's box grows on each side for the next image.
const GROW: f64 = 0.1;
/// Least overlap of two boxes of one object in successive images.
const LEAST_OVERLAP: f64 = 0.2;

/// What the decoder says about one box.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// The mask.
    pub mask: Mask,
    /// Its own guess of its overlap with the true mask, 0..1.
    pub quality: f64,
}

/// Encoder and decoder.
#[derive(Debug)]
pub struct Sam2 {
    encoder: Net,
    decoder: Net,
    /// Side (px) of the encoder's square input.
    side: u32,
}

impl Sam2 {
    /// Loads [`ENCODER`] and [`DECODER`] from a folder.
    ///
    /// # Errors
    /// [`FoundationError`] naming the file.
    pub fn load(folder: &Path) -> Result<Self, FoundationError> {
        let path = folder.join(ENCODER);
        let encoder = Net::load(&path, ("SAM2's image encoder", HINT), &[PIXELS], &FEATURES)?;
        let inputs: Vec<&str> = FEATURES.into_iter().chain([BOXES]).collect();
        let decoder =
            Net::load(&folder.join(DECODER), ("SAM2's mask decoder", HINT), &inputs, &OUTPUTS)?;
        let side = match encoder.input_shape(PIXELS)[..] {
            [_, _, h, w] if h > 0 && h == w => h as u32,
            ref other => {
                let reason = format!("its image input has shape {other:?}, not [1, 3, S, S]");
                return Err(FoundationError::File { path, reason });
            }
        };
        Ok(Self { encoder, decoder, side })
    }

    pub(super) fn encode(&mut self, pixels: Vec<f32>) -> Result<Vec<Output>, FoundationError> {
        let side = self.side as usize;
        self.encoder.run(vec![(PIXELS, vec![1, 3, side, side], Input::F32(pixels))], &FEATURES)
    }

    /// `masks`, `iou`, `object` for boxes given in the encoder's pixels (borders).
    pub(super) fn decode(
        &mut self,
        features: &[Output],
        boxes: &[[f32; 4]],
    ) -> Result<Vec<Output>, FoundationError> {
        let mut inputs: Vec<(&str, Vec<usize>, Input)> = FEATURES
            .into_iter()
            .zip(features)
            .map(|(name, (shape, data))| (name, shape.clone(), Input::F32(data.clone())))
            .collect();
        inputs.push((BOXES, vec![1, boxes.len(), 4], Input::F32(boxes.concat())));
        self.decoder.run(inputs, &OUTPUTS)
    }

    /// For each box the decoder's masks, best first; empty where it sees no object in the box.
    ///
    /// # Errors
    /// [`FoundationError`].
    pub fn candidates(
        &mut self,
        color: &RgbImage,
        boxes: &[PixelBox],
    ) -> Result<Vec<Vec<Candidate>>, FoundationError> {
        let (w, h) = (color.width(), color.height());
        if w == 0 || h == 0 {
            return Err(FoundationError::input("colour image", "has no pixels"));
        }
        if boxes.is_empty() {
            return Ok(Vec::new());
        }
        let features = self.encode(planes(color, self.side, self.side))?;
        let (sx, sy) = (f64::from(self.side) / f64::from(w), f64::from(self.side) / f64::from(h));
        // From pixel centres at integers to borders at integers.
        let x = |v: f64| ((v + 0.5) * sx) as f32;
        let y = |v: f64| ((v + 0.5) * sy) as f32;
        let scaled: Vec<[f32; 4]> =
            boxes.iter().map(|b| [x(b.left), y(b.top), x(b.right), y(b.bottom)]).collect();
        let out = self.decode(&features, &scaled)?;
        let [(shape, logits), (_, iou), (_, object)] = &out[..] else {
            return Err(FoundationError::input("SAM2's output", "is not complete"));
        };
        let [_, n, m, rows, columns] = shape[..] else {
            return Err(FoundationError::input("SAM2's masks", format!("have shape {shape:?}")));
        };
        if n != boxes.len() || iou.len() != n * m || object.len() != n {
            return Err(FoundationError::input("SAM2's output", "does not fit the boxes"));
        }
        Ok((0..n)
            .map(|i| {
                if object[i] < 0.0 {
                    return Vec::new();
                }
                let mut all: Vec<Candidate> = (0..m)
                    .map(|j| {
                        let part = &logits[(i * m + j) * rows * columns..][..rows * columns];
                        Candidate {
                            mask: enlarged(part, (columns, rows), w, h),
                            quality: f64::from(iou[i * m + j]),
                        }
                    })
                    .collect();
                all.sort_by(|a, b| b.quality.total_cmp(&a.quality));
                all
            })
            .collect())
    }
}

fn failed(e: FoundationError) -> BackendError {
    BackendError::Failed { backend: "sam2", source: Box::new(e) }
}

impl CutOut for Sam2 {
    fn cut_out(&mut self, color: &RgbImage, boxes: &[PixelBox]) -> Result<Vec<Mask>, BackendError> {
        let all = self.candidates(color, boxes).map_err(failed)?;
        let empty = || enlarged(&[], (0, 0), color.width(), color.height());
        Ok(all
            .into_iter()
            .map(|c| c.into_iter().next().map_or_else(empty, |best| best.mask))
            .collect())
    }
}

/// Follows a mask with SAM2's image networks: the last mask's box, a little larger, is the next prompt,
/// and among the answers the best that lies where the last mask was is taken. SAM2's own memory of
/// earlier images is not used, so that a long occlusion or a twin beside the object can mislead it.
#[derive(Debug)]
pub struct Sam2Follower {
    sam: Sam2,
    last: Option<PixelBox>,
}

impl Sam2Follower {
    /// A follower without a mask yet.
    pub fn new(sam: Sam2) -> Self {
        Self { sam, last: None }
    }
}

impl FollowMask for Sam2Follower {
    fn begin(&mut self, _: &RgbImage, mask: &Mask) -> Result<(), BackendError> {
        self.last = bounds(mask);
        match self.last {
            Some(_) => Ok(()),
            None => Err(BackendError::NotFound("the mask to follow is empty".into())),
        }
    }

    fn follow(&mut self, color: &RgbImage) -> Result<Option<Mask>, BackendError> {
        let Some(last) = self.last else {
            return Err(BackendError::NotFound("there is no mask to follow yet".into()));
        };
        let (gx, gy) = (GROW * (last.right - last.left), GROW * (last.bottom - last.top));
        let prompt = PixelBox {
            left: last.left - gx,
            top: last.top - gy,
            right: last.right + gx,
            bottom: last.bottom + gy,
        };
        let all = self.sam.candidates(color, &[prompt]).map_err(failed)?;
        let best = all
            .into_iter()
            .flatten()
            .filter_map(|c| {
                let at = bounds(&c.mask)?;
                let overlap = at.overlap(&last);
                (overlap >= LEAST_OVERLAP).then_some((c.quality * overlap, at, c.mask))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        // Out of sight: the box stays where the object was last seen.
        let Some((_, at, mask)) = best else { return Ok(None) };
        self.last = Some(at);
        Ok(Some(mask))
    }
}
