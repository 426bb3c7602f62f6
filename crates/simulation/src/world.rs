//! The physical world: a table, objects, the arm as kinematic bodies, two dynamic fingers with a
//! limited force. What is carried is carried by friction alone.

use crate::arm::{ArmModel, LinkPiece};
use crate::contacts::{Contacts, Tag};
use crate::gripper::{
    FINGER_ROOT, FINGER_THICKNESS, FingerDrive, PAD_LENGTH, PAD_THICKNESS, PAD_WIDTH, PALM_FRONT,
    PALM_RADIUS, STROKE, TCP_OFFSET,
};
use crate::mount::{self, DropSet, Guide, Mount};
use crate::parts::{Part, Solid};
use crate::units;
use rapier3d::prelude::*;
use tdv_geometry::Pose as Pose64;
use tdv_geometry::nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// One tick of the world, s.
pub const DT: f64 = 0.002;

/// An object as the physics needs it.
#[derive(Debug, Clone)]
pub struct Body {
    /// Its name.
    pub name: String,
    /// Mass, kg.
    pub mass: f64,
    /// Coefficient of friction; averaged with the other surface's, multiplied with the pads'.
    pub friction: f64,
    /// Convex parts in the object's frame.
    pub parts: Vec<Part>,
    /// Where it starts, `T_base_link_object`.
    pub pose: Pose64,
    /// How it is fastened.
    pub mount: Mount,
}

/// Numbers of the physics that are not objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorldConfig {
    /// The arm.
    pub arm: ArmModel,
    /// Table top from x, y to x, y in `base_link`, m; its surface is z = 0.
    pub table: [[f64; 2]; 2],
    /// Friction of the table.
    pub table_friction: f64,
    /// Friction of the rubber pads; multiplied with the object's.
    pub pad_friction: f64,
    /// Solver sub-steps in a tick.
    pub substeps: usize,
}

impl Default for WorldConfig {
    fn default() -> Self {
        Self {
            arm: ArmModel::default(),
            table: [[-0.35, -0.75], [1.15, 0.75]],
            table_friction: 0.5,
            pad_friction: 0.9,
            substeps: 4,
        }
    }
}

/// Moving mass of one finger, kg: its linkage and the reflected motor.
const FINGER_MASS: f32 = 0.15;
/// Stiffness (N/m) and damping (N s/m) with which a finger follows its drive.
const FINGER_STIFFNESS: f32 = 15_000.0;
const FINGER_DAMPING: f32 = 95.0;

const TABLE: Group = Group::GROUP_1;
const OBJECT: Group = Group::GROUP_2;
const ARM: Group = Group::GROUP_3;
const FINGER: Group = Group::GROUP_4;
const DROP: Group = Group::GROUP_5;

struct Finger {
    body: RigidBodyHandle,
    joint: ImpulseJointHandle,
    /// +1 or -1 along the closing axis.
    side: f64,
    colliders: [ColliderHandle; 2],
}

/// The world. Poses are in `base_link`.
pub struct World {
    physics: PhysicsWorld,
    frames: [RigidBodyHandle; 7],
    /// Colliders that must stay above the table, apart from the fingers'.
    moving: Vec<ColliderHandle>,
    fingers: [Finger; 2],
    objects: Vec<RigidBodyHandle>,
    guides: Vec<Guide>,
    drops: Vec<RigidBodyHandle>,
    config: WorldConfig,
    drive: FingerDrive,
    /// Half gap that the finger motors aim at now, m.
    aim: f64,
    time_ticks: u64,
}

impl World {
    /// A world with the arm at the joint angles `q` (rad), fingers open.
    pub fn new(config: WorldConfig, bodies: &[Body], q: &[f64; 6]) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0, -9.81);
        let p = &mut physics.integration_parameters;
        p.dt = DT as f32;
        p.num_solver_iterations = config.substeps;
        // Objects are centimetres in size, forces tens of newtons: contacts have to be far stiffer
        // than the engine's defaults for games, whose 30 Hz would let a pad sink in by millimetres.
        p.length_unit = 0.05;
        p.contact_softness = SpringCoefficients { natural_frequency: 400.0, damping_ratio: 5.0 };
        p.static_contact_softness = p.contact_softness;
        p.friction_model = FrictionModel::Coulomb;
        // Friction that reacts to the bias velocities lets a held bottle creep by half a degree a second.
        p.friction_in_bias_pass = false;
        p.contact_recycling = false;
        p.contact_clustering = false;

        let [[x0, y0], [x1, y1]] = config.table;
        let half = [0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.02];
        let table = ColliderBuilder::cuboid(half[0] as f32, half[1] as f32, half[2] as f32)
            .translation(Vector::new((0.5 * (x0 + x1)) as f32, (0.5 * (y0 + y1)) as f32, -0.02))
            .friction(config.table_friction as f32)
            .collision_groups(groups(TABLE, OBJECT | DROP))
            .user_data(Tag::Table.to_user_data());
        physics.insert_collider(table, None);
        let floor = ColliderBuilder::cuboid(5.0, 5.0, 0.05)
            .translation(Vector::new(0.0, 0.0, -0.8))
            .collision_groups(groups(TABLE, OBJECT | DROP))
            .user_data(Tag::Floor.to_user_data());
        physics.insert_collider(floor, None);

        let poses = config.arm.link_frames(q);
        let frames = poses.map(|pose| {
            physics.insert_body(
                RigidBodyBuilder::kinematic_position_based()
                    .pose(units::pose(&pose))
                    .can_sleep(false),
            )
        });
        let mut moving = Vec::new();
        for piece in config.arm.pieces() {
            let handle = physics.insert_collider(arm_collider(&piece), Some(frames[piece.frame]));
            if piece.frame >= 2 {
                moving.push(handle);
            }
        }
        for part in palm_parts() {
            let c = part.collider().collision_groups(groups(ARM, OBJECT | DROP)).friction(0.4);
            let c = c.user_data(Tag::Arm.to_user_data());
            moving.push(physics.insert_collider(c, Some(frames[6])));
        }
        let fingers = [1.0, -1.0].map(|side| {
            insert_finger(&mut physics, frames[6], &poses[6], side, config.pad_friction)
        });
        let objects: Vec<RigidBodyHandle> =
            bodies.iter().enumerate().map(|(i, b)| insert_object(&mut physics, i, b)).collect();
        let mut guides = Vec::new();
        for (i, body) in bodies.iter().enumerate() {
            if let Mount::Slider(slider) = body.mount
                && let Some(base) = objects.get(slider.base).filter(|_| slider.base < i)
            {
                guides.push(Guide::insert(&mut physics, (*base, objects[i]), i, slider));
            }
        }
        let mut world = Self {
            physics,
            frames,
            moving,
            fingers,
            objects,
            guides,
            drops: Vec::new(),
            config,
            drive: FingerDrive::default(),
            aim: 0.5 * STROKE,
            time_ticks: 0,
        };
        world.apply_drive();
        world
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &WorldConfig {
        &self.config
    }

    /// Seconds simulated so far.
    pub fn time(&self) -> f64 {
        self.time_ticks as f64 * DT
    }

    /// Ticks simulated so far.
    pub fn ticks(&self) -> u64 {
        self.time_ticks
    }

    /// Sets what the fingers are to do from the next tick on.
    pub fn set_drive(&mut self, drive: FingerDrive) {
        self.drive = drive;
    }

    /// Makes the pads' friction `share` times what it is configured to be.
    pub fn set_pad_grip(&mut self, share: f64) {
        for finger in &self.fingers {
            if let Some(pad) = self.physics.colliders.get_mut(finger.colliders[0]) {
                pad.set_friction((self.config.pad_friction * share.max(0.0)) as f32);
            }
        }
    }

    /// One tick: the arm goes to the joint angles `q` (rad) within it.
    pub fn step(&mut self, q: &[f64; 6]) {
        for (handle, pose) in self.frames.iter().zip(self.config.arm.link_frames(q)) {
            if let Some(body) = self.physics.bodies.get_mut(*handle) {
                body.set_next_kinematic_position(units::pose(&pose));
            }
        }
        self.apply_drive();
        self.physics.step();
        self.time_ticks += 1;
        for k in 0..self.guides.len() {
            let travel = self.travel(&self.guides[k]);
            self.guides[k].release(&mut self.physics, travel);
        }
    }

    fn travel(&self, guide: &Guide) -> f64 {
        let (base, object) = (self.object_pose(guide.slider.base), self.object_pose(guide.object));
        guide.travel(&base, &object)
    }

    /// How far object `i` has been drawn out of its guide, m; none if it has none or came free.
    pub fn joint_travel(&self, i: usize) -> Option<f64> {
        let guide = self.guides.iter().find(|g| g.object == i && g.joined())?;
        Some(self.travel(guide))
    }

    /// Adds drops of something to pour.
    pub fn add_drops(&mut self, drops: &DropSet) {
        let group = groups(DROP, TABLE | OBJECT | ARM | FINGER | DROP);
        self.drops.extend(mount::insert_drops(&mut self.physics, drops, group));
    }

    /// Centres of all drops, m in `base_link`.
    pub fn drops(&self) -> Vec<Point3<f64>> {
        let at = |h: &RigidBodyHandle| self.body_pose(*h).translation.vector.into();
        self.drops.iter().map(at).collect()
    }

    /// The two pads are driven by one motor: both aim at the same half gap. The aim runs ahead of the
    /// pads' mean at most by what the force limit allows, which makes the squeeze, while the spring
    /// between each pad and the aim keeps them symmetric.
    fn apply_drive(&mut self) {
        let mean = 0.5 * self.gap();
        let reach = self.drive.force / f64::from(FINGER_STIFFNESS);
        let goal = 0.5 * self.drive.gap;
        let stride = 0.5 * self.drive.speed * DT;
        let before = self.aim;
        self.aim = (self.aim + (goal - self.aim).clamp(-stride, stride))
            .clamp(mean - reach, mean + reach)
            .clamp(-reach, 0.5 * STROKE + 0.001);
        let rate =
            ((self.aim - before) / DT).clamp(-0.5 * self.drive.speed, 0.5 * self.drive.speed);
        for finger in &self.fingers {
            if let Some(joint) = self.physics.impulse_joints.get_mut(finger.joint, true) {
                joint.data.set_motor(
                    JointAxis::LinX,
                    self.aim as f32,
                    rate as f32,
                    FINGER_STIFFNESS,
                    FINGER_DAMPING,
                );
                joint.data.set_motor_max_force(JointAxis::LinX, self.drive.force as f32);
            }
        }
    }

    fn finger_offset(&self, finger: &Finger) -> f64 {
        let (Some(palm), Some(body)) =
            (self.physics.bodies.get(self.frames[6]), self.physics.bodies.get(finger.body))
        else {
            return 0.0;
        };
        let tool = units::pose64(palm.position());
        let axis = tool.rotation * Vector3::y() * finger.side;
        let at = units::vector64(body.translation()) - tool.translation.vector;
        axis.dot(&at)
    }

    /// Gap between the pads, m.
    pub fn gap(&self) -> f64 {
        self.fingers.iter().map(|f| self.finger_offset(f)).sum()
    }

    /// Offsets of the two pads from the middle plane (m, positive outwards), +y side first.
    pub fn pad_offsets(&self) -> [f64; 2] {
        [self.finger_offset(&self.fingers[0]), self.finger_offset(&self.fingers[1])]
    }

    /// Poses of the link frames (see [`ArmModel::link_frames`]).
    pub fn link_poses(&self) -> [Pose64; 7] {
        self.frames.map(|h| self.body_pose(h))
    }

    /// Poses of the two fingers: origin in the middle of the pad's face, axes as `tool0`'s, +y side
    /// first.
    pub fn finger_poses(&self) -> [Pose64; 2] {
        [self.body_pose(self.fingers[0].body), self.body_pose(self.fingers[1].body)]
    }

    fn body_pose(&self, handle: RigidBodyHandle) -> Pose64 {
        self.physics
            .bodies
            .get(handle)
            .map_or_else(Pose64::identity, |b| units::pose64(b.position()))
    }

    /// How many objects there are.
    pub fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// `T_base_link_object` of object `i`; the identity for an index that does not exist.
    pub fn object_pose(&self, i: usize) -> Pose64 {
        self.objects.get(i).map_or_else(Pose64::identity, |h| self.body_pose(*h))
    }

    /// Linear (m/s) and angular (rad/s) speed of object `i`.
    pub fn object_speed(&self, i: usize) -> (f64, f64) {
        let body = self.objects.get(i).and_then(|h| self.physics.bodies.get(*h));
        body.map_or((0.0, 0.0), |b| {
            (f64::from(b.linvel().length()), f64::from(b.angvel().length()))
        })
    }

    /// Puts object `i` somewhere else, at rest, and what slides on it along with it.
    pub fn place_object(&mut self, i: usize, pose: &Pose64) {
        let by = pose * self.object_pose(i).inverse();
        self.put(i, pose);
        for k in 0..self.guides.len() {
            let guide = &self.guides[k];
            if guide.slider.base == i && guide.joined() {
                let object = guide.object;
                let to = by * self.object_pose(object);
                self.put(object, &to);
            }
        }
    }

    fn put(&mut self, i: usize, pose: &Pose64) {
        if let Some(body) = self.objects.get(i).and_then(|h| self.physics.bodies.get_mut(*h)) {
            body.set_position(units::pose(pose), true);
            body.set_linvel(Vector::ZERO, true);
            body.set_angvel(Vector::ZERO, true);
        }
    }

    /// What touches what after the last tick.
    pub fn contacts(&self) -> Contacts {
        Contacts::read(&self.physics, self.objects.len(), DT)
    }

    /// Height of the lowest point of the moving arm and gripper above the table plane, m; negative
    /// inside the table.
    pub fn clearance(&self) -> f64 {
        let fingers = self.fingers.iter().flat_map(|f| f.colliders.iter());
        self.moving
            .iter()
            .chain(fingers)
            .filter_map(|h| self.physics.colliders.get(*h))
            .map(|c| f64::from(c.compute_aabb().mins.z))
            .fold(f64::INFINITY, f64::min)
    }

    /// A number that is equal for two worlds exactly when every body has bit for bit the same pose
    /// and velocity (FNV-1a over the bits).
    pub fn state_hash(&self) -> u64 {
        let fingers = self.fingers.iter().map(|f| f.body);
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for handle in self
            .frames
            .iter()
            .copied()
            .chain(fingers)
            .chain(self.objects.iter().copied())
            .chain(self.drops.iter().copied())
        {
            let Some(b) = self.physics.bodies.get(handle) else { continue };
            let (t, r) = (b.translation(), b.rotation());
            let (v, w) = (b.linvel(), b.angvel());
            let numbers = [t.x, t.y, t.z, r.x, r.y, r.z, r.w, v.x, v.y, v.z, w.x, w.y, w.z];
            for byte in numbers.iter().flat_map(|n| n.to_bits().to_le_bytes()) {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
        hash
    }
}

fn groups(member: Group, filter: Group) -> InteractionGroups {
    InteractionGroups::new(member, filter, InteractionTestMode::And)
}

/// The capsule of a round piece; its ends are drawn in so that the caps do not stick out far.
fn arm_collider(piece: &LinkPiece) -> ColliderBuilder {
    let (a, b) = (Vector3::from(piece.a), Vector3::from(piece.b));
    let (mid, half) = (0.5 * (a + b), 0.5 * (b - a));
    let length = half.norm();
    let keep = if length > 1e-9 { ((length - 0.6 * piece.radius) / length).max(0.02) } else { 0.0 };
    ColliderBuilder::capsule_from_endpoints(
        units::vector(&(mid - half * keep)),
        units::vector(&(mid + half * keep)),
        piece.radius as f32,
    )
    .collision_groups(groups(ARM, OBJECT))
    .friction(0.4)
    .user_data(Tag::Arm.to_user_data())
}

/// Solid parts of the gripper that do not move against `tool0`.
pub(crate) fn palm_parts() -> [Part; 2] {
    let at = |z: f64| Pose64::translation(0.0, 0.0, z);
    [
        Part { solid: Solid::Cylinder { radius: PALM_RADIUS, height: 0.060 }, pose: at(0.030) },
        Part {
            solid: Solid::Cuboid([0.018, 0.045, 0.5 * (PALM_FRONT - 0.060)]),
            pose: at(0.5 * (PALM_FRONT + 0.060)),
        },
    ]
}

/// Parts of the finger on the given side in its own frame (origin on the pad's face).
pub(crate) fn finger_parts(side: f64) -> [Part; 2] {
    let pad_end = 0.5 * PAD_LENGTH;
    let root = FINGER_ROOT - TCP_OFFSET;
    [
        Part {
            solid: Solid::Cuboid([0.5 * PAD_WIDTH, 0.5 * PAD_THICKNESS, pad_end]),
            pose: Pose64::translation(0.0, side * 0.5 * PAD_THICKNESS, 0.0),
        },
        Part {
            solid: Solid::Cuboid([0.010, 0.5 * FINGER_THICKNESS, 0.5 * (pad_end - 0.001 - root)]),
            pose: Pose64::translation(
                0.0,
                side * (PAD_THICKNESS + 0.5 * FINGER_THICKNESS),
                0.5 * (pad_end - 0.001 + root),
            ),
        },
    ]
}

fn insert_finger(
    physics: &mut PhysicsWorld,
    palm: RigidBodyHandle,
    tool0: &Pose64,
    side: f64,
    pad_friction: f64,
) -> Finger {
    let offset = Translation3::new(0.0, side * 0.5 * STROKE, TCP_OFFSET);
    let pose = tool0 * Pose64::from_parts(offset, UnitQuaternion::identity());
    let inertia = FINGER_MASS * 0.03 * 0.03;
    let body = physics.insert_body(
        RigidBodyBuilder::dynamic()
            .pose(units::pose(&pose))
            .gravity_scale(0.0)
            .can_sleep(false)
            .additional_mass_properties(MassProperties::new(
                Vector::ZERO,
                FINGER_MASS,
                Vector::splat(inertia),
            )),
    );
    let tag = if side > 0.0 { Tag::FingerA } else { Tag::FingerB };
    let friction = [pad_friction as f32, 0.5];
    let colliders = [0, 1].map(|i| {
        physics.insert_collider(
            finger_parts(side)[i]
                .collider()
                .friction(friction[i])
                .friction_combine_rule(CoefficientCombineRule::Multiply)
                .collision_groups(groups(FINGER, OBJECT | DROP))
                .user_data(tag.to_user_data()),
            Some(body),
        )
    });
    let axis = Vector::new(0.0, side as f32, 0.0);
    let joint = PrismaticJointBuilder::new(axis)
        .local_anchor1(Vector::new(0.0, 0.0, TCP_OFFSET as f32))
        .local_anchor2(Vector::ZERO)
        .limits([0.0, 0.5 * STROKE as f32])
        .motor_model(MotorModel::ForceBased);
    let mut joint: GenericJoint = joint.into();
    joint.contacts_enabled = false;
    let joint = physics.insert_impulse_joint(palm, body, joint);
    Finger { body, joint, side, colliders }
}

fn insert_object(physics: &mut PhysicsWorld, index: usize, body: &Body) -> RigidBodyHandle {
    let builder = match body.mount {
        Mount::Fixed => RigidBodyBuilder::fixed(),
        Mount::Free | Mount::Slider(_) => RigidBodyBuilder::dynamic(),
    };
    let handle = physics.insert_body(builder.pose(units::pose(&body.pose)).ccd_enabled(false));
    // The arm moves by itself, what is screwed down not at all: such pairs are left out unless asked for.
    let mut pairs = ActiveCollisionTypes::default();
    if body.mount == Mount::Fixed {
        pairs |= ActiveCollisionTypes::KINEMATIC_FIXED;
    }
    let volume: f64 = body.parts.iter().map(Part::volume).sum();
    for part in &body.parts {
        let mass = body.mass * part.volume() / volume.max(1e-12);
        physics.insert_collider(
            part.collider()
                .mass(mass as f32)
                .friction(body.friction as f32)
                .collision_groups(groups(OBJECT, TABLE | OBJECT | ARM | FINGER | DROP))
                .active_collision_types(pairs)
                .user_data(Tag::Object(index as u32).to_user_data()),
            Some(handle),
        );
    }
    handle
}
