//! glTF 2.0, as text or as GLB: every mesh of the scene in one, with base colours and one texture.
//!
//! glTF is y-up and calls its unit the metre; meshes made from pictures have no unit at all. Here z is
//! up: (x, y, z) becomes (x, -z, y).

mod document;

use super::load::{assemble, shrink};
use super::{Mesh, MeshError};
use document::Loaded;
use image::RgbImage;
use nalgebra::{Matrix3, Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};
use std::path::Path;

/// Deepest chain of nodes; a deeper one is a loop.
const DEEPEST: usize = 64;
/// Most vertices of all nodes together.
const MOST_VERTICES: usize = 5_000_000;

/// Reads a `.glb` or `.gltf`; axes turned to z up, normals left out unless every part has them.
pub(super) fn load(path: &Path, bytes: &[u8]) -> Result<Mesh, MeshError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let parse = |reason: String| MeshError::Parse { path: path.into(), reason };
    let loaded = Loaded::parse(bytes, folder).map_err(parse)?;
    let mut reader =
        Reader { loaded, folder, path, textures: Vec::new(), parts: Vec::new(), vertices: 0 };
    let document = &reader.loaded.document;
    let roots: Vec<usize> = match document.scenes.get(document.scene) {
        Some(scene) => scene.nodes.clone(),
        // Without a scene: every node that is nobody's child.
        None => (0..document.nodes.len())
            .filter(|i| document.nodes.iter().all(|n| !n.children.contains(i)))
            .collect(),
    };
    // glTF's y is our z.
    let up = Matrix4::new(
        1.0, 0.0, 0.0, 0.0, //
        0.0, 0.0, -1.0, 0.0, //
        0.0, 1.0, 0.0, 0.0, //
        0.0, 0.0, 0.0, 1.0,
    );
    for node in roots {
        reader.node(node, &up, 0)?;
    }
    let textures = reader.textures.into_iter().map(|(_, image)| image).collect();
    Ok(assemble(reader.parts, textures))
}

struct Reader<'a> {
    loaded: Loaded,
    folder: &'a Path,
    path: &'a Path,
    /// Image number and picture.
    textures: Vec<(usize, RgbImage)>,
    parts: Vec<(Mesh, Option<usize>)>,
    vertices: usize,
}

impl Reader<'_> {
    fn parse(&self, reason: String) -> MeshError {
        MeshError::Parse { path: self.path.into(), reason }
    }

    fn node(&mut self, index: usize, parent: &Matrix4<f64>, depth: usize) -> Result<(), MeshError> {
        if depth > DEEPEST {
            return Err(self.parse("its nodes form a loop".into()));
        }
        let Some(node) = self.loaded.document.nodes.get(index) else {
            return Err(self.parse(format!("no node {index}")));
        };
        let local = match node.matrix {
            Some(m) => Matrix4::from_column_slice(&m),
            None => {
                let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
                let turn =
                    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9).unwrap_or_default();
                Matrix4::new_translation(&node.translation.unwrap_or_default().into())
                    * turn.to_homogeneous()
                    * Matrix4::new_nonuniform_scaling(&node.scale.unwrap_or([1.0; 3]).into())
            }
        };
        let (mesh, children) = (node.mesh, node.children.clone());
        let place = parent * local;
        if let Some(mesh) = mesh {
            let count = self.loaded.document.meshes.get(mesh).map_or(0, |m| m.primitives.len());
            for primitive in 0..count {
                self.primitive(mesh, primitive, &place)?;
            }
        }
        for child in children {
            self.node(child, &place, depth + 1)?;
        }
        Ok(())
    }

    fn primitive(
        &mut self,
        mesh: usize,
        number: usize,
        place: &Matrix4<f64>,
    ) -> Result<(), MeshError> {
        let (loaded, path) = (&self.loaded, self.path);
        let parse = |reason: String| MeshError::Parse { path: path.into(), reason };
        let document = &loaded.document;
        let primitive = &document.meshes[mesh].primitives[number];
        let mode = primitive.mode.unwrap_or(4);
        // Points and lines are no surface.
        if !(4..=6).contains(&mode) {
            return Ok(());
        }
        let Some(positions) = primitive.attributes.get("POSITION") else { return Ok(()) };
        let positions = loaded.floats::<3>(*positions, &[("VEC3", 3)], 0.0).map_err(parse)?;
        let count = positions.len();
        let material = primitive.material.and_then(|m| document.materials.get(m));
        let pbr = material.map(|m| &m.pbr_metallic_roughness);
        let reference = pbr.and_then(|p| p.base_color_texture.as_ref());
        let factor = pbr.and_then(|p| p.base_color_factor);
        let same = |n: usize| (n == count).then_some(());
        let mut uvs = vec![[0.0; 2]; count];
        let mut textured = None;
        if let Some(r) = reference
            && let Some(a) = primitive.attributes.get(&format!("TEXCOORD_{}", r.tex_coord))
        {
            let read = loaded.floats::<2>(*a, &[("VEC2", 2)], 0.0).map_err(parse)?;
            if same(read.len()).is_some() {
                // Its origin is the upper left corner, ours the lower left one.
                uvs = read.iter().map(|uv| [uv[0], 1.0 - uv[1]]).collect();
                textured = Some(r.index);
            }
        }
        let plain = if textured.is_some() { [1.0; 4] } else { [0.58, 0.58, 0.58, 1.0] };
        let factor = factor.unwrap_or(if material.is_some() { [1.0; 4] } else { plain });
        let colors = match primitive.attributes.get("COLOR_0") {
            Some(a) => {
                let kinds = [("VEC4", 4), ("VEC3", 3)];
                loaded.floats::<4>(*a, &kinds, 1.0).map_err(parse)?
            }
            None => Vec::new(),
        };
        let colors: Vec<[u8; 3]> = if same(colors.len()).is_some() && count > 0 {
            let factor = if material.is_some() { factor } else { [1.0; 4] };
            colors.iter().map(|c| std::array::from_fn(|k| encode(c[k] * factor[k]))).collect()
        } else {
            vec![std::array::from_fn(|k| encode(factor[k])); count]
        };
        let normals = match primitive.attributes.get("NORMAL") {
            Some(a) => loaded.floats::<3>(*a, &[("VEC3", 3)], 0.0).map_err(parse)?,
            None => Vec::new(),
        };
        let corners = match primitive.indices {
            Some(a) => loaded.indices(a).map_err(parse)?,
            None => (0..count as u32).collect(),
        };
        let linear: Matrix3<f64> = place.fixed_view::<3, 3>(0, 0).into_owned();
        let triangles = triangles(&corners, mode, linear.determinant() < 0.0);
        let turn = linear.try_inverse().map(|m| m.transpose());
        let moved = positions
            .iter()
            .map(|p| place.transform_point(&Point3::from(p.map(f64::from))))
            .map(|p| [p.x as f32, p.y as f32, p.z as f32])
            .collect();
        let normals = match turn {
            Some(turn) if normals.len() == count => normals
                .iter()
                .map(|n| turn * Vector3::from(n.map(f64::from)))
                .map(|n| n.try_normalize(1e-12).unwrap_or_else(Vector3::z))
                .map(|n| [n.x as f32, n.y as f32, n.z as f32])
                .collect(),
            _ => Vec::new(),
        };
        self.vertices += count;
        if self.vertices > MOST_VERTICES {
            return Err(self.parse(format!("it has more than {MOST_VERTICES} vertices")));
        }
        let texture = match textured {
            Some(index) => Some(self.texture(index)?),
            None => None,
        };
        let part = Mesh { positions: moved, normals, uvs, colors, triangles, texture: None };
        self.parts.push((part, texture));
        Ok(())
    }

    fn texture(&mut self, index: usize) -> Result<usize, MeshError> {
        let (source, bytes) =
            self.loaded.image(index, self.folder).map_err(|reason| self.parse(reason))?;
        if let Some(i) = self.textures.iter().position(|(s, _)| *s == source) {
            return Ok(i);
        }
        let image = image::load_from_memory(&bytes).map_err(|e| MeshError::Texture {
            path: self.path.into(),
            texture: format!("image {source}").into(),
            reason: format!("{e} (PNG and JPEG can be read)"),
        })?;
        self.textures.push((source, shrink(image.into_rgb8())));
        Ok(self.textures.len() - 1)
    }
}

/// Triangles of a list (4), strip (5) or fan (6).
fn triangles(corners: &[u32], mode: u32, mirrored: bool) -> Vec<[u32; 3]> {
    let mut out: Vec<[u32; 3]> = match mode {
        4 => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        5 => corners
            .windows(3)
            .enumerate()
            .map(|(i, c)| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[1], c[0], c[2]] })
            .collect(),
        _ => corners.windows(2).skip(1).map(|c| [corners[0], c[0], c[1]]).collect(),
    };
    if mirrored {
        out.iter_mut().for_each(|t| t.swap(1, 2));
    }
    out
}

/// Linear light to sRGB.
fn encode(v: f32) -> u8 {
    let v = v.clamp(0.0, 1.0);
    let s = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    (s * 255.0).round() as u8
}

#[cfg(test)]
mod tests;
