//! A table with two to five things of the catalogue, seen from somewhere in front of it.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_perception::{ObjectModel, Resting};
use tdv_rendering::{DepthOnly, Instance, Intrinsics, Renderer, look_at};
use tdv_simulation::backdrop::{Backdrop, BackdropConfig, FIRST_FREE_ID};
use tdv_simulation::sensor::SensorConfig;

/// Things that stand in another one and not on the table: part, holder, where (m) in the holder's
/// frame, how far (m) it may be moved from there and which way.
const INSIDE: [(&str, &str, [f64; 3], [f64; 3]); 3] = [
    ("plug", "socket", [-0.045, 0.0, 0.0202], [0.0; 3]),
    ("drawer", "cabinet", [0.0; 3], [0.1, 0.0, 0.0]),
    ("tissue", "tissue_box", [0.0; 3], [0.0, 0.0, 0.03]),
];
/// Room (m) between the circles round two things.
const GAP: f64 = 0.008;
/// Where the middles of things may be (m, base frame).
const AREA: [[f64; 2]; 2] = [[0.30, 0.66], [-0.20, 0.20]];
/// Least visible part of a thing that is asked for, and least pixels.
const VISIBLE: (f64, usize) = (0.5, 150);
/// Pixels that everything keeps from the picture's border.
const BORDER: f64 = 8.0;

/// One thing before the camera.
#[derive(Debug, Clone)]
pub struct Thing {
    /// Index into the models.
    pub model: usize,
    /// `T_base_thing`.
    pub pose: Pose,
    /// Its number in the id image.
    pub id: u16,
    /// Whether enough of it is seen to be asked for.
    pub seen: bool,
}

/// A picture, ready to be rendered.
#[derive(Debug, Clone)]
pub struct Table {
    /// `T_base_camera`.
    pub camera: Pose,
    /// Table, floor, up to three distractors, light.
    pub backdrop: Backdrop,
    /// What of the catalogue is there.
    pub things: Vec<Thing>,
}

/// Key of everything random of a picture.
pub(super) fn key(seed: u64, index: usize) -> u64 {
    seed.wrapping_mul(100_003).wrapping_add(index as u64)
}

/// Draws picture `index`.
pub fn draw(models: &[ObjectModel], index: usize, seed: u64) -> Table {
    let key = key(seed, index);
    let mut rng = ChaCha8Rng::seed_from_u64(key);
    let config = BackdropConfig {
        distractors: rng.random_range(0..4),
        clear_x: [0.15, 0.82],
        clear_y: [-0.30, 0.30],
        ..BackdropConfig::default()
    };
    let backdrop = Backdrop::generate(&config, key);
    let k = SensorConfig::lab().intrinsics;
    let camera = camera(&mut rng);
    let mut things = Vec::new();
    // A layout that does not fit into the picture is drawn again.
    for _ in 0..60 {
        things = layout(models, &mut rng);
        let to_camera = camera.inverse();
        if things.len() > 1
            && things.iter().all(|t| in_view(&models[t.model], &(to_camera * t.pose), &k))
        {
            break;
        }
    }
    look_at_each(models, &camera, &k, &mut things);
    Table { camera, backdrop, things }
}

/// Somewhere in front of the table, looking down at its middle.
fn camera(rng: &mut ChaCha8Rng) -> Pose {
    let azimuth = rng.random_range(-0.9..0.9_f64);
    let elevation = rng.random_range(0.66..1.19_f64);
    let distance = rng.random_range(0.75..1.10);
    let target =
        Point3::new(0.475 + rng.random_range(-0.03..0.03), rng.random_range(-0.03..0.03), 0.02);
    let way = Vector3::new(
        elevation.cos() * azimuth.cos(),
        elevation.cos() * azimuth.sin(),
        elevation.sin(),
    );
    look_at(&(target + way * distance), &target)
}

/// Two to five things on the table, those that belong inside another one inside it.
fn layout(models: &[ObjectModel], rng: &mut ChaCha8Rng) -> Vec<Thing> {
    let named = |name: &str| models.iter().position(|m| m.name == name);
    let inside: Vec<(usize, usize, [f64; 3], [f64; 3])> = INSIDE
        .iter()
        .filter_map(|(part, holder, at, slide)| Some((named(part)?, named(holder)?, *at, *slide)))
        .collect();
    let mut free: Vec<usize> =
        (0..models.len()).filter(|i| inside.iter().all(|p| p.0 != *i)).collect();
    free.shuffle(rng);
    let count = rng.random_range(2..=5_usize);
    let mut out: Vec<Thing> = Vec::new();
    let mut circles: Vec<(f64, f64, f64)> = Vec::new();
    let add = |out: &mut Vec<Thing>, model, pose| {
        out.push(Thing { model, pose, id: FIRST_FREE_ID + out.len() as u16, seen: false });
    };
    for model in free {
        if out.len() >= count {
            break;
        }
        let turn = standing(&models[model], rng);
        let part = inside.iter().find(|p| p.1 == model).filter(|_| rng.random_bool(0.6));
        let mut radius = models[model].size().xy().norm() / 2.0;
        let part = part.map(|(part, _, at, slide)| {
            let share = rng.random_range(0.0..1.0);
            let at: [f64; 3] = std::array::from_fn(|k| at[k] + share * slide[k]);
            radius = radius.max(models[*part].max.coords.xy().norm() + at[0].max(0.0));
            (*part, Pose::translation(at[0], at[1], at[2]))
        });
        for _ in 0..40 {
            let x = rng.random_range(AREA[0][0]..AREA[0][1]);
            let y = rng.random_range(AREA[1][0]..AREA[1][1]);
            let apart = circles.iter().all(|(cx, cy, r)| (x - cx).hypot(y - cy) > r + radius + GAP);
            if apart {
                circles.push((x, y, radius));
                let pose = Pose::translation(x, y, 0.0) * turn;
                add(&mut out, model, pose);
                if let Some((part, at)) = part.filter(|_| out.len() < count) {
                    add(&mut out, part, pose * at);
                }
                break;
            }
        }
    }
    out
}

/// Standing on the table at the origin, turned somehow.
fn standing(model: &ObjectModel, rng: &mut ChaCha8Rng) -> Pose {
    let yaw = rng.random_range(0.0..std::f64::consts::TAU);
    let quarter = std::f64::consts::FRAC_PI_2;
    let on_side = match model.resting {
        Resting::Upright => UnitQuaternion::identity(),
        Resting::Any => {
            let axis = Vector3::ith_axis(rng.random_range(0..2_usize));
            UnitQuaternion::from_axis_angle(&axis, quarter * f64::from(rng.random_range(0..4)))
        }
    };
    let turn = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, yaw]).rotation * on_side;
    let turned = Pose::from_parts(Vector3::zeros().into(), turn);
    let (low, _) = model.mesh.transformed(&turned).bounds();
    Pose::from_parts(Vector3::new(0.0, 0.0, -low.z).into(), turn)
}

/// Whether the box round the model lies within the picture.
fn in_view(model: &ObjectModel, t_camera_model: &Pose, k: &Intrinsics) -> bool {
    (0..8).all(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { model.min } else { model.max }[axis];
        let p = t_camera_model * Point3::new(pick(0), pick(1), pick(2));
        k.project(&p).is_some_and(|(u, v)| {
            u > BORDER
                && v > BORDER
                && u < f64::from(k.width) - BORDER
                && v < f64::from(k.height) - BORDER
        })
    })
}

/// Tells which things are seen well enough.
fn look_at_each(models: &[ObjectModel], camera: &Pose, k: &Intrinsics, things: &mut [Thing]) {
    let to_camera = camera.inverse();
    let (mut renderer, mut out) = (Renderer::new(), DepthOnly::default());
    let instance =
        |t: &Thing| Instance { mesh: &models[t.model].mesh, pose: to_camera * t.pose, id: t.id };
    let together: Vec<Instance<'_>> = things.iter().map(instance).collect();
    let mut count = |scene: &[Instance<'_>], id: u16| {
        renderer.render_depth(k, scene, &mut out);
        out.ids.iter().filter(|i| **i == id).count()
    };
    let seen: Vec<bool> = things
        .iter()
        .map(|t| {
            let (alone, visible) = (count(&[instance(t)], t.id), count(&together, t.id));
            visible >= VISIBLE.1 && visible as f64 >= VISIBLE.0 * alone as f64
        })
        .collect();
    things.iter_mut().zip(seen).for_each(|(t, s)| t.seen = s);
}
