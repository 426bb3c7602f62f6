//! The part of a glTF 2.0 document that a still mesh needs, and the numbers behind its accessors.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Extensions that change the data itself and are understood; others may be used, not required.
const UNDERSTOOD: [&str; 3] =
    ["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness"];
/// Most numbers of one accessor: a damaged count must not ask for all memory.
const MOST: usize = 30_000_000;

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    pub extensions_required: Vec<String>,
    pub scene: usize,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<MeshEntry>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<View>,
    pub buffers: Vec<Buffer>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub images: Vec<Image>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct Scene {
    pub nodes: Vec<usize>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct Node {
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    /// Column after column.
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct MeshEntry {
    pub primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct Primitive {
    pub attributes: BTreeMap<String, usize>,
    pub indices: Option<usize>,
    pub material: Option<usize>,
    pub mode: Option<u32>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    pub byte_offset: usize,
    pub component_type: u32,
    pub normalized: bool,
    pub count: usize,
    #[serde(rename = "type")]
    pub kind: String,
    pub sparse: Option<serde_json::Value>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct View {
    pub buffer: usize,
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct Buffer {
    pub uri: Option<String>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Material {
    pub pbr_metallic_roughness: Pbr,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Pbr {
    pub base_color_factor: Option<[f32; 4]>,
    pub base_color_texture: Option<TextureRef>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct TextureRef {
    pub index: usize,
    pub tex_coord: usize,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default)]
pub(super) struct Texture {
    pub source: Option<usize>,
}

#[derive(Debug, Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Image {
    pub uri: Option<String>,
    pub buffer_view: Option<usize>,
}

/// A document with its buffers in memory.
pub(super) struct Loaded {
    pub document: Document,
    buffers: Vec<Vec<u8>>,
}

impl Loaded {
    /// From the octets of a `.glb` or `.gltf`; other files are looked for in `folder`.
    pub fn parse(bytes: &[u8], folder: &Path) -> Result<Self, String> {
        let (json, binary) =
            if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
        let document: Document =
            serde_json::from_slice(json).map_err(|e| format!("not a glTF document: {e}"))?;
        if let Some(name) =
            document.extensions_required.iter().find(|n| !UNDERSTOOD.contains(&n.as_str()))
        {
            return Err(format!(
                "it requires the extension {name}, which is not understood: export it uncompressed"
            ));
        }
        let buffers = document
            .buffers
            .iter()
            .enumerate()
            .map(|(i, b)| match (&b.uri, binary) {
                (Some(uri), _) => resource(uri, folder),
                (None, Some(bytes)) if i == 0 => Ok(bytes.to_vec()),
                (None, _) => Err(format!("buffer {i} has neither a file nor a binary chunk")),
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { document, buffers })
    }

    /// The octets of a buffer view.
    fn view(&self, index: usize) -> Result<(&[u8], Option<usize>), String> {
        let view = self.document.buffer_views.get(index).ok_or(format!("no bufferView {index}"))?;
        let buffer = self.buffers.get(view.buffer).ok_or(format!("no buffer {}", view.buffer))?;
        let end = view.byte_offset.checked_add(view.byte_length);
        end.and_then(|end| buffer.get(view.byte_offset..end))
            .map(|bytes| (bytes, view.byte_stride))
            .ok_or(format!("bufferView {index} reaches beyond its buffer: the file is cut short"))
    }

    /// Encoded image (PNG or JPEG) of a texture.
    pub fn image(&self, texture: usize, folder: &Path) -> Result<(usize, Vec<u8>), String> {
        let none = || format!("texture {texture} names no PNG or JPEG image");
        let source = self.document.textures.get(texture).and_then(|t| t.source).ok_or_else(none)?;
        let image = self.document.images.get(source).ok_or_else(none)?;
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Ok((source, resource(uri, folder)?)),
            (None, Some(view)) => Ok((source, self.view(view)?.0.to_vec())),
            (None, None) => Err(none()),
        }
    }

    /// The elements of an accessor, `N` numbers each; `fill` for components that are not there (an
    /// alpha value). Integers that stand for 0..1 (or -1..1) are divided.
    pub fn floats<const N: usize>(
        &self,
        index: usize,
        kinds: &[(&str, usize)],
        fill: f32,
    ) -> Result<Vec<[f32; N]>, String> {
        let (accessor, width, bytes, stride) = self.accessor(index, kinds)?;
        let size = component_size(accessor.component_type)?;
        let whole = accessor.normalized;
        let read = |b: &[u8]| -> f32 {
            match (accessor.component_type, b) {
                (5120, [a, ..]) => {
                    let v = f32::from(i8::from_le_bytes([*a]));
                    if whole { (v / 127.0).max(-1.0) } else { v }
                }
                (5121, [a, ..]) => f32::from(*a) / if whole { 255.0 } else { 1.0 },
                (5122, [a, b, ..]) => {
                    let v = f32::from(i16::from_le_bytes([*a, *b]));
                    if whole { (v / 32767.0).max(-1.0) } else { v }
                }
                (5123, [a, b, ..]) => {
                    f32::from(u16::from_le_bytes([*a, *b])) / if whole { 65535.0 } else { 1.0 }
                }
                (5125, [a, b, c, d, ..]) => u32::from_le_bytes([*a, *b, *c, *d]) as f32,
                (_, [a, b, c, d, ..]) => f32::from_le_bytes([*a, *b, *c, *d]),
                _ => f32::NAN,
            }
        };
        Ok((0..accessor.count)
            .map(|i| {
                let element = &bytes[i * stride..];
                std::array::from_fn(|k| if k < width { read(&element[k * size..]) } else { fill })
            })
            .collect())
    }

    /// Vertex numbers.
    pub fn indices(&self, index: usize) -> Result<Vec<u32>, String> {
        let (accessor, _, bytes, stride) = self.accessor(index, &[("SCALAR", 1)])?;
        (0..accessor.count)
            .map(|i| match (accessor.component_type, &bytes[i * stride..]) {
                (5121, [a, ..]) => Ok(u32::from(*a)),
                (5123, [a, b, ..]) => Ok(u32::from(u16::from_le_bytes([*a, *b]))),
                (5125, [a, b, c, d, ..]) => Ok(u32::from_le_bytes([*a, *b, *c, *d])),
                (other, _) => Err(format!("indices of component type {other}")),
            })
            .collect()
    }

    /// An accessor, its components, its octets from the first element on (long enough for all) and the
    /// octets from one element to the next.
    fn accessor(
        &self,
        index: usize,
        kinds: &[(&str, usize)],
    ) -> Result<(&Accessor, usize, &[u8], usize), String> {
        let a = self.document.accessors.get(index).ok_or(format!("no accessor {index}"))?;
        let bad = |why: String| format!("accessor {index}: {why}");
        let Some((_, width)) = kinds.iter().find(|(k, _)| *k == a.kind) else {
            return Err(bad(format!("is {:?}, expected {}", a.kind, kinds[0].0)));
        };
        if a.sparse.is_some() {
            return Err(bad("sparse accessors are not understood".into()));
        }
        let view = a.buffer_view.ok_or_else(|| bad("has no bufferView".into()))?;
        let (bytes, stride) = self.view(view)?;
        let element = component_size(a.component_type)? * width;
        let stride = stride.unwrap_or(element);
        if a.count > MOST || stride < element {
            return Err(bad(format!("{} elements, {stride} octets apart", a.count)));
        }
        let bytes = bytes.get(a.byte_offset..).unwrap_or_default();
        let need = if a.count == 0 { 0 } else { (a.count - 1) * stride + element };
        if bytes.len() < need {
            return Err(bad(format!("needs {need} octets, its view has {}", bytes.len())));
        }
        Ok((a, *width, bytes, stride))
    }
}

fn component_size(kind: u32) -> Result<usize, String> {
    match kind {
        5120 | 5121 => Ok(1),
        5122 | 5123 => Ok(2),
        5125 | 5126 => Ok(4),
        other => Err(format!("unknown component type {other}")),
    }
}

/// JSON and binary chunk of a GLB.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let word =
        |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    match word(4) {
        Some(2) => {}
        Some(v) => return Err(format!("GLB version {v}; only version 2 is understood")),
        None => return Err("the GLB header is cut short".into()),
    }
    let (mut json, mut binary, mut at) = (None, None, 12_usize);
    while let (Some(length), Some(kind)) = (word(at), word(at + 4)) {
        let data = bytes
            .get(at + 8..(at + 8).saturating_add(length as usize))
            .ok_or("a GLB chunk reaches beyond the file: it is cut short")?;
        match &kind.to_le_bytes() {
            b"JSON" => json = json.or(Some(data)),
            b"BIN\0" => binary = binary.or(Some(data)),
            _ => {}
        }
        at = (at + 8).saturating_add(length as usize);
    }
    json.map(|j| (j, binary)).ok_or("the GLB has no JSON chunk".into())
}

/// A `data:` URI or a file beside the document.
fn resource(uri: &str, folder: &Path) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) =
            data.split_once(";base64,").ok_or("a data URI that is not base64".to_owned())?;
        return base64(text).ok_or("a data URI with damaged base64".into());
    }
    let name = uri.replace("%20", " ");
    if name.contains("://") || Path::new(&name).is_absolute() || name.split('/').any(|p| p == "..")
    {
        return Err(format!("{uri}: only files beside the mesh are read"));
    }
    std::fs::read(folder.join(&name)).map_err(|e| format!("{name}: {e}"))
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut held, mut bits) = (0_u32, 0);
    for c in text.bytes().filter(|c| !c.is_ascii_whitespace() && *c != b'=') {
        let v = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        held = (held << 6 | u32::from(v)) & 0xff_ffff;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((held >> bits) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_every_length() {
        for (text, data) in
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob")]
        {
            assert_eq!(base64(text).unwrap(), data.as_bytes());
        }
        assert_eq!(base64("Zm9*"), None);
    }
}
