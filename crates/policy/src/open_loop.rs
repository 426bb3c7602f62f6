//! The control experiment without feedback: look once, bend the demonstration to what was seen, play it.

use crate::Observation;
use std::collections::BTreeMap;
use tdv_demonstration::{Demonstration, DemonstrationError, Task, bend_to};
use tdv_geometry::{Pose, pose_distance};
use thiserror::Error;

/// Samples of the trajectory among which the present pose is looked for, so that play only goes forward.
const WINDOW: usize = 12;
/// Metres that a radian counts for when the present pose is looked for.
const REACH: f64 = 0.1;

/// Why nothing is played.
#[derive(Debug, Error)]
pub enum OpenLoopError {
    /// Not every reference object has been seen yet.
    #[error("no usable pose of `{0}`")]
    NotSeen(String),
    /// The demonstration cannot be bent to the start.
    #[error(transparent)]
    Bend(#[from] DemonstrationError),
}

struct Play {
    procedure: usize,
    poses: Vec<Pose>,
    at: usize,
}

/// Plays the demonstrated trajectory, bent to the first look at the scene. The reference objects are
/// where they were then; how far the play has come is measured on the moving frame, which once grasped
/// hangs on the arm and is known from its joints.
pub struct OpenLoop {
    demonstration: Demonstration,
    task: Task,
    horizon: usize,
    seen: BTreeMap<String, Pose>,
    play: Option<Play>,
}

impl OpenLoop {
    /// Gives `horizon` poses at a time, `task.generation.retime.dt` apart.
    pub fn new(demonstration: Demonstration, task: Task, horizon: usize) -> Self {
        Self { demonstration, task, horizon, seen: BTreeMap::new(), play: None }
    }

    /// Keeps the reference objects' poses `T_base_object` of the first instant in which all are there.
    ///
    /// # Errors
    /// [`OpenLoopError::NotSeen`].
    pub fn look(&mut self, pose_of: impl Fn(&str) -> Option<Pose>) -> Result<(), OpenLoopError> {
        if self.seen.is_empty() {
            self.seen = self
                .demonstration
                .procedures
                .iter()
                .map(|p| {
                    let pose = pose_of(&p.reference)
                        .ok_or_else(|| OpenLoopError::NotSeen(p.reference.clone()))?;
                    Ok((p.reference.clone(), pose))
                })
                .collect::<Result<_, OpenLoopError>>()?;
        }
        Ok(())
    }

    /// `T_base_frame` as this control believes it: references as first seen, the moving frame as it is.
    pub fn believed(&self, procedure: usize, name: &str, now: Option<Pose>) -> Option<Pose> {
        let reference = self.demonstration.procedures.get(procedure).map(|p| p.reference.as_str());
        if reference == Some(name) { self.seen.get(name).copied() } else { now }
    }

    /// The canonical poses that follow.
    ///
    /// # Errors
    /// [`OpenLoopError::Bend`].
    pub fn plan(&mut self, seen: &Observation) -> Result<Vec<Pose>, OpenLoopError> {
        let now = seen.canonical_pose();
        if self.play.as_ref().is_none_or(|p| p.procedure != seen.procedure) {
            let bent = bend_to(&self.demonstration, &self.task, seen.procedure, &now)?;
            self.play = Some(Play {
                procedure: seen.procedure,
                poses: bent.poses().copied().collect(),
                at: 0,
            });
        }
        let Some(play) = &mut self.play else { return Ok(Vec::new()) };
        let last = play.poses.len() - 1;
        let distance = |i: &usize| {
            let (d, a) = pose_distance(&play.poses[*i], &now);
            d + REACH * a
        };
        let nearest = (play.at..=(play.at + WINDOW).min(last))
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        play.at = nearest.unwrap_or(play.at);
        Ok((1..=self.horizon).map(|k| play.poses[(play.at + k).min(last)]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HistoryConfig, Observer};
    use std::path::Path;
    use tdv_demonstration::{ProcedureDemo, gripper_symmetry};
    use tdv_geometry::{PoseTrajectory, Stamp, Symmetry, pose_from_xyz_rpy};

    fn demonstration() -> Demonstration {
        let grasp = pose_from_xyz_rpy([0.0, 0.0, 0.05], [std::f64::consts::PI, 0.0, 0.0]);
        let above = pose_from_xyz_rpy([0.1, 0.1, 0.3], [std::f64::consts::PI, 0.0, 0.4]);
        Demonstration {
            task: "cup_on_coaster".into(),
            text: "put the mug on the coaster".into(),
            procedures: vec![ProcedureDemo {
                name: "reach".into(),
                moving: "tcp".into(),
                reference: "mug".into(),
                trajectory: PoseTrajectory::from_poses(&[above, grasp], 0.05).unwrap(),
                moving_symmetry: gripper_symmetry(),
                reference_symmetry: Symmetry::None,
                end: tdv_demonstration::GripperEnd::Close,
                reference_pose: None,
            }],
            grasp: Some(grasp),
            grasp_width: None,
            reference_pose: pose_from_xyz_rpy([0.5, -0.2, 0.0], [0.0; 3]),
            object_start: Some(pose_from_xyz_rpy([0.4, 0.1, 0.0], [0.0; 3])),
        }
    }

    /// Distance (m) of the tool from the grasp at the end, the mug being moved by `shift` after 0.5 s.
    fn end_error(shift: f64) -> f64 {
        let task =
            Task::load(Path::new("../../config/tasks/cup_on_coaster.yaml")).expect("the task");
        let demonstration = demonstration();
        let dt = task.generation.retime.dt;
        let mut observer =
            Observer::new(&demonstration, HistoryConfig { length: 4, dt, max_gap: 0.5 }).unwrap();
        let mut control = OpenLoop::new(demonstration.clone(), task, 8);
        let mut tool = pose_from_xyz_rpy([0.45, -0.1, 0.35], [std::f64::consts::PI, 0.0, 1.0]);
        let mut mug = pose_from_xyz_rpy([0.4, 0.15, 0.0], [0.0, 0.0, 0.3]);
        for i in 0..400_i64 {
            if i == 10 {
                mug.translation.x += shift;
            }
            let pose_of = |name: &str| match name {
                "tcp" => Some(tool),
                _ => Some(mug),
            };
            control.look(pose_of).unwrap();
            let stamp = Stamp::from_secs(1.0 + i as f64 * dt);
            let seen = observer.observe(stamp, 0, |n| control.believed(0, n, pose_of(n))).unwrap();
            let plan = seen.undo(&control.plan(&seen).unwrap());
            tool = seen.reference_pose * plan[0];
        }
        pose_distance(&(mug * demonstration.procedures[0].goal()), &tool).0
    }

    #[test]
    fn it_arrives_where_nothing_changes_and_misses_what_was_moved() {
        assert!(end_error(0.0) < 1e-6, "{}", end_error(0.0));
        let miss = end_error(0.08);
        assert!((miss - 0.08).abs() < 1e-6, "{miss}");
    }

    #[test]
    fn what_is_not_in_view_is_named() {
        let task =
            Task::load(Path::new("../../config/tasks/cup_on_coaster.yaml")).expect("the task");
        let mut control = OpenLoop::new(demonstration(), task, 8);
        let e = control.look(|_| None).unwrap_err();
        assert!(e.to_string().contains("mug"), "{e}");
    }
}
