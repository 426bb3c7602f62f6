//! Stanford PLY, as text or binary: positions, normals, vertex colours, texture coordinates.

use super::{Mesh, MeshError};
use std::path::Path;

/// Most entries of an element: a damaged header must not ask for all memory.
const MOST: usize = 20_000_000;

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Text,
    Little,
    Big,
}

#[derive(Clone, Copy)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    kind: Kind,
    /// Type of the count, for a list.
    list: Option<Kind>,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Reads a PLY; normals are left out unless every vertex has one.
pub(super) fn load(path: &Path, bytes: &[u8]) -> Result<Mesh, MeshError> {
    read(bytes).map_err(|reason| MeshError::Parse { path: path.into(), reason })
}

fn read(bytes: &[u8]) -> Result<Mesh, String> {
    let (form, elements, start) = header(bytes)?;
    let mut values = Values { form, bytes: &bytes[start..], at: 0 };
    let mut mesh = Mesh::default();
    let mut faces = false;
    let mut has_normals = false;
    for element in &elements {
        let vertex = element.name == "vertex";
        let find = |names: &[&str]| {
            element.properties.iter().position(|p| names.contains(&p.name.as_str()))
        };
        let place = [find(&["x"]), find(&["y"]), find(&["z"])];
        let normal = [find(&["nx"]), find(&["ny"]), find(&["nz"])];
        let color = [find(&["red", "r"]), find(&["green", "g"]), find(&["blue", "b"])];
        let uv = [find(&["s", "u", "texture_u"]), find(&["t", "v", "texture_v"])];
        // Float colours run from 0 to 1, whole ones to 255.
        let whole = color[0].is_none_or(|i| element.properties[i].kind.size() == 1);
        let face = element.name == "face";
        let corners = find(&["vertex_indices", "vertex_index"]);
        if vertex && place.iter().any(Option::is_none) {
            return Err("its vertices have no x, y, z".into());
        }
        faces |= face && element.count > 0;
        has_normals |= vertex && normal.iter().all(Option::is_some);
        let mut row = vec![0.0; element.properties.len()];
        let mut list = Vec::new();
        for number in 0..element.count {
            for (k, p) in element.properties.iter().enumerate() {
                let cut = || {
                    format!(
                        "{} {number} of {}: the file ends or a value is bad",
                        element.name, element.count
                    )
                };
                let Some(count_kind) = p.list else {
                    row[k] = values.next(p.kind).ok_or_else(cut)?;
                    continue;
                };
                let count = values.next(count_kind).ok_or_else(cut)?;
                if !(0.0..=100_000.0).contains(&count) {
                    return Err(format!("{} {number}: a list of {count} values", element.name));
                }
                let mine = face && Some(k) == corners;
                list.clear();
                for _ in 0..count as usize {
                    let v = values.next(p.kind).ok_or_else(cut)?;
                    if mine {
                        list.push(if v >= 0.0 && v < f64::from(u32::MAX) {
                            v as u32
                        } else {
                            u32::MAX
                        });
                    }
                }
                if mine {
                    // A polygon is a fan round its first corner.
                    let fan = list.windows(2).skip(1).map(|c| [list[0], c[0], c[1]]);
                    mesh.triangles.extend(fan);
                }
            }
            if vertex {
                let three = |at: &[Option<usize>; 3]| at.map(|i| i.map_or(0.0, |i| row[i] as f32));
                mesh.positions.push(three(&place));
                mesh.normals.push(three(&normal));
                mesh.uvs.push(uv.map(|i| i.map_or(0.0, |i| row[i] as f32)));
                mesh.colors.push(if color.iter().all(Option::is_some) {
                    three(&color).map(|v| if whole { v } else { v * 255.0 }.clamp(0.0, 255.0) as u8)
                } else {
                    [200; 3]
                });
            }
        }
    }
    if !faces && !mesh.positions.is_empty() {
        return Err(format!(
            "{} points without faces: a point cloud (or Gaussian splats) is no mesh; export the mesh, \
             as GLB for example",
            mesh.positions.len()
        ));
    }
    if !has_normals {
        mesh.normals.clear();
    }
    Ok(mesh)
}

/// Form, elements, and where the data begins.
fn header(bytes: &[u8]) -> Result<(Form, Vec<Element>, usize), String> {
    let mut at = 0;
    let mut form = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = bytes.get(at..).unwrap_or_default();
        let length = line.iter().position(|b| *b == b'\n').ok_or("its header has no end")?;
        let line = std::str::from_utf8(&line[..length]).map_err(|_| "its header is not text")?;
        at += length + 1;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let bad = || format!("header line {:?}", line.trim());
        match words.as_slice() {
            ["ply"] | ["comment" | "obj_info", ..] | [] => {}
            ["format", name, _] => {
                form = Some(match *name {
                    "ascii" => Form::Text,
                    "binary_little_endian" => Form::Little,
                    "binary_big_endian" => Form::Big,
                    _ => return Err(bad()),
                });
            }
            ["element", name, count] => {
                let count = count.parse().ok().filter(|n| *n <= MOST).ok_or_else(bad)?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let (list, kind, name) = match rest {
                    ["list", count, kind, name] => {
                        (Some(Kind::of(count).ok_or_else(bad)?), kind, name)
                    }
                    [kind, name] => (None, kind, name),
                    _ => return Err(bad()),
                };
                let kind = Kind::of(kind).ok_or_else(bad)?;
                let element = elements.last_mut().ok_or_else(bad)?;
                element.properties.push(Property { name: (*name).into(), kind, list });
            }
            ["end_header"] => break,
            _ => return Err(bad()),
        }
    }
    Ok((form.ok_or("its header names no format")?, elements, at))
}

struct Values<'a> {
    form: Form,
    bytes: &'a [u8],
    at: usize,
}

impl Values<'_> {
    fn next(&mut self, kind: Kind) -> Option<f64> {
        if self.form == Form::Text {
            let rest = self.bytes.get(self.at..)?;
            let begin = rest.iter().position(|b| !b.is_ascii_whitespace())?;
            let word = &rest[begin..];
            let end = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
            self.at += begin + end;
            return std::str::from_utf8(&word[..end]).ok()?.parse().ok();
        }
        let size = kind.size();
        let mut b = [0_u8; 8];
        b[..size].copy_from_slice(self.bytes.get(self.at..self.at + size)?);
        self.at += size;
        if self.form == Form::Big {
            b[..size].reverse();
        }
        let [b0, b1, b2, b3, ..] = b;
        Some(match kind {
            Kind::I8 => f64::from(i8::from_le_bytes([b0])),
            Kind::U8 => f64::from(b0),
            Kind::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Kind::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Kind::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Kind::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Kind::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Kind::F64 => f64::from_le_bytes(b),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "comment made for a test\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const POINTS: [[f32; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]];

    fn binary(big: bool) -> Vec<u8> {
        let name = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut out = format!("ply\nformat {name} 1.0\n{HEADER}").into_bytes();
        for (i, p) in POINTS.iter().enumerate() {
            for v in p {
                out.extend(if big { v.to_be_bytes() } else { v.to_le_bytes() });
            }
            out.extend([i as u8 * 10, 20, 30]);
        }
        out.push(4);
        for i in 0..4_i32 {
            out.extend(if big { i.to_be_bytes() } else { i.to_le_bytes() });
        }
        out
    }

    #[test]
    fn text_and_both_byte_orders_give_the_same_square() {
        let mut text = format!("ply\nformat ascii 1.0\n{HEADER}");
        for (i, p) in POINTS.iter().enumerate() {
            text += &format!("{} {} {} {} 20 30\n", p[0], p[1], p[2], i * 10);
        }
        text += "4 0 1 2 3\n";
        for bytes in [text.into_bytes(), binary(false), binary(true)] {
            let mesh = read(&bytes).unwrap();
            assert_eq!(mesh.positions, POINTS);
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(mesh.colors[3], [30, 20, 30]);
            assert!(mesh.normals.is_empty());
        }
    }

    #[test]
    fn clouds_and_damaged_files_are_errors() {
        let good = binary(false);
        for cut in [3, 30, good.len() - 30, good.len() - 1] {
            assert!(read(&good[..cut]).is_err(), "cut at {cut}");
        }
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
            property float z\nend_header\n1 2 3\n";
        assert!(read(text.as_bytes()).unwrap_err().contains("point cloud"));
        let huge = text.replace("vertex 1", "vertex 99999999999");
        assert!(read(huge.as_bytes()).unwrap_err().contains("99999999999"));
    }
}
