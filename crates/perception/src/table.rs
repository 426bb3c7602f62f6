//! The table: the dominant plane that faces up, found by seeded RANSAC and refined by least squares.

use crate::points::PointMap;
use nalgebra::{Matrix3, Point3, Rotation3, SymmetricEigen, Unit, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tdv_geometry::Pose;
use tdv_rendering::Intrinsics;

/// Settings of the plane search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TableConfig {
    /// RANSAC samples.
    pub iterations: usize,
    /// Least fraction of the measured points that the table has to hold.
    pub min_fraction: f64,
    /// Roughly where "up" is in the camera frame; only a preference. The default suits any camera
    /// that looks down at a table by 0 to 90 degrees.
    pub up: [f64; 3],
    /// Seed of the sampling.
    pub seed: u64,
}

impl Default for TableConfig {
    fn default() -> Self {
        Self { iterations: 250, min_fraction: 0.08, up: [0.0, -0.8, -0.6], seed: 1 }
    }
}

/// The table plane in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TablePlane {
    /// `T_camera_table`: z = plane normal (up), origin on the plane below the image centre (below the
    /// plane's own centroid where the central ray misses it), x = the camera's x along the plane.
    pub pose: Pose,
    /// Unit normal, towards the camera.
    pub normal: Vector3<f64>,
    /// `normal . p = offset` for points p of the plane (m); negative, since the camera is above.
    pub offset: f64,
    /// Fraction of the measured points on it.
    pub fraction: f64,
    /// Root mean square distance of these points (m).
    pub rms: f64,
}

impl TablePlane {
    /// Height (m) of a camera-frame point above the plane.
    #[inline]
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.offset
    }

    /// From a normal and offset; `anchor` is a point near the plane that replaces the image centre
    /// where the central ray does not meet the plane within 3 m.
    pub(crate) fn from_normal(
        normal: Vector3<f64>,
        offset: f64,
        anchor: &Point3<f64>,
        intrinsics: &Intrinsics,
    ) -> Self {
        let ray = intrinsics.ray(
            (f64::from(intrinsics.width) - 1.0) / 2.0,
            (f64::from(intrinsics.height) - 1.0) / 2.0,
        );
        let down = normal.dot(&ray);
        let hit = offset / down;
        let origin = if down < -0.05 && hit > 0.0 && hit < 3.0 {
            Point3::from(ray * hit)
        } else {
            anchor - normal * (normal.dot(&anchor.coords) - offset)
        };
        let mut x = Vector3::x() - normal * normal.x;
        if x.norm() < 1e-3 {
            x = Vector3::z() - normal * normal.z;
        }
        let x = x.normalize();
        let m = Matrix3::from_columns(&[x, normal.cross(&x), normal]);
        // Not `UnitQuaternion::from_matrix`: its iteration fails for half turns (camera looking straight down).
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m));
        let pose = Pose::from_parts(origin.coords.into(), rotation);
        Self { pose, normal, offset, fraction: 0.0, rms: 0.0 }
    }
}

/// Half width (m) of the band that counts as "on the plane" at a distance: depth noise grows with z^2.
fn band(z: f64) -> f64 {
    0.005 + 0.004 * z * z
}

/// Least-squares plane through points: unit normal and centroid.
pub(crate) fn fit_plane(points: &[Point3<f64>]) -> Option<(Unit<Vector3<f64>>, Point3<f64>)> {
    if points.len() < 3 {
        return None;
    }
    let centre = points.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / points.len() as f64;
    let mut c = Matrix3::zeros();
    for p in points {
        let d = p.coords - centre;
        c += d * d.transpose();
    }
    let e = SymmetricEigen::new(c);
    let i = e.eigenvalues.imin();
    Unit::try_new(e.eigenvectors.column(i).into_owned(), 1e-12).map(|n| (n, centre.into()))
}

/// Finds the table from nothing. `None` when no upward plane holds enough points.
pub fn detect_table(
    map: &PointMap,
    intrinsics: &Intrinsics,
    config: &TableConfig,
) -> Option<TablePlane> {
    let all: Vec<(usize, Point3<f64>)> =
        (0..map.points.len()).filter_map(|i| map.point(i).map(|p| (i, p))).collect();
    if all.len() < 100 {
        return None;
    }
    let up = Vector3::from(config.up).try_normalize(1e-9).unwrap_or(-Vector3::y());
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let step = (all.len() / 1200).max(1);
    let subset: Vec<Point3<f64>> = all.iter().step_by(step).map(|(_, p)| *p).collect();
    let reach = (map.width / 6).max(4) as i64;
    let mut best: Option<(f64, Vector3<f64>, f64)> = None;
    for _ in 0..config.iterations {
        let (i, a) = all[rng.random_range(0..all.len())];
        // The other two from the same neighbourhood: likelier to be on the same surface.
        let mut near = || -> Option<Point3<f64>> {
            let x = (i % map.width) as i64 + rng.random_range(-reach..=reach);
            let y = (i / map.width) as i64 + rng.random_range(-reach..=reach);
            if x < 0 || y < 0 || x >= map.width as i64 || y >= map.height as i64 {
                return None;
            }
            map.point(y as usize * map.width + x as usize)
        };
        let (Some(b), Some(c)) = (near(), near()) else { continue };
        let Some(n) = (b - a).cross(&(c - a)).try_normalize(1e-5) else { continue };
        let n = if n.dot(&a.coords) > 0.0 { -n } else { n };
        let facing = n.dot(&up);
        if facing < 0.2 {
            continue;
        }
        let d = n.dot(&a.coords);
        let count =
            subset.iter().filter(|p| (n.dot(&p.coords) - d).abs() < band(p.z)).count() as f64;
        let score = count * (0.25 + 0.75 * facing);
        if best.as_ref().is_none_or(|b| score > b.0) {
            best = Some((score, n, d));
        }
    }
    let (_, n, d) = best?;
    refine(map, intrinsics, n, d, 1.0).filter(|t| t.fraction >= config.min_fraction)
}

/// Follows a plane found in an earlier frame; `None` when it is no longer there (call
/// [`detect_table`] then).
pub fn follow_table(
    map: &PointMap,
    intrinsics: &Intrinsics,
    previous: &TablePlane,
    config: &TableConfig,
) -> Option<TablePlane> {
    let t = refine(map, intrinsics, previous.normal, previous.offset, 2.5)?;
    let turned = t.normal.dot(&previous.normal).clamp(-1.0, 1.0).acos();
    (t.fraction >= config.min_fraction.max(0.6 * previous.fraction) && turned < 0.1).then_some(t)
}

/// Least squares on the points near the plane, the band narrowing from `widen` times its normal width.
fn refine(
    map: &PointMap,
    intrinsics: &Intrinsics,
    mut normal: Vector3<f64>,
    mut offset: f64,
    widen: f64,
) -> Option<TablePlane> {
    let mut valid = 0;
    let mut near = Vec::new();
    let mut centre = Point3::origin();
    let mut rms = 0.0;
    // The last rounds are narrow so that a coaster's top does not pull the plane up.
    let mut limit: Option<f64> = None;
    for round in 0..5 {
        near.clear();
        valid = 0;
        let wide = if round == 0 { widen } else { 1.0 };
        for i in 0..map.points.len() {
            let Some(p) = map.point(i) else { continue };
            valid += 1;
            let w = limit.map_or(wide * band(p.z), |l| l.min(band(p.z)));
            if (normal.dot(&p.coords) - offset).abs() < w {
                near.push(p);
            }
        }
        let (n, c) = fit_plane(&near)?;
        centre = c;
        normal = if n.dot(&c.coords) > 0.0 { -n.into_inner() } else { n.into_inner() };
        offset = normal.dot(&c.coords);
        rms = (near.iter().map(|p| (normal.dot(&p.coords) - offset).powi(2)).sum::<f64>()
            / near.len() as f64)
            .sqrt();
        if round >= 1 {
            limit = Some((2.5 * rms).max(0.003));
        }
    }
    let mut t = TablePlane::from_normal(normal, offset, &centre, intrinsics);
    t.fraction = near.len() as f64 / valid.max(1) as f64;
    t.rms = rms;
    Some(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::RgbdFrame;
    use tdv_geometry::Stamp;
    use tdv_rendering::{DepthImage, RgbImage};

    const K: Intrinsics =
        Intrinsics { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 79.5, cy: 59.5 };

    /// Depth of the plane `normal . p = offset`, a box 8 cm high in the middle.
    fn frame(normal: Vector3<f64>, offset: f64) -> RgbdFrame {
        let mut data = Vec::new();
        for v in 0..120 {
            for u in 0..160 {
                let lift = if (60..100).contains(&u) && (50..80).contains(&v) { 0.08 } else { 0.0 };
                let z = (offset + lift) / normal.dot(&K.ray(f64::from(u), f64::from(v)));
                data.push(if z > 0.0 { z as f32 } else { 0.0 });
            }
        }
        RgbdFrame {
            stamp: Stamp(0),
            color: RgbImage::new(160, 120),
            depth: DepthImage { width: 160, height: 120, data },
            intrinsics: K,
        }
    }

    #[test]
    fn plane_from_steep_and_straight_views_and_after_motion() {
        for normal in [Vector3::new(0.0, 0.0, -1.0), Vector3::new(0.05, -0.6, -0.8).normalize()] {
            let f = frame(normal, -0.7);
            let map = PointMap::new(&f, 2);
            let t = detect_table(&map, &K, &TableConfig::default()).unwrap();
            assert!(t.normal.angle(&normal) < 0.003 && (t.offset + 0.7).abs() < 0.002, "{t:?}");
            assert!((t.pose.rotation * Vector3::z()).angle(&normal) < 0.003);
            let moved = (normal + Vector3::new(0.02, 0.01, 0.0)).normalize();
            let map = PointMap::new(&frame(moved, -0.69), 4);
            let t = follow_table(&map, &K, &t, &TableConfig::default()).unwrap();
            assert!(t.normal.angle(&moved) < 0.004, "{t:?}");
        }
        assert!(
            detect_table(
                &PointMap::new(&frame(-Vector3::z(), 0.0), 2),
                &K,
                &TableConfig::default()
            )
            .is_none()
        );
    }
}
