//! The tracking benchmark with exact truth: thirteen own objects, five sequences each, rendered by the
//! lab's camera with all its imperfections, followed by the perceiver and the pose tracker's state
//! machine as in the graph, but in process. The same seed gives the same pictures and poses.

mod judge;
mod motion;
mod objects;
mod report;
mod scene;

pub use judge::{Figures, Frame, HIDDEN_FROM, Judge, OCCLUDED_FROM, SequenceResult};
pub use motion::{MotionLimits, RATE, wander};
pub use objects::{BenchObject, objects};
pub use report::{Group, SyntheticReport};
pub use scene::{Gauge, KINDS, Kind, OBJECT_ID, OCCLUDER_ID, Shot, shot};

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tdv_geometry::{Pose, Stamp};
use tdv_perception::objects::{ObjectSpec, Objects, ObjectsConfig, ObjectsInput, TaskObjects};
use tdv_perception::{ObjectModel, Perceiver, PerceiverConfig, PerceptionOutput, RgbdFrame};
use tdv_simulation::sensor::{RgbdSensor, SceneItem, SensorConfig, SensorFrame};
use thiserror::Error;

/// Why a sequence could not be run.
#[derive(Debug, Error)]
pub enum SyntheticError {
    /// No object of this name.
    #[error("no object {name:?} in the benchmark; there are {known}")]
    Object {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A rendered frame was refused.
    #[error("{object}, sequence {index}, frame {frame}: {source}")]
    Frame {
        /// Object.
        object: String,
        /// Sequence.
        index: usize,
        /// Frame.
        frame: usize,
        /// Why.
        source: tdv_perception::FrameError,
    },
}

/// Settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SyntheticConfig {
    /// Frames of each sequence.
    pub frames: usize,
    /// Seed of motions, rooms and noise.
    pub seed: u64,
    /// Perception.
    pub perceiver: PerceiverConfig,
    /// The pose tracker's state machine.
    pub objects: ObjectsConfig,
}

impl Default for SyntheticConfig {
    fn default() -> Self {
        Self {
            frames: 150,
            seed: 1,
            perceiver: PerceiverConfig::default(),
            objects: ObjectsConfig::default(),
        }
    }
}

/// What an onlooker sees of a frame.
#[derive(Debug)]
pub struct Look<'a> {
    /// Frame number.
    pub number: usize,
    /// The pictures.
    pub frame: &'a RgbdFrame,
    /// What the perceiver said.
    pub output: &'a PerceptionOutput,
    /// True `T_camera_object`.
    pub truth: Pose,
    /// Estimated `T_camera_object` after the state machine.
    pub estimate: Option<Pose>,
    /// Judged.
    pub result: &'a Frame,
}

/// Runs sequence `index` (0..5) of the object number `number` of [`objects`]. The tracker starts near
/// the truth (up to 4 mm and 3 degrees off) and is on its own from there.
///
/// # Errors
/// [`SyntheticError`].
pub fn run(
    object: &BenchObject,
    number: usize,
    index: usize,
    config: &SyntheticConfig,
    mut look: impl FnMut(&Look<'_>),
) -> Result<SequenceResult, SyntheticError> {
    let shot = shot(object, number, index, config.frames, config.seed);
    let model = ObjectModel::new(object.name, object.mesh.clone(), object.symmetry.clone());
    let judge = Judge::new(&model);
    let key = config.seed.wrapping_mul(1009) + (number * KINDS.len() + index) as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(key);
    let mut perceiver = Perceiver::new(config.perceiver.clone(), vec![model.clone()]);
    let task = TaskObjects {
        objects: vec![ObjectSpec {
            name: object.name.to_owned(),
            symmetry: object.symmetry.clone(),
        }],
        ..TaskObjects::default()
    };
    let mut states = Objects::new(config.objects.clone(), task);
    let mut sensor = RgbdSensor::new(SensorConfig::lab(), key);
    sensor.keep_still(shot.backdrop.fixtures.len());
    let mut picture = SensorFrame::default();
    let mut gauge = Gauge::new(&shot.camera);
    let to_camera = shot.camera.inverse();
    let mut frames = Vec::with_capacity(shot.object.len());
    for (i, truth) in shot.object.iter().enumerate() {
        let mut items = shot.backdrop.items();
        items.push(SceneItem { mesh: &object.mesh, pose: *truth, id: OBJECT_ID });
        let mut hidden = 0.0;
        if let Some((mesh, poses)) = &shot.occluder
            && let Some(pose) = poses.get(i)
        {
            items.push(SceneItem { mesh, pose: *pose, id: OCCLUDER_ID });
            hidden = gauge.hidden(&object.mesh, truth, mesh, pose);
        }
        sensor.capture(&shot.camera, &items, &shot.backdrop.lighting, i as u64, &mut picture);
        let frame = RgbdFrame {
            stamp: Stamp::from_secs(1.0 + i as f64 / RATE),
            color: picture.color.clone(),
            depth: picture.depth.clone(),
            intrinsics: sensor.config().intrinsics,
        };
        let seen = to_camera * truth;
        if i == 0 {
            perceiver.start_at(&frame, object.name, &nudged(&seen, &mut rng));
        }
        let begin = Instant::now();
        let output = perceiver.step(&frame).map_err(|source| SyntheticError::Frame {
            object: object.name.to_owned(),
            index,
            frame: i,
            source,
        })?;
        let ms = begin.elapsed().as_secs_f64() * 1000.0;
        let out = states.step(&ObjectsInput {
            stamp: frame.stamp,
            detections: &output.detections,
            table: None,
            t_base_camera: shot.camera,
            object_held: false,
        });
        let Some(estimate) = out.objects.first() else { continue };
        let confidence = output.detections.first().map_or(0.0, |d| d.confidence);
        let result =
            judge.frame(estimate.pose.as_ref(), truth, estimate.state, confidence, hidden, ms);
        look(&Look {
            number: i,
            frame: &frame,
            output: &output,
            truth: seen,
            estimate: estimate.pose.map(|p| to_camera * p),
            result: &result,
        });
        frames.push(result);
    }
    Ok(SequenceResult {
        object: object.name.to_owned(),
        index,
        kind: shot.kind,
        seed: config.seed,
        frames,
    })
}

/// A pose up to 4 mm and 3 degrees away.
fn nudged(pose: &Pose, rng: &mut ChaCha8Rng) -> Pose {
    let mut draw = |reach: f64| Vector3::from_fn(|_, _| rng.random_range(-reach..reach));
    let shift = draw(0.0023);
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(draw(1.7f64.to_radians()));
    Pose::from_parts((pose.translation.vector + shift).into(), turn * pose.rotation)
}

#[cfg(test)]
mod tests;
