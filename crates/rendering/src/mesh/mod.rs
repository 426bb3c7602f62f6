//! Triangle meshes in metres with per-vertex normals, texture coordinates and colours.

mod gltf;
mod load;
mod ply;
pub mod primitives;
mod sample;
mod topology;
mod write;
mod write_glb;

pub use sample::SurfacePoint;
pub use topology::Topology;

use image::RgbImage;
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;
use std::path::PathBuf;
use tdv_geometry::Pose;
use thiserror::Error;

/// Why a mesh was refused.
#[derive(Debug, Error)]
pub enum MeshError {
    /// The file cannot be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No format that is known.
    #[error("{path}: unknown mesh format, expected .obj, .glb, .gltf, .ply or .stl")]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// The contents do not follow the format.
    #[error("{path}: {reason}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Nothing to draw.
    #[error("{path}: the mesh has no triangles")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A coordinate is NaN or infinite.
    #[error("{path}: vertex {index} is not finite: {value:?}")]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Which vertex.
        index: usize,
        /// Its coordinates.
        value: [f32; 3],
    },
    /// A triangle names a vertex that does not exist.
    #[error("{path}: triangle {triangle} names vertex {vertex}, but there are {count}")]
    Index {
        /// The file.
        path: PathBuf,
        /// Which triangle.
        triangle: usize,
        /// The index it names.
        vertex: u32,
        /// How many vertices there are.
        count: usize,
    },
    /// A size no tabletop object has.
    #[error("{path}: the mesh is {diameter:.4} m across; {hint}")]
    Size {
        /// The file.
        path: PathBuf,
        /// Its diameter as read.
        diameter: f64,
        /// What to do.
        hint: String,
    },
    /// A texture image cannot be read.
    #[error("{path}: texture {texture}: {reason}")]
    Texture {
        /// The mesh file.
        path: PathBuf,
        /// The texture file.
        texture: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// A triangle mesh, metres. All per-vertex lists have the same length; triangles are
/// counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions (m).
    pub positions: Vec<[f32; 3]>,
    /// Unit normals.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, (0, 0) at the texture's lower left corner.
    pub uvs: Vec<[f32; 2]>,
    /// sRGB colours; multiply the texture if there is one.
    pub colors: Vec<[u8; 3]>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Colour texture (sRGB).
    pub texture: Option<RgbImage>,
}

impl Mesh {
    /// Smallest and largest coordinates (m); zeros for a mesh without vertices.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        let Some(first) = self.positions.first() else {
            return (Point3::origin(), Point3::origin());
        };
        let (mut low, mut high) = (*first, *first);
        for p in &self.positions {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        (Point3::from(low.map(f64::from)), Point3::from(high.map(f64::from)))
    }

    /// Middle of the bounding box (m).
    pub fn center(&self) -> Point3<f64> {
        let (low, high) = self.bounds();
        nalgebra::center(&low, &high)
    }

    /// Diameter (m) of the sphere round [`Self::center`] that holds every vertex: never less than
    /// the largest distance between two vertices, and at most a factor of sqrt(3) above it.
    pub fn diameter(&self) -> f64 {
        let c = self.center();
        let far =
            self.positions.iter().map(|p| (Point3::from(p.map(f64::from)) - c).norm_squared());
        2.0 * far.fold(0.0, f64::max).sqrt()
    }

    /// Moved by `pose` (T_new_mesh).
    #[must_use]
    pub fn transformed(&self, pose: &Pose) -> Self {
        let mut out = self.clone();
        for p in &mut out.positions {
            let q = pose * Point3::from(p.map(f64::from));
            *p = [q.x as f32, q.y as f32, q.z as f32];
        }
        for n in &mut out.normals {
            let q = pose.rotation * Vector3::from(n.map(f64::from));
            *n = [q.x as f32, q.y as f32, q.z as f32];
        }
        out
    }

    /// Scaled about the origin by a positive factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let mut out = self.clone();
        for p in &mut out.positions {
            *p = p.map(|v| (f64::from(v) * factor) as f32);
        }
        out
    }

    /// Stretched along the axes by positive factors; normals follow the surface.
    #[must_use]
    pub fn stretched(&self, factors: [f64; 3]) -> Self {
        let mut out = self.clone();
        for p in &mut out.positions {
            *p = std::array::from_fn(|k| (f64::from(p[k]) * factors[k]) as f32);
        }
        for n in &mut out.normals {
            let m = Vector3::from_fn(|k, _| f64::from(n[k]) / factors[k]);
            let m = m.try_normalize(1e-12).unwrap_or_else(Vector3::z);
            *n = [m.x as f32, m.y as f32, m.z as f32];
        }
        out
    }

    /// The same mesh in one colour.
    #[must_use]
    pub fn colored(mut self, color: [u8; 3]) -> Self {
        self.colors.fill(color);
        self
    }

    /// Adds the other's triangles. A mesh keeps one texture only: the result is textured if `self`
    /// was empty; otherwise both textures are first baked into the vertex colours.
    pub fn append(&mut self, other: &Mesh) {
        if self.positions.is_empty() {
            *self = other.clone();
            return;
        }
        let mut other = other.clone();
        self.bake_texture();
        other.bake_texture();
        let base = self.positions.len() as u32;
        self.positions.append(&mut other.positions);
        self.normals.append(&mut other.normals);
        self.uvs.append(&mut other.uvs);
        self.colors.append(&mut other.colors);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
    }

    /// Samples the texture at the vertices, multiplies it into the vertex colours and drops it.
    pub fn bake_texture(&mut self) {
        let Some(texture) = self.texture.take() else { return };
        for (color, uv) in self.colors.iter_mut().zip(&self.uvs) {
            let texel = nearest_texel(&texture, *uv);
            *color = std::array::from_fn(|k| {
                ((u32::from(color[k]) * u32::from(texel[k]) + 127) / 255) as u8
            });
        }
    }

    /// Normals from the triangles, weighted by the corner angle. Vertices at the same position are
    /// smoothed together where their faces meet at less than 40 degrees, so that a mesh split at
    /// texture seams (or an STL, which shares nothing) looks round where it is round and sharp at
    /// its edges.
    pub fn recompute_normals(&mut self) {
        let v = |i: u32| Vector3::from(self.positions[i as usize].map(f64::from));
        let mut own = vec![Vector3::<f64>::zeros(); self.positions.len()];
        for t in &self.triangles {
            let p = t.map(v);
            let Some(n) = (p[1] - p[0]).cross(&(p[2] - p[0])).try_normalize(1e-20) else {
                continue;
            };
            for k in 0..3 {
                let a = p[(k + 1) % 3] - p[k];
                let b = p[(k + 2) % 3] - p[k];
                own[t[k] as usize] += n * a.angle(&b);
            }
        }
        let mut at: HashMap<[i64; 3], Vec<u32>> = HashMap::with_capacity(self.positions.len());
        for (i, p) in self.positions.iter().enumerate() {
            let key = p.map(|c| (f64::from(c) * 1e6).round() as i64);
            at.entry(key).or_default().push(i as u32);
        }
        let limit = 40_f64.to_radians().cos();
        self.normals = vec![[0.0, 0.0, 1.0]; self.positions.len()];
        for group in at.values() {
            for &i in group {
                // A vertex of no triangle takes what the others at its place agree on.
                let mine = own[i as usize].try_normalize(1e-20);
                let mut sum = Vector3::zeros();
                for &j in group {
                    let Some(theirs) = own[j as usize].try_normalize(1e-20) else { continue };
                    if i == j || mine.is_none_or(|m| m.dot(&theirs) > limit) {
                        sum += own[j as usize];
                    }
                }
                let Some(n) = sum.try_normalize(1e-20).or(mine) else { continue };
                self.normals[i as usize] = [n.x as f32, n.y as f32, n.z as f32];
            }
        }
    }

    /// Signed volume (m^3); that of the solid if the mesh is closed and wound outwards.
    pub fn volume(&self) -> f64 {
        let v = |i: u32| Vector3::from(self.positions[i as usize].map(f64::from));
        self.triangles.iter().map(|t| v(t[0]).dot(&v(t[1]).cross(&v(t[2])))).sum::<f64>() / 6.0
    }
}

/// A texture coordinate brought to 0..1 by repetition; 1 itself stays.
pub(crate) fn repeat(t: f32) -> f32 {
    if (0.0..=1.0).contains(&t) {
        t
    } else if t.abs() < 1e6 {
        // Casting truncates; `floor` and `rem_euclid` are library calls on the baseline processor.
        let part = t - t as i32 as f32;
        if part < 0.0 { part + 1.0 } else { part }
    } else {
        0.0
    }
}

/// Texel at a texture coordinate, repeating outside 0..1.
pub(crate) fn nearest_texel(texture: &RgbImage, uv: [f32; 2]) -> [u8; 3] {
    let (w, h) = texture.dimensions();
    let wrap = |t: f32, n: u32| ((repeat(t) * n as f32) as u32).min(n.saturating_sub(1));
    if w == 0 || h == 0 {
        return [255; 3];
    }
    texture.get_pixel(wrap(uv[0], w), wrap(1.0 - uv[1], h)).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    #[test]
    fn bounds_transform_and_scale() {
        let m = primitives::cuboid([0.1, 0.2, 0.3], [9, 8, 7]);
        assert!((m.diameter() - (0.01f64 + 0.04 + 0.09).sqrt()).abs() < 1e-6);
        let moved = m.transformed(&pose_from_xyz_rpy([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])).scaled(2.0);
        assert!((moved.center() - Point3::new(2.0, 0.0, 0.0)).norm() < 1e-6);
        assert!((moved.volume() - 8.0 * 0.006).abs() < 1e-7);
    }

    #[test]
    fn normals_are_smooth_on_a_cylinder_and_sharp_at_its_rim() {
        let reference = primitives::cylinder(0.03, 0.1, 48, [1, 2, 3]);
        let mut m = reference.clone();
        m.recompute_normals();
        for (a, b) in m.normals.iter().zip(&reference.normals) {
            let dot: f32 = (0..3).map(|k| a[k] * b[k]).sum();
            assert!(dot > 0.995, "{a:?} {b:?}");
        }
    }

    #[test]
    fn appending_keeps_one_texture_and_bakes_the_rest() {
        let mut plain = primitives::cuboid([0.1; 3], [200, 100, 50]);
        let mut textured = primitives::cuboid([0.1; 3], [255; 3]);
        textured.texture = Some(RgbImage::from_pixel(4, 4, image::Rgb([10, 20, 30])));
        plain.append(&textured);
        assert!(plain.texture.is_none());
        assert_eq!(plain.colors[0], [200, 100, 50]);
        assert_eq!(plain.colors.last(), Some(&[10, 20, 30]));
        assert_eq!(plain.triangles.len(), 24);
        let mut empty = Mesh::default();
        empty.append(&textured);
        assert!(empty.texture.is_some());
    }
}
