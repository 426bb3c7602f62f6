//! The object catalogue's files: `object.yaml` and the mesh beside it.

use crate::mesh::{Mesh, MeshError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use tdv_geometry::{GeometryError, Pose, Symmetry, pose_from_xyz_rpy};
use thiserror::Error;

/// Why an object's folder was refused.
#[derive(Debug, Error)]
pub enum ObjectError {
    /// The yaml file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The yaml file does not have the fields it should.
    #[error("{path}: {reason}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What the parser said, with the line.
        reason: String,
    },
    /// A field holds a value that makes no sense.
    #[error("{path}: {field} {reason}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Which field.
        field: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The mesh was refused.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// Shape of one convex part; sizes in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum PartShape {
    /// A box by its half edge lengths.
    Box {
        /// Half of the edge lengths along x, y, z.
        half_extents: [f64; 3],
    },
    /// A cylinder along the part's z axis, its middle at the part's origin.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Full height.
        height: f64,
    },
}

/// One convex part of an object's collision shape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CollisionPart {
    /// Its shape.
    pub shape: PartShape,
    /// Position of the part's origin in the object frame (m).
    #[serde(default)]
    pub xyz: [f64; 3],
    /// Fixed-axis roll, pitch, yaw of the part in the object frame (rad).
    #[serde(default)]
    pub rpy: [f64; 3],
}

impl CollisionPart {
    /// T_object_part.
    pub fn pose(&self) -> Pose {
        pose_from_xyz_rpy(self.xyz, self.rpy)
    }
}

/// Contents of `config/objects/NAME/object.yaml`. Lengths in metres, masses in kg, colours sRGB.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectFile {
    /// The object's name, that of its folder.
    pub name: String,
    /// Other words for it.
    #[serde(default)]
    pub synonyms: Vec<String>,
    /// Colour words that fit it.
    #[serde(default)]
    pub colors: Vec<String>,
    /// Mesh file, relative to the folder.
    pub mesh: String,
    /// Mesh by which a camera knows it, where something belongs to it that is no part of it: a cabinet
    /// with its drawer shut. Relative to the folder; none: `mesh`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen: Option<String>,
    /// Rotations that leave it looking the same.
    #[serde(default)]
    pub symmetry: Symmetry,
    /// Mass (kg).
    pub mass: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Its main colours, the largest first.
    #[serde(default)]
    pub palette: Vec<[u8; 3]>,
    /// Convex parts for physics and collision checking.
    pub collision: Vec<CollisionPart>,
}

impl ObjectFile {
    /// Reads `dir/object.yaml` and checks every field.
    ///
    /// # Errors
    /// [`ObjectError`] other than `Mesh`.
    pub fn load(dir: &Path) -> Result<Self, ObjectError> {
        let path = dir.join("object.yaml");
        let text = std::fs::read_to_string(&path)
            .map_err(|source| ObjectError::Io { path: path.clone(), source })?;
        let object: Self = serde_saphyr::from_str(&text)
            .map_err(|e| ObjectError::Parse { path: path.clone(), reason: e.to_string() })?;
        object.check(&path)?;
        Ok(object)
    }

    /// Checks every field and writes `dir/object.yaml`, with `comment` as its first lines.
    ///
    /// # Errors
    /// [`ObjectError`] other than `Mesh`.
    pub fn save(&self, dir: &Path, comment: &str) -> Result<(), ObjectError> {
        let path = dir.join("object.yaml");
        self.check(&path)?;
        let body = serde_saphyr::to_string(self)
            .map_err(|e| ObjectError::Parse { path: path.clone(), reason: e.to_string() })?;
        let comment: String = comment.lines().map(|l| format!("# {l}\n")).collect();
        std::fs::write(&path, comment + &body).map_err(|source| ObjectError::Io { path, source })
    }

    /// Loads the mesh named by the file.
    ///
    /// # Errors
    /// [`ObjectError::Mesh`].
    pub fn load_mesh(&self, dir: &Path) -> Result<Mesh, ObjectError> {
        Ok(Mesh::load(&dir.join(&self.mesh))?)
    }

    /// Loads the mesh by which a camera knows the object.
    ///
    /// # Errors
    /// [`ObjectError::Mesh`].
    pub fn load_seen(&self, dir: &Path) -> Result<Mesh, ObjectError> {
        Ok(Mesh::load(&dir.join(self.seen.as_ref().unwrap_or(&self.mesh)))?)
    }

    fn check(&self, path: &Path) -> Result<(), ObjectError> {
        let bad = |field: &str, reason: String| {
            Err(ObjectError::Value { path: path.into(), field: field.into(), reason })
        };
        if self.name.trim().is_empty() {
            return bad("name", "is empty".into());
        }
        if self.mesh.trim().is_empty() || Path::new(&self.mesh).is_absolute() {
            return bad("mesh", format!("{:?} is not a file name inside the folder", self.mesh));
        }
        if !(self.mass > 0.0 && self.mass < 100.0) {
            return bad("mass", format!("{} is not between 0 and 100 kg", self.mass));
        }
        if !(0.0..=5.0).contains(&self.friction) {
            return bad("friction", format!("{} is not between 0 and 5", self.friction));
        }
        if let Symmetry::Continuous { axis } = &self.symmetry
            && !(axis.iter().map(|v| v * v).sum::<f64>() > 1e-12)
        {
            return bad("symmetry", format!("axis {axis:?} has no direction"));
        }
        if let Symmetry::Discrete { rotations } = &self.symmetry {
            for q in rotations {
                let unit: Result<Pose, GeometryError> =
                    tdv_geometry::pose_from_xyz_quat([0.0; 3], *q);
                if let Err(e) = unit {
                    return bad("symmetry", e.to_string());
                }
            }
        }
        if self.collision.is_empty() {
            return bad("collision", "lists no part".into());
        }
        for (i, part) in self.collision.iter().enumerate() {
            let sizes: &[f64] = match &part.shape {
                PartShape::Box { half_extents } => half_extents,
                PartShape::Cylinder { radius, height } => &[*radius, *height],
            };
            let finite = part.xyz.iter().chain(&part.rpy).all(|v| v.is_finite());
            if !finite || !sizes.iter().all(|&s| s > 0.0 && s < 3.0) {
                return bad(
                    &format!("collision[{i}]"),
                    format!("{part:?} needs finite poses and sizes between 0 and 3 m"),
                );
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "name: puck\nmesh: mesh.obj\nmass: 0.1\nfriction: 0.6\n\
        symmetry: {continuous: {axis: [0, 0, 1]}}\npalette: [[150, 80, 60]]\n\
        collision:\n  - shape: {cylinder: {radius: 0.05, height: 0.01}}\n    xyz: [0, 0, 0.005]\n";

    fn load(text: &str) -> Result<ObjectFile, ObjectError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("object.yaml"), text).unwrap();
        ObjectFile::load(dir.path())
    }

    #[test]
    fn a_file_is_read_and_written_back() {
        let object = load(GOOD).unwrap();
        assert_eq!(object.symmetry, Symmetry::Continuous { axis: [0.0, 0.0, 1.0] });
        assert!((object.collision[0].pose().translation.z - 0.005).abs() < 1e-12);
        let dir = tempfile::tempdir().unwrap();
        object.save(dir.path(), "A puck.\nMade for a test.").unwrap();
        assert_eq!(ObjectFile::load(dir.path()).unwrap(), object);
        let nameless = ObjectFile { name: String::new(), ..object };
        assert!(matches!(nameless.save(dir.path(), ""), Err(ObjectError::Value { .. })));
    }

    #[test]
    fn bad_fields_are_named() {
        for (from, to, field) in [
            ("mass: 0.1", "mass: -1", "mass"),
            ("friction: 0.6", "friction: .nan", "friction"),
            ("radius: 0.05", "radius: 0", "collision[0]"),
            ("axis: [0, 0, 1]", "axis: [0, 0, 0]", "symmetry"),
            ("name: puck", "name: ''", "name"),
            ("mesh: mesh.obj", "mesh: /etc/mesh.obj", "mesh"),
            ("mass: 0.1", "mass: 0.1\nweight: 3", "weight"),
            ("mass: 0.1\n", "", "mass"),
        ] {
            let e = load(&GOOD.replace(from, to)).unwrap_err().to_string();
            assert!(e.contains(field) && e.contains("object.yaml"), "{field}: {e}");
        }
        let nowhere = ObjectFile::load(Path::new("no/such/folder"));
        assert!(matches!(nowhere, Err(ObjectError::Io { .. })));
    }
}
