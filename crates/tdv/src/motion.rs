//! What a trial recorded, as the evaluation takes it.

use tdv_evaluation::{MotionSample, PredictedPath};
use tdv_geometry::{Pose, Stamp};
use tdv_runtime::tracked;
use tdv_runtime::trial::TrialOutcome;

/// The true joints.
pub fn samples(outcome: &TrialOutcome) -> Vec<MotionSample> {
    outcome
        .motion
        .iter()
        .filter_map(|m| {
            let first6 = |v: &[f64]| <[f64; 6]>::try_from(v.get(..6)?).ok();
            let (q, qd) = (first6(&m.position)?, first6(&m.velocity)?);
            Some(MotionSample { stamp: tracked::stamp(&m.header), q, qd })
        })
        .collect()
}

/// The predictions as tool paths; those of a held object by its pose in the gripper.
pub fn predictions(outcome: &TrialOutcome) -> Vec<PredictedPath> {
    let attached = |at: Stamp| {
        let known = outcome.attachments.partition_point(|(stamp, _)| *stamp <= at);
        known.checked_sub(1).map(|i| outcome.attachments[i].1)
    };
    outcome
        .predictions
        .iter()
        .filter_map(|(received, m)| {
            let to_tool = match m.moving.as_str() {
                "tcp" => Pose::identity(),
                _ => attached(tracked::stamp(&m.header))?.inverse(),
            };
            let reference = tracked::pose(&m.reference_pose).ok()?;
            let line = std::iter::once(&m.moving_pose).chain(&m.poses);
            let tool = line
                .map(|p| tracked::pose(p).map(|p| reference * p * to_tool))
                .collect::<Result<Vec<Pose>, _>>()
                .ok()?;
            Some(PredictedPath { received: *received, tool })
        })
        .collect()
}
