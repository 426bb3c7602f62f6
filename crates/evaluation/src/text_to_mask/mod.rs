//! How often a text names the right pixels: rendered tables with things of the catalogue, sentences that
//! name one of them or one that is not there, and the mask that perception gives for each. The same
//! seed gives the same pictures, sentences and answers.

mod report;
mod scene;
mod words;

pub use report::{Group, TextMaskReport};
pub use scene::{Table, Thing, draw};
pub use words::{Asked, Question, questions};

use serde::{Deserialize, Serialize};
use std::time::Instant;
use tdv_geometry::Stamp;
use tdv_perception::segment::Mask;
use tdv_perception::text_mask::{TextMaskConfig, text_masks};
use tdv_perception::{FrameError, ObjectModel, RgbdFrame};
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorConfig, SensorFrame};

/// Least overlap of a right mask with the true one.
pub const RIGHT_IOU: f64 = 0.5;

/// What came of one sentence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Which picture.
    pub scene: usize,
    /// In what way it asks.
    pub asked: Asked,
    /// The sentence.
    pub text: String,
    /// The object that it means; none if that is not there.
    pub target: Option<String>,
    /// The object whose mask was given.
    pub given: Option<String>,
    /// Why none was given.
    pub reason: String,
    /// Intersection over union with the target's visible pixels; 0 without a mask, none without a target.
    pub iou: Option<f64>,
    /// Whether the answer is right: the target's mask, or a refusal where there is none.
    pub right: bool,
    /// Milliseconds of processor time from the pictures to the mask.
    pub ms: f64,
}

/// What an onlooker sees of one sentence.
#[derive(Debug)]
pub struct Look<'a> {
    /// The pictures.
    pub frame: &'a RgbdFrame,
    /// Visible pixels of the target, row-major; empty if it is not there.
    pub truth: &'a [bool],
    /// The mask given.
    pub mask: Option<&'a Mask>,
    /// Judged.
    pub answer: &'a Answer,
}

/// Renders picture `index`, asks its sentences and judges the answers.
///
/// # Errors
/// [`FrameError`], which a rendered picture never is.
pub fn run(
    models: &[ObjectModel],
    index: usize,
    seed: u64,
    config: &TextMaskConfig,
    mut look: impl FnMut(&Look<'_>),
) -> Result<Vec<Answer>, FrameError> {
    let table = draw(models, index, seed);
    let mut items = table.backdrop.items();
    items.extend(table.things.iter().map(|t| SceneItem {
        mesh: &models[t.model].mesh,
        pose: t.pose,
        id: t.id,
    }));
    let mut sensor = RgbdSensor::new(SensorConfig::lab(), scene::key(seed, index));
    let mut picture = SensorFrame::default();
    sensor.capture(&table.camera, &items, &table.backdrop.lighting, 0, &mut picture);
    let frame = RgbdFrame {
        stamp: Stamp(0),
        intrinsics: sensor.config().intrinsics,
        color: picture.color,
        depth: picture.depth,
    };
    let mut out = Vec::new();
    for question in questions(&table, models, index, seed) {
        let (begin, worked) = (Instant::now(), cpu_ms());
        let found = text_masks(&question.text, &frame, models, config)?;
        let wall = begin.elapsed().as_secs_f64() * 1000.0;
        let ms = cpu_ms().zip(worked).map_or(wall, |(end, begin)| end - begin);
        let thing = question.target.map(|i| &table.things[i]);
        let truth: Vec<bool> = match thing {
            Some(t) => picture.ids.iter().map(|id| *id == t.id).collect(),
            None => Vec::new(),
        };
        // A sentence that asks for one thing and gets two was misread.
        let given = found.iter().find_map(|f| f.found.as_ref().ok());
        let several = found.iter().filter(|f| f.found.is_ok()).count() > 1;
        let iou = thing.map(|_| {
            given.map_or(0.0, |g| overlap(&g.mask, &truth, frame.intrinsics.width as usize))
        });
        let answer = Answer {
            scene: index,
            asked: question.asked,
            text: question.text,
            target: thing.map(|t| models[t.model].name.clone()),
            given: given.map(|g| models[g.model].name.clone()),
            reason: found.iter().find_map(|f| f.found.as_ref().err()).cloned().unwrap_or_default(),
            iou,
            right: !several
                && match iou {
                    Some(iou) => iou >= RIGHT_IOU,
                    None => given.is_none(),
                },
            ms,
        };
        look(&Look { frame: &frame, truth: &truth, mask: given.map(|g| &g.mask), answer: &answer });
        out.push(answer);
    }
    Ok(out)
}

/// Milliseconds that this thread has had a processor, where the system tells: on a machine that others
/// use as well the clock on the wall says little.
fn cpu_ms() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_ascii_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-6)
}

/// Intersection over union of a mask with the pixels of a whole image of this width.
pub fn overlap(mask: &Mask, truth: &[bool], width: usize) -> f64 {
    let (mut both, mut either) = (0_usize, 0_usize);
    for (i, is) in truth.iter().enumerate() {
        let given = mask.at((i % width) as i32, (i / width) as i32);
        both += usize::from(*is && given);
        either += usize::from(*is || given);
    }
    both as f64 / either.max(1) as f64
}

#[cfg(test)]
mod tests;
