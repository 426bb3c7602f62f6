//! From tracked poses to what a policy sees: the history of the moving frame in the reference frame of
//! the procedure that is on, in the canonical variant that the training set was made in.

use crate::{HistoryBuffer, HistoryConfig, HistoryError, Pushed};
use tdv_demonstration::{Canonical, Demonstration, Variant};
use tdv_geometry::{Pose, Stamp};
use thiserror::Error;

/// Why there is no observation.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ObserverError {
    /// The procedure number is not one of the demonstration's.
    #[error(
        "procedure {procedure} of {count}: the switch policy and the demonstration do not belong together"
    )]
    Procedure {
        /// As asked for.
        procedure: usize,
        /// How many there are.
        count: usize,
    },
    /// A frame has no pose that may be used.
    #[error("no usable pose of `{0}`")]
    Missing(String),
    /// The pose does not fit the history.
    #[error(transparent)]
    History(#[from] HistoryError),
}

/// What a policy is given.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Stamp of the newest pose.
    pub stamp: Stamp,
    /// The procedure it is for.
    pub procedure: usize,
    /// Canonical `T_reference_moving`, oldest first, equally spaced in time; the last is the newest.
    pub history: Vec<Pose>,
    /// `T_base_reference` of the newest pose.
    pub reference_pose: Pose,
    /// `T_reference_moving` as observed.
    pub moving_pose: Pose,
    /// How observed and canonical poses belong together.
    pub variant: Variant,
}

struct Procedure {
    name: String,
    moving: String,
    reference: String,
    canonical: Canonical,
}

/// Keeps the history of the current procedure.
pub struct Observer {
    procedures: Vec<Procedure>,
    current: Option<usize>,
    variant: Option<Variant>,
    history: HistoryBuffer,
}

impl Observer {
    /// For the procedures of a demonstration.
    ///
    /// # Errors
    /// [`HistoryError::Config`].
    pub fn new(
        demonstration: &Demonstration,
        history: HistoryConfig,
    ) -> Result<Self, HistoryError> {
        let procedures = demonstration
            .procedures
            .iter()
            .map(|p| Procedure {
                name: p.name.clone(),
                moving: p.moving.clone(),
                reference: p.reference.clone(),
                canonical: p.canonical(),
            })
            .collect();
        Ok(Self { procedures, current: None, variant: None, history: HistoryBuffer::new(history)? })
    }

    /// Number of procedures.
    pub fn count(&self) -> usize {
        self.procedures.len()
    }

    /// Name, moving frame and reference frame of a procedure.
    pub fn names(&self, procedure: usize) -> Option<(&str, &str, &str)> {
        self.procedures
            .get(procedure)
            .map(|p| (p.name.as_str(), p.moving.as_str(), p.reference.as_str()))
    }

    /// Forgets the history.
    pub fn reset(&mut self) {
        self.current = None;
        self.variant = None;
        self.history.reset();
    }

    /// Takes in the poses of one instant; `pose_of` gives `T_base_frame` of a tracked frame by name, or
    /// none when it must not be relied on. A change of the procedure starts a new history.
    ///
    /// # Errors
    /// [`ObserverError`]; the history is as before.
    pub fn observe(
        &mut self,
        stamp: Stamp,
        procedure: usize,
        pose_of: impl Fn(&str) -> Option<Pose>,
    ) -> Result<Observation, ObserverError> {
        let count = self.procedures.len();
        let p =
            self.procedures.get(procedure).ok_or(ObserverError::Procedure { procedure, count })?;
        let find =
            |name: &str| pose_of(name).ok_or_else(|| ObserverError::Missing(name.to_owned()));
        let reference_pose = find(&p.reference)?;
        let moving_pose = reference_pose.inverse() * find(&p.moving)?;
        if self.current != Some(procedure) {
            self.current = Some(procedure);
            self.variant = None;
            self.history.reset();
        }
        if let Pushed::Restarted { .. } = self.history.push(stamp, &moving_pose)? {
            self.variant = None;
        }
        let variant = p.canonical.choose(&moving_pose, self.variant);
        self.variant = Some(variant);
        let history =
            self.history.poses().unwrap_or_default().iter().map(|q| variant.apply(q)).collect();
        Ok(Observation { stamp, procedure, history, reference_pose, moving_pose, variant })
    }
}

impl Observation {
    /// A plan of canonical poses as the robot is to follow it.
    pub fn undo(&self, plan: &[Pose]) -> Vec<Pose> {
        plan.iter().map(|p| self.variant.undo(p)).collect()
    }

    /// The newest pose in its canonical variant.
    pub fn canonical_pose(&self) -> Pose {
        self.variant.apply(&self.moving_pose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use tdv_demonstration::{ProcedureDemo, gripper_symmetry};
    use tdv_geometry::{PoseTrajectory, Symmetry, pose_distance, pose_from_xyz_rpy};

    fn observer() -> Observer {
        let demo = |name: &str, moving: &str, reference: &str, symmetry| ProcedureDemo {
            name: name.into(),
            moving: moving.into(),
            reference: reference.into(),
            trajectory: PoseTrajectory::from_poses(&[Pose::identity()], 0.05).unwrap(),
            moving_symmetry: symmetry,
            reference_symmetry: Symmetry::None,
            end: tdv_demonstration::GripperEnd::of_name(name),
            reference_pose: None,
        };
        let demonstration = Demonstration {
            task: "t".into(),
            text: "t".into(),
            procedures: vec![
                demo("reach", "tcp", "mug", gripper_symmetry()),
                demo("place", "mug", "coaster", Symmetry::None),
            ],
            grasp: None,
            grasp_width: None,
            reference_pose: Pose::identity(),
            object_start: None,
        };
        let history = HistoryConfig { length: 4, dt: 0.05, max_gap: 0.5 };
        Observer::new(&demonstration, history).unwrap()
    }

    fn poses() -> BTreeMap<&'static str, Pose> {
        BTreeMap::from([
            ("tcp", pose_from_xyz_rpy([0.4, 0.0, 0.3], [0.0, 0.0, 3.0])),
            ("mug", pose_from_xyz_rpy([0.4, 0.0, 0.0], [0.0; 3])),
            ("coaster", pose_from_xyz_rpy([0.5, -0.2, 0.0], [0.0; 3])),
        ])
    }

    #[test]
    fn half_turned_gripper_is_seen_canonical_and_the_plan_goes_back() {
        let (mut o, poses) = (observer(), poses());
        let seen = o.observe(Stamp(1), 0, |n| poses.get(n).copied()).unwrap();
        assert_eq!(seen.history.len(), 4);
        assert!(seen.canonical_pose().rotation.angle() < 0.2, "turned to the demonstrated side");
        let back = seen.undo(&[seen.canonical_pose()]);
        let (d, a) = pose_distance(&back[0], &seen.moving_pose);
        assert!(d < 1e-12 && a < 1e-9);
    }

    #[test]
    fn a_new_procedure_starts_a_new_history_and_missing_poses_are_named() {
        let (mut o, mut poses) = (observer(), poses());
        o.observe(Stamp(1), 0, |n| poses.get(n).copied()).unwrap();
        let place = o.observe(Stamp(2), 1, |n| poses.get(n).copied()).unwrap();
        assert!(place.history.iter().all(|p| *p == place.history[0]));
        poses.remove("coaster");
        let e = o.observe(Stamp(3), 1, |n| poses.get(n).copied()).unwrap_err();
        assert_eq!(e, ObserverError::Missing("coaster".into()));
        assert!(matches!(
            o.observe(Stamp(4), 2, |n| poses.get(n).copied()),
            Err(ObserverError::Procedure { .. })
        ));
    }
}
