//! Solids built from numbers: closed, wound outwards, with normals; sizes in metres.

use super::Mesh;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Neighbouring profile edges meeting at less than this angle are shaded as one curve.
const SMOOTH_COS: f64 = 0.7;

/// A box centred on the origin with full edge lengths `size`.
pub fn cuboid(size: [f64; 3], color: [u8; 3]) -> Mesh {
    let mut out = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let corner = |u: f64, v: f64| {
                let mut p = [0.0; 3];
                p[axis] = sign * size[axis] / 2.0;
                // Swapping the sides of the negative faces keeps the winding outwards.
                p[a] = u * sign * size[a] / 2.0;
                p[b] = v * size[b] / 2.0;
                p
            };
            let mut n = [0.0_f32; 3];
            n[axis] = sign as f32;
            let base = out.positions.len() as u32;
            for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                push(&mut out, corner(u, v), n, color);
                if let Some(uv) = out.uvs.last_mut() {
                    *uv = [(u as f32 + 1.0) / 2.0, (v as f32 + 1.0) / 2.0];
                }
            }
            out.triangles.push([base, base + 1, base + 2]);
            out.triangles.push([base, base + 2, base + 3]);
        }
    }
    out
}

/// A box centred on the origin with edges and corners rounded to `radius` (at most half the
/// shortest edge).
pub fn rounded_cuboid(size: [f64; 3], radius: f64, color: [u8; 3]) -> Mesh {
    const ARC: usize = 4;
    let half = size.map(|s| s / 2.0);
    let r = radius.clamp(0.0, half[0].min(half[1]).min(half[2]));
    let inner = half.map(|h| h - r);
    let mut out = Mesh::default();
    for axis in 0..3 {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        // Offsets beyond the inner box whose directions divide the rounding evenly.
        let lines = |k: usize| -> Vec<f64> {
            let arc = (0..=ARC).map(|i| {
                let angle = std::f64::consts::FRAC_PI_4 * i as f64 / ARC as f64;
                inner[k] + r * angle.tan()
            });
            let plus: Vec<f64> = arc.collect();
            plus.iter().rev().map(|v| -v).chain(plus.iter().copied()).collect()
        };
        let (us, vs) = (lines(a), lines(b));
        for sign in [-1.0, 1.0] {
            let base = out.positions.len() as u32;
            for &v in &vs {
                for &u in &us {
                    let mut q = [0.0; 3];
                    q[axis] = sign * half[axis];
                    q[a] = u * sign;
                    q[b] = v;
                    let q = Vector3::from(q);
                    let p = Vector3::from_fn(|k, _| q[k].clamp(-inner[k], inner[k]));
                    let mut face = Vector3::zeros();
                    face[axis] = sign;
                    let n = (q - p).try_normalize(1e-12).unwrap_or(face);
                    let s = p + n * r;
                    push(&mut out, s.into(), n.map(|v| v as f32).into(), color);
                }
            }
            let w = us.len() as u32;
            for j in 0..vs.len() as u32 - 1 {
                for i in 0..w - 1 {
                    let k = base + j * w + i;
                    out.triangles.push([k, k + 1, k + w + 1]);
                    out.triangles.push([k, k + w + 1, k + w]);
                }
            }
        }
    }
    out.triangles.retain(|t| {
        let p = t.map(|i| Vector3::from(out.positions[i as usize]));
        (p[1] - p[0]).cross(&(p[2] - p[0])).norm() > 1e-14
    });
    out
}

/// A solid of revolution about z. `profile` lists (radius, z) from one end to the other with the
/// material on the LEFT of the direction of travel (up an outer wall, down an inner one); it should
/// start and end on the axis to be closed. `colors` holds one colour for each profile edge.
pub fn lathe(profile: &[[f64; 2]], segments: usize, colors: &[[u8; 3]]) -> Mesh {
    let segments = segments.max(3);
    let normal = |i: usize| -> Option<[f64; 2]> {
        let (a, b) = (profile.get(i)?, profile.get(i + 1)?);
        let (dr, dz) = (b[0] - a[0], b[1] - a[1]);
        let length = dr.hypot(dz);
        (length > 1e-12).then(|| [dz / length, -dr / length])
    };
    let blend = |own: [f64; 2], other: Option<[f64; 2]>| match other {
        Some(o) if own[0] * o[0] + own[1] * o[1] > SMOOTH_COS => {
            let (r, z) = (own[0] + o[0], own[1] + o[1]);
            let l = r.hypot(z);
            [r / l, z / l]
        }
        _ => own,
    };
    let total: f64 = profile.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).sum();
    let mut along = 0.0;
    let mut out = Mesh::default();
    for i in 0..profile.len().saturating_sub(1) {
        let (a, b) = (profile[i], profile[i + 1]);
        let Some(own) = normal(i) else { continue };
        let color = colors.get(i).or(colors.last()).copied().unwrap_or([200; 3]);
        let before = if i > 0 { normal(i - 1) } else { None };
        let ends = [(a, blend(own, before)), (b, blend(own, normal(i + 1)))];
        let base = out.positions.len() as u32;
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        for (k, (p, n)) in ends.iter().enumerate() {
            for s in 0..=segments {
                let angle = TAU * s as f64 / segments as f64;
                let (sin, cos) = if s == segments { (0.0, 1.0) } else { angle.sin_cos() };
                let n = [(n[0] * cos) as f32, (n[0] * sin) as f32, n[1] as f32];
                push(&mut out, [p[0] * cos, p[0] * sin, p[1]], n, color);
                if let Some(uv) = out.uvs.last_mut() {
                    let v = (along + k as f64 * length) / total;
                    *uv = [(s as f64 / segments as f64) as f32, v as f32];
                }
            }
        }
        along += length;
        let ring = segments as u32 + 1;
        for s in 0..segments as u32 {
            let (a0, a1, b0, b1) = (base + s, base + s + 1, base + ring + s, base + ring + s + 1);
            if a[0] > 0.0 {
                out.triangles.push([a0, a1, b1]);
            }
            if b[0] > 0.0 {
                out.triangles.push([a0, b1, b0]);
            }
        }
    }
    out
}

/// A solid cylinder along z, from z = 0 to `height`.
pub fn cylinder(radius: f64, height: f64, segments: usize, color: [u8; 3]) -> Mesh {
    lathe(&[[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]], segments, &[color])
}

/// A flat disc with slightly bevelled edges along z, from z = 0 to `thickness`.
pub fn disc(radius: f64, thickness: f64, segments: usize, color: [u8; 3]) -> Mesh {
    let b = (thickness * 0.15).min(radius * 0.1);
    let profile = [
        [0.0, 0.0],
        [radius - b, 0.0],
        [radius, b],
        [radius, thickness - b],
        [radius - b, thickness],
        [0.0, thickness],
    ];
    lathe(&profile, segments, &[color])
}

/// A tube along z open at both ends, from z = 0 to `height`; `inner` < `outer` are its radii.
pub fn tube(outer: f64, inner: f64, height: f64, segments: usize, color: [u8; 3]) -> Mesh {
    let profile = [[inner, 0.0], [outer, 0.0], [outer, height], [inner, height], [inner, 0.0]];
    lathe(&profile, segments, &[color])
}

/// A sphere round the origin.
pub fn sphere(radius: f64, segments: usize, color: [u8; 3]) -> Mesh {
    tapered_capsule(radius, radius, 0.0, segments, color)
}

/// A capsule along z: a cylinder of `length` centred on the origin with hemispheres on both ends.
pub fn capsule(radius: f64, length: f64, segments: usize, color: [u8; 3]) -> Mesh {
    let shift = tdv_geometry::pose_from_xyz_rpy([0.0, 0.0, -length / 2.0], [0.0; 3]);
    tapered_capsule(radius, radius, length, segments, color).transformed(&shift)
}

/// The hull of two balls: radius `r0` at the origin and `r1` at z = `length`.
pub fn tapered_capsule(r0: f64, r1: f64, length: f64, segments: usize, color: [u8; 3]) -> Mesh {
    // Where the cone touches the balls: the same angle above the equator on both.
    let lean = if length > (r0 - r1).abs() { ((r0 - r1) / length).asin() } else { 0.0 };
    let steps = (segments / 2).max(4);
    let mut profile = Vec::new();
    let mut arc = |centre: f64, r: f64, from: f64, to: f64| {
        for i in 0..=steps {
            let a = from + (to - from) * i as f64 / steps as f64;
            // Exactly on the axis at the poles.
            let radius = if (a.abs() - FRAC_PI_2).abs() < 1e-12 { 0.0 } else { r * a.cos() };
            profile.push([radius, centre + r * a.sin()]);
        }
    };
    arc(0.0, r0, -FRAC_PI_2, lean);
    arc(length, r1, lean, FRAC_PI_2);
    lathe(&profile, segments, &[color])
}

/// A rounded bar swept along a path in the xz plane (closed by flat ends): `width` across y,
/// `thickness` in the plane.
pub fn swept_bar(path: &[[f64; 2]], width: f64, thickness: f64, color: [u8; 3]) -> Mesh {
    const RING: usize = 16;
    let mut out = Mesh::default();
    let n = path.len();
    for i in 0..n {
        let (a, b) = (path[i.saturating_sub(1)], path[(i + 1).min(n - 1)]);
        let (tx, tz) = (b[0] - a[0], b[1] - a[1]);
        let l = tx.hypot(tz).max(1e-12);
        // In-plane normal: the tangent turned by 90 degrees.
        let (nx, nz) = (-tz / l, tx / l);
        for k in 0..RING {
            let angle = TAU * k as f64 / RING as f64;
            // A superellipse: between a rectangle and an ellipse.
            let round = |v: f64| v.signum() * v.abs().powf(0.7);
            let (u, w) = (round(angle.cos()) * thickness / 2.0, round(angle.sin()) * width / 2.0);
            let p = [path[i][0] + nx * u, w, path[i][1] + nz * u];
            push(&mut out, p, [0.0, 0.0, 1.0], color);
        }
    }
    let ring = RING as u32;
    for i in 0..n.saturating_sub(1) as u32 {
        for k in 0..ring {
            let (a, b) = (i * ring + k, i * ring + (k + 1) % ring);
            out.triangles.push([a, b, b + ring]);
            out.triangles.push([a, b + ring, a + ring]);
        }
    }
    let last = n.saturating_sub(1) as u32 * ring;
    for k in 1..ring - 1 {
        out.triangles.push([0, k + 1, k]);
        out.triangles.push([last, last + k, last + k + 1]);
    }
    if out.volume() < 0.0 {
        for t in &mut out.triangles {
            t.swap(1, 2);
        }
    }
    out.recompute_normals();
    out
}

/// Sizes of a [`mug`]; the frame's origin is the middle of the underside, z up, +x to the handle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MugSize {
    /// Outer radius.
    pub radius: f64,
    /// Height of the rim.
    pub height: f64,
    /// Thickness of the wall.
    pub wall: f64,
    /// Thickness of the base.
    pub base: f64,
    /// How far the handle stands out from the outer wall.
    pub handle_reach: f64,
    /// Width of the handle across y.
    pub handle_width: f64,
    /// Thickness of the handle's bar in its plane.
    pub handle_thickness: f64,
    /// Lowest and highest z of the handle.
    pub handle_z: [f64; 2],
}

impl Default for MugSize {
    fn default() -> Self {
        Self {
            radius: 0.032,
            height: 0.090,
            wall: 0.003,
            base: 0.005,
            handle_reach: 0.034,
            handle_width: 0.012,
            handle_thickness: 0.008,
            handle_z: [0.020, 0.078],
        }
    }
}

impl MugSize {
    /// Centre line of the handle in the xz plane, from the lower to the upper root, both inside the wall.
    pub fn handle_path(&self, steps: usize) -> Vec<[f64; 2]> {
        let t = self.handle_thickness / 2.0;
        let root = self.radius - self.wall / 2.0;
        let reach = self.radius + self.handle_reach - t - root;
        let mid = (self.handle_z[0] + self.handle_z[1]) / 2.0;
        let half = (self.handle_z[1] - self.handle_z[0]) / 2.0 - t;
        (0..=steps)
            .map(|i| {
                let a = -FRAC_PI_2 + std::f64::consts::PI * i as f64 / steps as f64;
                // A superellipse of exponent 2.6: the D shape of a mug's handle.
                let flat = |v: f64| v.signum() * v.abs().powf(2.0 / 2.6);
                let x = if i == 0 || i == steps { 0.0 } else { flat(a.cos()) };
                [root + reach * x, mid + half * flat(a.sin())]
            })
            .collect()
    }
}

/// A hollow mug with a handle: `color` outside, `inside` within.
pub fn mug(size: &MugSize, segments: usize, color: [u8; 3], inside: [u8; 3]) -> Mesh {
    let (r, h) = (size.radius, size.height);
    let inner = r - size.wall;
    // Bevels of the foot and the rim.
    let (f, c) = (0.0015, size.wall * 0.27);
    let profile = [
        [0.0, 0.0],
        [r - f, 0.0],
        [r, f],
        [r, h - c],
        [r - c, h],
        [inner + c, h],
        [inner, h - c],
        [inner, size.base + f],
        [inner - f, size.base],
        [0.0, size.base],
    ];
    let colors = [color, color, color, color, color, inside, inside, inside, inside];
    let mut out = lathe(&profile, segments, &colors);
    let bar = swept_bar(&size.handle_path(20), size.handle_width, size.handle_thickness, color);
    out.append(&bar);
    out
}

fn push(mesh: &mut Mesh, p: [f64; 3], n: [f32; 3], color: [u8; 3]) {
    mesh.positions.push(p.map(|v| v as f32));
    mesh.normals.push(n);
    mesh.uvs.push([0.0; 2]);
    mesh.colors.push(color);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use std::f64::consts::PI;

    /// Every edge between merged positions is used once in each direction.
    fn assert_closed(name: &str, m: &Mesh) {
        let key = |i: u32| m.positions[i as usize].map(|v| (f64::from(v) * 1e7).round() as i64);
        let mut edges: HashMap<([i64; 3], [i64; 3]), i32> = HashMap::new();
        for t in &m.triangles {
            for k in 0..3 {
                let (a, b) = (key(t[k]), key(t[(k + 1) % 3]));
                if a != b {
                    *edges.entry((a, b)).or_default() += 1;
                    *edges.entry((b, a)).or_default() -= 1;
                }
            }
        }
        assert!(edges.values().all(|&n| n == 0), "{name} is not closed");
        for t in &m.triangles {
            let p = t.map(|i| Vector3::from(m.positions[i as usize]));
            let n = (p[1] - p[0]).cross(&(p[2] - p[0]));
            for &i in t {
                let v = Vector3::from(m.normals[i as usize]);
                assert!((v.norm() - 1.0).abs() < 1e-3, "{name}: normal {v:?}");
                assert!(n.norm() < 1e-12 || n.dot(&v) > 0.0, "{name}: normal against the winding");
            }
        }
    }

    #[test]
    fn solids_are_closed_wound_outwards_and_of_the_right_volume() {
        let c = [1, 2, 3];
        for (name, mesh, volume) in [
            ("cuboid", cuboid([0.1, 0.2, 0.3], c), 0.006),
            ("rounded", rounded_cuboid([0.1, 0.2, 0.3], 0.0, c), 0.006),
            ("cylinder", cylinder(0.05, 0.2, 96, c), PI * 0.0025 * 0.2),
            ("tube", tube(0.05, 0.04, 0.2, 96, c), PI * 0.0009 * 0.2),
            ("sphere", sphere(0.05, 96, c), 4.0 / 3.0 * PI * 1.25e-4),
            ("capsule", capsule(0.05, 0.1, 96, c), 4.0 / 3.0 * PI * 1.25e-4 + PI * 2.5e-4),
        ] {
            assert_closed(name, &mesh);
            assert!((mesh.volume() / volume - 1.0).abs() < 4e-3, "{name}: {}", mesh.volume());
        }
        assert_closed("rounded", &rounded_cuboid([0.1, 0.2, 0.3], 0.03, c));
        assert_closed("disc", &disc(0.05, 0.008, 48, c));
        assert_closed("tapered", &tapered_capsule(0.02, 0.01, 0.05, 24, c));
        let (low, high) = rounded_cuboid([0.1, 0.2, 0.3], 0.03, c).bounds();
        assert!((high - low - Vector3::new(0.1, 0.2, 0.3)).norm() < 1e-6);
    }

    #[test]
    fn the_mug_has_its_stated_size() {
        let m = mug(&MugSize::default(), 48, [30, 60, 150], [230; 3]);
        assert_closed("mug", &m);
        let (low, high) = m.bounds();
        let wanted =
            [(low.x, -0.032), (high.x, 0.066), (high.z, 0.09), (low.z, 0.0), (high.y, 0.032)];
        for (have, want) in wanted {
            assert!((have - want).abs() < 2e-4, "{have} {want}");
        }
        let handle = swept_bar(&MugSize::default().handle_path(20), 0.012, 0.008, [0; 3]);
        let (low, high) = handle.bounds();
        assert!((low.z - 0.020).abs() < 5e-4 && (high.z - 0.078).abs() < 5e-4, "{low} {high}");
        assert!((high.y - 0.006).abs() < 1e-4);
        // The roots end inside the wall.
        assert!(low.x > 0.029 && low.x < 0.032);
    }
}
