//! A recording through perception: what was seen in each frame.

use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_demonstration::{FrameObservation, Task};
use tdv_geometry::nalgebra::Point3;
use tdv_perception::hands::HandDetector;
use tdv_perception::objects::{Levelling, LevellingConfig};
use tdv_perception::{ObjectModel, Perceiver, PerceiverConfig, RgbdFrame};
use tdv_rendering::RgbImage;
use tdv_runtime::camera_bag::CameraBag;

/// Least confidence of a pose that is handed on.
const CONFIDENT: f64 = 0.3;

/// Frames kept with their overlay for the report.
const PICTURES: u64 = 8;

/// All frames as observations, and some of them as pictures.
pub struct Observed {
    pub frames: Vec<FrameObservation>,
    pub pictures: Vec<(f64, RgbImage)>,
    pub hands: usize,
    pub unpaired: usize,
}

pub fn bar(length: u64, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:12} [{bar:32}] {pos}/{len} {eta}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style).with_message(what)
}

/// Looks at every frame of a recording.
pub fn observe(
    bag: &Path,
    task: &Task,
    hand_models: &Path,
    objects: &Path,
) -> anyhow::Result<Observed> {
    let mut hands = HandDetector::load(
        &hand_models.join("palm_detection_full.tflite"),
        &hand_models.join("hand_landmark_full.tflite"),
    )
    .context("hand networks (launch_scripts/fetch_hand_models.sh gets them)")?;
    let names = task.object_names();
    let models: Vec<ObjectModel> = names
        .iter()
        .map(|name| ObjectModel::load(&objects.join(name)))
        .collect::<Result<_, _>>()?;
    let config = PerceiverConfig { prompt: task.text.clone(), ..Default::default() };
    let mut perceiver = Perceiver::new(config, models);
    let mut recording = CameraBag::open(bag)?;
    let mut levelling = Levelling::new(LevellingConfig::default());
    let count = recording.frame_count();
    let progress = bar(count, "parsing");
    let mut observed = Observed { frames: Vec::new(), pictures: Vec::new(), hands: 0, unpaired: 0 };
    let every = (count / PICTURES).max(1);
    let mut first = None;
    while let Some(frame) = recording.next_frame()? {
        let first = *first.get_or_insert(frame.stamp);
        let frame = RgbdFrame {
            stamp: frame.stamp,
            color: frame.color,
            depth: frame.depth,
            intrinsics: frame.intrinsics,
        };
        let seen = perceiver.step(&frame)?;
        let hand = hands.detect(&frame.color, &frame.depth, &frame.intrinsics)?;
        if let Some(table) = &seen.table {
            levelling.observe(recording.t_base_camera(), &table.pose);
        }
        let camera = levelling.correct(recording.t_base_camera());
        let objects: BTreeMap<_, _> = seen
            .detections
            .iter()
            .filter(|d| d.found && d.confidence > CONFIDENT)
            .map(|d| (d.name.clone(), (camera * d.pose, d.confidence)))
            .collect();
        if progress.position() % every == every / 2 {
            let overlay = crate::picture::overlay(&frame, &seen, hand.as_ref());
            observed.pictures.push((frame.stamp.since(first), overlay));
        }
        observed.hands += usize::from(hand.is_some());
        let hand = hand.map(|h| h.joints_camera.map(|p: Point3<f64>| camera * p));
        observed.frames.push(FrameObservation { stamp: frame.stamp, objects, hand });
        progress.inc(1);
    }
    progress.finish_and_clear();
    observed.unpaired = recording.unpaired();
    Ok(observed)
}
