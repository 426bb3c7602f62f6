use super::{Mesh, MeshError};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

impl Mesh {
    /// OBJ and MTL text: one material for each vertex colour (a triangle takes the colour of its
    /// first vertex), coordinates to a hundredth of a millimetre, normals to four digits. The text
    /// depends on the mesh alone, so that a generated file can be compared byte by byte. Texture
    /// and texture coordinates are not written.
    pub fn to_obj(&self, mtl_name: &str) -> (String, String) {
        let mut positions: Vec<String> = Vec::new();
        let mut normals: Vec<String> = Vec::new();
        let mut seen_p: BTreeMap<String, usize> = BTreeMap::new();
        let mut seen_n: BTreeMap<String, usize> = BTreeMap::new();
        let corner: Vec<(usize, usize)> = self
            .positions
            .iter()
            .zip(&self.normals)
            .map(|(p, n)| {
                let p = format!("{} {} {}", fixed(p[0], 5), fixed(p[1], 5), fixed(p[2], 5));
                let n = format!("{} {} {}", fixed(n[0], 4), fixed(n[1], 4), fixed(n[2], 4));
                (intern(p, &mut positions, &mut seen_p), intern(n, &mut normals, &mut seen_n))
            })
            .collect();
        let mut by_color: BTreeMap<[u8; 3], Vec<[u32; 3]>> = BTreeMap::new();
        for t in &self.triangles {
            by_color.entry(self.colors[t[0] as usize]).or_default().push(*t);
        }
        let mut obj = format!("mtllib {mtl_name}\n");
        for p in &positions {
            obj += &format!("v {p}\n");
        }
        for n in &normals {
            obj += &format!("vn {n}\n");
        }
        let mut mtl = String::new();
        for (color, triangles) in &by_color {
            let name = format!("c{:02x}{:02x}{:02x}", color[0], color[1], color[2]);
            let kd = color.map(|v| format!("{:.4}", f64::from(v) / 255.0)).join(" ");
            // Writing into a String cannot fail.
            let _ = writeln!(mtl, "newmtl {name}\nKd {kd}");
            let _ = writeln!(obj, "usemtl {name}");
            for t in triangles {
                let f = t.map(|i| {
                    let (p, n) = corner[i as usize];
                    format!("{}//{}", p + 1, n + 1)
                });
                // Rounding can make two corners of a sliver coincide: such a triangle is nothing.
                let same = |a: usize, b: usize| corner[t[a] as usize].0 == corner[t[b] as usize].0;
                if !(same(0, 1) || same(1, 2) || same(2, 0)) {
                    let _ = writeln!(obj, "f {}", f.join(" "));
                }
            }
        }
        (obj, mtl)
    }

    /// Writes [`Self::to_obj`] to `path` and, beside it, the mtl of the same stem.
    ///
    /// # Errors
    /// [`MeshError::Io`].
    pub fn save_obj(&self, path: &Path) -> Result<(), MeshError> {
        let mtl_path = path.with_extension("mtl");
        let mtl_name = mtl_path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (obj, mtl) = self.to_obj(&mtl_name);
        for (path, text) in [(path, obj), (&mtl_path, mtl)] {
            std::fs::write(path, text)
                .map_err(|source| MeshError::Io { path: path.into(), source })?;
        }
        Ok(())
    }
}

fn intern(text: String, list: &mut Vec<String>, seen: &mut BTreeMap<String, usize>) -> usize {
    *seen.entry(text).or_insert_with_key(|t| {
        list.push(t.clone());
        list.len() - 1
    })
}

/// Decimal text without a negative zero (which would depend on rounding noise).
fn fixed(v: f32, digits: usize) -> String {
    let s = format!("{v:.digits$}");
    if s.starts_with('-') && s[1..].bytes().all(|b| b == b'0' || b == b'.') {
        s[1..].to_owned()
    } else {
        s
    }
}

#[cfg(test)]
mod tests {
    use super::super::primitives;
    use super::*;

    #[test]
    fn an_obj_written_is_the_obj_read() {
        let dir = tempfile::tempdir().unwrap();
        let mut m = primitives::cylinder(0.05, 0.01, 32, [150, 80, 60]);
        m.append(&primitives::cuboid([0.02, 0.02, 0.1], [10, 20, 30]));
        let path = dir.path().join("x.obj");
        m.save_obj(&path).unwrap();
        let back = Mesh::load(&path).unwrap();
        assert_eq!(back.triangles.len(), m.triangles.len());
        assert!((back.volume() - m.volume()).abs() < 2e-3 * m.volume());
        assert!(back.colors.contains(&[150, 80, 60]) && back.colors.contains(&[10, 20, 30]));
        assert_eq!(m.to_obj("x.mtl"), m.clone().to_obj("x.mtl"));
    }
}
