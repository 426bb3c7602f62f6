//! A hand of capsules in the pose of a real one, before an RGB-D camera. For tests only.

use image::{Rgb, RgbImage};
use nalgebra::{Point3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use tdv_rendering::{DepthImage, Intrinsics};

use super::landmark::JOINTS;
use super::lift::{HALF_THICKNESS, PARENT};

pub(super) const K: Intrinsics =
    Intrinsics { width: 640, height: 480, fx: 610.0, fy: 610.0, cx: 319.5, cy: 239.5 };

/// The file with what MediaPipe finds on a real video.
pub(super) fn video_landmarks() -> serde_json::Value {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/hands/video_landmarks.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Hand shapes (m) that the landmark network gave on a real video.
pub(super) fn shapes() -> Vec<[Vector3<f64>; JOINTS]> {
    let json = video_landmarks();
    let frames = json["frames"].as_array().unwrap().iter();
    frames
        .map(|frame| {
            std::array::from_fn(|i| {
                Vector3::from_fn(|axis, _| frame["world"][i][axis].as_f64().unwrap())
            })
        })
        .collect()
}

/// 0..1
fn uniform(random: &mut ChaCha8Rng) -> f64 {
    f64::from(random.next_u32()) / f64::from(u32::MAX)
}

/// About normal, variance 1.
pub(super) fn gauss(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| uniform(random) - 0.5).sum()
}

/// What the camera sees of a hand.
pub(super) struct Scene {
    pub truth: [Point3<f64>; JOINTS],
    pub color: RgbImage,
    pub depth: DepthImage,
    pub random: ChaCha8Rng,
}

impl Scene {
    /// A hand of `size` (1 = average) at `place` (camera frame, m), a background plane 0.3 m
    /// behind it; noise of sigma 3 in the colours and of 1.5 mm at 1 m in the depths.
    pub(super) fn new(
        shape: &[Vector3<f64>; JOINTS],
        size: f64,
        place: Vector3<f64>,
        seed: u64,
    ) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let aside = Rotation3::rotation_between(&Vector3::z(), &place).unwrap();
        let truth = shape.map(|p| Point3::from(aside * p * size + place));
        // The forearm goes on from the wrist, away from the middle finger.
        let wrist = truth[0].coords;
        let elbow = wrist + (wrist - truth[9].coords).normalize() * 0.2;
        let knuckles = [(9, 5), (13, 9), (17, 13)];
        let mut capsules: Vec<Capsule> = (1..JOINTS)
            .map(|joint| (joint, PARENT[joint]))
            .chain(knuckles)
            .map(|(a, b)| Capsule {
                ends: (truth[a].coords, truth[b].coords),
                radii: (HALF_THICKNESS[a] * size, HALF_THICKNESS[b] * size),
            })
            .collect();
        capsules.push(Capsule {
            ends: (truth[1].coords, truth[5].coords),
            radii: (0.013 * size, 0.012 * size),
        });
        capsules.push(Capsule { ends: (wrist, elbow), radii: (0.02 * size, 0.032 * size) });

        let mut color = RgbImage::new(K.width, K.height);
        let mut depth = DepthImage::new(K.width, K.height);
        for v in 0..K.height {
            for u in 0..K.width {
                let ray = K.ray(f64::from(u), f64::from(v));
                let hit = march(&capsules, &ray);
                let tone = 110.0 + 12.0 * f64::from((u / 37 + v / 29) % 3);
                let (z, rgb) = match hit {
                    Some((z, normal)) => {
                        let light = Vector3::new(-0.4, -0.7, -0.6).normalize();
                        let shade = 0.45 + 0.55 * normal.dot(&light).max(0.0);
                        (z, [224.0, 172.0, 138.0].map(|c| c * shade))
                    }
                    None => (place.z + 0.3, [tone, tone, tone * 0.97]),
                };
                let noise = 3.0 * gauss(&mut random);
                color.put_pixel(u, v, Rgb(rgb.map(|c| (c + noise).clamp(0.0, 255.0) as u8)));
                let noisy = z + 0.0015 * z * z * gauss(&mut random);
                depth.data[(v * K.width + u) as usize] = noisy as f32;
            }
        }
        Self { truth, color, depth, random }
    }

    /// 15 % of the depth readings missing, and at steps every second one between the two sides.
    pub(super) fn spoil(&mut self) {
        let clean = self.depth.data.clone();
        for i in 0..clean.len() {
            let next = clean[(i + 1) % clean.len()];
            if (clean[i] - next).abs() > 0.05 && uniform(&mut self.random) < 0.5 {
                self.depth.data[i] = 0.5 * (clean[i] + next);
            }
            let below = clean[(i + K.width as usize) % clean.len()];
            if uniform(&mut self.random) < 0.15 || (clean[i] - below).abs() > 0.05 {
                self.depth.data[i] = 0.0;
            }
        }
    }

    /// The joints' true pixels.
    pub(super) fn pixels(&self) -> [(f64, f64); JOINTS] {
        self.truth.map(|p| K.project(&p).unwrap())
    }

    /// Mean distance of `joints` from the truth over some of them, metres.
    pub(super) fn error(&self, joints: &[Point3<f64>; JOINTS], which: &[usize]) -> f64 {
        let sum: f64 = which.iter().map(|i| (joints[*i] - self.truth[*i]).norm()).sum();
        sum / which.len() as f64
    }
}

struct Capsule {
    ends: (Vector3<f64>, Vector3<f64>),
    radii: (f64, f64),
}

impl Capsule {
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        let axis = self.ends.1 - self.ends.0;
        let along = ((point - self.ends.0).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
        let radius = self.radii.0 * (1.0 - along) + self.radii.1 * along;
        (point - self.ends.0 - axis * along).norm() - radius
    }
}

/// Depth and surface normal where a ray (z = 1) meets the union of the capsules.
fn march(capsules: &[Capsule], ray: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
    let near: Vec<&Capsule> = capsules
        .iter()
        .filter(|capsule| {
            // Distance between the ray's line and the ball round the capsule.
            let middle = (capsule.ends.0 + capsule.ends.1) / 2.0;
            let away = middle - ray * (middle.dot(ray) / ray.norm_squared());
            let half = (capsule.ends.1 - capsule.ends.0).norm() / 2.0;
            away.norm() < half + capsule.radii.0.max(capsule.radii.1)
        })
        .collect();
    let distance = |point: &Vector3<f64>| {
        near.iter().map(|capsule| capsule.distance(point)).fold(f64::MAX, f64::min)
    };
    let mut z = 0.2;
    while z < 1.5 && !near.is_empty() {
        let point = ray * z;
        let away = distance(&point);
        if away < 0.0003 {
            let slope = |axis: usize| {
                let step = Vector3::ith(axis, 0.001);
                distance(&(point + step)) - distance(&(point - step))
            };
            let normal = Vector3::new(slope(0), slope(1), slope(2));
            return Some((z, normal.normalize()));
        }
        z += (away / ray.norm()).max(0.0003);
    }
    None
}
