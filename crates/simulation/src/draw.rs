//! What a seed decides about a scene: where the objects start, and how wrong the robot's knowledge is.

use crate::error::SimulationError;
use crate::scene::{Placement, Scene};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_rendering::Intrinsics;

/// What the robot's side is told, with the errors drawn from a seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Knowledge {
    /// Factor on each object's mesh, in the scene's order.
    pub mesh_scale: Vec<f64>,
    /// `T_base_link_camera_color_optical_frame` as calibrated.
    pub camera: Pose,
    /// The camera's numbers as calibrated.
    pub intrinsics: Intrinsics,
}

/// Separates the streams of random numbers, so that one more draw here moves nothing there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    Starts = 1,
    Knowledge = 2,
    Disturbance = 3,
}

pub(crate) fn rng(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut r = ChaCha8Rng::seed_from_u64(seed);
    r.set_stream(stream as u64);
    r
}

impl Scene {
    /// Start poses of all objects (`T_base_link_object`), standing on the table. They are drawn before
    /// anybody asks whether the arm can reach them.
    ///
    /// # Errors
    /// [`SimulationError::Value`] when a region has no point outside its excluded disc.
    pub fn draw_starts(&self, seed: u64) -> Result<Vec<Pose>, SimulationError> {
        let mut rng = rng(seed, Stream::Starts);
        let mut poses: Vec<Pose> = Vec::with_capacity(self.objects.len());
        for (i, object) in self.objects.iter().enumerate() {
            let pose = match &object.start {
                Placement::On(a) => {
                    let other = self.objects.iter().position(|o| o.name == a.object);
                    other.and_then(|k| poses.get(k)).map(|p| p * a.pose())
                }
                Placement::Spot(s) => {
                    let x = s.xy[0] + s.jitter * rng.random_range(-1.0..=1.0);
                    let y = s.xy[1] + s.jitter * rng.random_range(-1.0..=1.0);
                    let yaw = s.yaw_deg + s.jitter_deg * rng.random_range(-1.0..=1.0);
                    Some(standing(x, y, yaw))
                }
                Placement::Region(r) => {
                    let disc = r.exclude.as_ref().and_then(|e| {
                        let at = self.objects.iter().position(|o| o.name == e.object)?;
                        Some((poses.get(at)?.translation, e.radius))
                    });
                    (0..10_000).find_map(|_| {
                        let x = rng.random_range(r.x[0]..=r.x[1]);
                        let y = rng.random_range(r.y[0]..=r.y[1]);
                        let yaw = rng.random_range(r.yaw_deg[0]..=r.yaw_deg[1]);
                        let free = disc.is_none_or(|(c, d)| (x - c.x).hypot(y - c.y) >= d);
                        free.then(|| standing(x, y, yaw))
                    })
                }
            };
            poses.push(pose.ok_or_else(|| SimulationError::Value {
                path: self.path.clone(),
                field: format!("objects[{i}] ({})", object.name),
                reason: "has no point outside its excluded disc".into(),
            })?);
        }
        Ok(poses)
    }

    /// What the robot's side is told: never the exact numbers.
    pub fn draw_knowledge(&self, seed: u64) -> Knowledge {
        let mut rng = rng(seed, Stream::Knowledge);
        let e = self.errors;
        let mut off = |bound: f64| bound * rng.random_range(-1.0..=1.0);
        let mesh_scale = self.objects.iter().map(|_| 1.0 + off(e.mesh_scale)).collect();
        let k = self.camera.intrinsics;
        let intrinsics = Intrinsics {
            fx: k.fx * (1.0 + off(e.intrinsics)),
            fy: k.fy * (1.0 + off(e.intrinsics)),
            cx: k.cx + off(e.intrinsics) * 0.5 * f64::from(k.width),
            cy: k.cy + off(e.intrinsics) * 0.5 * f64::from(k.height),
            ..k
        };
        // Drawn in the ball, so that the stated bound holds for the length and the angle.
        let mut ball = |bound: f64| {
            let v = Vector3::new(off(1.0), off(1.0), off(1.0));
            v * (bound / v.norm().max(1.0))
        };
        let shift = Translation3::from(ball(e.extrinsics));
        let turn = UnitQuaternion::from_scaled_axis(ball(e.extrinsics_deg.to_radians()));
        let camera = self.camera.pose() * Pose::from_parts(shift, turn);
        Knowledge { mesh_scale, camera, intrinsics }
    }
}

fn standing(x: f64, y: f64, yaw_deg: f64) -> Pose {
    pose_from_xyz_rpy([x, y, 0.0], [0.0, 0.0, yaw_deg.to_radians()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use tdv_geometry::pose_distance;

    fn scene() -> Scene {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes/cup_on_coaster.yaml");
        Scene::load(&path).unwrap()
    }

    #[test]
    fn starts_fill_the_region_and_spare_the_disc() {
        let s = scene();
        let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
        for seed in 0..400 {
            let p = s.draw_starts(seed).unwrap();
            assert_eq!(p, s.draw_starts(seed).unwrap());
            let (mug, coaster) = (p[s.index_of("mug").unwrap()], p[s.index_of("coaster").unwrap()]);
            let (x, y) = (mug.translation.x, mug.translation.y);
            assert!((0.25..=0.70).contains(&x) && (-0.25..=0.25).contains(&y));
            assert!((x - coaster.translation.x).hypot(y - coaster.translation.y) >= 0.11);
            low = [low[0].min(x), low[1].min(y)];
            high = [high[0].max(x), high[1].max(y)];
        }
        assert!(high[0] - low[0] > 0.44 && high[1] - low[1] > 0.49);
    }

    #[test]
    fn knowledge_is_off_within_the_bounds_and_never_exact() {
        let s = scene();
        let (mut far, mut turned): (f64, f64) = (0.0, 0.0);
        for seed in 0..200 {
            let k = s.draw_knowledge(seed);
            let (d, a) = pose_distance(&k.camera, &s.camera.pose());
            assert!(d > 0.0 && d <= 0.003 + 1e-12, "{d}");
            assert!(a > 0.0 && a <= 0.5_f64.to_radians() + 1e-9, "{a}");
            (far, turned) = (far.max(d), turned.max(a));
            assert!(k.mesh_scale.iter().all(|f| (f - 1.0).abs() <= 0.01 && *f != 1.0));
            assert!((k.intrinsics.fx / s.camera.intrinsics.fx - 1.0).abs() <= 0.005);
        }
        assert!(far > 0.0025 && turned > 0.4_f64.to_radians());
    }
}
