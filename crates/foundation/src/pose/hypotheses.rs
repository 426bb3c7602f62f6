//! Where the search starts: rotations spread over the sphere of views, and one translation from the mask.

use super::depth_filter::NEAREST_M;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, Symmetry, exact_rotation};
use tdv_rendering::{DepthImage, Intrinsics};

/// In-plane turns of each view.
const TURNS: u32 = 6;
/// Two hypotheses nearer than this (rad) count as one.
const SAME_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// The 42 corners of an icosahedron whose edges are halved once, on the unit sphere.
pub fn views() -> Vec<Vector3<f64>> {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut corners = Vec::with_capacity(42);
    for (a, b) in [(1.0, g), (1.0, -g), (-1.0, g), (-1.0, -g)] {
        for axis in 0..3 {
            let mut v = Vector3::zeros();
            v[axis] = a;
            v[(axis + 1) % 3] = b;
            corners.push(v);
        }
    }
    // Corners that share an edge are 2 apart, all others at least 2 g.
    let mut out = corners.clone();
    for (i, a) in corners.iter().enumerate() {
        for b in &corners[..i] {
            if (a - b).norm() < 2.5 {
                out.push(a + b);
            }
        }
    }
    out.iter().map(Vector3::normalize).collect()
}

/// Orientations of an object as seen from every view at every turn, those that its symmetry makes
/// equal left out; 252 for an object without symmetry.
pub fn rotations(symmetry: &Symmetry) -> Vec<UnitQuaternion<f64>> {
    let mut kept: Vec<Pose> = Vec::new();
    for view in views() {
        let z = -view;
        let x = Vector3::z().cross(&z).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let camera = exact_rotation(Matrix3::from_columns(&[x, z.cross(&x), z]));
        for turn in 0..TURNS {
            let angle = f64::from(turn) * std::f64::consts::TAU / f64::from(TURNS);
            let turned = camera * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            let pose = Pose::from_parts(Vector3::zeros().into(), turned.inverse());
            if kept.iter().all(|k| symmetry.distance(&pose, k).1 >= SAME_RAD) {
                kept.push(pose);
            }
        }
    }
    kept.into_iter().map(|p| p.rotation).collect()
}

/// The object's centre (m, camera frame), guessed as the middle of the mask's bounding box at the
/// median depth of the mask; `None` with fewer than four readings.
pub fn guess_centre(
    depth: &DepthImage,
    k: &Intrinsics,
    mask: impl Fn(i32, i32) -> bool,
) -> Option<Point3<f64>> {
    let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
    let mut readings = Vec::new();
    for v in 0..depth.height as i32 {
        for u in (0..depth.width as i32).filter(|u| mask(*u, v)) {
            for (i, c) in [u, v].into_iter().enumerate() {
                low[i] = low[i].min(c);
                high[i] = high[i].max(c);
            }
            readings.extend(depth.get(u, v).filter(|z| *z >= NEAREST_M && z.is_finite()));
        }
    }
    if readings.len() < 4 {
        return None;
    }
    readings.sort_by(f32::total_cmp);
    let n = readings.len();
    let z = f64::midpoint(f64::from(readings[(n - 1) / 2]), f64::from(readings[n / 2]));
    let middle = |i: usize| f64::midpoint(f64::from(low[i]), f64::from(high[i]));
    Some(k.unproject(middle(0), middle(1), z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_42_views_and_252_rotations() {
        let v = views();
        assert_eq!(v.len(), 42);
        let nearest = |a: &Vector3<f64>| {
            v.iter().filter(|b| *b != a).map(|b| a.angle(b)).fold(f64::MAX, f64::min)
        };
        for a in &v {
            let degrees = nearest(a).to_degrees();
            assert!((31.0..37.0).contains(&degrees), "{degrees}");
        }
        let all = rotations(&Symmetry::None);
        assert_eq!(all.len(), 252);
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a.angle_to(b) >= SAME_RAD - 1e-9));
        }
    }

    #[test]
    fn every_orientation_has_a_hypothesis_near_it() {
        let all = rotations(&Symmetry::None);
        for i in 0..200 {
            let t = f64::from(i);
            let q = UnitQuaternion::from_euler_angles(t * 0.73, (t * 0.37).sin() * 1.5, t * 1.31);
            let best = all.iter().map(|r| r.angle_to(&q)).fold(f64::MAX, f64::min);
            assert!(best.to_degrees() < 40.0, "{}", best.to_degrees());
        }
    }

    #[test]
    fn symmetry_leaves_fewer() {
        let axis = [0.0, 0.0, 1.0];
        let bottle = rotations(&Symmetry::Continuous { axis }).len();
        let cube = rotations(&Symmetry::Cube).len();
        let half = vec![[0.0, 0.0, 1.0, 0.0]];
        let two = rotations(&Symmetry::Discrete { rotations: half }).len();
        // A turning body has the directions of its axis left (15 caps of 30 degrees cover a sphere at
        // best), a cube a 24th of all rotations.
        assert!((15..=50).contains(&bottle), "{bottle}");
        assert!((6..=21).contains(&cube), "{cube}");
        assert!((100..=160).contains(&two), "{two}");
    }

    #[test]
    fn the_centre_lies_in_the_box_at_the_median() {
        let k = Intrinsics { width: 40, height: 30, fx: 50.0, fy: 50.0, cx: 19.5, cy: 14.5 };
        let mut d = DepthImage { width: 40, height: 30, data: vec![2.0; 1200] };
        let mask = |u: i32, v: i32| (10..=20).contains(&u) && (5..=15).contains(&v);
        for v in 5..=15 {
            for u in 10..=20 {
                d.data[v * 40 + u] = if u < 13 { 0.0 } else { 0.5 + 0.001 * (u as f32 - 16.5) };
            }
        }
        let p = guess_centre(&d, &k, mask).unwrap();
        assert!((p - k.unproject(15.0, 10.0, 0.5)).norm() < 1e-3, "{p}");
        assert_eq!(guess_centre(&d, &k, |u, v| u == 14 && v < 8 && v > 4), None);
        assert_eq!(guess_centre(&d, &k, |_, _| false), None);
    }
}
