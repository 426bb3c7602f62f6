//! The whole way: from mask to pose, and from pose to pose.

use super::crop::{Normal, Window, observed};
use super::networks::{CHANNELS, RefineNet, ScoreNet};
use super::target::{Artist, Target};
use super::{depth_filter, hypotheses};
use crate::FoundationError;
use candle_core::{Device, Tensor};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;
use tdv_perception::RgbdFrame;
use tdv_rendering::DepthImage;

/// Largest turn (rad) of one refinement.
const TURN: f64 = 0.349_066;
/// Points nearer than this (m) count as none, for the refiner and for the scorer.
const NEAREST: [f64; 2] = [0.001, 0.1];

/// Settings; the defaults are those that the released networks were made for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Refinements of every hypothesis of a first pose.
    pub register_iterations: usize,
    /// Refinements from one image to the next.
    pub follow_iterations: usize,
    /// Side of the refiner's window in mesh diameters.
    pub refine_crop: f64,
    /// Side of the scorer's window in mesh diameters.
    pub score_crop: f64,
    /// Side (px) of what the networks see; a multiple of 8.
    pub crop_px: u32,
    /// Hypotheses that go through a network at once.
    pub batch: usize,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            register_iterations: 5,
            follow_iterations: 2,
            refine_crop: 1.2,
            score_crop: 1.1,
            crop_px: 160,
            batch: 16,
        }
    }
}

impl PoseConfig {
    fn check(&self) -> Result<(), FoundationError> {
        let bad = |reason: &str| Err(FoundationError::input("pose configuration", reason));
        if self.crop_px < 8 || !self.crop_px.is_multiple_of(8) || self.crop_px > 1024 {
            return bad("crop_px must be a multiple of 8 up to 1024");
        }
        if self.batch == 0 {
            return bad("batch must be at least 1");
        }
        if ![self.refine_crop, self.score_crop].iter().all(|c| (0.5..=5.0).contains(c)) {
            return bad("crop sides must lie between 0.5 and 5 diameters");
        }
        Ok(())
    }
}

/// What improves a hypothesis; [`RefineNet`].
pub trait Refine {
    /// Raw translation and rotation outputs `[N, 3]` for rendered (`a`) and observed (`b`) crops.
    ///
    /// # Errors
    /// Whatever keeps it from running.
    fn refine(&self, a: &Tensor, b: &Tensor) -> Result<(Tensor, Tensor), FoundationError>;
}

/// What ranks hypotheses; [`ScoreNet`].
pub trait Rank {
    /// One feature row for each pair of crops.
    ///
    /// # Errors
    /// Whatever keeps it from running.
    fn features(&self, a: &Tensor, b: &Tensor) -> Result<Tensor, FoundationError>;
    /// Scores `[N]` of all hypotheses from their features.
    ///
    /// # Errors
    /// Whatever keeps it from running.
    fn compare(&self, features: &Tensor) -> Result<Tensor, FoundationError>;
}

impl Refine for RefineNet {
    fn refine(&self, a: &Tensor, b: &Tensor) -> Result<(Tensor, Tensor), FoundationError> {
        self.forward(a, b)
    }
}

impl Rank for ScoreNet {
    fn features(&self, a: &Tensor, b: &Tensor) -> Result<Tensor, FoundationError> {
        Self::features(self, a, b)
    }
    fn compare(&self, features: &Tensor) -> Result<Tensor, FoundationError> {
        Self::compare(self, features)
    }
}

/// A pose and what speaks for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseFound {
    /// `T_camera_object`.
    pub pose: Pose,
    /// The scorer's output, meaningful only against other hypotheses of the same image; 0 when following.
    pub score: f64,
    /// Share (0..1) of the object's rendered pixels where the camera measured the same depth. The
    /// networks have no confidence of their own; this one falls when the object is hidden or lost.
    pub agreement: f64,
}

/// FoundationPose with its networks.
#[derive(Debug)]
pub struct PoseEstimator<R = RefineNet, S = ScoreNet> {
    refiner: R,
    scorer: S,
    device: Device,
    config: PoseConfig,
    artist: Artist,
}

impl<R: Refine, S: Rank> PoseEstimator<R, S> {
    /// # Errors
    /// [`FoundationError::Input`] for a configuration out of range.
    pub fn new(
        refiner: R,
        scorer: S,
        device: Device,
        config: PoseConfig,
    ) -> Result<Self, FoundationError> {
        config.check()?;
        Ok(Self { refiner, scorer, device, config, artist: Artist::default() })
    }

    /// The pose of a target of which `mask(u, v)` says where it is seen.
    ///
    /// # Errors
    /// [`FoundationError::Input`] when the frame does not fit together or the mask holds no depth.
    pub fn register(
        &mut self,
        frame: &RgbdFrame,
        mask: impl Fn(i32, i32) -> bool,
        target: &Target,
    ) -> Result<PoseFound, FoundationError> {
        let depth = checked(frame)?;
        let Some(centre) = hypotheses::guess_centre(&depth, &frame.intrinsics, mask) else {
            return Err(FoundationError::input("mask", "holds fewer than four depth readings"));
        };
        let mut poses: Vec<Pose> = hypotheses::rotations(target.symmetry())
            .into_iter()
            .map(|r| Pose::from_parts(centre.coords.into(), r))
            .collect();
        for _ in 0..self.config.register_iterations {
            self.refine(frame, &depth, target, &mut poses)?;
        }
        // A hypothesis that ran out of the picture cannot be ranked.
        let reach = 0.5 * self.config.score_crop * target.diameter();
        poses.retain(|p| window(p, reach, frame).is_some());
        let scores = self.scores(frame, &depth, target, &poses)?;
        let best = scores.iter().zip(&poses).max_by(|a, b| a.0.total_cmp(b.0));
        let Some((score, pose)) = best else {
            return Err(FoundationError::input("hypotheses", "all left the camera's view"));
        };
        let agreement = self.agreement(frame, &depth, target, pose);
        Ok(PoseFound { pose: target.original(pose), score: f64::from(*score), agreement })
    }

    /// The pose in the next image, from the last one (`T_camera_object`).
    ///
    /// # Errors
    /// [`FoundationError::Input`] when the frame does not fit together or the last pose is out of view.
    pub fn follow(
        &mut self,
        frame: &RgbdFrame,
        target: &Target,
        last: &Pose,
    ) -> Result<PoseFound, FoundationError> {
        let depth = checked(frame)?;
        let mut poses = vec![target.centred(last)];
        let reach = 0.5 * self.config.refine_crop * target.diameter();
        if window(&poses[0], reach, frame).is_none() {
            return Err(FoundationError::input("last pose", "is not in front of the camera"));
        }
        for _ in 0..self.config.follow_iterations {
            self.refine(frame, &depth, target, &mut poses)?;
        }
        let agreement = self.agreement(frame, &depth, target, &poses[0]);
        Ok(PoseFound { pose: target.original(&poses[0]), score: 0.0, agreement })
    }

    /// One refinement of every hypothesis; those out of view stay as they are.
    fn refine(
        &mut self,
        frame: &RgbdFrame,
        depth: &DepthImage,
        target: &Target,
        poses: &mut [Pose],
    ) -> Result<(), FoundationError> {
        let radius = 0.5 * target.diameter();
        let reach = radius * self.config.refine_crop;
        let seen: Vec<usize> =
            (0..poses.len()).filter(|i| window(&poses[*i], reach, frame).is_some()).collect();
        for part in seen.chunks(self.config.batch) {
            let some: Vec<Pose> = part.iter().map(|i| poses[*i]).collect();
            let (a, b) = self.crops(frame, depth, target, &some, (reach, NEAREST[0]))?;
            let (moves, turns) = self.refiner.refine(&a, &b)?;
            let (moves, turns) = (moves.to_vec2::<f32>()?, turns.to_vec2::<f32>()?);
            for ((i, m), t) in part.iter().zip(&moves).zip(&turns) {
                let vector = |v: &[f32]| Vector3::from_iterator(v.iter().copied().map(f64::from));
                poses[*i] = improved(&poses[*i], &vector(m), &vector(t), radius);
            }
        }
        Ok(())
    }

    fn scores(
        &mut self,
        frame: &RgbdFrame,
        depth: &DepthImage,
        target: &Target,
        poses: &[Pose],
    ) -> Result<Vec<f32>, FoundationError> {
        if poses.is_empty() {
            return Ok(Vec::new());
        }
        let reach = 0.5 * self.config.score_crop * target.diameter();
        let mut features = Vec::new();
        for some in poses.chunks(self.config.batch) {
            let (a, b) = self.crops(frame, depth, target, some, (reach, NEAREST[1]))?;
            features.push(self.scorer.features(&a, &b)?);
        }
        Ok(self.scorer.compare(&Tensor::cat(&features, 0)?)?.to_vec1()?)
    }

    /// Rendered and observed crops `[N, 6, S, S]` of hypotheses that are all in view.
    fn crops(
        &mut self,
        frame: &RgbdFrame,
        depth: &DepthImage,
        target: &Target,
        poses: &[Pose],
        (reach, nearest): (f64, f64),
    ) -> Result<(Tensor, Tensor), FoundationError> {
        let (k, size) = (&frame.intrinsics, self.config.crop_px);
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for pose in poses {
            let Some(window) = window(pose, reach, frame) else { continue };
            let origin = pose.translation.vector;
            let normal = Normal { origin, radius: 0.5 * target.diameter(), nearest };
            a.extend(self.artist.draw(target, pose, k, (&window, size), &normal));
            b.extend(observed(&frame.color, depth, k, &window, &normal, size));
        }
        let side = size as usize;
        let shape = (a.len() / (CHANNELS * side * side), CHANNELS, side, side);
        Ok((Tensor::from_vec(a, shape, &self.device)?, Tensor::from_vec(b, shape, &self.device)?))
    }

    fn agreement(
        &mut self,
        frame: &RgbdFrame,
        depth: &DepthImage,
        target: &Target,
        pose: &Pose,
    ) -> f64 {
        let size = self.config.crop_px;
        let Some(window) = window(pose, 0.5 * target.diameter(), frame) else { return 0.0 };
        let normal = Normal {
            origin: pose.translation.vector,
            radius: 0.5 * target.diameter(),
            nearest: NEAREST[0],
        };
        self.artist.draw(target, pose, &frame.intrinsics, (&window, size), &normal);
        let camera = window.camera(&frame.intrinsics, size);
        let near = (0.05 * target.diameter()).clamp(0.003, 0.02);
        let (mut drawn, mut agreed) = (0usize, 0usize);
        for (i, z) in self.artist.depth().iter().enumerate().filter(|(_, z)| **z > 0.0) {
            drawn += 1;
            let (x, y) = ((i as u32 % size) as f64, (i as u32 / size) as f64);
            let p = camera.unproject(x, y, f64::from(*z));
            let Some((u, v)) = frame.intrinsics.project(&p) else { continue };
            let measured = depth.get(u.round() as i32, v.round() as i32);
            agreed += usize::from(measured.is_some_and(|m| f64::from((m - z).abs()) < near));
        }
        agreed as f64 / drawn.max(1) as f64
    }
}

fn checked(frame: &RgbdFrame) -> Result<DepthImage, FoundationError> {
    frame.check().map_err(|e| FoundationError::input("frame", e.to_string()))?;
    Ok(depth_filter::clean(&frame.depth))
}

fn window(pose: &Pose, reach: f64, frame: &RgbdFrame) -> Option<Window> {
    Window::around(&pose.translation.vector.into(), reach, &frame.intrinsics)
}

/// A hypothesis moved by the refiner's raw outputs. The turn is about the object's centre in camera axes.
fn improved(pose: &Pose, step: &Vector3<f64>, turn: &Vector3<f64>, radius: f64) -> Pose {
    // A network that meets an image unlike any other may answer NaN; the hypothesis then stays.
    if !step.iter().chain(turn.iter()).all(|v| v.is_finite()) {
        return *pose;
    }
    // The networks were trained on the transposed rotation.
    let turn = UnitQuaternion::from_scaled_axis(turn.map(|v| -v.tanh() * TURN));
    Pose::from_parts((pose.translation.vector + step * radius).into(), turn * pose.rotation)
}

#[cfg(test)]
#[path = "estimator_tests.rs"]
mod tests;
