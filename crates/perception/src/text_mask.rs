//! Words to pixels: the mask of each thing on the table that a text names, or why there is none. No
//! pose is searched: size, height and colours have to do, and whatever another entry of the catalogue
//! fits better is not taken.

use crate::catalogue::ObjectModel;
use crate::frame::{DepthStatus, FrameError, RgbdFrame};
use crate::perceiver::window_mask;
use crate::points::PointMap;
use crate::prompt::parse_prompt;
use crate::segment::{Cluster, Mask, Scene};
use crate::table::{TableConfig, TablePlane, detect_table};
use serde::{Deserialize, Serialize};

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
        let (fit, cluster) = seen.find(model, models, config)?;
        let mask = window_mask(&seen.scene, &cluster, frame, &models[model]);
        Ok(FoundMask { model, mask, fit })
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

    /// The group of cells that fits a model best and no other model better, and how well.
    fn find(
        &self,
        wanted: usize,
        models: &[ObjectModel],
        config: &TextMaskConfig,
    ) -> Result<(f64, Cluster), String> {
        let model = &models[wanted];
        let mut ranked: Vec<(f64, Cluster)> = self
            .scene
            .colored_clusters(model)
            .into_iter()
            .chain(self.generic.iter().cloned())
            .map(|c| (self.scene.fit(&c, model).resting(), c))
            .collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(best) = ranked.first().map(|r| r.0) else {
            return Err(format!("no {} seen: nothing stands on the table", model.name));
        };
        let mut rival = None;
        for (fit, cluster) in ranked.into_iter().take_while(|r| r.0 >= config.min_fit) {
            let others = (0..models.len()).filter(|i| *i != wanted);
            let better = others
                .map(|i| (self.scene.fit(&cluster, &models[i]).resting(), i))
                .find(|(other, _)| *other > config.rival * fit);
            match better {
                Some((_, i)) => rival = rival.or(Some(i)),
                None => return Ok((fit, cluster)),
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
