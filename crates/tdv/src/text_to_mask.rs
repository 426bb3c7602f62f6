//! `tdv eval text-to-mask`: rendered tables, sentences, and the masks that perception gives for them.

use crate::arguments::TextToMaskArgs;
use crate::eval::write_json;
use anyhow::Context as _;
use image::Rgb;
use std::path::Path;
use tdv_evaluation::text_to_mask::{Look, TextMaskReport, run as ask};
use tdv_perception::Catalogue;
use tdv_perception::text_mask::TextMaskConfig;
use tdv_rendering::RgbImage;

const TRUTH: Rgb<u8> = Rgb([40, 230, 60]);
const GIVEN: Rgb<u8> = Rgb([255, 40, 200]);

/// Asks all sentences and prints the table; false when a target is missed.
pub fn run(args: &TextToMaskArgs) -> anyhow::Result<bool> {
    let models = Catalogue::load(&args.objects)?.models;
    if let Some(folder) = &args.pictures {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let config = TextMaskConfig::default();
    let (mut answers, mut failed) = (Vec::new(), None);
    for index in 0..args.scenes {
        answers.extend(ask(&models, index, args.seed, &config, |look| {
            if let Some(folder) = &args.pictures
                && let Err(e) = save(folder, look)
            {
                failed = Some(e);
            }
        })?);
    }
    if let Some(e) = failed {
        return Err(e);
    }
    let report = TextMaskReport::new(answers);
    print!("{}", report.table());
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.met())
}

/// The picture with the true outline in green and the given one in pink.
fn save(folder: &Path, look: &Look<'_>) -> anyhow::Result<()> {
    let mut image = look.frame.color.clone();
    let width = image.width() as usize;
    if let Some(mask) = look.mask {
        outline(&mut image, GIVEN, |x, y| mask.at(x, y));
    }
    outline(&mut image, TRUTH, |x, y| {
        look.truth.get(y as usize * width + x as usize).copied().unwrap_or(false)
    });
    let a = look.answer;
    let how = if a.right { "right" } else { "WRONG" };
    let words: String = a.text.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
    let iou = a.iou.map_or("absent".to_owned(), |v| format!("{:02.0}", v * 100.0));
    let path = folder.join(format!("{how}_{iou}_{:03}_{words}.png", a.scene));
    image.save(&path).with_context(|| path.display().to_string())
}

/// Draws the pixels of a set that have a neighbour outside.
fn outline(image: &mut RgbImage, color: Rgb<u8>, within: impl Fn(i32, i32) -> bool) {
    for y in 1..image.height() as i32 - 1 {
        for x in 1..image.width() as i32 - 1 {
            let inside = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
                .iter()
                .all(|(u, v)| within(*u, *v));
            if within(x, y) && !inside {
                image.put_pixel(x as u32, y as u32, color);
            }
        }
    }
}
