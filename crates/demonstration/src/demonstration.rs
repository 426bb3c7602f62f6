use crate::{Canonical, DemonstrationError, file};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::nalgebra::Point3;
use tdv_geometry::{Pose, PoseTrajectory, Stamp, Symmetry};

/// What was seen in one frame of a recording, everything in `base_link` (m).
#[derive(Debug, Clone, PartialEq)]
pub struct FrameObservation {
    /// When the frame was taken.
    pub stamp: Stamp,
    /// Object name -> (`T_base_object`, confidence 0..1).
    pub objects: BTreeMap<String, (Pose, f64)>,
    /// 21 hand joints, OpenPose order unless [`crate::RemapConfig`] says otherwise.
    pub hand: Option<[Point3<f64>; 21]>,
}

/// One procedure of a demonstration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcedureDemo {
    /// `reach`, `place` or `follow`.
    pub name: String,
    /// The frame that moves: an object's name or `tcp`.
    pub moving: String,
    /// The frame it is seen from.
    pub reference: String,
    /// `T_reference_moving`, stamps counted from the procedure's start; ends at the goal pose.
    pub trajectory: PoseTrajectory,
    /// Rotations of the moving frame that change nothing.
    #[serde(default)]
    pub moving_symmetry: Symmetry,
    /// Rotations of the reference frame that change nothing.
    #[serde(default)]
    pub reference_symmetry: Symmetry,
}

impl ProcedureDemo {
    /// The last pose of the procedure, `T_reference_moving`.
    pub fn goal(&self) -> Pose {
        self.trajectory.last().pose
    }

    /// The rule that makes poses of this procedure unique.
    pub fn canonical(&self) -> Canonical {
        Canonical::new(self.goal(), self.moving_symmetry.clone(), self.reference_symmetry.clone())
    }
}

/// A parsed demonstration: noise, dwell and gaps are gone, both ends are where objects can rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Demonstration {
    /// Name of the task.
    pub task: String,
    /// Its instruction in words.
    pub text: String,
    /// The procedures in order.
    pub procedures: Vec<ProcedureDemo>,
    /// `T_object_tcp` of the grasp; none for a hand task.
    pub grasp: Option<Pose>,
    /// The object's width between the fingers (m), if the task knows it.
    pub grasp_width: Option<f64>,
    /// `T_base_reference` during the demonstration, in its canonical orientation.
    pub reference_pose: Pose,
    /// `T_base_object` before the grasp; none for a hand task.
    pub object_start: Option<Pose>,
}

impl Demonstration {
    /// Writes JSON, whole or not at all.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`], [`DemonstrationError::Format`].
    pub fn save(&self, path: &Path) -> Result<(), DemonstrationError> {
        let text = serde_json::to_string_pretty(self).map_err(|e| DemonstrationError::Format {
            path: path.to_path_buf(),
            reason: e.to_string(),
        })?;
        file::write_atomically(path, text.as_bytes())
    }

    /// Reads what [`Demonstration::save`] wrote.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`], [`DemonstrationError::Format`] (naming the place in the file).
    pub fn load(path: &Path) -> Result<Self, DemonstrationError> {
        let format = |reason| DemonstrationError::Format { path: path.to_path_buf(), reason };
        let demo: Self =
            serde_json::from_str(&file::read(path)?).map_err(|e| format(e.to_string()))?;
        if demo.procedures.is_empty() {
            return Err(format("no procedure in it".into()));
        }
        Ok(demo)
    }

    /// The procedure of that name.
    pub fn procedure(&self, name: &str) -> Option<&ProcedureDemo> {
        self.procedures.iter().find(|p| p.name == name)
    }

    /// Identity of the content, 16 hexadecimal digits.
    pub fn hash(&self) -> String {
        let mut h = file::Fnv::new();
        h.text(&self.task);
        h.text(&self.text);
        for p in &self.procedures {
            for t in [&p.name, &p.moving, &p.reference] {
                h.text(t);
            }
            for q in p.trajectory.points() {
                h.bytes(&q.stamp.0.to_le_bytes());
                hash_pose(&mut h, &q.pose);
            }
        }
        for p in self.grasp.iter().chain([&self.reference_pose]).chain(&self.object_start) {
            hash_pose(&mut h, p);
        }
        h.hex()
    }
}

pub(crate) fn hash_pose(h: &mut file::Fnv, pose: &Pose) {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).for_each(|v| h.number(*v));
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    pub(crate) fn example() -> Demonstration {
        let poses: Vec<_> = (0..20)
            .map(|i| {
                pose_from_xyz_rpy([0.01 * f64::from(i), 0.1, 0.2 / 3.0], [0.1, 0.03, f64::from(i)])
            })
            .collect();
        Demonstration {
            task: "t".into(),
            text: "do it".into(),
            procedures: vec![ProcedureDemo {
                name: "place".into(),
                moving: "mug".into(),
                reference: "coaster".into(),
                trajectory: PoseTrajectory::from_poses(&poses, 1.0 / 30.0).unwrap(),
                moving_symmetry: Symmetry::None,
                reference_symmetry: Symmetry::None,
            }],
            grasp: Some(poses[3]),
            grasp_width: Some(0.064),
            reference_pose: poses[1],
            object_start: None,
        }
    }

    #[test]
    fn file_round_trip_is_exact() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.json");
        let d = example();
        d.save(&path).unwrap();
        let back = Demonstration::load(&path).unwrap();
        assert_eq!(back, d);
        assert_eq!(back.hash(), d.hash());
        let mut other = d.clone();
        other.text.push('!');
        assert_ne!(other.hash(), d.hash());
    }

    #[test]
    fn broken_files_name_themselves() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("d.json");
        assert!(Demonstration::load(&path).unwrap_err().to_string().contains("d.json"));
        std::fs::write(&path, "{\"task\": \"t\"").unwrap();
        assert!(matches!(Demonstration::load(&path), Err(DemonstrationError::Format { .. })));
    }
}
