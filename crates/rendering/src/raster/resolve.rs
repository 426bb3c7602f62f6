//! Second pass: what each pixel shows.

use super::base::Base;
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

/// A quantity that varies linearly over a triangle's plane: `constant + gradient . p` at the point p
/// of the camera frame.
#[derive(Clone, Copy)]
struct Affine<const N: usize> {
    constant: [f32; N],
    gradient: [V3; N],
    /// Whether it is the same everywhere.
    flat: bool,
}

impl<const N: usize> Default for Affine<N> {
    fn default() -> Self {
        Self { constant: [0.0; N], gradient: [[0.0; 3]; N], flat: true }
    }
}

impl<const N: usize> Affine<N> {
    /// From the values at the corners; `k1`, `k2` give the barycentric coordinates of the second and
    /// third corner as `k . (p - corner)`.
    fn new(v: [[f32; N]; 3], corner: &V3, k1: &V3, k2: &V3) -> Self {
        if v[0] == v[1] && v[0] == v[2] {
            return Self { constant: v[0], ..Self::default() };
        }
        let gradient: [V3; N] = std::array::from_fn(|i| {
            let (d1, d2) = (v[1][i] - v[0][i], v[2][i] - v[0][i]);
            std::array::from_fn(|k| d1 * k1[k] + d2 * k2[k])
        });
        let constant = std::array::from_fn(|i| v[0][i] - dot(&gradient[i], corner));
        Self { constant, gradient, flat: false }
    }

    /// Prepared for one image row: value / z at a pixel is `a * inverse_z + b * ray_x + c`.
    fn along_row(&self, ray_y: f32) -> Row<N> {
        Row {
            a: self.constant,
            b: std::array::from_fn(|i| self.gradient[i][0]),
            c: std::array::from_fn(|i| self.gradient[i][1] * ray_y + self.gradient[i][2]),
        }
    }
}

/// An [`Affine`] along one image row.
struct Row<const N: usize> {
    a: [f32; N],
    b: [f32; N],
    c: [f32; N],
}

impl<const N: usize> Row<N> {
    /// The value divided by z.
    fn over_z(&self, inverse_z: f32, ray_x: f32) -> [f32; N] {
        std::array::from_fn(|i| self.a[i] * inverse_z + self.b[i] * ray_x + self.c[i])
    }
}

/// What the pixels of one triangle have in common.
#[derive(Clone, Copy, Default)]
struct Facet {
    id: u16,
    instance: usize,
    normal: Affine<3>,
    albedo: Affine<3>,
    uv: Affine<2>,
}

/// The last triangles met: rows revisit those of the row above.
const CACHE: usize = 128;

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
        let k1 = cross(&e2, &face).map(|v| v / square);
        let k2 = cross(&face, &e1).map(|v| v / square);
        let mut n = t.map(|i| self.normals[base + i]);
        for v in &mut n {
            if dot(v, v) < 1e-12 {
                *v = normalize(face);
            }
        }
        let mut facet = Facet {
            id: instance.id,
            instance: index as usize,
            normal: Affine::new(n, &p[0], &k1, &k2),
            ..Facet::default()
        };
        if facet.normal.flat {
            // One normal for all: turned towards the camera once.
            let n = normalize(facet.normal.constant);
            facet.normal.constant = if dot(&n, &p[0]) > 0.0 { n.map(|v| -v) } else { n };
        }
        if colored {
            let table = &*TO_LINEAR;
            let color = t.map(|i| mesh.colors.get(i).copied().unwrap_or([200; 3]));
            let color = color.map(|c| c.map(|v| table[v as usize]));
            facet.albedo = Affine::new(color, &p[0], &k1, &k2);
            if mesh.texture.is_some() {
                let uv = t.map(|i| mesh.uvs.get(i).copied().unwrap_or_default());
                facet.uv = Affine::new(uv, &p[0], &k1, &k2);
            }
        }
        facet
    }

    pub(super) fn resolve(
        &self,
        camera: &Intrinsics,
        scene: &[Instance<'_>],
        base: Option<&Base>,
        (depth, ids, normals): (&mut [f32], &mut [u16], &mut [V3]),
        mut color: Option<(&Shader, &mut RgbImage)>,
    ) {
        let width = camera.width as usize;
        if width == 0 {
            return;
        }
        let fy = 1.0 / camera.fy as f32;
        let rays: Vec<f32> =
            (0..width).map(|x| ((x as f64 - camera.cx) / camera.fx) as f32).collect();
        let mut cache = vec![(0_u32, Facet::default()); CACHE];
        for y in 0..camera.height as usize {
            let ray_y = (y as f32 - camera.cy as f32) * fy;
            let row = y * width..(y + 1) * width;
            let visible = &self.visible[row.clone()];
            let inverse = &self.inv_z[row.clone()];
            let depth = &mut depth[row.clone()];
            let ids = &mut ids[row.clone()];
            let normals = &mut normals[row.clone()];
            let mut from = 0;
            while from < width {
                let seen = visible[from];
                let run = visible[from..].iter().take_while(|v| **v == seen).count();
                let span = from..from + run;
                from += run;
                let all = row.start + span.start..row.start + span.end;
                let pixels = 3 * all.start..3 * all.end;
                if seen == 0 {
                    if let Some(Base { image: base, .. }) = base {
                        depth[span.clone()].copy_from_slice(&base.depth.data[all.clone()]);
                        ids[span.clone()].copy_from_slice(&base.ids[all.clone()]);
                        normals[span].copy_from_slice(&base.normals[all]);
                        if let Some((_, image)) = &mut color {
                            image.as_mut()[pixels.clone()]
                                .copy_from_slice(&base.color.as_raw()[pixels]);
                        }
                    } else {
                        depth[span.clone()].fill(0.0);
                        ids[span.clone()].fill(0);
                        normals[span].fill([0.0; 3]);
                        if let Some((shader, image)) = &mut color {
                            for pixel in image.as_mut()[pixels].chunks_exact_mut(3) {
                                pixel.copy_from_slice(&shader.background);
                            }
                        }
                    }
                    continue;
                }
                let slot = &mut cache[seen as usize % CACHE];
                if slot.0 != seen {
                    *slot = (seen, self.facet(scene, seen - 1, color.is_some()));
                }
                let facet = &slot.1;
                let (inverse, rays) = (&inverse[span.clone()], &rays[span.clone()]);
                let (depth, normals) = (&mut depth[span.clone()], &mut normals[span.clone()]);
                ids[span].fill(facet.id);
                for (z, w) in depth.iter_mut().zip(inverse) {
                    *z = 1.0 / w;
                }
                fill_normals(&facet.normal, inverse, rays, ray_y, normals);
                if let Some((shader, image)) = &mut color {
                    let texture = scene[facet.instance].mesh.texture.as_ref();
                    let pixels = &mut image.as_mut()[pixels];
                    let run = (&*depth, inverse, rays, ray_y);
                    shader.fill(facet, texture, run, normals, pixels);
                }
            }
        }
    }
}

fn fill_normals(field: &Affine<3>, inverse: &[f32], rays: &[f32], ray_y: f32, normals: &mut [V3]) {
    if field.flat {
        normals.fill(field.constant);
        return;
    }
    let row = field.along_row(ray_y);
    for ((n, w), x) in normals.iter_mut().zip(inverse).zip(rays) {
        // Divided by z it points the same way.
        let m = row.over_z(*w, *x);
        let square = dot(&m, &m).max(1e-30);
        let away = m[0] * x + m[1] * ray_y + m[2] > 0.0;
        let scale = if away { -1.0 } else { 1.0 } / square.sqrt();
        *n = m.map(|v| v * scale);
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
    let (fu, fv) = (u - u as u32 as f32, v - v as u32 as f32);
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
    /// Cosine below which a highlight is darker than 1e-4.
    gloss_from: f32,
    background: [u8; 3],
}

/// Depths, inverse depths and the rays' x of a run of pixels, and their common ray y.
type Run<'a> = (&'a [f32], &'a [f32], &'a [f32], f32);

impl Shader {
    pub(super) fn new(lighting: &Lighting) -> Self {
        Self {
            ambient: lighting.ambient,
            lights: lighting.lights.iter().map(|l| (normalize(l.direction), l.color)).collect(),
            specular: lighting.specular,
            shininess: lighting.shininess,
            gloss_from: 1e-4_f32.powf(1.0 / lighting.shininess.max(1e-3)),
            background: lighting.background,
        }
    }

    /// Colours pixels of one triangle.
    fn fill(
        &self,
        facet: &Facet,
        texture: Option<&RgbImage>,
        (depth, inverse, rays, ray_y): Run<'_>,
        normals: &[V3],
        pixels: &mut [u8],
    ) {
        let albedo_row = facet.albedo.along_row(ray_y);
        let uv_row = facet.uv.along_row(ray_y);
        for (i, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (z, w, x) = (depth[i], inverse[i], rays[i]);
            let mut albedo = if facet.albedo.flat {
                facet.albedo.constant
            } else {
                albedo_row.over_z(w, x).map(|v| v * z)
            };
            if let Some(texture) = texture {
                let texel = bilinear(texture, uv_row.over_z(w, x).map(|v| v * z));
                for k in 0..3 {
                    albedo[k] *= texel[k];
                }
            }
            let point = [x * z, ray_y * z, z];
            pixel.copy_from_slice(&self.shade(&albedo, &normals[i], &point));
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
                let s = dot(normal, &half);
                if s > self.gloss_from {
                    let s = self.specular * s.powf(self.shininess);
                    for k in 0..3 {
                        gloss[k] += s * color[k];
                    }
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
