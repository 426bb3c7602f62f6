//! From a mesh in metres to an entry of the object catalogue.

use crate::candidates::color_words;
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::Symmetry;
use tdv_rendering::shape::{convex_parts, guess_mass, in_object_frame};
use tdv_rendering::{Mesh, ObjectError, ObjectFile};

/// Name of the mesh file of an entry.
pub const MESH_FILE: &str = "mesh.glb";

/// What the mesh does not tell.
#[derive(Debug, Clone, PartialEq)]
pub struct EntryWords {
    /// Name of the object and of its folder.
    pub name: String,
    /// Other words for it.
    pub synonyms: Vec<String>,
    /// Mass (kg); a guess from the volume if there is none.
    pub mass: Option<f64>,
    /// Coulomb friction coefficient.
    pub friction: f64,
}

/// The mesh in the object frame and the file that describes it. `mesh` is in metres, z up, and was
/// looked at for its symmetry before it is moved.
pub fn make_entry(words: &EntryWords, mesh: &Mesh, symmetry: Symmetry) -> (Mesh, ObjectFile) {
    let mesh = in_object_frame(mesh, &symmetry);
    let colors: Vec<[u8; 3]> = mesh.surface_points(4000, 17).iter().map(|s| s.color).collect();
    let first = colors.first().copied().unwrap_or_default();
    // One plain grey is what a mesh without colours gets: it says nothing.
    let plain = first[0] == first[1] && first[1] == first[2] && colors.iter().all(|c| *c == first);
    let file = ObjectFile {
        name: words.name.clone(),
        synonyms: words.synonyms.clone(),
        colors: if plain {
            Vec::new()
        } else {
            color_words(colors.iter().copied()).into_iter().map(str::to_owned).collect()
        },
        mesh: MESH_FILE.into(),
        seen: None,
        mass: words.mass.unwrap_or_else(|| guess_mass(&mesh)),
        friction: words.friction,
        palette: if plain { Vec::new() } else { main_colors(&colors) },
        collision: convex_parts(&mesh, &symmetry),
        symmetry,
    };
    (mesh, file)
}

/// Writes mesh and description into `dir`, which is made.
///
/// # Errors
/// [`ObjectError`].
pub fn save_entry(
    dir: &Path,
    mesh: &Mesh,
    file: &ObjectFile,
    comment: &str,
) -> Result<(), ObjectError> {
    std::fs::create_dir_all(dir).map_err(|source| ObjectError::Io { path: dir.into(), source })?;
    mesh.save_glb(&dir.join(&file.mesh))?;
    file.save(dir, comment)
}

/// Up to four colours that cover at least 8 % each, the largest first.
fn main_colors(colors: &[[u8; 3]]) -> Vec<[u8; 3]> {
    let mut bins: BTreeMap<[u8; 3], (usize, [usize; 3])> = BTreeMap::new();
    for c in colors {
        let bin = bins.entry(c.map(|v| v / 52)).or_default();
        bin.0 += 1;
        (0..3).for_each(|k| bin.1[k] += usize::from(c[k]));
    }
    let mut all: Vec<_> = bins.into_values().filter(|b| b.0 * 100 >= 8 * colors.len()).collect();
    all.sort_by_key(|b| std::cmp::Reverse(b.0));
    all.into_iter().take(4).map(|(n, sum)| sum.map(|s| (s / n) as u8)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::ObjectModel;
    use tdv_rendering::mesh::primitives;
    use tdv_rendering::shape::find_symmetry;

    #[test]
    fn an_entry_written_is_a_model_read() {
        let mut mesh = primitives::cylinder(0.03, 0.12, 48, [200, 40, 30]);
        mesh.append(&primitives::cylinder(0.0301, 0.03, 48, [240, 240, 240]));
        let words = EntryWords {
            name: "tin".into(),
            synonyms: vec!["can".into()],
            mass: None,
            friction: 0.5,
        };
        let symmetry = find_symmetry(&mesh, 1).symmetry;
        let (mesh, file) = make_entry(&words, &mesh, symmetry);
        assert_eq!(file.colors[0], "red", "{:?}", file.colors);
        assert_eq!(file.palette[0], [200, 40, 30]);
        assert!((0.1..0.5).contains(&file.mass), "{}", file.mass);
        let dir = std::env::temp_dir().join(format!("tdv-entry-{}", std::process::id()));
        save_entry(&dir, &mesh, &file, "A tin.").unwrap();
        let model = ObjectModel::load(&dir).unwrap();
        std::fs::remove_dir_all(&dir).unwrap();
        assert!(model.round_about_z() && model.min.z.abs() < 1e-6);
        assert!((model.size().z - 0.12).abs() < 1e-5);
        assert!((model.palette.fit([200, 40, 30])) > 0.9);
    }
}
