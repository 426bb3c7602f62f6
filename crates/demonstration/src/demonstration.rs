use crate::sequence::{self, Role, Step};
use crate::{Canonical, DemonstrationError, GripperEnd, Hold, file};
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
#[serde(from = "ProcedureFile")]
pub struct ProcedureDemo {
    /// As in the task: `reach`, `place`, `follow` unless it lists its own.
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
    /// What the gripper does at the end.
    pub end: GripperEnd,
    /// `T_base_reference` during the procedure, where it is not the demonstration's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference_pose: Option<Pose>,
}

/// File form: older files do not say what the gripper does, the procedure's name does.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProcedureFile {
    name: String,
    moving: String,
    reference: String,
    trajectory: PoseTrajectory,
    #[serde(default)]
    moving_symmetry: Symmetry,
    #[serde(default)]
    reference_symmetry: Symmetry,
    end: Option<GripperEnd>,
    #[serde(default)]
    reference_pose: Option<Pose>,
}

impl From<ProcedureFile> for ProcedureDemo {
    fn from(f: ProcedureFile) -> Self {
        Self {
            end: f.end.unwrap_or_else(|| GripperEnd::of_name(&f.name)),
            name: f.name,
            moving: f.moving,
            reference: f.reference,
            trajectory: f.trajectory,
            moving_symmetry: f.moving_symmetry,
            reference_symmetry: f.reference_symmetry,
            reference_pose: f.reference_pose,
        }
    }
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
    /// `T_object_tcp` of the first grasp; none for a hand task. Later ones: [`Demonstration::grasp_of`].
    pub grasp: Option<Pose>,
    /// The object's width between the fingers (m), if the task knows it.
    pub grasp_width: Option<f64>,
    /// `T_base_reference` of the task's reference object, in its canonical orientation.
    pub reference_pose: Pose,
    /// `T_base_object` before the first grasp; none for a hand task.
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

    fn steps(&self) -> Vec<Step<'_>> {
        self.procedures
            .iter()
            .map(|p| Step { moving: &p.moving, reference: &p.reference, end: p.end })
            .collect()
    }

    /// What is held during each procedure, in order.
    pub fn holds(&self) -> Vec<Hold> {
        sequence::holds(&self.steps())
    }

    /// The procedure to begin again with when `procedure` fails: the one that grasps what it presupposes,
    /// else itself.
    pub fn retry_from(&self, procedure: usize) -> usize {
        let hold = self.holds().into_iter().nth(procedure);
        hold.map_or(0, |h| if h.grip { h.grasped_by.unwrap_or(0) } else { procedure })
    }

    pub(crate) fn role(&self, procedure: usize) -> Role {
        sequence::role(&self.steps(), procedure)
    }

    /// `T_object_tcp` while the object of procedure `procedure` is carried; none where none is.
    pub fn grasp_of(&self, procedure: usize) -> Option<Pose> {
        let moving = &self.procedures.get(procedure)?.moving;
        if moving == sequence::TCP {
            return None;
        }
        let by = self.holds().get(procedure)?.grasped_by;
        by.map(|g| self.procedures[g].goal()).or(self.grasp)
    }

    /// `T_base_reference` during a procedure, see [`ProcedureDemo::reference_pose`].
    pub fn reference_of(&self, procedure: usize) -> Pose {
        let own = self.procedures.get(procedure).and_then(|p| p.reference_pose);
        own.unwrap_or(self.reference_pose)
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
            // Files from before this was written keep their identity.
            if p.end != GripperEnd::of_name(&p.name) {
                h.bytes(&[p.end as u8]);
            }
            if let Some(pose) = &p.reference_pose {
                hash_pose(&mut h, pose);
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
                end: GripperEnd::Open,
                reference_pose: None,
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
    fn older_files_say_by_the_name_what_the_gripper_does() {
        let text = serde_json::to_string(&example()).unwrap();
        assert!(text.contains(r#""end":"open""#));
        let old = text.replace(r#","end":"open""#, "");
        assert_eq!(serde_json::from_str::<Demonstration>(&old).unwrap(), example());
        let follow = old.replace(r#""name":"place""#, r#""name":"follow""#);
        let follow: Demonstration = serde_json::from_str(&follow).unwrap();
        assert_eq!(follow.procedures[0].end, GripperEnd::None);
        assert!(
            serde_json::from_str::<Demonstration>(&text.replace("\"end\"", "\"ende\"")).is_err()
        );
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
