//! Second pass: what each pixel shows.

use super::{Instance, Renderer};
use crate::lighting::Lighting;
use crate::mesh::{nearest_texel, repeat};
use crate::{Intrinsics, RgbImage};
use std::sync::LazyLock;

type V3 = [f32; 3];

fn dot(a: &V3, b: &V3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: &V3, b: &V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: &V3, b: &V3) -> V3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn normalize(a: V3) -> V3 {
    let s = dot(&a, &a);
    if s > 1e-24 { a.map(|v| v / s.sqrt()) } else { a }
}

/// A quantity that varies linearly over a triangle: value at the first corner and the differences
/// to the two others.
#[derive(Clone, Copy)]
struct Linear<const N: usize> {
    base: [f32; N],
    d1: [f32; N],
    d2: [f32; N],
}

impl<const N: usize> Default for Linear<N> {
    fn default() -> Self {
        Self { base: [0.0; N], d1: [0.0; N], d2: [0.0; N] }
    }
}

impl<const N: usize> Linear<N> {
    fn new(v: [[f32; N]; 3]) -> Self {
        Self {
            base: v[0],
            d1: std::array::from_fn(|k| v[1][k] - v[0][k]),
            d2: std::array::from_fn(|k| v[2][k] - v[0][k]),
        }
    }

    fn at(&self, b1: f32, b2: f32) -> [f32; N] {
        std::array::from_fn(|k| self.base[k] + b1 * self.d1[k] + b2 * self.d2[k])
    }
}

/// What the pixels of one triangle have in common.
#[derive(Clone, Copy, Default)]
struct Facet {
    id: u16,
    instance: usize,
    corner: V3,
    /// Barycentric coordinates are `k1 . (p - corner)` and `k2 . (p - corner)`.
    k1: V3,
    k2: V3,
    normal: Linear<3>,
    albedo: Linear<3>,
    uv: Linear<2>,
}

impl Renderer {
    fn facet(&self, scene: &[Instance<'_>], number: u32, colored: bool) -> Facet {
        let (index, triangle) = self.drawn[number as usize];
        let instance = &scene[index as usize];
        let mesh = instance.mesh;
        let base = self.bases[index as usize];
        let t = mesh.triangles[triangle as usize].map(|i| i as usize);
        let p = t.map(|i| self.camera[base + i]);
        let (e1, e2) = (sub(&p[1], &p[0]), sub(&p[2], &p[0]));
        let face = cross(&e1, &e2);
        let square = dot(&face, &face).max(1e-30);
        let mut n = t.map(|i| self.normals[base + i]);
        for v in &mut n {
            if dot(v, v) < 1e-12 {
                *v = normalize(face);
            }
        }
        let mut facet = Facet {
            id: instance.id,
            instance: index as usize,
            corner: p[0],
            k1: cross(&e2, &face).map(|v| v / square),
            k2: cross(&face, &e1).map(|v| v / square),
            normal: Linear::new(n),
            ..Facet::default()
        };
        if colored {
            let table = &*TO_LINEAR;
            let color = t.map(|i| mesh.colors.get(i).copied().unwrap_or([200; 3]));
            facet.albedo = Linear::new(color.map(|c| c.map(|v| table[v as usize])));
            if mesh.texture.is_some() {
                facet.uv = Linear::new(t.map(|i| mesh.uvs.get(i).copied().unwrap_or_default()));
            }
        }
        facet
    }

    pub(super) fn resolve(
        &self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        (depth, ids, normals): (&mut [f32], &mut [u16], &mut [V3]),
        mut color: Option<(&mut Shader, &mut RgbImage)>,
    ) {
        let width = camera.width as usize;
        if width == 0 {
            return;
        }
        let (fx, fy) = (1.0 / camera.fx as f32, 1.0 / camera.fy as f32);
        let mut facet = Facet::default();
        let mut current = 0;
        for y in 0..camera.height as usize {
            let ray_y = (y as f32 - camera.cy as f32) * fy;
            for x in 0..width {
                let i = y * width + x;
                let seen = self.visible[i];
                if seen == 0 {
                    depth[i] = 0.0;
                    ids[i] = 0;
                    normals[i] = [0.0; 3];
                    if let Some((shader, image)) = &mut color {
                        image.as_mut()[3 * i..3 * i + 3].copy_from_slice(&shader.background);
                    }
                    continue;
                }
                if seen != current {
                    facet = self.facet(scene, seen - 1, color.is_some());
                    current = seen;
                }
                let z = 1.0 / self.inv_z[i];
                let p = [(x as f32 - camera.cx as f32) * fx * z, ray_y * z, z];
                let from = sub(&p, &facet.corner);
                let (b1, b2) = (dot(&facet.k1, &from), dot(&facet.k2, &from));
                let mut n = normalize(facet.normal.at(b1, b2));
                if dot(&n, &p) > 0.0 {
                    n = n.map(|v| -v);
                }
                depth[i] = z;
                ids[i] = facet.id;
                normals[i] = n;
                if let Some((shader, image)) = &mut color {
                    let mut albedo = facet.albedo.at(b1, b2);
                    if let Some(texture) = &scene[facet.instance].mesh.texture {
                        let texel = bilinear(texture, facet.uv.at(b1, b2));
                        for k in 0..3 {
                            albedo[k] *= texel[k];
                        }
                    }
                    let shaded = shader.shade(&albedo, &n, &p);
                    image.as_mut()[3 * i..3 * i + 3].copy_from_slice(&shaded);
                }
            }
        }
    }
}

/// Linear-light texture value between the four nearest texels, repeating outside 0..1 (without
/// blending across the border).
fn bilinear(texture: &RgbImage, uv: [f32; 2]) -> V3 {
    let table = &*TO_LINEAR;
    let (w, h) = texture.dimensions();
    if w < 2 || h < 2 {
        return nearest_texel(texture, uv).map(|v| table[v as usize]);
    }
    let u = (repeat(uv[0]) * w as f32 - 0.5).clamp(0.0, (w - 1) as f32);
    let v = (repeat(1.0 - uv[1]) * h as f32 - 0.5).clamp(0.0, (h - 1) as f32);
    let (fu, fv) = (u.fract(), v.fract());
    let column = |d: usize| (u as usize + d).min(w as usize - 1);
    let row = |d: usize| (v as usize + d).min(h as usize - 1);
    let raw = texture.as_raw();
    let texel = |x: usize, y: usize| {
        let i = 3 * (y * w as usize + x);
        [raw[i], raw[i + 1], raw[i + 2]].map(|v| table[v as usize])
    };
    let (x0, x1, y0, y1) = (column(0), column(1), row(0), row(1));
    let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
    std::array::from_fn(|k| {
        let top = a[k] + fu * (b[k] - a[k]);
        let bottom = c[k] + fu * (d[k] - c[k]);
        top + fv * (bottom - top)
    })
}

/// Lighting prepared for one image.
pub(super) struct Shader {
    ambient: V3,
    lights: Vec<(V3, V3)>,
    specular: f32,
    shininess: f32,
    background: [u8; 3],
}

impl Shader {
    pub(super) fn new(lighting: &Lighting) -> Self {
        Self {
            ambient: lighting.ambient,
            lights: lighting.lights.iter().map(|l| (normalize(l.direction), l.color)).collect(),
            specular: lighting.specular,
            shininess: lighting.shininess,
            background: lighting.background,
        }
    }

    fn shade(&self, albedo: &V3, normal: &V3, point: &V3) -> [u8; 3] {
        let mut light = self.ambient;
        let mut gloss = [0.0; 3];
        for (direction, color) in &self.lights {
            let facing = dot(normal, direction);
            if facing <= 0.0 {
                continue;
            }
            for k in 0..3 {
                light[k] += facing * color[k];
            }
            if self.specular > 0.0 {
                let view = normalize(*point);
                let half = normalize(sub(direction, &view));
                let s = self.specular * dot(normal, &half).max(0.0).powf(self.shininess);
                for k in 0..3 {
                    gloss[k] += s * color[k];
                }
            }
        }
        let table = &*TO_SRGB;
        std::array::from_fn(|k| {
            let v = albedo[k] * light[k] + gloss[k];
            table[(v.clamp(0.0, 1.0) * (TABLE - 1) as f32 + 0.5) as usize]
        })
    }
}

const TABLE: usize = 4096;

/// sRGB byte to linear light.
static TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = i as f64 / 255.0;
        let l = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
        l as f32
    })
});

/// Linear light (0..1 in [`TABLE`] steps) to sRGB byte.
static TO_SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..TABLE)
        .map(|i| {
            let l = i as f64 / (TABLE - 1) as f64;
            let v = if l <= 0.0031308 { l * 12.92 } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            (v * 255.0).round() as u8
        })
        .collect()
});
