use super::{Mesh, nearest_texel};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A point of a mesh's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Where (m, mesh frame).
    pub point: Point3<f64>,
    /// Unit normal of its triangle.
    pub normal: Vector3<f64>,
    /// sRGB, from the texture and the vertex colours.
    pub color: [u8; 3],
}

impl Mesh {
    /// `count` points spread evenly over the surface (by area, seeded); none for a mesh without area.
    pub fn surface_points(&self, count: usize, seed: u64) -> Vec<SurfacePoint> {
        let vertex =
            |i: u32| self.positions.get(i as usize).map(|p| Point3::from(p.map(f64::from)));
        let mut total = 0.0;
        let mut upto = Vec::with_capacity(self.triangles.len());
        for t in &self.triangles {
            if let (Some(a), Some(b), Some(c)) = (vertex(t[0]), vertex(t[1]), vertex(t[2])) {
                total += (b - a).cross(&(c - a)).norm() / 2.0;
            }
            upto.push(total);
        }
        if !(total > 0.0 && total.is_finite()) {
            return Vec::new();
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut out = Vec::with_capacity(count);
        for i in 0..count {
            // Stratified: one draw in each equal share of the area.
            let at = (i as f64 + rng.random::<f64>()) / count as f64 * total;
            let (mut u, mut v) = (rng.random::<f64>(), rng.random::<f64>());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let t = self.triangles[upto.partition_point(|s| *s < at).min(upto.len() - 1)];
            let (Some(a), Some(b), Some(c)) = (vertex(t[0]), vertex(t[1]), vertex(t[2])) else {
                continue;
            };
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-30) else { continue };
            out.push(SurfacePoint {
                point: a + (b - a) * u + (c - a) * v,
                normal,
                color: self.color_in(&t, [1.0 - u - v, u, v]),
            });
        }
        out
    }

    fn color_in(&self, t: &[u32; 3], weights: [f64; 3]) -> [u8; 3] {
        let mut color = [0.0; 3];
        let mut uv = [0.0; 2];
        for (i, w) in t.iter().zip(weights) {
            let c = self.colors.get(*i as usize).copied().unwrap_or([200; 3]);
            let at = self.uvs.get(*i as usize).copied().unwrap_or_default();
            (0..3).for_each(|k| color[k] += w * f64::from(c[k]));
            (0..2).for_each(|k| uv[k] += w as f32 * at[k]);
        }
        let texel = self.texture.as_ref().map_or([255; 3], |t| nearest_texel(t, uv));
        std::array::from_fn(|k| (color[k] * f64::from(texel[k]) / 255.0).round() as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::super::primitives;
    use super::*;

    #[test]
    fn points_lie_on_the_surface_by_area() {
        let m = primitives::cuboid([0.1, 0.1, 0.4], [10, 20, 30]);
        let points = m.surface_points(3600, 5);
        assert_eq!(points, m.surface_points(3600, 5));
        assert_eq!(points.len(), 3600);
        // Ends: 2 of 18 hundredths of a square decimetre.
        let ends = points.iter().filter(|p| p.normal.z.abs() > 0.9).count();
        assert!((380..420).contains(&ends), "{ends}");
        for p in &points {
            let off = (p.point.x.abs() - 0.05).abs().min((p.point.y.abs() - 0.05).abs());
            assert!(off.min((p.point.z.abs() - 0.2).abs()) < 1e-7 && p.color == [10, 20, 30]);
        }
        assert!(Mesh::default().surface_points(10, 1).is_empty());
    }
}
