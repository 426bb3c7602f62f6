use super::{Mesh, MeshError};
use crate::codec::{CodecError, encode_png};
use serde_json::json;
use std::path::Path;

impl Mesh {
    /// The mesh as a GLB (glTF 2.0, y up): positions, normals, colours, texture coordinates and texture.
    ///
    /// # Errors
    /// [`CodecError`] for a texture without pixels.
    pub fn to_glb(&self) -> Result<Vec<u8>, CodecError> {
        let mut data = Bin::default();
        let (low, high) = self.bounds();
        // Back from z up to glTF's y up.
        let turned = |v: &[f32; 3]| [v[0], v[2], -v[1]];
        let positions = data.push(self.positions.iter().flat_map(turned), 34962);
        let normals = data.push(self.normals.iter().flat_map(turned), 34962);
        let colors = data
            .push(self.colors.iter().flat_map(|c| c.map(|v| linear(f32::from(v) / 255.0))), 34962);
        let uvs = data.push(self.uvs.iter().flat_map(|uv| [uv[0], 1.0 - uv[1]]), 34962);
        let indices =
            data.octets(self.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()), 34963);
        let n = self.positions.len();
        let vertices = |view: usize, kind: &str| json!({"bufferView": view, "componentType": 5126, "count": n, "type": kind});
        let mut place = vertices(positions, "VEC3");
        place["min"] = json!([low.x as f32, low.z as f32, -high.y as f32]);
        place["max"] = json!([high.x as f32, high.z as f32, -low.y as f32]);
        let accessors = json!([
            place,
            vertices(normals, "VEC3"),
            vertices(colors, "VEC3"),
            vertices(uvs, "VEC2"),
            {"bufferView": indices, "componentType": 5125, "count": 3 * self.triangles.len(),
             "type": "SCALAR"},
        ]);
        let mut pbr = json!({"metallicFactor": 0.0, "roughnessFactor": 0.9});
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "tdv"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{
                "attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2, "TEXCOORD_0": 3},
                "indices": 4, "material": 0, "mode": 4}]}],
            "accessors": accessors,
        });
        if let Some(texture) = &self.texture {
            let view = data.octets(encode_png(texture)?, 0);
            pbr["baseColorTexture"] = json!({"index": 0});
            document["textures"] = json!([{"source": 0}]);
            document["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
        }
        document["materials"] = json!([{"pbrMetallicRoughness": pbr}]);
        document["bufferViews"] = data.views.into();
        document["buffers"] = json!([{"byteLength": data.bytes.len()}]);
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + text.len() + 8 + data.bytes.len();
        let mut out = b"glTF".to_vec();
        out.extend(2_u32.to_le_bytes());
        out.extend((total as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &data.bytes)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(chunk);
        }
        Ok(out)
    }

    /// Writes [`Self::to_glb`] to `path`.
    ///
    /// # Errors
    /// [`MeshError::Io`], [`MeshError::Texture`].
    pub fn save_glb(&self, path: &Path) -> Result<(), MeshError> {
        let bytes = self.to_glb().map_err(|e| MeshError::Texture {
            path: path.into(),
            texture: "of the mesh".into(),
            reason: e.to_string(),
        })?;
        std::fs::write(path, bytes).map_err(|source| MeshError::Io { path: path.into(), source })
    }
}

#[derive(Default)]
struct Bin {
    bytes: Vec<u8>,
    views: Vec<serde_json::Value>,
}

impl Bin {
    fn push(&mut self, values: impl IntoIterator<Item = f32>, target: u32) -> usize {
        self.octets(values.into_iter().flat_map(f32::to_le_bytes), target)
    }

    /// Appends a view; its number. `target` 0 is none.
    fn octets(&mut self, octets: impl IntoIterator<Item = u8>, target: u32) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(octets);
        let mut view =
            json!({"buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start});
        if target != 0 {
            view["target"] = target.into();
        }
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }
}

/// sRGB to linear light.
fn linear(v: f32) -> f32 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}
