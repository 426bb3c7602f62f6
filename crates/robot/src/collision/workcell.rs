use super::shapes::{ConvexPart, ShapeError, convex_parts};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::path::Path;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use thiserror::Error;

/// Why a workcell file cannot be used.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum WorkcellError {
    /// The file or a mesh that it names cannot be read.
    #[error("{path}: {reason}")]
    Read {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// Two fixtures of one name.
    #[error("fixture {name} is there twice; give it another name")]
    Twice {
        /// The name.
        name: String,
    },
    /// A shape that has no volume.
    #[error("fixture {name}: {source}")]
    Shape {
        /// The name.
        name: String,
        /// What is wrong.
        source: ShapeError,
    },
}

/// What a fixture looks like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FixtureShape {
    /// Edge lengths (m).
    Box([f64; 3]),
    /// Radius and length along z (m).
    Cylinder([f64; 2]),
    /// Radius (m).
    Sphere(f64),
    /// Wavefront OBJ file (m), relative to the workcell's file; decomposed into convex parts.
    Mesh(String),
}

/// Something that stands still in the arm's reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fixture {
    /// What the operator reads.
    pub name: String,
    /// Its shape, centred on its pose.
    pub shape: FixtureShape,
    /// Position in `base_link` (m).
    pub position: [f64; 3],
    /// Roll, pitch, yaw (rad).
    #[serde(default)]
    pub rpy: [f64; 3],
}

/// Everything that stands around the robot, besides the table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Workcell {
    /// May be empty.
    #[serde(default)]
    pub fixtures: Vec<Fixture>,
    /// Folder that mesh files are relative to.
    #[serde(skip)]
    folder: std::path::PathBuf,
}

impl Workcell {
    /// From fixtures; meshes are relative to the current folder.
    pub fn new(fixtures: Vec<Fixture>) -> Self {
        Self { fixtures, folder: std::path::PathBuf::new() }
    }

    /// From a YAML file: `fixtures:` with `name`, `shape` (`{box: [x, y, z]}`,
    /// `{cylinder: [radius, length]}`, `{sphere: radius}` or `{mesh: file.obj}`), `position` and `rpy`.
    ///
    /// # Errors
    /// [`WorkcellError`].
    pub fn load(path: &Path) -> Result<Self, WorkcellError> {
        let name = path.display().to_string();
        let read = |reason: String| WorkcellError::Read { path: name.clone(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| read(e.to_string()))?;
        let mut cell: Self = serde_saphyr::from_str(&text).map_err(|e| read(e.to_string()))?;
        cell.folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        cell.parts()?;
        Ok(cell)
    }

    /// Name and convex parts, in `base_link`, of every fixture.
    pub(super) fn parts(&self) -> Result<Vec<(String, Vec<ConvexPart>)>, WorkcellError> {
        let mut out: Vec<(String, Vec<ConvexPart>)> = Vec::new();
        for f in &self.fixtures {
            if out.iter().any(|(name, _)| *name == f.name) {
                return Err(WorkcellError::Twice { name: f.name.clone() });
            }
            let pose = pose_from_xyz_rpy(f.position, f.rpy);
            let shape = |source| WorkcellError::Shape { name: f.name.clone(), source };
            let parts = match &f.shape {
                FixtureShape::Box(edges) => vec![ConvexPart::cuboid(*edges, &pose).map_err(shape)?],
                FixtureShape::Cylinder([r, l]) => {
                    vec![ConvexPart::cylinder(*r, *l, &pose).map_err(shape)?]
                }
                FixtureShape::Sphere(r) => {
                    vec![ConvexPart::capsule(f.position, f.position, *r).map_err(shape)?]
                }
                FixtureShape::Mesh(file) => self.mesh(file, &pose)?.map_err(shape)?,
            };
            out.push((f.name.clone(), parts));
        }
        Ok(out)
    }

    fn mesh(
        &self,
        file: &str,
        pose: &Pose,
    ) -> Result<Result<Vec<ConvexPart>, ShapeError>, WorkcellError> {
        let path = self.folder.join(file);
        let read =
            |reason: String| WorkcellError::Read { path: path.display().to_string(), reason };
        let text = std::fs::read_to_string(&path).map_err(|e| read(e.to_string()))?;
        let (vertices, triangles) = obj(&text).map_err(read)?;
        let parts = convex_parts(&vertices, Some(&triangles));
        Ok(parts.map(|p| p.into_iter().map(|part| part.moved(pose)).collect()))
    }
}

/// Vertices and triangles.
type Mesh = (Vec<Point3<f64>>, Vec<[u32; 3]>);

/// A Wavefront OBJ text; faces of more corners become fans.
fn obj(text: &str) -> Result<Mesh, String> {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (n, line) in text.lines().enumerate() {
        let bad = || format!("line {}: {line:?} is not a vertex or face", n + 1);
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let v: Vec<f64> =
                    words.take(3).map(str::parse).collect::<Result<_, _>>().map_err(|_| bad())?;
                let [x, y, z] = v[..] else { return Err(bad()) };
                vertices.push(Point3::new(x, y, z));
            }
            Some("f") => {
                let corner = |w: &str| -> Option<u32> {
                    let i: i64 = w.split('/').next()?.parse().ok()?;
                    let i = if i < 0 { vertices.len() as i64 + i } else { i - 1 };
                    u32::try_from(i).ok()
                };
                let c: Vec<u32> = words.map(corner).collect::<Option<_>>().ok_or_else(bad)?;
                if c.len() < 3 {
                    return Err(bad());
                }
                triangles.extend(c.windows(2).skip(1).map(|w| [c[0], w[0], w[1]]));
            }
            _ => {}
        }
    }
    Ok((vertices, triangles))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_read_and_checked() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot");
        let cell = Workcell::load(&Path::new(folder).join("workcell.yaml")).unwrap();
        assert!(cell.fixtures.is_empty());
        let text = "fixtures:\n- name: mug\n  shape: {mesh: ../objects/mug/mesh.obj}\n  position: [0.5, 0, 0]\n- name: post\n  shape: {cylinder: [0.02, 0.5]}\n  position: [0, 0.4, 0.25]\n";
        let mut cell: Workcell = serde_saphyr::from_str(text).unwrap();
        cell.folder = folder.into();
        let parts = cell.parts().unwrap();
        assert!(parts[0].1.len() > 1, "a mug is not convex");
        assert_eq!((parts[1].0.as_str(), parts[1].1.len()), ("post", 1));
        cell.fixtures[1].name = "mug".into();
        assert!(matches!(cell.parts(), Err(WorkcellError::Twice { .. })));
        cell.fixtures[1].name = "post".into();
        cell.fixtures[1].shape = FixtureShape::Box([0.1, -0.1, 0.1]);
        let e = cell.parts().unwrap_err();
        assert!(e.to_string().contains("post") && e.to_string().contains("-0.1"), "{e}");
        assert!(
            serde_saphyr::from_str::<Workcell>("fixtures: [{name: a, shape: {cone: 1}}]").is_err()
        );
        assert!(Workcell::load(Path::new("/no.yaml")).is_err());
        assert!(obj("v 1 2\n").is_err() && obj("f 1 x 3\n").is_err());
    }
}
