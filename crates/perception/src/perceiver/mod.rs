//! All objects of a prompt in one camera stream: mask and first pose where an object has no pose yet,
//! tracking where it has one.

use crate::catalogue::ObjectModel;
use crate::frame::{DepthStatus, FrameError, RgbdFrame};
use crate::points::PointMap;
use crate::prompt::{Prompt, parse_prompt};
use crate::register::{RegisterConfig, Registration, search};
use crate::segment::{Cluster, Mask, Scene};
use crate::table::{TableConfig, TablePlane, detect_table, follow_table};
use crate::track::{Tracker, TrackerConfig};
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tdv_geometry::{Pose, Stamp};

/// Settings of the perceiver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PerceiverConfig {
    /// Text that names the objects wanted ("put the cup on the coaster"); empty: all of the catalogue.
    pub prompt: String,
    /// Table plane search.
    pub table: TableConfig,
    /// First pose.
    pub register: RegisterConfig,
    /// Tracking.
    pub tracker: TrackerConfig,
    /// Least fit (0..1) of a cluster that is registered.
    pub min_fit: f64,
    /// Clusters that are registered per object and attempt.
    pub candidates: usize,
    /// Score below which an ambiguous first pose is not taken.
    pub ambiguous_below: f64,
    /// Frames between two attempts to find a missing object (an attempt takes several frame times).
    pub retry_frames: u32,
    /// Confidence below which a tracked pose counts as bad.
    pub lost_below: f64,
    /// Bad frames in a row after which the object is searched again.
    pub lost_frames: u32,
}

impl Default for PerceiverConfig {
    fn default() -> Self {
        Self {
            prompt: String::new(),
            table: TableConfig::default(),
            register: RegisterConfig::default(),
            tracker: TrackerConfig::default(),
            min_fit: 0.08,
            candidates: 3,
            ambiguous_below: 0.75,
            retry_frames: 10,
            lost_below: 0.35,
            lost_frames: 8,
        }
    }
}

/// One object in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Catalogue name (the prompt's words for what is not in the catalogue).
    pub name: String,
    /// `T_camera_object`; the identity when not found.
    pub pose: Pose,
    /// 0..1; 0 when not found.
    pub confidence: f64,
    /// Covariance of position (m^2) and rotation (rad^2) in camera axes: xyz, then rotation.
    pub covariance: Matrix6<f64>,
    /// Whether `pose` means anything.
    pub found: bool,
    /// Why it was not found, or what is doubtful; empty otherwise.
    pub reason: String,
}

/// What one frame gave.
#[derive(Debug, Clone, PartialEq)]
pub struct PerceptionOutput {
    /// The frame's stamp.
    pub stamp: Stamp,
    /// The table, if it is seen.
    pub table: Option<TablePlane>,
    /// Wanted objects in the prompt's order (catalogue order without prompt), then the prompt's unknown words.
    pub detections: Vec<Detection>,
    /// Label image, row-major, the frame's size: 0 nothing, i + 1 = `detections[i]`.
    pub masks: Vec<u8>,
    /// How good the depth image was.
    pub depth: DepthStatus,
    /// The depth image repeats the last one under a new colour image; only colour was used.
    pub stale_depth: bool,
}

#[derive(Debug)]
struct Object {
    model: Arc<ObjectModel>,
    tracker: Option<Tracker>,
    /// Frames until the next attempt.
    wait: u32,
    bad: u32,
    reason: String,
}

/// Finds and follows the objects of a prompt.
#[derive(Debug)]
pub struct Perceiver {
    config: PerceiverConfig,
    objects: Vec<Object>,
    prompt: Prompt,
    table: Option<TablePlane>,
    table_wait: u32,
    depth_print: u64,
    color_print: u64,
}

impl Perceiver {
    /// A perceiver for the objects of `models` that the configured prompt names.
    pub fn new(config: PerceiverConfig, models: Vec<ObjectModel>) -> Self {
        let prompt = if config.prompt.trim().is_empty() {
            Prompt::default()
        } else {
            parse_prompt(&config.prompt, &models)
        };
        let all = config.prompt.trim().is_empty();
        let models: Vec<Arc<ObjectModel>> = models.into_iter().map(Arc::new).collect();
        let wanted: Vec<usize> = if all {
            (0..models.len()).collect()
        } else {
            prompt.wanted.iter().map(|w| w.model).collect()
        };
        let objects = wanted
            .into_iter()
            .filter_map(|i| models.get(i))
            .map(|model| Object {
                model: model.clone(),
                tracker: None,
                wait: 0,
                bad: 0,
                reason: "not searched yet".into(),
            })
            .collect();
        Self { config, objects, prompt, table: None, table_wait: 0, depth_print: 0, color_print: 0 }
    }

    /// Names of the objects that are looked for.
    pub fn names(&self) -> Vec<&str> {
        self.objects.iter().map(|o| o.model.name.as_str()).collect()
    }

    /// The wanted models, in the order of the detections.
    pub fn models(&self) -> impl Iterator<Item = Arc<ObjectModel>> + '_ {
        self.objects.iter().map(|o| o.model.clone())
    }

    pub(crate) fn config(&self) -> &PerceiverConfig {
        &self.config
    }

    /// What the prompt asked for, and what of it is not in the catalogue.
    pub fn prompt(&self) -> &Prompt {
        &self.prompt
    }

    /// Drops the pose of an object (of all for an empty name), so that the next frame searches it
    /// anew. False when no object has this name.
    pub fn reregister(&mut self, name: &str) -> bool {
        let mut any = false;
        for o in self.objects.iter_mut().filter(|o| name.is_empty() || o.model.name == name) {
            o.tracker = None;
            o.wait = 0;
            o.bad = 0;
            o.reason = "registration was asked for".into();
            any = true;
        }
        any
    }

    /// Starts tracking an object at a known pose (`T_camera_object`), without search. False when no
    /// object has this name or the frame is unusable.
    pub fn start_at(&mut self, frame: &RgbdFrame, name: &str, pose: &Pose) -> bool {
        if frame.check().is_err() {
            return false;
        }
        let config = self.config.tracker.clone();
        let Some(o) = self.objects.iter_mut().find(|o| o.model.name == name) else { return false };
        o.tracker = Some(Tracker::start(frame, o.model.clone(), pose, config));
        o.bad = 0;
        o.reason.clear();
        true
    }

    /// Processes the next frame.
    ///
    /// # Errors
    /// [`FrameError`] for a frame whose images and intrinsics do not fit together; nothing is changed then.
    pub fn step(&mut self, frame: &RgbdFrame) -> Result<PerceptionOutput, FrameError> {
        let depth = frame.check()?;
        let (d, c) = (frame.depth_fingerprint(), frame.color_fingerprint());
        let stale_depth = d == self.depth_print && c != self.color_print;
        (self.depth_print, self.color_print) = (d, c);
        let with_depth = depth != DepthStatus::Empty && !stale_depth;
        if with_depth {
            self.follow_table(frame);
        }
        // Tracked objects first: their pixels are no candidates for the missing ones.
        let mut detections: Vec<Detection> =
            self.objects.iter().map(|o| missing(&o.model.name, String::new())).collect();
        for (object, out) in self.objects.iter_mut().zip(&mut detections) {
            follow(object, frame, with_depth, &self.config, out);
        }
        self.find_missing(frame, with_depth, &depth, &mut detections);
        for (object, out) in self.objects.iter().zip(&mut detections) {
            if !out.found {
                out.reason.clone_from(&object.reason);
            }
        }
        detections.extend(self.prompt.unknown.iter().map(|u| missing(&u.phrase, u.reason.clone())));
        Ok(PerceptionOutput {
            stamp: frame.stamp,
            table: self.table,
            masks: self.label_image(frame),
            detections,
            depth,
            stale_depth,
        })
    }

    fn follow_table(&mut self, frame: &RgbdFrame) {
        let map = PointMap::new(frame, 8);
        let k = &frame.intrinsics;
        let c = &self.config.table;
        self.table = match self.table {
            Some(t) => follow_table(&map, k, &t, c),
            None => None,
        };
        if self.table.is_none() {
            if self.table_wait > 0 {
                self.table_wait -= 1;
                return;
            }
            self.table = detect_table(&PointMap::new(frame, 4), k, c);
            self.table_wait = if self.table.is_none() { self.config.retry_frames } else { 0 };
        }
    }

    fn find_missing(
        &mut self,
        frame: &RgbdFrame,
        with_depth: bool,
        depth: &DepthStatus,
        detections: &mut [Detection],
    ) {
        let mut scene: Option<Scene> = None;
        let mut generic: Vec<Cluster> = Vec::new();
        let taken = self.label_image(frame);
        for (object, out) in self.objects.iter_mut().zip(detections) {
            if object.tracker.is_some() {
                continue;
            }
            if object.wait > 0 {
                object.wait -= 1;
                continue;
            }
            if !with_depth {
                object.reason = format!("{depth}: no first pose without depth");
                continue;
            }
            let Some(table) = self.table else {
                object.reason = "no table plane in view: point the camera at the table".into();
                continue;
            };
            object.wait = self.config.retry_frames;
            if scene.is_none() {
                let s = Scene::new(frame, table);
                generic = s.clusters();
                scene = Some(s);
            }
            let Some(scene) = &scene else { continue };
            match find(frame, scene, &generic, &taken, &object.model, &self.config) {
                Ok(found) => {
                    let tracker = Tracker::start(
                        frame,
                        object.model.clone(),
                        &found.pose,
                        self.config.tracker.clone(),
                    );
                    object.tracker = Some(tracker);
                    object.bad = 0;
                    object.wait = 0;
                    follow(object, frame, with_depth, &self.config, out);
                    if out.found && found.ambiguous() {
                        out.reason = format!(
                            "orientation ambiguous: score {:.2}, another one {:.2}",
                            found.score, found.second
                        );
                    }
                }
                Err(reason) => object.reason = reason,
            }
        }
    }

    fn label_image(&self, frame: &RgbdFrame) -> Vec<u8> {
        let n = frame.intrinsics.width as usize * frame.intrinsics.height as usize;
        let mut labels = vec![0u8; n];
        let several = self.objects.iter().filter(|o| o.tracker.is_some()).count() > 1;
        let mut nearest = if several { vec![f32::INFINITY; n] } else { Vec::new() };
        for (i, object) in self.objects.iter().enumerate() {
            let Some(tracker) = &object.tracker else { continue };
            let label = u8::try_from(i + 1).unwrap_or(u8::MAX);
            tracker.silhouette(frame, |pixel, z| {
                if !several {
                    labels[pixel] = label;
                } else if z < nearest[pixel] {
                    nearest[pixel] = z;
                    labels[pixel] = label;
                }
            });
        }
        labels
    }
}

pub(crate) fn missing(name: &str, reason: String) -> Detection {
    Detection {
        name: name.to_owned(),
        pose: Pose::identity(),
        confidence: 0.0,
        covariance: Matrix6::identity(),
        found: false,
        reason,
    }
}

/// Tracks one object into the frame; drops the tracker after too many bad frames.
fn follow(
    object: &mut Object,
    frame: &RgbdFrame,
    with_depth: bool,
    config: &PerceiverConfig,
    out: &mut Detection,
) {
    let Some(tracker) = &mut object.tracker else { return };
    let tracked = tracker.track(frame, with_depth);
    out.pose = tracked.pose;
    out.confidence = tracked.confidence;
    out.covariance = tracked.covariance;
    out.found = true;
    object.bad = if tracked.confidence < config.lost_below { object.bad + 1 } else { 0 };
    if object.bad >= config.lost_frames {
        object.reason = format!(
            "lost: confidence {:.2}, {:.0} % of it visible, depth agrees on {:.0} % of that",
            tracked.confidence,
            100.0 * tracked.quality.visible,
            100.0 * tracked.quality.agreement
        );
        object.tracker = None;
        object.wait = 0;
        object.bad = 0;
        out.found = false;
        out.confidence = 0.0;
    }
}

/// The best pose of a model among the clusters that fit it, or why there is none.
fn find(
    frame: &RgbdFrame,
    scene: &Scene,
    generic: &[Cluster],
    taken: &[u8],
    model: &ObjectModel,
    config: &PerceiverConfig,
) -> Result<Registration, String> {
    let colored = scene.colored_clusters(model);
    let free = |c: &Cluster| {
        let row = frame.intrinsics.width as usize;
        let s = scene.map.stride as usize;
        let pixel = |i: u32| {
            let (x, y) = (i as usize % scene.map.width, i as usize / scene.map.width);
            y * s * row + x * s
        };
        let used = c.cells.iter().filter(|i| taken[pixel(**i)] != 0).count();
        2 * used < c.cells.len()
    };
    let mut ranked: Vec<(f64, &Cluster)> = colored
        .iter()
        .chain(generic)
        .filter(|c| free(c))
        .map(|c| (scene.fit(c, model).total, c))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some((best_fit, _)) = ranked.first().copied() else {
        return Err(format!("no {} seen: nothing stands on the table", model.name));
    };
    ranked.retain(|(f, _)| *f >= config.min_fit);
    if ranked.is_empty() {
        return Err(format!(
            "no {} seen: of {} things on the table none has its size and colour (best fit {:.2}, {:.2} needed)",
            model.name,
            generic.len(),
            best_fit,
            config.min_fit
        ));
    }
    let mut best: Option<(f64, Registration)> = None;
    for (fit, cluster) in ranked.iter().take(config.candidates) {
        let mask = window_mask(scene, cluster, frame, model);
        let Some(r) = search(frame, &mask, model, Some(&scene.table), &config.register) else {
            continue;
        };
        // The pose says more than the cluster's outer figures, but both count.
        let total = r.score * fit.powf(0.25);
        if best.as_ref().is_none_or(|b| total > b.0) {
            best = Some((total, r));
        }
    }
    match best {
        Some((_, r)) if r.ambiguous() && r.score < config.ambiguous_below => Err(format!(
            "{}: two orientations fit equally badly ({:.2}, {:.2}); too much of it is hidden",
            model.name, r.score, r.second
        )),
        Some((_, r)) if r.score >= config.register.min_score => Ok(r),
        Some((_, r)) => Err(format!(
            "no {} seen: the likeliest thing on the table matches its shape with {:.2}, {:.2} needed",
            model.name, r.score, config.register.min_score
        )),
        None => Err(format!("no {} seen: no depth on the candidates", model.name)),
    }
}

/// A cluster's mask in a window that leaves room for the unseen part of the object.
pub(crate) fn window_mask(
    scene: &Scene,
    cluster: &Cluster,
    frame: &RgbdFrame,
    model: &ObjectModel,
) -> Mask {
    let k = &frame.intrinsics;
    let span = cluster.length.max(cluster.top).max(0.05) * k.fx / cluster.centroid.z.max(0.1);
    scene.mask(cluster, (0.35 * span) as i32 + 4, frame, model)
}

#[cfg(test)]
mod tests;
