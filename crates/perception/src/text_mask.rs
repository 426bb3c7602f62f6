//! Words to pixels: the mask of each thing on the table that a text names, or why there is none. No
//! pose is searched: size, height and colours have to do, and whatever another entry of the catalogue
//! fits better is not taken.

use crate::catalogue::ObjectModel;
use crate::color::Palette;
use crate::frame::{DepthStatus, FrameError, RgbdFrame};
use crate::points::PointMap;
use crate::prompt::parse_prompt;
use crate::segment::{Cluster, Mask, Scene};
use crate::table::{TableConfig, TablePlane, detect_table};
use serde::{Deserialize, Serialize};

/// How much nearer or farther (m) than the cells of a thing a surface of its colours may be that
/// belongs to it: another thing of the same colour behind it does not.
const JOINED_M: f32 = 0.025;

/// Settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextMaskConfig {
    /// Table plane search.
    pub table: TableConfig,
    /// Least fit (0..1) of what is taken.
    pub min_fit: f64,
    /// A thing is not taken if another entry fits this many times better.
    pub rival: f64,
}

impl Default for TextMaskConfig {
    fn default() -> Self {
        Self { table: TableConfig::default(), min_fit: 0.3, rival: 1.15 }
    }
}

/// One thing that the text asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct TextMask {
    /// The words.
    pub phrase: String,
    /// What they mean in this picture; else a sentence for the operator.
    pub found: Result<FoundMask, String>,
}

/// The pixels of a thing.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundMask {
    /// Index into the models.
    pub model: usize,
    /// Its pixels, in a window larger than itself.
    pub mask: Mask,
    /// How well it fits the model, 0..1.
    pub fit: f64,
}

/// The mask of everything that `text` names, in its order; words that name nothing are answered too.
///
/// # Errors
/// [`FrameError`] for images that do not fit together.
pub fn text_masks(
    text: &str,
    frame: &RgbdFrame,
    models: &[ObjectModel],
    config: &TextMaskConfig,
) -> Result<Vec<TextMask>, FrameError> {
    let depth = frame.check()?;
    let prompt = parse_prompt(text, models);
    let map = PointMap::new(frame, 4);
    let table = match depth {
        DepthStatus::Empty => None,
        _ => detect_table(&map, &frame.intrinsics, &config.table),
    };
    let seen = table.map(|table| Seen::new(frame, table));
    let look = |model: usize| -> Result<FoundMask, String> {
        let Some(seen) = &seen else {
            return Err(match depth {
                DepthStatus::Empty => format!("{depth}: no mask without depth"),
                _ => "no table plane in view: point the camera at the table".into(),
            });
        };
        let found = seen.find(model, models, config)?;
        let mask = seen.mask(&found, frame, &models[model]);
        Ok(FoundMask { model, mask, fit: found.fit })
    };
    let mut out = Vec::with_capacity(prompt.wanted.len() + prompt.unknown.len());
    for w in prompt.wanted {
        out.push(TextMask { found: look(w.model), phrase: w.phrase });
    }
    for unknown in prompt.unknown {
        // "The blue one": of several entries, the only one that is here.
        let mut here: Vec<FoundMask> =
            unknown.may_be.iter().filter_map(|m| look(*m).ok()).collect();
        let found = match here.len() {
            0 => Err(unknown.reason),
            1 => Ok(here.remove(0)),
            _ => {
                let names: Vec<&str> = here.iter().map(|f| models[f.model].name.as_str()).collect();
                Err(format!("\"{}\" fits {}; use a name", unknown.phrase, names.join(" and ")))
            }
        };
        out.push(TextMask { phrase: unknown.phrase, found });
    }
    Ok(out)
}

/// What all phrases share of a frame.
struct Seen {
    scene: Scene,
    generic: Vec<Cluster>,
}

impl Seen {
    fn new(frame: &RgbdFrame, table: TablePlane) -> Self {
        let scene = Scene::new(frame, table);
        let generic = scene.clusters();
        Self { scene, generic }
    }

    /// Another model that fits the cells better, or the whole thing that they are a part of.
    fn better(
        &self,
        found: &Found,
        wanted: usize,
        models: &[ObjectModel],
        rival: f64,
    ) -> Option<usize> {
        let inside = |whole: &&Cluster| {
            let cells = &found.cluster.cells;
            let step = cells.len().div_ceil(100).max(1);
            let some = || cells.iter().step_by(step);
            let shared = some().filter(|i| whole.cells.binary_search(i).is_ok()).count();
            10 * shared > 8 * some().count() && whole.cells.len() > cells.len()
        };
        let whole = self.generic.iter().find(inside);
        (0..models.len()).filter(|i| *i != wanted).find(|i| {
            [Some(&found.cluster), whole].into_iter().flatten().any(|c| {
                self.scene.fit(c, &models[*i]).resting() > rival * found.fit
                    && self.scene.shows_main_color(c, &models[*i])
            })
        })
    }

    /// The pixels of a group of cells, in a window with room for what of it was not found.
    fn mask(&self, found: &Found, frame: &RgbdFrame, model: &ObjectModel) -> Mask {
        let c = &found.cluster;
        let span = c.length.max(c.top).max(0.05) * frame.intrinsics.fx / c.centroid.z.max(0.1);
        let margin = (0.35 * span) as i32 + 4;
        let palette = found.vivid.as_ref().unwrap_or(&model.palette).clone();
        let model = model.recolored(palette);
        self.scene.mask_within(c, margin, frame, &model, JOINED_M)
    }

    /// The group of cells that fits a model best and no other model better.
    fn find(
        &self,
        wanted: usize,
        models: &[ObjectModel],
        config: &TextMaskConfig,
    ) -> Result<Found, String> {
        let model = &models[wanted];
        let vivid = model.palette.vivid().map(|palette| model.recolored(palette));
        let whole = self.scene.colored_clusters(model).into_iter().chain(self.generic.clone());
        let strong = vivid.iter().flat_map(|m| self.scene.colored_clusters(m));
        let mut ranked: Vec<Found> = whole
            .map(|c| (c, None))
            .chain(strong.map(|c| (c, vivid.as_ref().map(|m| m.palette.clone()))))
            .map(|(cluster, vivid)| Found {
                fit: self.scene.fit(&cluster, model).resting(),
                cluster,
                vivid,
            })
            .collect();
        // Strong colours alone leave a part out: only where all colours together fit clearly worse.
        let rank = |f: &Found| f.fit * if f.vivid.is_some() { 0.8 } else { 1.0 };
        ranked.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
        let Some(best) = ranked.iter().map(|r| r.fit).reduce(f64::max) else {
            return Err(format!("no {} seen: nothing stands on the table", model.name));
        };
        let mut rival = None;
        for found in ranked.into_iter().filter(|r| r.fit >= config.min_fit) {
            if !self.scene.shows_main_color(&found.cluster, model) {
                continue;
            }
            match self.better(&found, wanted, models, config.rival) {
                Some(i) => rival = rival.or(Some(i)),
                None => return Ok(found),
            }
        }
        Err(match rival {
            Some(i) => format!(
                "no {} seen: what is most like it is rather the {}",
                model.name, models[i].name
            ),
            None => format!(
                "no {} seen: of {} things on the table none has its size and colour (best fit \
                 {best:.2}, {:.2} needed)",
                model.name,
                self.generic.len(),
                config.min_fit
            ),
        })
    }
}

/// A group of cells that is taken for a model.
struct Found {
    fit: f64,
    cluster: Cluster,
    /// The colours by which it was found, if they are not all of the model's.
    vivid: Option<Palette>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{K, Lab, camera, coaster_model, mug_model, upright};
    use nalgebra::Point3;

    fn models() -> Vec<ObjectModel> {
        let mut coaster = coaster_model();
        coaster.colors = vec!["brown".into()];
        vec![coaster, mug_model()]
    }

    #[test]
    fn the_named_thing_is_masked_and_what_is_absent_is_refused() {
        let all = models();
        let (mug, coaster) = (&all[1], &all[0]);
        let poses = [upright(0.45, 0.12, 0.0, 0.6), upright(0.5, -0.13, 0.0, 0.0)];
        let frame = Lab::new(3).frame(&[(&mug.mesh, poses[0]), (&coaster.mesh, poses[1])]);
        let alone = Lab::new(3).frame(&[(&coaster.mesh, poses[1])]);
        let ask =
            |text: &str, frame| text_masks(text, frame, &all, &TextMaskConfig::default()).unwrap();
        let covers = |mask: &Mask, p: Point3<f64>| {
            let (u, v) = K.project(&(camera().inverse() * p)).unwrap();
            mask.at(u.round() as i32, v.round() as i32)
        };
        let on_mug = Point3::new(0.45, 0.12, 0.09) + nalgebra::Vector3::new(0.031, 0.0, -0.02);
        let on_coaster = Point3::new(0.5, -0.13, 0.008);
        let found = ask("put the cup on the brown coaster", &frame);
        let masks: Vec<&Mask> = found.iter().map(|f| &f.found.as_ref().unwrap().mask).collect();
        assert!(covers(masks[0], on_mug) && !covers(masks[0], on_coaster));
        assert!(covers(masks[1], on_coaster) && !covers(masks[1], on_mug));
        for absent in ["the mug", "the banana", "the green coaster", "the blue one"] {
            let answers = ask(absent, &alone);
            assert!(answers.iter().all(|a| a.found.is_err()), "{absent}: {answers:?}");
        }
        assert!(ask("the mug with the blue handle", &frame)[0].found.is_ok());
        assert!(ask("the mug with the red handle", &frame)[0].found.is_err());
    }

    #[test]
    fn colour_alone_names_what_is_on_the_table() {
        let mut all = models();
        all[0].colors = vec!["blue".into()];
        let frame = Lab::new(5).frame(&[(&all[1].mesh, upright(0.45, 0.05, 0.0, 0.6))]);
        let found = text_masks("the blue one", &frame, &all, &TextMaskConfig::default()).unwrap();
        assert_eq!(found[0].found.as_ref().unwrap().model, 1, "{found:?}");
    }

    #[test]
    fn without_depth_or_table_the_answer_is_a_sentence() {
        let all = models();
        let mut frame = Lab::new(5).frame(&[(&all[1].mesh, upright(0.45, 0.05, 0.0, 0.6))]);
        frame.depth.data.fill(0.0);
        let ask = |f: &RgbdFrame| text_masks("the mug", f, &all, &TextMaskConfig::default());
        let said = ask(&frame).unwrap()[0].found.clone().unwrap_err();
        assert!(said.contains("depth"), "{said}");
        frame.depth.data.pop();
        assert!(ask(&frame).is_err());
    }
}
