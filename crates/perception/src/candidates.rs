//! The things that stand on the table, before any of them has a name: which one is meant?

use crate::color::{COLOR_WORDS, Palette, color_word};
use crate::frame::RgbdFrame;
use crate::points::PointMap;
use crate::segment::{Cluster, Mask, Scene};
use crate::table::{TableConfig, TablePlane, detect_table};
use tdv_geometry::Symmetry;
use thiserror::Error;

/// Why none of the things can be taken.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum CandidateError {
    /// No plane.
    #[error("no table plane in view: point the camera at the table, from above")]
    NoTable,
    /// Nothing on it.
    #[error("nothing stands on the table")]
    Nothing,
    /// A colour that nothing has.
    #[error("nothing {word} stands on the table; seen: {seen}")]
    NoColor {
        /// The colour asked for.
        word: &'static str,
        /// What there is.
        seen: String,
    },
    /// More than one.
    #[error(
        "several things fit: {seen}; name a colour (--prompt \"the red one\") or leave one only"
    )]
    Several {
        /// What there is.
        seen: String,
    },
}

/// One thing on the table.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Its cells.
    pub cluster: Cluster,
    /// Its pixels, in a window larger than itself.
    pub mask: Mask,
    /// Colour words that fit at least a quarter of it, the best first.
    pub colors: Vec<&'static str>,
}

impl std::fmt::Display for Candidate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mm = |v: f64| (v * 1000.0).round();
        let color = self.colors.first().copied().unwrap_or("colourful");
        let (l, w, h) = (mm(self.cluster.length), mm(self.cluster.width), mm(self.cluster.top));
        write!(f, "a {color} thing, {l} x {w} mm, {h} mm high")
    }
}

/// The table and the things on it, the largest first.
///
/// # Errors
/// [`CandidateError::NoTable`], [`CandidateError::Nothing`].
pub fn candidates(frame: &RgbdFrame) -> Result<(TablePlane, Vec<Candidate>), CandidateError> {
    let map = PointMap::new(frame, 4);
    let table = detect_table(&map, &frame.intrinsics, &TableConfig::default())
        .ok_or(CandidateError::NoTable)?;
    let scene = Scene::new(frame, table);
    // A model without colours claims every pixel that is not the table's.
    let plain = crate::catalogue::ObjectModel::new(
        "thing",
        tdv_rendering::mesh::primitives::cuboid([0.1; 3], [128; 3]),
        Symmetry::None,
    );
    let (w, h) = (scene.map.width as u32, scene.map.height as u32);
    let mut out: Vec<Candidate> = scene
        .clusters()
        .into_iter()
        .filter(|c| c.cells.len() >= 60 && c.length < 0.6)
        // What the image cuts off has no size.
        .filter(|c| {
            let edge = c.cells.iter().filter(|i| {
                let (x, y) = (**i % w, **i / w);
                x < 2 || y < 2 || x + 3 > w || y + 3 > h
            });
            edge.count() * 50 < c.cells.len()
        })
        .map(|cluster| {
            let span = cluster.length.max(cluster.top).max(0.05) * frame.intrinsics.fx
                / cluster.centroid.z.max(0.1);
            let mask = scene.mask(&cluster, (0.35 * span) as i32 + 4, frame, &plain);
            let colors = words(frame, &mask);
            Candidate { cluster, mask, colors }
        })
        .collect();
    out.sort_by_key(|c| std::cmp::Reverse(c.cluster.cells.len()));
    if out.is_empty() {
        return Err(CandidateError::Nothing);
    }
    Ok((table, out))
}

/// The candidates of a colour that `prompt` names; all of them if it names none.
///
/// # Errors
/// [`CandidateError::NoColor`].
pub fn of_color<'a>(
    all: &'a [Candidate],
    prompt: &str,
) -> Result<Vec<&'a Candidate>, CandidateError> {
    let prompt = prompt.to_lowercase();
    let word = prompt.split(|c: char| !c.is_alphabetic()).find_map(color_word);
    let Some(word) = word else { return Ok(all.iter().collect()) };
    let fits: Vec<&Candidate> = all.iter().filter(|c| c.colors.contains(&word)).collect();
    if fits.is_empty() {
        return Err(CandidateError::NoColor { word, seen: list(all.iter()) });
    }
    Ok(fits)
}

/// The only one.
///
/// # Errors
/// [`CandidateError::Several`].
pub fn only<'a>(some: &[&'a Candidate]) -> Result<&'a Candidate, CandidateError> {
    match some {
        [one] => Ok(one),
        [] => Err(CandidateError::Nothing),
        several => Err(CandidateError::Several { seen: list(several.iter().copied()) }),
    }
}

fn list<'a>(all: impl Iterator<Item = &'a Candidate>) -> String {
    all.map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

fn words(frame: &RgbdFrame, mask: &Mask) -> Vec<&'static str> {
    let mut pixels = Vec::new();
    for v in (mask.y0..mask.y0 + mask.height as i32).step_by(2) {
        for u in (mask.x0..mask.x0 + mask.width as i32).step_by(2) {
            if mask.at(u, v) {
                pixels.push(frame.color.get_pixel(u as u32, v as u32).0);
            }
        }
    }
    color_words(pixels.into_iter())
}

/// Colour words that fit at least a quarter of the pixels, the best first.
pub fn color_words(pixels: impl Iterator<Item = [u8; 3]>) -> Vec<&'static str> {
    let palettes = COLOR_WORDS.map(|(name, c)| (name, Palette::new([(c, 1.0)])));
    let mut counts = [0_usize; COLOR_WORDS.len()];
    let mut total = 0_usize;
    for p in pixels {
        total += 1;
        let fits = palettes.iter().map(|(_, palette)| palette.fit(p)).enumerate();
        if let Some((i, fit)) = fits.max_by(|a, b| a.1.total_cmp(&b.1))
            && fit > 0.2
        {
            counts[i] += 1;
        }
    }
    let mut out: Vec<(usize, &'static str)> = counts
        .iter()
        .zip(COLOR_WORDS)
        .filter(|(n, _)| **n * 4 >= total && total > 0)
        .map(|(n, (name, _))| (*n, name))
        .collect();
    out.sort_by_key(|(n, _)| std::cmp::Reverse(*n));
    out.into_iter().map(|(_, name)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Lab, coaster_model, mug_model, upright};

    #[test]
    fn two_things_are_told_apart_by_colour() {
        let (mug, coaster) = (mug_model(), coaster_model());
        let frame = Lab::new(3).frame(&[
            (&mug.mesh, upright(0.45, 0.12, 0.0, 0.6)),
            (&coaster.mesh, upright(0.5, -0.13, 0.0, 0.0)),
        ]);
        let (_, all) = candidates(&frame).unwrap();
        assert_eq!(all.len(), 2, "{}", list(all.iter()));
        let blue = only(&of_color(&all, "the blue cup").unwrap()).unwrap();
        assert!((blue.cluster.top - 0.09).abs() < 0.006, "{blue}");
        let e = only(&of_color(&all, "the cup").unwrap()).unwrap_err().to_string();
        assert!(e.contains("a blue thing") && e.contains("several"), "{e}");
        let e = of_color(&all, "the green cup").unwrap_err().to_string();
        assert!(e.contains("nothing green") && e.contains("blue"), "{e}");
    }
}
