//! GroundingDINO: words to boxes.

use super::{Input, Net};
use crate::FoundationError;
use crate::text_image::boxes::located;
use crate::text_image::image::{detector_size, planes};
use crate::text_image::phrases::Phrases;
use crate::text_image::wordpiece::WordPiece;
use std::path::Path;
use tdv_perception::backend::{BackendError, LocateText, Located};
use tdv_rendering::RgbImage;

/// The network's file in the model folder.
pub const FILE: &str = "groundingdino.onnx";
/// The vocabulary's file in the model folder.
pub const VOCABULARY: &str = "vocab.txt";
/// How to get the files.
pub const HINT: &str = "Fetch IDEA-Research/grounding-dino-tiny (Apache-2.0) and run \
    launch_scripts/export_onnx.py --grounding";
const INPUTS: [&str; 6] = [
    "pixel_values",
    "input_ids",
    "attention_mask",
    "position_ids",
    "token_type_ids",
    "text_token_mask",
];
const OUTPUTS: [&str; 2] = ["logits", "pred_boxes"];

/// The detector with its vocabulary.
#[derive(Debug)]
pub struct GroundingDino {
    net: Net,
    words: WordPiece,
    /// Boxes of lower score are not reported; 0.25 by default.
    pub threshold: f64,
}

impl GroundingDino {
    /// Loads [`FILE`] and [`VOCABULARY`] from a folder.
    ///
    /// # Errors
    /// [`FoundationError`] naming the file.
    pub fn load(folder: &Path) -> Result<Self, FoundationError> {
        let words = WordPiece::load(&folder.join(VOCABULARY))?;
        let net = Net::load(&folder.join(FILE), ("GroundingDINO", HINT), &INPUTS, &OUTPUTS)?;
        Ok(Self { net, words, threshold: 0.25 })
    }

    /// Raw logits and boxes, with the numbers of columns of the logits.
    pub(super) fn forward(
        &mut self,
        pixels: (Vec<f32>, u32, u32),
        phrases: &Phrases,
    ) -> Result<(Vec<f32>, usize, Vec<f32>), FoundationError> {
        let n = phrases.ids.len();
        let (data, width, height) = pixels;
        let row = vec![1, n];
        let inputs = vec![
            (INPUTS[0], vec![1, 3, height as usize, width as usize], Input::F32(data)),
            (INPUTS[1], row.clone(), Input::I64(phrases.ids.clone())),
            (INPUTS[2], row.clone(), Input::I64(vec![1; n])),
            (INPUTS[3], row.clone(), Input::I64(phrases.positions.clone())),
            (INPUTS[4], row, Input::I64(vec![0; n])),
            (INPUTS[5], vec![1, n, n], Input::Bool(phrases.sees.clone())),
        ];
        let mut out = self.net.run(inputs, &OUTPUTS)?.into_iter();
        let (Some((shape, logits)), Some((_, boxes))) = (out.next(), out.next()) else {
            return Err(FoundationError::input("GroundingDINO's output", "is not complete"));
        };
        Ok((logits, shape.last().copied().unwrap_or(0), boxes))
    }

    /// All boxes that fit one of the phrases, best first.
    ///
    /// # Errors
    /// [`FoundationError`].
    pub fn locate(
        &mut self,
        color: &RgbImage,
        phrases: &[String],
    ) -> Result<Vec<Located>, FoundationError> {
        if color.width() == 0 || color.height() == 0 {
            return Err(FoundationError::input("colour image", "has no pixels"));
        }
        let phrases = Phrases::new(phrases, &self.words)?;
        // A file exported for one size is fed that size.
        let fixed = match self.net.input_shape(INPUTS[0])[..] {
            [_, _, h, w] if h > 0 && w > 0 => Some((w as u32, h as u32)),
            _ => None,
        };
        let (w, h) = fixed.unwrap_or_else(|| detector_size(color.width(), color.height()));
        let (logits, columns, boxes) = self.forward((planes(color, w, h), w, h), &phrases)?;
        let size = (color.width(), color.height());
        Ok(located(&logits, columns, &boxes, &phrases, size, self.threshold))
    }
}

impl LocateText for GroundingDino {
    fn locate(
        &mut self,
        color: &RgbImage,
        phrases: &[String],
    ) -> Result<Vec<Located>, BackendError> {
        Self::locate(self, color, phrases)
            .map_err(|e| BackendError::Failed { backend: "groundingdino", source: Box::new(e) })
    }
}
