//! What stands round a task: a table with a seeded surface, the floor, a few distractor objects,
//! seeded light.

use nalgebra::Vector2;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives::{cuboid, cylinder, rounded_cuboid, sphere};
use tdv_rendering::{Light, Lighting, Mesh, RgbImage};

/// Ids of the backdrop's parts in the sensor's id image; everything else starts at [`FIRST_FREE_ID`].
pub const TABLE_ID: u16 = 1;
/// Id of the floor.
pub const FLOOR_ID: u16 = 2;
/// Id of the first distractor; the others follow.
pub const DISTRACTOR_ID: u16 = 3;
/// The lowest id that the backdrop never uses.
pub const FIRST_FREE_ID: u16 = 32;
/// Most distractors that there can be.
pub const MAX_DISTRACTORS: usize = 16;

/// What the table top looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TableTop {
    /// Grey, white or pale wood, drawn from the seed.
    #[default]
    Plain,
    /// Brown wood with a strong grain.
    Wood,
    /// Nearly black.
    Dark,
    /// A cloth with a woven check.
    Checked,
    /// A cloth with printed blots.
    Printed,
}

/// How to dress the scene. Positions in base_link, metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackdropConfig {
    /// Extent of the table top along x.
    pub table_x: [f64; 2],
    /// Extent of the table top along y.
    pub table_y: [f64; 2],
    /// What its top looks like.
    pub table_top: TableTop,
    /// Height of the floor.
    pub floor_z: f64,
    /// How many distractors (at most [`MAX_DISTRACTORS`]).
    pub distractors: usize,
    /// Distractors stay out of this range along x while inside `clear_y`.
    pub clear_x: [f64; 2],
    /// Distractors stay out of this range along y while inside `clear_x`.
    pub clear_y: [f64; 2],
    /// Distractors stand at most this far (m) from the middle of the clear area's sides.
    pub margin: f64,
}

impl Default for BackdropConfig {
    fn default() -> Self {
        Self {
            table_x: [-0.45, 1.15],
            table_y: [-0.80, 0.80],
            table_top: TableTop::default(),
            floor_z: -0.75,
            distractors: 0,
            clear_x: [-0.30, 0.82],
            clear_y: [-0.33, 0.33],
            margin: 0.14,
        }
    }
}

/// A fixed thing of the scene.
#[derive(Debug, Clone)]
pub struct Fixture {
    /// "table", "floor", or the kind of distractor.
    pub name: &'static str,
    /// Its surface.
    pub mesh: Mesh,
    /// T_base_fixture; distractors have their origin at the middle of their box.
    pub pose: Pose,
    /// Half of its size along its own axes (m), for physics and collision checking.
    pub half_extents: [f64; 3],
    /// Its number in the id image.
    pub id: u16,
}

/// Table, floor, distractors and light, all drawn from one seed.
#[derive(Debug, Clone)]
pub struct Backdrop {
    /// Table first, floor second, then the distractors.
    pub fixtures: Vec<Fixture>,
    /// Light; directions in base_link.
    pub lighting: Lighting,
}

impl Backdrop {
    /// Draws a backdrop; the same seed gives the same one.
    pub fn generate(config: &BackdropConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6261_636b);
        let lighting = light(&mut rng);
        let mut fixtures = vec![table(config, &mut rng), floor(config, &mut rng)];
        let mut placed: Vec<(Vector2<f64>, f64)> = Vec::new();
        for index in 0..config.distractors.min(MAX_DISTRACTORS) {
            if let Some(f) = distractor(config, index as u16, &mut placed, &mut rng) {
                fixtures.push(f);
            }
        }
        Self { fixtures, lighting }
    }

    /// The fixtures as the sensor takes them.
    pub fn items(&self) -> Vec<crate::sensor::SceneItem<'_>> {
        self.fixtures
            .iter()
            .map(|f| crate::sensor::SceneItem { mesh: &f.mesh, pose: f.pose, id: f.id })
            .collect()
    }
}

/// A main lamp somewhere above, a weak one opposite, and what the walls throw back.
fn light(rng: &mut ChaCha8Rng) -> Lighting {
    let azimuth = rng.random_range(0.0..std::f32::consts::TAU);
    let elevation = rng.random_range(0.75..1.35_f32);
    let strength = rng.random_range(0.45..0.75_f32);
    let warmth = rng.random_range(-0.06..0.06_f32);
    let lamp = |azimuth: f32, elevation: f32, strength: f32| Light {
        direction: [
            elevation.cos() * azimuth.cos(),
            elevation.cos() * azimuth.sin(),
            elevation.sin(),
        ],
        color: [strength * (1.0 + warmth), strength, strength * (1.0 - warmth)],
    };
    let fill_azimuth = azimuth + std::f32::consts::PI + rng.random_range(-0.8..0.8_f32);
    let ambient = rng.random_range(0.24..0.38_f32);
    Lighting {
        ambient: [ambient; 3],
        lights: vec![lamp(azimuth, elevation, strength), lamp(fill_azimuth, 0.5, strength * 0.3)],
        specular: rng.random_range(0.0..0.10),
        shininess: 28.0,
        background: [92, 94, 98],
    }
}

fn table(config: &BackdropConfig, rng: &mut ChaCha8Rng) -> Fixture {
    // Greys, whites and pale woods: colours that no object of the tasks has.
    let base: [f32; 3] = match rng.random_range(0..4) {
        0 => [196.0, 194.0, 190.0],
        1 => [168.0, 168.0, 166.0],
        2 => [206.0, 196.0, 178.0],
        _ => [182.0, 184.0, 178.0],
    };
    let shift = rng.random_range(-14.0..14.0_f32);
    let grain = rng.random_range(2.0..9.0_f32);
    let stretch = [rng.random_range(3..9_usize), rng.random_range(20..60_usize)];
    let plain = surface(512, base.map(|v| v + shift), grain, stretch, rng);
    let texture = match config.table_top {
        TableTop::Plain => plain,
        TableTop::Wood => surface(512, [142.0, 98.0, 60.0], 24.0, stretch, rng),
        TableTop::Dark => surface(512, [44.0, 46.0, 50.0], grain, stretch, rng),
        TableTop::Checked => cloth(false, rng),
        TableTop::Printed => cloth(true, rng),
    };
    let (x, y) = (config.table_x, config.table_y);
    let thickness = 0.03;
    let half = [(x[1] - x[0]) / 2.0, (y[1] - y[0]) / 2.0, thickness / 2.0];
    let mut mesh = cuboid(half.map(|v| 2.0 * v), [255; 3]);
    mesh.texture = Some(texture);
    let centre = [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0, -thickness / 2.0];
    let pose = pose_from_xyz_rpy(centre, [0.0; 3]);
    Fixture { name: "table", mesh, pose, half_extents: half, id: TABLE_ID }
}

fn floor(config: &BackdropConfig, rng: &mut ChaCha8Rng) -> Fixture {
    let shade = rng.random_range(70.0..130.0_f32);
    let mut mesh = cuboid([6.0, 6.0, 0.02], [255; 3]);
    mesh.texture = Some(surface(256, [shade, shade * 0.98, shade * 0.95], 10.0, [2, 2], rng));
    let pose = pose_from_xyz_rpy([0.35, 0.0, config.floor_z - 0.01], [0.0; 3]);
    Fixture { name: "floor", mesh, pose, half_extents: [3.0, 3.0, 0.01], id: FLOOR_ID }
}

/// A square texture: a base colour with grain at three scales, stretched by different amounts along
/// the two axes (wood, cloth, laminate).
fn surface(
    size: u32,
    base: [f32; 3],
    grain: f32,
    stretch: [usize; 2],
    rng: &mut ChaCha8Rng,
) -> RgbImage {
    let n = size as usize;
    let mut value = vec![0.0_f32; n * n];
    for (scale, weight) in [(8, 0.6), (2, 0.5), (1, 0.35)] {
        let (sx, sy) = (scale * stretch[0], scale * stretch[1]);
        let (columns, rows) = (n / sx + 2, n / sy + 2);
        let nodes: Vec<f32> = (0..columns * rows).map(|_| rng.random_range(-1.0..1.0)).collect();
        for (y, row) in value.chunks_exact_mut(n).enumerate() {
            let (cy, fy) = (y / sy, (y % sy) as f32 / sy as f32);
            for (x, v) in row.iter_mut().enumerate() {
                let (cx, fx) = (x / sx, (x % sx) as f32 / sx as f32);
                let at = |i: usize, j: usize| nodes[(cy + j) * columns + cx + i];
                let top = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
                let bottom = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
                *v += weight * (top * (1.0 - fy) + bottom * fy);
            }
        }
    }
    let mut out = RgbImage::new(size, size);
    for (pixel, v) in out.pixels_mut().zip(&value) {
        let speck = rng.random_range(-0.25..0.25_f32);
        pixel.0 = base.map(|b| (b + grain * (v + speck)).clamp(0.0, 255.0) as u8);
    }
    out
}

/// A table cloth: a woven check, or blots printed on plain cloth.
fn cloth(printed: bool, rng: &mut ChaCha8Rng) -> RgbImage {
    let inks: [[u8; 3]; 3] = if printed {
        [[186, 176, 150], [120, 84, 60], [92, 110, 128]]
    } else {
        [[206, 202, 196], [110, 116, 126], [160, 160, 164]]
    };
    let mut out = RgbImage::new(512, 512);
    for (x, y, p) in out.enumerate_pixels_mut() {
        let (i, j) = (x / 16, y / 16);
        let ink = if printed {
            // Blots of a hash of the cell.
            let h = (i / 2).wrapping_mul(73_856_093) ^ (j / 2).wrapping_mul(19_349_663);
            usize::from(h % 7 == 0) + 2 * usize::from(h % 11 == 3)
        } else {
            ((i + j) % 2 + u32::from(i % 4 == 0)) as usize
        };
        let grain = rng.random_range(-6.0..6.0_f32);
        p.0 = inks[ink.min(2)].map(|c| (f32::from(c) + grain).clamp(0.0, 255.0) as u8);
    }
    out
}

fn distractor(
    config: &BackdropConfig,
    index: u16,
    placed: &mut Vec<(Vector2<f64>, f64)>,
    rng: &mut ChaCha8Rng,
) -> Option<Fixture> {
    // Muted colours away from the tasks' saturated ones.
    let hues: [[u8; 3]; 6] = [
        [112, 120, 104],
        [150, 140, 160],
        [96, 104, 116],
        [190, 186, 170],
        [120, 150, 140],
        [140, 110, 130],
    ];
    let color = hues[rng.random_range(0..hues.len())];
    let kind = rng.random_range(0..4);
    let mut size = |low: f64, high: f64| rng.random_range(low..high);
    let (name, mesh, half) = match kind {
        0 => {
            let h = [size(0.02, 0.05), size(0.02, 0.05), size(0.015, 0.045)];
            ("box", rounded_cuboid(h.map(|v| 2.0 * v), 0.003, color), h)
        }
        1 => {
            let (r, h) = (size(0.02, 0.04), size(0.05, 0.12));
            let middle = pose_from_xyz_rpy([0.0, 0.0, -h / 2.0], [0.0; 3]);
            ("can", cylinder(r, h, 32, color).transformed(&middle), [r, r, h / 2.0])
        }
        2 => {
            let r = size(0.02, 0.035);
            ("ball", sphere(r, 32, color), [r; 3])
        }
        _ => {
            let h = [size(0.06, 0.09), size(0.04, 0.06), size(0.006, 0.015)];
            ("book", rounded_cuboid(h.map(|v| 2.0 * v), 0.002, color), h)
        }
    };
    let reach = half[0].hypot(half[1]);
    for _ in 0..40 {
        let x = rng.random_range(config.clear_x[0]..config.clear_x[1]);
        let outside = reach + rng.random_range(0.0..config.margin.max(1e-3));
        let left = rng.random_bool(0.5);
        let y = if left { config.clear_y[1] + outside } else { config.clear_y[0] - outside };
        let at = Vector2::new(x, y);
        let inside = y.abs() + reach < config.table_y[1].abs().min(config.table_y[0].abs());
        if inside && placed.iter().all(|(p, r)| (p - at).norm() > r + reach + 0.01) {
            placed.push((at, reach));
            let yaw = rng.random_range(0.0..std::f64::consts::TAU);
            let pose = pose_from_xyz_rpy([x, y, half[2]], [0.0, 0.0, yaw]);
            return Some(Fixture {
                name,
                mesh,
                pose,
                half_extents: half,
                id: DISTRACTOR_ID + index,
            });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_room_and_others_differ() {
        let config = BackdropConfig { distractors: 5, ..BackdropConfig::default() };
        let (a, b, c) = (
            Backdrop::generate(&config, 7),
            Backdrop::generate(&config, 7),
            Backdrop::generate(&config, 8),
        );
        assert_eq!(a.lighting, b.lighting);
        assert_eq!(a.fixtures[0].mesh, b.fixtures[0].mesh);
        assert_ne!(a.lighting, c.lighting);
        assert_ne!(a.fixtures[0].mesh.texture, c.fixtures[0].mesh.texture);
    }

    #[test]
    fn the_table_top_is_z_zero_and_distractors_leave_the_workspace_alone() {
        for seed in 0..30 {
            let config = BackdropConfig { distractors: 6, ..BackdropConfig::default() };
            let room = Backdrop::generate(&config, seed);
            let (_, high) = room.fixtures[0].mesh.transformed(&room.fixtures[0].pose).bounds();
            assert!(high.z.abs() < 1e-6);
            assert!(room.fixtures.len() > 5);
            for f in &room.fixtures[2..] {
                let (low, high) = f.mesh.transformed(&f.pose).bounds();
                assert!(low.y > config.clear_y[1] - 1e-6 || high.y < config.clear_y[0] + 1e-6);
                assert!(low.z.abs() < 1e-6, "{} floats", f.name);
                assert!(f.id >= DISTRACTOR_ID && f.id < FIRST_FREE_ID);
            }
        }
    }
}
