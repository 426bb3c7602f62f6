//! What stands before the camera in a sequence: background, object, and a hand or a gripper that
//! hides part of it, all drawn from the sequence's number.

use super::motion::{MotionLimits, wander};
use super::objects::BenchObject;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives::{cuboid, cylinder, rounded_cuboid};
use tdv_rendering::{DepthOnly, Instance, Intrinsics, Mesh, Renderer, look_at};
use tdv_simulation::avatar::{GraspTarget, HandPose, HandShape, Skin, fit_grasp};
use tdv_simulation::backdrop::{Backdrop, BackdropConfig, FIRST_FREE_ID, TableTop};

/// Id of the object in the id image.
pub const OBJECT_ID: u16 = FIRST_FREE_ID;
/// Id of the hand or gripper.
pub const OCCLUDER_ID: u16 = FIRST_FREE_ID + 1;
/// Greatest part of the object that is hidden on purpose.
const MOST_HIDDEN: f64 = 0.7;
/// Middle of the space in which objects move (m, base frame; the table is z = 0).
const MIDDLE: [f64; 3] = [0.48, 0.0, 0.26];
/// Directions of the hand's body tried for a held object.
const HOLDS: usize = 8;

/// What happens in a sequence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Tumbling freely, nothing before it.
    Free,
    /// Tumbling while a hand passes between it and the camera.
    Crossing,
    /// Carried by a hand.
    Hand,
    /// Carried by a gripper.
    Gripper,
}

/// The sequences of each object, in order.
pub const KINDS: [Kind; 5] = [Kind::Free, Kind::Free, Kind::Crossing, Kind::Hand, Kind::Gripper];

/// A sequence, ready to be rendered.
#[derive(Debug)]
pub struct Shot {
    /// What happens.
    pub kind: Kind,
    /// `T_base_camera`.
    pub camera: Pose,
    /// Table, floor, distractors, light.
    pub backdrop: Backdrop,
    /// `T_base_object` of each frame.
    pub object: Vec<Pose>,
    /// Hand or gripper, and `T_base_occluder` of each frame.
    pub occluder: Option<(Mesh, Vec<Pose>)>,
}

/// Builds sequence `index` (0..5) of object number `number`.
pub fn shot(object: &BenchObject, number: usize, index: usize, frames: usize, seed: u64) -> Shot {
    let kind = KINDS[index % KINDS.len()];
    let key = seed ^ ((number as u64) << 8 | index as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut rng = ChaCha8Rng::seed_from_u64(key);
    let camera = viewpoint((number + index) % 3);
    let backdrop = background((number + index) % 4, key);
    let speed = rng.random_range(0.3..0.5);
    let turning = rng.random_range(110.0..180.0_f64).to_radians();
    let held = matches!(kind, Kind::Hand | Kind::Gripper);
    let lean = if held { 0.6 } else { f64::INFINITY };
    let limits = MotionLimits { speed, turning, lean };
    let yaw = rng.random_range(0.0..std::f64::consts::TAU);
    let tilt: [f64; 2] = if held { [0.0; 2] } else { [0.5, 0.3] };
    let start = pose_from_xyz_rpy(MIDDLE, [tilt[0], tilt[1], yaw]) * middle_to_origin(&object.mesh);
    if !held {
        let poses = wander(&start, &limits, frames, key);
        let occluder = (kind == Kind::Crossing).then(|| crossing(&object.mesh, &camera, &poses));
        return Shot { kind, camera, backdrop, object: poses, occluder };
    }
    let (body, target) = hold(&object.mesh);
    let in_body = if kind == Kind::Hand { hand(&target) } else { gripper(&target) };
    let occluder = in_body.transformed(&body);
    // Of several directions the one that hides most without hiding too much.
    let mut best: Option<(f64, Vec<Pose>)> = None;
    for k in 0..HOLDS {
        let angle = std::f64::consts::TAU * k as f64 / HOLDS as f64;
        // The body's axis stands upright, whatever the object's own axes are.
        let upright = pose_from_xyz_rpy(MIDDLE, [0.0, 0.0, yaw + angle])
            * Pose::from_parts(nalgebra::Translation3::identity(), body.rotation.inverse())
            * middle_to_origin(&object.mesh);
        let poses = wander(&upright, &limits, frames, key);
        let mut gauge = Gauge::new(&camera);
        let hidden: Vec<f64> =
            poses.iter().step_by(10).map(|p| gauge.hidden(&object.mesh, p, &occluder, p)).collect();
        let most = hidden.iter().copied().fold(0.0, f64::max);
        let mean = hidden.iter().sum::<f64>() / hidden.len().max(1) as f64;
        let worth = if most <= MOST_HIDDEN { mean } else { MOST_HIDDEN - most };
        if best.as_ref().is_none_or(|b| worth > b.0) {
            best = Some((worth, poses));
        }
    }
    let poses = best.map(|b| b.1).unwrap_or_default();
    Shot { kind, camera, backdrop, occluder: Some((occluder, poses.clone())), object: poses }
}

fn viewpoint(index: usize) -> Pose {
    let target = Point3::from(MIDDLE);
    let eye = match index {
        0 => Point3::new(1.05, 0.0, 0.75),
        1 => Point3::new(0.90, 0.55, 0.62),
        _ => Point3::new(0.66, -0.22, 1.08),
    };
    look_at(&eye, &target)
}

/// Four rooms: bare table; cluttered table; checked cloth; printed cloth with clutter.
fn background(index: usize, seed: u64) -> Backdrop {
    let clutter = index % 2 == 1;
    let config = BackdropConfig {
        distractors: if clutter { 10 } else { 0 },
        clear_x: [0.0, 0.7],
        clear_y: if index == 3 { [-0.08, 0.08] } else { [-0.16, 0.16] },
        margin: 0.25,
        table_top: match index {
            2 => TableTop::Checked,
            3 => TableTop::Printed,
            _ => TableTop::Plain,
        },
        ..BackdropConfig::default()
    };
    Backdrop::generate(&config, seed)
}

/// Brings the middle of a mesh's box to the origin.
fn middle_to_origin(mesh: &Mesh) -> Pose {
    let c = mesh.center();
    Pose::translation(-c.x, -c.y, -c.z)
}

/// `T_object_body` and the body as which an object is held: its longest axis upright.
fn hold(mesh: &Mesh) -> (Pose, GraspTarget) {
    let (low, high) = mesh.bounds();
    let size = high - low;
    let long = size.imax();
    let mut axis = Vector3::zeros();
    axis[long] = 1.0;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap_or_default();
    let (a, b) = (size[(long + 1) % 3], size[(long + 2) % 3]);
    let height = size[long];
    let mut foot = mesh.center();
    foot[long] = low[long];
    // The narrow side goes between thumb and fingers (the body's y).
    let across = turn * Vector3::y();
    let narrow_is_y: f64 = if a < b { across[(long + 1) % 3] } else { across[(long + 2) % 3] };
    let quarter = if narrow_is_y.abs() > 0.5 { 0.0 } else { std::f64::consts::FRAC_PI_2 };
    let turn = turn * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), quarter);
    let radius = (a.min(b) / 2.0).clamp(0.012, 0.042);
    let target = GraspTarget { radius, height, tool_height: (height * 0.7).min(height - 0.025) };
    (Pose::from_parts(foot.coords.into(), turn), target)
}

/// A hand round the body, in the body's frame.
fn hand(target: &GraspTarget) -> Mesh {
    let shape = HandShape::default();
    let fit = fit_grasp(&shape, target);
    let wrist = fit.closed.palm.translation.vector;
    let elbow = Point3::from(wrist + Vector3::new(-0.10, -0.10, 0.26));
    Skin::default().mesh(&shape, &fit.closed, &elbow)
}

/// A parallel gripper round the body, in the body's frame: fingers along y, coming from above.
fn gripper(target: &GraspTarget) -> Mesh {
    const DARK: [u8; 3] = [66, 68, 72];
    const STEEL: [u8; 3] = [120, 122, 126];
    let tip = target.tool_height;
    let mut out = Mesh::default();
    for side in [-1.0, 1.0] {
        let y = side * (target.radius + 0.0065);
        let finger = rounded_cuboid([0.024, 0.013, 0.080], 0.003, STEEL);
        out.append(&finger.transformed(&Pose::translation(0.0, y, tip + 0.020)));
        let pad = cuboid([0.022, 0.004, 0.038], [30, 30, 32]);
        let at = side * (target.radius + 0.002);
        out.append(&pad.transformed(&Pose::translation(0.0, at, tip)));
    }
    let rail = rounded_cuboid([0.036, 0.130, 0.030], 0.004, DARK);
    out.append(&rail.transformed(&Pose::translation(0.0, 0.0, tip + 0.070)));
    let palm = cylinder(0.040, 0.090, 32, DARK);
    out.append(&palm.transformed(&Pose::translation(0.0, 0.0, tip + 0.082)));
    let wrist = cylinder(0.032, 0.200, 32, [176, 180, 184]);
    out.append(&wrist.transformed(&Pose::translation(0.0, 0.0, tip + 0.170)));
    out
}

/// A relaxed hand that slides before the object twice, hiding as much as it should at each moment.
fn crossing(mesh: &Mesh, camera: &Pose, poses: &[Pose]) -> (Mesh, Vec<Pose>) {
    let shape = HandShape::default();
    let pose = HandPose::relaxed(Pose::identity());
    let skin = Skin::default().mesh(&shape, &pose, &Point3::new(-0.25, 0.0, 0.0));
    // The middle of the fingers' roots at the origin, the back of the hand towards the camera.
    let skin = skin.transformed(&Pose::translation(-0.10, 0.0, 0.0));
    let mut gauge = Gauge::new(camera);
    let centre = mesh.center();
    let n = poses.len().max(1) as f64;
    let placed = poses.iter().enumerate().map(|(i, p)| {
        // Two passes, the second one to the full 70 %.
        let phase = 2.0 * i as f64 / n;
        let (pass, within) = (phase as usize, phase.fract());
        let peak = if pass == 0 { 0.45 } else { MOST_HIDDEN - 0.02 };
        let level = ((within - 0.3) / 0.15).clamp(0.0, 1.0).min(((0.95 - within) / 0.15).max(0.0));
        let wanted = peak * level;
        let seen = camera.inverse() * (p * centre);
        // 9 cm before the object's middle, the arm coming from the image's right.
        let depth = (seen.z - 0.09).max(0.25) / seen.z;
        let at = |offset: f64| {
            let c = seen * depth + Vector3::new(offset, 0.0, 0.0);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
            camera * Pose::from_parts(c.coords.into(), turn)
        };
        let (mut far, mut near) = (0.32, 0.0);
        if wanted <= 0.0 {
            near = far;
        } else if gauge.hidden(mesh, p, &skin, &at(near)) > wanted {
            for _ in 0..7 {
                let middle = 0.5 * (far + near);
                if gauge.hidden(mesh, p, &skin, &at(middle)) > wanted {
                    near = middle;
                } else {
                    far = middle;
                }
            }
            near = far;
        }
        at(near)
    });
    let placed: Vec<Pose> = placed.collect();
    (skin, placed)
}

/// Tells how much of an object an occluder hides, from drawings of a quarter of the camera's size.
#[derive(Debug)]
pub struct Gauge {
    renderer: Renderer,
    alone: DepthOnly,
    both: DepthOnly,
    k: Intrinsics,
    back: Pose,
}

impl Gauge {
    /// For the lab's camera at `T_base_camera`.
    pub fn new(camera: &Pose) -> Self {
        let k = tdv_simulation::sensor::SensorConfig::lab().intrinsics.scaled(0.25);
        Self {
            renderer: Renderer::new(),
            alone: DepthOnly::default(),
            both: DepthOnly::default(),
            k,
            back: camera.inverse(),
        }
    }

    /// Part (0..1) of the object's silhouette that the occluder hides; 1 out of view.
    pub fn hidden(&mut self, object: &Mesh, at: &Pose, occluder: &Mesh, there: &Pose) -> f64 {
        let own = Instance { mesh: object, pose: self.back * at, id: OBJECT_ID };
        let other = Instance { mesh: occluder, pose: self.back * there, id: OCCLUDER_ID };
        self.renderer.render_depth(&self.k, &[own], &mut self.alone);
        self.renderer.render_depth(&self.k, &[own, other], &mut self.both);
        let count = |d: &DepthOnly| d.ids.iter().filter(|i| **i == OBJECT_ID).count() as f64;
        let all = count(&self.alone);
        if all < 1.0 { 1.0 } else { 1.0 - count(&self.both) / all }
    }
}
