use super::{Mesh, MeshError};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Larger textures are halved until they fit: the renderer has no mip levels, and at a camera's
/// resolution more texels only alias.
const MAX_TEXTURE: u32 = 1024;

/// Smallest and largest diameter (m) of a thing on a table.
const SMALLEST: f64 = 5e-3;
/// See [`SMALLEST`].
const LARGEST: f64 = 2.0;

impl Mesh {
    /// Reads a mesh in metres, z up. By content, then by the file's name: glTF and GLB (turned from its
    /// y up), PLY and STL (text or binary), Wavefront OBJ with its mtl. Base colours, vertex colours and
    /// one texture are kept; further textures are baked into vertex colours. Missing normals are computed.
    ///
    /// # Errors
    /// Everything in [`MeshError`]; a diameter above 2 m or below 5 mm is refused, because it almost
    /// always means another unit.
    pub fn load(path: &Path) -> Result<Self, MeshError> {
        let mesh = Self::load_unscaled(path)?;
        mesh.check_size(path)?;
        Ok(mesh)
    }

    /// As [`Self::load`] for a mesh of any unit or none, such as one made from pictures.
    ///
    /// # Errors
    /// Everything in [`MeshError`] except for `Size`.
    pub fn load_unscaled(path: &Path) -> Result<Self, MeshError> {
        let bytes =
            std::fs::read(path).map_err(|source| MeshError::Io { path: path.into(), source })?;
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_lowercase();
        let text = bytes.trim_ascii_start();
        let mut mesh = if bytes.starts_with(b"glTF") || text.starts_with(b"{") {
            super::gltf::load(path, &bytes)?
        } else if bytes.starts_with(b"ply") && bytes.get(3).is_some_and(u8::is_ascii_whitespace) {
            super::ply::load(path, &bytes)?
        } else {
            match extension.as_str() {
                "obj" => load_obj(path)?,
                "stl" => load_stl(path, &bytes)?,
                "glb" | "gltf" | "ply" => {
                    let reason = format!("is not a {extension} file by its first octets");
                    return Err(MeshError::Parse { path: path.into(), reason });
                }
                _ if bytes.starts_with(b"solid") => load_stl(path, &bytes)?,
                _ => return Err(MeshError::Format { path: path.into() }),
            }
        };
        mesh.check(path)?;
        if mesh.normals.len() != mesh.positions.len() {
            mesh.recompute_normals();
        }
        Ok(mesh)
    }

    fn check(&self, path: &Path) -> Result<(), MeshError> {
        let path = || PathBuf::from(path);
        if self.triangles.is_empty() {
            return Err(MeshError::Empty { path: path() });
        }
        if let Some((index, value)) =
            self.positions.iter().enumerate().find(|(_, p)| !p.iter().all(|v| v.is_finite()))
        {
            return Err(MeshError::NotFinite { path: path(), index, value: *value });
        }
        let count = self.positions.len();
        for (triangle, t) in self.triangles.iter().enumerate() {
            if let Some(&vertex) = t.iter().find(|&&v| v as usize >= count) {
                return Err(MeshError::Index { path: path(), triangle, vertex, count });
            }
        }
        Ok(())
    }

    /// Refuses sizes that no tabletop object has; `path` is named in the error.
    ///
    /// # Errors
    /// [`MeshError::Size`] with the likely unit.
    pub fn check_size(&self, path: &Path) -> Result<(), MeshError> {
        let diameter = self.diameter();
        if (SMALLEST..=LARGEST).contains(&diameter) {
            return Ok(());
        }
        // The unit under which it would be a thing for one hand.
        let units = [("millimetres", 0.001), ("centimetres", 0.01), ("inches", 0.0254)];
        let likely = units.iter().find(|(_, f)| (0.02..=0.6).contains(&(diameter * f)));
        let hint = match likely {
            Some((name, factor)) => {
                format!("this looks like {name}: scale it by {factor} (meshes are in metres)")
            }
            None => "meshes are in metres: give its scale or its true height".into(),
        };
        Err(MeshError::Size { path: path.into(), diameter, hint })
    }
}

fn load_obj(path: &Path) -> Result<Mesh, MeshError> {
    // tobj hides the reason when a file cannot be opened.
    std::fs::metadata(path).map_err(|source| MeshError::Io { path: path.into(), source })?;
    let parse = |e: tobj::LoadError| MeshError::Parse { path: path.into(), reason: e.to_string() };
    let options =
        tobj::LoadOptions { single_index: true, triangulate: true, ..tobj::LoadOptions::default() };
    let (models, materials) = tobj::load_obj(path, &options).map_err(parse)?;
    // A missing mtl file only costs the colours; a broken one is reported like the mesh itself.
    let materials = match materials {
        Ok(m) => m,
        Err(tobj::LoadError::OpenFileFailed) => Vec::new(),
        Err(e) => return Err(parse(e)),
    };
    let mut all_normals = true;
    let mut textures: Vec<(PathBuf, RgbImage)> = Vec::new();
    let mut parts: Vec<(Mesh, Option<usize>)> = Vec::new();
    for model in &models {
        let m = &model.mesh;
        let count = m.positions.len() / 3;
        let material = m.material_id.and_then(|i| materials.get(i));
        let texture = match material.and_then(|m| m.diffuse_texture.as_deref()) {
            Some(name) => Some(texture_index(path, name, &mut textures)?),
            None => None,
        };
        let base = match (texture, material.and_then(|m| m.diffuse)) {
            // Exporters write Kd 0 0 0 beside a texture as often as 1 1 1: the texture decides.
            (Some(_), _) => [255; 3],
            (None, Some(kd)) => kd.map(to_u8),
            (None, None) => [200; 3],
        };
        let colors = if m.vertex_color.len() == m.positions.len() && !m.vertex_color.is_empty() {
            m.vertex_color
                .chunks_exact(3)
                .map(|c| [to_u8(c[0]), to_u8(c[1]), to_u8(c[2])])
                .collect()
        } else {
            vec![base; count]
        };
        let uvs = if m.texcoords.len() == count * 2 {
            m.texcoords.chunks_exact(2).map(|c| [c[0], c[1]]).collect()
        } else {
            vec![[0.0; 2]; count]
        };
        all_normals &= m.normals.len() == m.positions.len();
        parts.push((
            Mesh {
                positions: triples(&m.positions),
                normals: triples(&m.normals),
                uvs,
                colors,
                triangles: m.indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
                texture: None,
            },
            texture,
        ));
    }
    let mut out = assemble(parts, textures.into_iter().map(|(_, t)| t).collect());
    if all_normals {
        normalise(&mut out.normals);
    }
    Ok(out)
}

/// Joins parts, each with the number of its texture. One texture for every part stays a texture;
/// otherwise all of them become vertex colours. Normals stay only if every part has them.
pub(super) fn assemble(parts: Vec<(Mesh, Option<usize>)>, mut textures: Vec<RgbImage>) -> Mesh {
    let keep = textures.len() == 1 && parts.iter().all(|(_, t)| t.is_some());
    let all_normals = parts.iter().all(|(p, _)| p.normals.len() == p.positions.len());
    let mut out = Mesh::default();
    for (mut part, texture) in parts {
        if !keep && let Some(t) = texture {
            part.texture = textures.get(t).cloned();
            part.bake_texture();
        }
        let base = out.positions.len() as u32;
        out.positions.append(&mut part.positions);
        out.normals.append(&mut part.normals);
        out.uvs.append(&mut part.uvs);
        out.colors.append(&mut part.colors);
        out.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i.saturating_add(base))));
    }
    if keep {
        out.texture = textures.pop();
    }
    if !all_normals {
        out.normals.clear();
    }
    out
}

/// Halves a texture until it fits.
pub(super) fn shrink(mut image: RgbImage) -> RgbImage {
    while image.width().max(image.height()) > MAX_TEXTURE {
        let (w, h) = ((image.width() / 2).max(1), (image.height() / 2).max(1));
        image = image::imageops::resize(&image, w, h, image::imageops::FilterType::Triangle);
    }
    image
}

fn texture_index(
    mesh: &Path,
    name: &str,
    textures: &mut Vec<(PathBuf, RgbImage)>,
) -> Result<usize, MeshError> {
    // The statement may carry options (`-s 1 1 1 file.png`); the file name comes last.
    let name = if name.starts_with('-') { name.rsplit(' ').next().unwrap_or(name) } else { name };
    let texture = mesh.parent().unwrap_or(Path::new(".")).join(name.replace('\\', "/"));
    if let Some(i) = textures.iter().position(|(p, _)| *p == texture) {
        return Ok(i);
    }
    let fail =
        |reason: String| MeshError::Texture { path: mesh.into(), texture: texture.clone(), reason };
    let bytes = std::fs::read(&texture).map_err(|e| fail(e.to_string()))?;
    let image = image::load_from_memory(&bytes)
        .map_err(|e| fail(format!("{e} (PNG and JPEG can be read)")))?;
    textures.push((texture, shrink(image.into_rgb8())));
    Ok(textures.len() - 1)
}

fn triples(flat: &[f32]) -> Vec<[f32; 3]> {
    flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
}

fn normalise(normals: &mut [[f32; 3]]) {
    for n in normals {
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        *n = if length > 1e-12 { n.map(|v| v / length) } else { [0.0, 0.0, 1.0] };
    }
}

fn to_u8(v: f32) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0).round() as u8
}

fn load_stl(path: &Path, bytes: &[u8]) -> Result<Mesh, MeshError> {
    let parse = |reason: String| MeshError::Parse { path: path.into(), reason };
    // A binary header may begin with "solid" too: the length decides first.
    let count = bytes.get(80..84).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let binary = count.is_some_and(|n| bytes.len() == 84 + 50 * n);
    let corners = if binary {
        binary_corners(&bytes[84..])
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        let text = std::str::from_utf8(bytes).map_err(|e| parse(format!("not text: {e}")))?;
        text_corners(text).map_err(parse)?
    } else {
        let wanted = count.map_or(84, |n| 84 + 50 * n);
        return Err(parse(format!(
            "neither text nor binary STL: {} bytes, a binary file of its header would have {wanted}",
            bytes.len()
        )));
    };
    let count = corners.len() as u32 / 3;
    Ok(Mesh {
        uvs: vec![[0.0; 2]; corners.len()],
        colors: vec![[200; 3]; corners.len()],
        positions: corners,
        triangles: (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        ..Mesh::default()
    })
}

fn binary_corners(records: &[u8]) -> Vec<[f32; 3]> {
    let mut out = Vec::with_capacity(records.len() / 50 * 3);
    for record in records.chunks_exact(50) {
        // Twelve bytes of normal first: recomputed anyway, exporters often leave it zero.
        for corner in record[12..48].chunks_exact(12) {
            let f = |k: usize| {
                f32::from_le_bytes([corner[k], corner[k + 1], corner[k + 2], corner[k + 3]])
            };
            out.push([f(0), f(4), f(8)]);
        }
    }
    out
}

fn text_corners(text: &str) -> Result<Vec<[f32; 3]>, String> {
    let mut out = Vec::new();
    let mut in_facet = 0;
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("vertex") => {
                let mut p = [0.0_f32; 3];
                for v in &mut p {
                    *v = words
                        .next()
                        .and_then(|w| w.parse().ok())
                        .ok_or_else(|| format!("line {}: bad vertex: {line}", number + 1))?;
                }
                out.push(p);
                in_facet += 1;
            }
            Some("endfacet") => {
                if in_facet != 3 {
                    return Err(format!(
                        "line {}: a facet with {in_facet} vertices, expected 3",
                        number + 1
                    ));
                }
                in_facet = 0;
            }
            _ => {}
        }
    }
    if in_facet != 0 {
        return Err("the file ends inside a facet".into());
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::primitives;
    use super::*;

    fn write(dir: &Path, name: &str, bytes: &[u8]) -> PathBuf {
        let path = dir.join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn stl_bytes(mesh: &Mesh) -> Vec<u8> {
        let mut out = vec![b's'; 80];
        out.extend((mesh.triangles.len() as u32).to_le_bytes());
        for t in &mesh.triangles {
            out.extend([0; 12]);
            for &i in t {
                for v in mesh.positions[i as usize] {
                    out.extend(v.to_le_bytes());
                }
            }
            out.extend([0; 2]);
        }
        out
    }

    #[test]
    fn both_kinds_of_stl_give_the_same_solid() {
        let dir = tempfile::tempdir().unwrap();
        let cube = primitives::cuboid([0.1, 0.2, 0.3], [1; 3]);
        let binary = Mesh::load(&write(dir.path(), "b.stl", &stl_bytes(&cube))).unwrap();
        let mut text = String::from("solid cube\n");
        for t in &cube.triangles {
            text += "facet normal 0 0 0\n outer loop\n";
            for &i in t {
                let p = cube.positions[i as usize];
                text += &format!("  vertex {} {} {}\n", p[0], p[1], p[2]);
            }
            text += " endloop\nendfacet\n";
        }
        let ascii = Mesh::load(&write(dir.path(), "a.STL", text.as_bytes())).unwrap();
        for m in [binary, ascii] {
            assert!((m.volume() - 0.006).abs() < 1e-8);
            assert_eq!(m.triangles.len(), 12);
            // Sharp edges: every normal lies along an axis.
            assert!(m.normals.iter().all(|n| n.iter().any(|v| v.abs() > 0.999)));
        }
    }

    #[test]
    fn an_obj_with_materials_keeps_colours_and_texture() {
        let dir = tempfile::tempdir().unwrap();
        let mut png = Vec::new();
        let texture = RgbImage::from_fn(2, 2, |x, y| image::Rgb([x as u8 * 200, y as u8 * 100, 7]));
        texture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
        write(dir.path(), "t.png", &png);
        write(dir.path(), "m.mtl", b"newmtl a\nKd 1 0 0.5\nnewmtl b\nmap_Kd t.png\n");
        let quad = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
        let face = "f 1/1 2/2 3/3 4/4\n";
        let plain = format!("mtllib m.mtl\n{quad}usemtl a\n{face}");
        let m = Mesh::load(&write(dir.path(), "plain.obj", plain.as_bytes())).unwrap();
        assert_eq!((m.triangles.len(), m.colors[0]), (2, [255, 0, 128]));
        assert_eq!(m.normals[0], [0.0, 0.0, 1.0]);
        let textured = format!("mtllib m.mtl\n{quad}usemtl b\n{face}");
        let m = Mesh::load(&write(dir.path(), "tex.obj", textured.as_bytes())).unwrap();
        assert_eq!(m.texture.as_ref().map(|t| t.dimensions()), Some((2, 2)));
        assert_eq!(m.colors[0], [255; 3]);
        // Mixed: the texture goes into the vertex colours of its part.
        let mixed = format!("mtllib m.mtl\n{quad}usemtl a\n{face}usemtl b\n{face}");
        let m = Mesh::load(&write(dir.path(), "mixed.obj", mixed.as_bytes())).unwrap();
        assert!(m.texture.is_none());
        assert!(m.colors.contains(&[255, 0, 128]) && m.colors.contains(&[0, 100, 7]));
    }

    #[test]
    fn bad_meshes_are_refused_with_the_reason() {
        let dir = tempfile::tempdir().unwrap();
        let mm = primitives::cuboid([90.0, 60.0, 190.0], [1; 3]);
        let e = Mesh::load(&write(dir.path(), "mm.stl", &stl_bytes(&mm))).unwrap_err();
        assert!(e.to_string().contains("looks like millimetres"), "{e}");
        // Without any unit: refused as it is, taken by whoever finds the scale.
        let unitless =
            write(dir.path(), "unit.stl", &stl_bytes(&primitives::cuboid([0.9, 1.7, 1.2], [1; 3])));
        assert!(matches!(Mesh::load(&unitless), Err(MeshError::Size { .. })));
        assert!((Mesh::load_unscaled(&unitless).unwrap().volume() - 0.9 * 1.7 * 1.2).abs() < 1e-5);
        let tiny = primitives::cuboid([1e-4; 3], [1; 3]);
        let e = Mesh::load(&write(dir.path(), "tiny.stl", &stl_bytes(&tiny))).unwrap_err();
        assert!(matches!(e, MeshError::Size { .. }));
        let mut nan = primitives::cuboid([0.1; 3], [1; 3]);
        nan.positions[3][1] = f32::NAN;
        let e = Mesh::load(&write(dir.path(), "nan.stl", &stl_bytes(&nan))).unwrap_err();
        assert!(matches!(e, MeshError::NotFinite { .. }));
        let mut cut = stl_bytes(&primitives::cuboid([0.1; 3], [1; 3]));
        cut.truncate(300);
        // The header of the test file starts with 's' but not "solid".
        let e = Mesh::load(&write(dir.path(), "cut.stl", &cut)).unwrap_err();
        assert!(e.to_string().contains("would have 684"), "{e}");
        for (name, text) in [
            ("empty.obj", ""),
            ("points.obj", "v 0 0 0\nv 1 0 0\n"),
            ("empty.stl", "solid nothing\nendsolid\n"),
        ] {
            let e = Mesh::load(&write(dir.path(), name, text.as_bytes())).unwrap_err();
            assert!(matches!(e, MeshError::Empty { .. }), "{name}: {e}");
        }
        for (name, text) in [
            ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
            ("word.obj", "v 0 zero 0\n"),
            ("facet.stl", "solid x\nfacet\nvertex 0 0 0\nendfacet\n"),
            ("vertex.stl", "solid x\nfacet\nvertex 0 0\nendfacet\n"),
        ] {
            let e = Mesh::load(&write(dir.path(), name, text.as_bytes())).unwrap_err();
            assert!(matches!(e, MeshError::Parse { .. }), "{name}: {e}");
        }
        assert!(matches!(Mesh::load(&dir.path().join("no.obj")), Err(MeshError::Io { .. })));
        let e = Mesh::load(&write(dir.path(), "not.ply", b"something else")).unwrap_err();
        assert!(matches!(e, MeshError::Parse { .. }), "{e}");
        let e = Mesh::load(&write(dir.path(), "x.dae", b"<xml>")).unwrap_err();
        assert!(e.to_string().contains(".glb"), "{e}");
    }
}
