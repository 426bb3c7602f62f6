use crate::demonstration::hash_pose;
use crate::{Canonical, DemonstrationError, GenerationMode, file};
use serde::{Deserialize, Serialize};
use std::path::Path;
use tdv_geometry::nalgebra::{Quaternion, Translation3, UnitQuaternion};
use tdv_geometry::{Pose, PoseTrajectory, Symmetry};

/// Noise to be added to the pose history in training (one sigma).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HistoryNoise {
    /// m, each axis.
    pub position: f64,
    /// rad, each axis.
    pub angle: f64,
}

/// The trajectories of one procedure.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcedureSet {
    /// `reach`, `place` or `follow`.
    pub name: String,
    /// The frame that moves.
    pub moving: String,
    /// The frame it is seen from.
    pub reference: String,
    /// `T_reference_moving` where every trajectory ends (in mode paper: where it should).
    pub goal: Pose,
    /// Rotations of the moving frame that change nothing.
    pub moving_symmetry: Symmetry,
    /// Rotations of the reference frame that change nothing.
    pub reference_symmetry: Symmetry,
    /// `T_reference_moving`, uniform steps of [`Dataset::dt`], canonical (see [`Canonical`]); the last
    /// pose is repeated at the end, so that standing still is learned.
    pub trajectories: Vec<PoseTrajectory>,
}

impl ProcedureSet {
    /// The rule by which the poses were made unique; live poses must go through the same.
    pub fn canonical(&self) -> Canonical {
        Canonical::new(self.goal, self.moving_symmetry.clone(), self.reference_symmetry.clone())
    }
}

/// A training set: one [`ProcedureSet`] per procedure, in order.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Name of the task.
    pub task: String,
    /// Its instruction in words.
    pub text: String,
    /// Which warp made it.
    pub mode: GenerationMode,
    /// The seed it was made with.
    pub seed: u64,
    /// Hash of the demonstration it was made from.
    pub demonstration: String,
    /// Seconds between samples.
    pub dt: f64,
    /// What to add to histories in training.
    pub noise: HistoryNoise,
    /// The procedures.
    pub procedures: Vec<ProcedureSet>,
}

const FORMAT: &str = "tdv-dataset-1";

/// File form: a pose is x, y, z, qx, qy, qz, qw.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct DatasetFile {
    format: String,
    task: String,
    text: String,
    mode: GenerationMode,
    seed: u64,
    demonstration: String,
    dt: f64,
    noise: HistoryNoise,
    hash: String,
    procedures: Vec<ProcedureFile>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProcedureFile {
    name: String,
    moving: String,
    reference: String,
    goal: [f64; 7],
    moving_symmetry: Symmetry,
    reference_symmetry: Symmetry,
    trajectories: Vec<Vec<[f64; 7]>>,
}

fn pack(p: &Pose) -> [f64; 7] {
    let ([x, y, z], [i, j, k, w]) = tdv_geometry::pose_to_xyz_quat(p);
    [x, y, z, i, j, k, w]
}

/// Exact inverse of [`pack`]: no renormalisation, so that a file read back hashes the same.
fn unpack(v: &[f64; 7]) -> Result<Pose, String> {
    let q = Quaternion::new(v[6], v[3], v[4], v[5]);
    if !(1.0 - 1e-6..1.0 + 1e-6).contains(&q.norm()) || !v.iter().all(|x| x.is_finite()) {
        return Err(format!("{v:?} is not a pose x, y, z, qx, qy, qz, qw"));
    }
    Ok(Pose::from_parts(Translation3::new(v[0], v[1], v[2]), UnitQuaternion::new_unchecked(q)))
}

impl Dataset {
    /// Identity of the content, 16 hexadecimal digits.
    pub fn hash(&self) -> String {
        let mut h = file::Fnv::new();
        for t in [&self.task, &self.text, &self.demonstration] {
            h.text(t);
        }
        h.bytes(&[self.mode as u8]);
        h.bytes(&self.seed.to_le_bytes());
        for x in [self.dt, self.noise.position, self.noise.angle] {
            h.number(x);
        }
        for p in &self.procedures {
            for t in [&p.name, &p.moving, &p.reference] {
                h.text(t);
            }
            hash_pose(&mut h, &p.goal);
            for t in &p.trajectories {
                h.bytes(&(t.len() as u64).to_le_bytes());
                t.poses().for_each(|q| hash_pose(&mut h, q));
            }
        }
        h.hex()
    }

    /// The bytes of the file; the same set gives the same bytes.
    ///
    /// # Errors
    /// [`DemonstrationError::Format`] if a number cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DemonstrationError> {
        let file = DatasetFile {
            format: FORMAT.into(),
            task: self.task.clone(),
            text: self.text.clone(),
            mode: self.mode,
            seed: self.seed,
            demonstration: self.demonstration.clone(),
            dt: self.dt,
            noise: self.noise,
            hash: self.hash(),
            procedures: self
                .procedures
                .iter()
                .map(|p| ProcedureFile {
                    name: p.name.clone(),
                    moving: p.moving.clone(),
                    reference: p.reference.clone(),
                    goal: pack(&p.goal),
                    moving_symmetry: p.moving_symmetry.clone(),
                    reference_symmetry: p.reference_symmetry.clone(),
                    trajectories: p
                        .trajectories
                        .iter()
                        .map(|t| t.poses().map(pack).collect())
                        .collect(),
                })
                .collect(),
        };
        serde_json::to_vec(&file).map_err(|e| DemonstrationError::Format {
            path: "dataset".into(),
            reason: e.to_string(),
        })
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`], [`DemonstrationError::Format`].
    pub fn save(&self, path: &Path) -> Result<(), DemonstrationError> {
        file::write_atomically(path, &self.to_bytes()?)
    }

    /// Reads what [`Dataset::save`] wrote and checks its hash.
    ///
    /// # Errors
    /// [`DemonstrationError::Io`]; [`DemonstrationError::Format`] for another format, broken numbers or a
    /// hash that does not fit the content.
    pub fn load(path: &Path) -> Result<Self, DemonstrationError> {
        let format = |reason| DemonstrationError::Format { path: path.to_path_buf(), reason };
        let f: DatasetFile =
            serde_json::from_str(&file::read(path)?).map_err(|e| format(e.to_string()))?;
        if f.format != FORMAT {
            return Err(format(format!("format '{}', expected '{FORMAT}'", f.format)));
        }
        let mut procedures = Vec::new();
        for p in f.procedures {
            let mut trajectories = Vec::new();
            for (i, t) in p.trajectories.iter().enumerate() {
                let poses: Vec<_> = t
                    .iter()
                    .map(unpack)
                    .collect::<Result<_, _>>()
                    .map_err(|e| format(format!("procedure {} trajectory {i}: {e}", p.name)))?;
                trajectories
                    .push(PoseTrajectory::from_poses(&poses, f.dt).map_err(|e| {
                        format(format!("procedure {} trajectory {i}: {e}", p.name))
                    })?);
            }
            procedures.push(ProcedureSet {
                goal: unpack(&p.goal).map_err(|e| format(format!("procedure {}: {e}", p.name)))?,
                name: p.name,
                moving: p.moving,
                reference: p.reference,
                moving_symmetry: p.moving_symmetry,
                reference_symmetry: p.reference_symmetry,
                trajectories,
            });
        }
        let set = Self {
            task: f.task,
            text: f.text,
            mode: f.mode,
            seed: f.seed,
            demonstration: f.demonstration,
            dt: f.dt,
            noise: f.noise,
            procedures,
        };
        let hash = set.hash();
        if hash != f.hash {
            return Err(format(format!(
                "content hashes to {hash}, the file says {}: it was changed or damaged",
                f.hash
            )));
        }
        Ok(set)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    fn example() -> Dataset {
        let poses: Vec<_> = (0..50)
            .map(|i| {
                let i = f64::from(i);
                pose_from_xyz_rpy([0.1 / 3.0 * i, i.sin(), 0.7], [0.01 * i, 0.3, 0.2 * i])
            })
            .collect();
        let t = PoseTrajectory::from_poses(&poses, 0.05).unwrap();
        Dataset {
            task: "t".into(),
            text: "x".into(),
            mode: GenerationMode::Repaired,
            seed: 7,
            demonstration: "00".into(),
            dt: 0.05,
            noise: HistoryNoise { position: 0.002, angle: 0.01 },
            procedures: vec![ProcedureSet {
                name: "place".into(),
                moving: "mug".into(),
                reference: "coaster".into(),
                goal: t.last().pose,
                moving_symmetry: crate::gripper_symmetry(),
                reference_symmetry: Symmetry::None,
                trajectories: vec![t.clone(), t],
            }],
        }
    }

    #[test]
    fn round_trip_is_exact_and_damage_is_seen() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("set.json");
        let set = example();
        set.save(&path).unwrap();
        let back = Dataset::load(&path).unwrap();
        assert_eq!(back, set);
        assert_eq!(back.to_bytes().unwrap(), set.to_bytes().unwrap());
        let text = std::fs::read_to_string(&path).unwrap().replacen("0.7,", "0.71,", 1);
        std::fs::write(&path, text).unwrap();
        assert!(Dataset::load(&path).unwrap_err().to_string().contains("damaged"));
        std::fs::write(&path, "{}").unwrap();
        assert!(matches!(Dataset::load(&path), Err(DemonstrationError::Format { .. })));
    }
}
