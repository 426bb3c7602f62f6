//! FoundationPose behind perception's traits.

use super::{PoseEstimator, PoseFound, Target};
use crate::FoundationError;
use tdv_geometry::Pose;
use tdv_perception::backend::{BackendError, FirstPose, NextPose, PoseEstimate};
use tdv_perception::segment::Mask;
use tdv_perception::{ObjectModel, RgbdFrame};

use super::{Rank, Refine};

const NAME: &str = "foundationpose";

/// The estimator with the targets that it has met, by name.
#[derive(Debug)]
pub struct PoseBackend<R = super::RefineNet, S = super::ScoreNet> {
    estimator: PoseEstimator<R, S>,
    targets: Vec<(String, Target)>,
}

impl<R: Refine, S: Rank> PoseBackend<R, S> {
    /// A backend on loaded networks ([`super::load`]).
    pub fn new(estimator: PoseEstimator<R, S>) -> Self {
        Self { estimator, targets: Vec::new() }
    }

    fn run(
        &mut self,
        model: &ObjectModel,
        f: impl FnOnce(&mut PoseEstimator<R, S>, &Target) -> Result<PoseFound, FoundationError>,
    ) -> Result<PoseEstimate, BackendError> {
        if !self.targets.iter().any(|(n, _)| *n == model.name) {
            let target = Target::new(&model.mesh, &model.symmetry).map_err(failed)?;
            self.targets.push((model.name.clone(), target));
        }
        let Some((_, target)) = self.targets.iter().find(|(n, _)| *n == model.name) else {
            return Err(BackendError::NotFound(format!("{} is no target", model.name)));
        };
        let found = f(&mut self.estimator, target).map_err(failed)?;
        Ok(PoseEstimate { pose: found.pose, confidence: found.agreement })
    }
}

fn failed(e: FoundationError) -> BackendError {
    BackendError::Failed { backend: NAME, source: Box::new(e) }
}

impl<R: Refine + Send, S: Rank + Send> FirstPose for PoseBackend<R, S> {
    fn first_pose(
        &mut self,
        frame: &RgbdFrame,
        mask: &Mask,
        model: &ObjectModel,
    ) -> Result<PoseEstimate, BackendError> {
        self.run(model, |e, target| e.register(frame, |u, v| mask.at(u, v), target))
    }
}

impl<R: Refine + Send, S: Rank + Send> NextPose for PoseBackend<R, S> {
    fn next_pose(
        &mut self,
        frame: &RgbdFrame,
        model: &ObjectModel,
        last: &Pose,
    ) -> Result<PoseEstimate, BackendError> {
        self.run(model, |e, target| e.follow(frame, target, last))
    }
}
