//! The catalogue: what each known object looks like, is called, and how it may stand.

use crate::color::{Palette, color_word};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tdv_geometry::{Pose, Symmetry, pose_distance};
use tdv_rendering::{Mesh, ObjectError, ObjectFile};
use thiserror::Error;

/// How an object rests on the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Resting {
    /// On its underside, z up; only the yaw is unknown (a mug, a coaster, a bottle).
    #[default]
    Upright,
    /// In any orientation.
    Any,
}

/// What can be wrong with a catalogue.
#[derive(Debug, Error)]
pub enum CatalogueError {
    /// A file or folder that cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// An object file, or its mesh, that cannot be used.
    #[error(transparent)]
    Object(#[from] ObjectError),
    /// A field with a value that makes no sense to perception.
    #[error("{path}: {field} is {value}; {hint}")]
    Field {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What to do.
        hint: &'static str,
    },
    /// A folder without any object.
    #[error("{0}: no object.yaml in any sub-folder; add NAME/object.yaml with a mesh")]
    Empty(PathBuf),
}

/// An object the perceiver can look for.
#[derive(Debug, Clone)]
pub struct ObjectModel {
    /// Name.
    pub name: String,
    /// Other words for it.
    pub synonyms: Vec<String>,
    /// Colour words that describe it.
    pub colors: Vec<String>,
    /// Mesh in metres, in the object's frame.
    pub mesh: Arc<Mesh>,
    /// Its symmetry.
    pub symmetry: Symmetry,
    /// How it rests.
    pub resting: Resting,
    /// Colours to look for; may be empty.
    pub palette: Palette,
    /// Lower corner of the bounding box (m).
    pub min: Point3<f64>,
    /// Upper corner of the bounding box (m).
    pub max: Point3<f64>,
    /// Radius (m) about the centre of the bounding box that holds every vertex.
    pub radius: f64,
    /// The rotations of a finite symmetry, computed once; identity first.
    rotations: Vec<UnitQuaternion<f64>>,
}

impl ObjectModel {
    /// A model with a mesh in metres; palette from the mesh's colours, no synonyms; it rests
    /// upright unless it has the symmetry of a cube.
    pub fn new(name: &str, mesh: Mesh, symmetry: Symmetry) -> Self {
        let palette = mesh_palette(&mesh);
        let rotations = symmetry.rotations();
        let resting = if symmetry == Symmetry::Cube { Resting::Any } else { Resting::Upright };
        let (min, max) = corners(&mesh);
        let centre = nalgebra::center(&min, &max);
        let radius = mesh.positions.iter().map(|p| (point(p) - centre).norm()).fold(0.0, f64::max);
        Self {
            name: name.to_owned(),
            synonyms: Vec::new(),
            colors: Vec::new(),
            mesh: Arc::new(mesh),
            symmetry,
            resting,
            palette,
            min,
            max,
            radius,
            rotations,
        }
    }

    /// Reads `dir/object.yaml` and its mesh; `path` may be the folder or the file itself.
    ///
    /// An empty palette is taken from the mesh's colours; a mesh of one plain grey (no material) says
    /// nothing about colour. Objects with the symmetry of a cube rest on any side, all others upright.
    ///
    /// # Errors
    /// [`CatalogueError`] naming the file and the field.
    pub fn load(path: &Path) -> Result<Self, CatalogueError> {
        let dir = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
        let file = ObjectFile::load(dir)?;
        if let Some(c) = file.colors.iter().find(|c| color_word(&c.to_lowercase()).is_none()) {
            return Err(CatalogueError::Field {
                path: dir.join("object.yaml"),
                field: "colors",
                value: c.clone(),
                hint: "use plain words such as red, blue, brown, grey",
            });
        }
        let mesh = file.load_seen(dir)?;
        let mut model = Self::new(&file.name.to_lowercase(), mesh, file.symmetry);
        model.synonyms = file.synonyms.iter().map(|s| s.to_lowercase()).collect();
        model.colors = file.colors.iter().map(|s| s.to_lowercase()).collect();
        if !file.palette.is_empty() {
            // The first one covers most of it.
            let weight = |i: usize| if i == 0 { 2.0 } else { 1.0 };
            let colors = file.palette.into_iter().enumerate();
            model.palette = Palette::new(colors.map(|(i, c)| (c, weight(i))));
        }
        Ok(model)
    }

    /// The same object with its mesh scaled by `factor`, for a size that is known better than the file says.
    #[must_use]
    pub fn rescaled(&self, factor: f64) -> Self {
        Self {
            min: self.min * factor,
            max: self.max * factor,
            radius: self.radius * factor,
            mesh: Arc::new(self.mesh.scaled(factor)),
            ..self.clone()
        }
    }

    /// The same object, looked for by other colours.
    #[must_use]
    pub fn recolored(&self, palette: Palette) -> Self {
        Self { palette, ..self.clone() }
    }

    /// Centre of the bounding box in the object frame.
    pub fn centre(&self) -> Point3<f64> {
        nalgebra::center(&self.min, &self.max)
    }

    /// The equivalent of `pose` whose orientation is nearest to `near`'s; as [`Symmetry::nearest`], but
    /// fast enough for thousands of hypotheses.
    pub fn nearest(&self, pose: &Pose, near: &UnitQuaternion<f64>) -> Pose {
        if self.rotations.len() < 2 {
            return self.symmetry.nearest(pose, near);
        }
        // The larger the dot product of two unit quaternions, the smaller the angle between them.
        let closeness =
            |s: &UnitQuaternion<f64>| (pose.rotation * s).coords.dot(&near.coords).abs();
        let best = self.rotations.iter().max_by(|a, b| closeness(a).total_cmp(&closeness(b)));
        let turn = best.copied().unwrap_or_else(UnitQuaternion::identity);
        Pose::from_parts(pose.translation, pose.rotation * turn)
    }

    /// Metres and radians between two poses of the object, the least over its symmetry.
    pub fn distance(&self, a: &Pose, b: &Pose) -> (f64, f64) {
        pose_distance(&self.nearest(a, &b.rotation), b)
    }

    /// Whether its file says that it has this colour (a canonical colour word).
    pub fn is_called(&self, color: &str) -> bool {
        self.colors.iter().any(|c| color_word(c) == Some(color))
    }

    /// Whether a part of it has this colour, by its file or its palette.
    pub fn shows(&self, color: &str) -> bool {
        self.is_called(color) || self.palette.shows(color)
    }

    /// Edge lengths of the bounding box (m).
    pub fn size(&self) -> Vector3<f64> {
        self.max - self.min
    }

    /// Whether it looks the same from every side about its own z axis.
    pub fn round_about_z(&self) -> bool {
        matches!(&self.symmetry, Symmetry::Continuous { axis }
            if Vector3::from(*axis).try_normalize(1e-9).is_some_and(|a| a.z.abs() > 0.999))
    }
}

/// All objects of a folder.
#[derive(Debug, Clone, Default)]
pub struct Catalogue {
    /// The objects, by name in alphabetical order.
    pub models: Vec<ObjectModel>,
}

impl Catalogue {
    /// Reads `dir/*/object.yaml`.
    ///
    /// # Errors
    /// [`CatalogueError`]; a folder without any object is an error too, and so are two objects of one name.
    pub fn load(dir: &Path) -> Result<Self, CatalogueError> {
        let io = |source| CatalogueError::Io { path: dir.into(), source };
        let mut files: Vec<PathBuf> = std::fs::read_dir(dir)
            .map_err(io)?
            .filter_map(|e| e.ok().map(|e| e.path().join("object.yaml")))
            .filter(|p| p.is_file())
            .collect();
        files.sort();
        if files.is_empty() {
            return Err(CatalogueError::Empty(dir.into()));
        }
        let mut models: Vec<ObjectModel> = Vec::new();
        for path in files {
            let model = ObjectModel::load(&path)?;
            if models.iter().any(|m| m.name == model.name) {
                return Err(CatalogueError::Field {
                    path,
                    field: "name",
                    value: model.name,
                    hint: "another folder has an object of this name",
                });
            }
            models.push(model);
        }
        Ok(Self { models })
    }

    /// The object of this name.
    pub fn get(&self, name: &str) -> Option<&ObjectModel> {
        self.models.iter().find(|m| m.name == name)
    }
}

fn point(p: &[f32; 3]) -> Point3<f64> {
    Point3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}

fn corners(mesh: &Mesh) -> (Point3<f64>, Point3<f64>) {
    let mut min = Point3::from(Vector3::repeat(f64::INFINITY));
    let mut max = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
    for p in &mesh.positions {
        let p = point(p);
        min = min.inf(&p);
        max = max.sup(&p);
    }
    (min, max)
}

/// Area-weighted colours of a mesh (none for one plain grey, which is what a mesh without material
/// gets): texture at the triangle's centre where there is one, else vertex colours.
fn mesh_palette(mesh: &Mesh) -> Palette {
    let colour = |t: &[u32; 3]| -> Option<[u8; 3]> {
        if let Some(texture) = &mesh.texture {
            let uv = t.iter().map(|i| mesh.uvs.get(*i as usize)).collect::<Option<Vec<_>>>();
            if let Some(uv) = uv {
                let u = uv.iter().map(|p| p[0]).sum::<f32>() / 3.0;
                let v = uv.iter().map(|p| p[1]).sum::<f32>() / 3.0;
                let (w, h) = texture.dimensions();
                let x = ((u.rem_euclid(1.0)) * w as f32) as u32;
                let y = ((1.0 - v.rem_euclid(1.0)) * h as f32) as u32;
                return Some(texture.get_pixel(x.min(w - 1), y.min(h - 1)).0);
            }
        }
        mesh.colors.get(t[0] as usize).copied()
    };
    let first = mesh.colors.first().copied().unwrap_or_default();
    let plain = mesh.texture.is_none() && mesh.colors.iter().all(|c| *c == first);
    if plain && first[0] == first[1] && first[1] == first[2] {
        return Palette::default();
    }
    Palette::new(mesh.triangles.iter().filter_map(|t| {
        let corner = |k: usize| mesh.positions.get(t[k] as usize).map(point);
        let (a, b, c) = (corner(0)?, corner(1)?, corner(2)?);
        let area = (b - a).cross(&(c - a)).norm() as f32;
        Some((colour(t)?, area))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_catalogue_is_read_whole() {
        let all =
            Catalogue::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects"));
        let all = all.unwrap();
        assert!(all.models.len() >= 17);
        assert!(all.get("cube").unwrap().is_called("brown"));
        assert!(all.get("mug").unwrap().shows("blue") && !all.get("mug").unwrap().shows("red"));
    }

    #[test]
    fn errors_name_file_and_field() {
        let dir = std::env::temp_dir().join(format!("tdv-catalogue-{}", std::process::id()));
        let sub = dir.join("thing");
        std::fs::create_dir_all(&sub).unwrap();
        assert!(matches!(Catalogue::load(&dir), Err(CatalogueError::Empty(_))));
        let yaml = sub.join("object.yaml");
        let rest = "mesh: thing.obj\nmass: 0.1\nfriction: 0.5\ncollision:\n  \
            - shape: {box: {half_extents: [0.1, 0.1, 0.1]}}\n";
        std::fs::write(&yaml, format!("name: thing\nweight: 3\n{rest}")).unwrap();
        let e = Catalogue::load(&dir).unwrap_err().to_string();
        assert!(e.contains("object.yaml") && e.contains("weight"), "{e}");
        std::fs::write(&yaml, format!("name: thing\ncolors: [bleu]\n{rest}")).unwrap();
        let e = Catalogue::load(&dir).unwrap_err().to_string();
        assert!(e.contains("bleu"), "{e}");
        std::fs::write(&yaml, format!("name: thing\n{rest}")).unwrap();
        let e = Catalogue::load(&dir).unwrap_err().to_string();
        assert!(e.contains("thing.obj"), "{e}");
        std::fs::write(
            sub.join("thing.obj"),
            "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.05\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n",
        )
        .unwrap();
        let c = Catalogue::load(&dir).unwrap();
        assert_eq!(c.models.len(), 1);
        assert!((c.models[0].size().x - 0.1).abs() < 1e-6);
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
