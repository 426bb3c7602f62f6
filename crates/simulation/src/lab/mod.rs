//! The whole lab in one struct, stepped tick by tick: controller, gripper, physics, truth and judge.

mod displace;

use crate::arm::base_link_to_base;
use crate::contacts::Contacts;
use crate::controller::{Controller, StopReason};
use crate::draw::Knowledge;
use crate::error::SimulationError;
use crate::gripper::{Gripper, GripperRequest, GripperStatus};
use crate::mount::{DropSet, Mount, Slider, filling};
use crate::parts::Part;
use crate::scene::{Placement, Scene, SceneMount};
use crate::trial::{Judge, Observed, PlacingGoal, Verdict};
use crate::visual::RobotMeshes;
use crate::world::{Body, DT, World, WorldConfig};
use displace::Slide;
use std::sync::Arc;
use tdv_geometry::nalgebra::{Point3, Translation3};
use tdv_geometry::{Pose, Stamp};
use tdv_rendering::mesh::primitives::sphere;
use tdv_rendering::{Mesh, ObjectFile};

/// Instance number of the table in id images; objects have 1, 2, ... in the scene's order.
pub const TABLE_ID: u16 = 1000;
/// Instance number of the arm.
pub const ARM_ID: u16 = 1001;
/// Instance number of the gripper.
pub const GRIPPER_ID: u16 = 1002;
/// Instance number of all drops.
pub const DROP_ID: u16 = 1003;

/// Colour of the drops.
const WATER: [u8; 3] = [70, 150, 226];

/// The scene with its objects' files and meshes; made once, shared by many trials.
#[derive(Debug)]
pub struct LabAssets {
    /// The scene.
    pub scene: Scene,
    /// Its objects' files, in the scene's order.
    pub files: Vec<ObjectFile>,
    /// Their meshes.
    pub meshes: Vec<Mesh>,
    /// The robot's meshes.
    pub robot: RobotMeshes,
    /// What a drop looks like.
    pub drop: Mesh,
}

impl LabAssets {
    /// Loads all objects of a scene.
    ///
    /// # Errors
    /// [`SimulationError::Object`].
    pub fn load(scene: Scene) -> Result<Self, SimulationError> {
        let mut files = Vec::new();
        let mut meshes = Vec::new();
        for object in &scene.objects {
            let dir = scene.object_dir(&object.name);
            let file = ObjectFile::load(&dir)?;
            meshes.push(file.load_mesh(&dir)?);
            files.push(file);
        }
        let radius = scene.drops.as_ref().map_or(0.004, |d| d.radius);
        let drop = sphere(radius, 8, WATER);
        let robot = RobotMeshes::new(scene.robot.controller.arm());
        Ok(Self { scene, files, meshes, robot, drop })
    }

    /// What to draw at the given poses (see [`Lab::render_poses`]): objects, arm links, fingers,
    /// and for whatever poses are left, drops.
    pub fn instances(&self, poses: &[Pose]) -> Vec<LabInstance<'_>> {
        let objects = self.meshes.iter().enumerate().map(|(i, mesh)| (mesh, i as u16 + 1));
        let links = self.robot.links.iter().enumerate();
        let links = links.map(|(i, mesh)| (mesh, if i == 6 { GRIPPER_ID } else { ARM_ID }));
        let fingers = self.robot.fingers.iter().map(|mesh| (mesh, GRIPPER_ID));
        objects
            .chain(links)
            .chain(fingers)
            .chain(std::iter::repeat((&self.drop, DROP_ID)))
            .zip(poses)
            .map(|((mesh, id), pose)| LabInstance { mesh, pose: *pose, id })
            .collect()
    }
}

/// A mesh to draw.
#[derive(Debug, Clone, Copy)]
pub struct LabInstance<'a> {
    /// What.
    pub mesh: &'a Mesh,
    /// Where, in `base_link`.
    pub pose: Pose,
    /// Number in id images.
    pub id: u16,
}

/// What went wrong physically so far. Truth: for evaluation only.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Incidents {
    /// How often the arm or the gripper went into the table.
    pub table_hits: u32,
    /// How deep, m.
    pub table_depth: f64,
    /// How often a link or the palm went into something screwed to the table.
    pub fixture_hits: u32,
    /// How often the arm was stopped for protection.
    pub protective_stops: u32,
    /// Largest push against the arm, N.
    pub peak_force: f64,
}

/// Deeper than this in the table (m) counts as a hit; the second number stops the arm.
const TABLE_HIT: f64 = 0.001;
const TABLE_STOP: f64 = 0.004;
/// The push against the arm is smoothed over this long, s.
const FORCE_SMOOTHING: f64 = 0.010;
/// Ticks between two looks of the judge.
const JUDGE_EVERY: u64 = 10;

/// The lab.
pub struct Lab {
    assets: Arc<LabAssets>,
    world: World,
    controller: Controller,
    gripper: Gripper,
    contacts: Contacts,
    force: f64,
    in_table: bool,
    in_fixture: bool,
    incidents: Incidents,
    knowledge: Knowledge,
    slides: Vec<Slide>,
    /// Seconds for which the pads do not grip.
    slippery: f64,
    judge: Judge,
    seed: u64,
}

impl Lab {
    /// A lab whose starts are drawn from the seed.
    ///
    /// # Errors
    /// [`SimulationError`] of the scene's objects and regions.
    pub fn new(scene: &Scene, seed: u64) -> Result<Self, SimulationError> {
        Self::from_assets(Arc::new(LabAssets::load(scene.clone())?), seed)
    }

    /// The same with objects loaded before.
    ///
    /// # Errors
    /// [`SimulationError::Value`] of the scene's regions.
    pub fn from_assets(assets: Arc<LabAssets>, seed: u64) -> Result<Self, SimulationError> {
        Self::with_starts(assets, seed, &[])
    }

    /// A lab with given start poses (`T_base_link_object`, in the scene's order; missing ones are
    /// drawn). All else is drawn from the seed as usual.
    ///
    /// # Errors
    /// [`SimulationError::Value`] of the scene's regions.
    pub fn with_starts(
        assets: Arc<LabAssets>,
        seed: u64,
        starts: &[Pose],
    ) -> Result<Self, SimulationError> {
        let scene = &assets.scene;
        let drawn = scene.draw_starts(seed)?;
        let mut bodies: Vec<Body> = Vec::with_capacity(drawn.len());
        for (i, (file, object)) in assets.files.iter().zip(&scene.objects).enumerate() {
            let parts: Vec<Part> = file.collision.iter().map(Part::from).collect();
            let on = match &object.start {
                Placement::On(a) => {
                    let k = scene.index_of(&a.object)?;
                    bodies.get(k).map(|b| b.pose * a.pose())
                }
                Placement::Region(_) | Placement::Spot(_) => None,
            };
            let pose = starts.get(i).copied().or(on).unwrap_or_else(|| {
                // An object whose origin is not in its base stands higher.
                let base = parts.iter().map(Part::lowest).fold(f64::INFINITY, f64::min);
                Translation3::new(0.0, 0.0, -base) * drawn[i]
            });
            let (mass, friction) = (file.mass, file.friction);
            let mount = mount_of(scene, &object.mount)?;
            bodies.push(Body { name: object.name.clone(), mass, friction, parts, pose, mount });
        }
        let (arm, home) = (scene.robot.controller.arm(), scene.robot.start()?);
        let mut world = World::new(WorldConfig { arm, ..WorldConfig::default() }, &bodies, &home);
        if let Some(drops) = &scene.drops {
            let cup = bodies[scene.index_of(&drops.inside)?].pose;
            let places = filling(drops.count, drops.radius, drops.cup_radius, drops.cup_floor);
            world.add_drops(&DropSet {
                centres: places.iter().map(|p| cup * p).collect(),
                radius: drops.radius,
                mass: drops.mass,
            });
        }
        let judge = make_judge(&assets, scene.task.goal)?;
        let contacts = world.contacts();
        let knowledge = scene.draw_knowledge(seed);
        Ok(Self {
            world,
            controller: Controller::with_power(scene.robot.controller, home, scene.robot.powered),
            gripper: Gripper::new(),
            contacts,
            force: 0.0,
            in_table: false,
            in_fixture: false,
            incidents: Incidents::default(),
            knowledge,
            slides: Vec::new(),
            slippery: 0.0,
            judge,
            seed,
            assets,
        })
    }

    /// One tick of [`DT`] = 2 ms.
    pub fn step(&mut self) {
        self.controller.step(DT);
        let drive = self.gripper.step(DT, self.world.gap());
        self.world.set_drive(drive);
        self.slide();
        self.dry();
        self.world.step(self.controller.q());
        self.contacts = self.world.contacts();
        // The controller gives forces in its base, which is base_link turned by pi about z.
        let f = base_link_to_base().rotation.inverse() * self.tool_force();
        self.controller.set_tcp_force([f.x, f.y, f.z, 0.0, 0.0, 0.0]);
        self.protect();
        if self.world.ticks().is_multiple_of(JUDGE_EVERY) {
            self.look();
        }
    }

    fn protect(&mut self) {
        let push = self.contacts.robot_force.norm();
        self.force += (push - self.force) * (DT / FORCE_SMOOTHING);
        self.incidents.peak_force = self.incidents.peak_force.max(self.force);
        let depth = -self.world.clearance();
        self.incidents.table_depth = self.incidents.table_depth.max(depth.max(0.0));
        if depth > TABLE_HIT && !self.in_table {
            self.incidents.table_hits += 1;
        }
        self.in_table = depth > TABLE_HIT;
        let crash = self.contacts.crash_depth;
        if crash > TABLE_HIT && !self.in_fixture {
            self.incidents.fixture_hits += 1;
        }
        self.in_fixture = crash > TABLE_HIT;
        let reason = if depth > TABLE_STOP {
            Some(StopReason::Table)
        } else if self.force > self.assets.scene.robot.force_limit || crash > TABLE_STOP {
            Some(StopReason::Force)
        } else {
            None
        };
        if let Some(reason) = reason
            && self.controller.protective_stop().is_none()
            // At rest there is nothing to stop: after an unlock the arm has to be able to leave.
            && self.controller.qd().iter().any(|v| v.abs() > 1e-3)
            && !self.leaving()
        {
            self.controller.protect(reason);
            self.incidents.protective_stops += 1;
        }
    }

    /// Whether the arm moves away from the table.
    fn leaving(&self) -> bool {
        let q = self.controller.q();
        let ahead: [f64; 6] = std::array::from_fn(|i| q[i] + 0.01 * self.controller.qd()[i]);
        let height = |q| self.world.config().arm.link_frames(q)[6].translation.z;
        height(&ahead) > height(q) + 1e-6
    }

    fn look(&mut self) {
        let seen: Vec<Observed> = (0..self.world.object_count())
            .map(|i| {
                let c = self.contacts.objects.get(i).copied().unwrap_or_default();
                Observed {
                    name: &self.assets.scene.objects[i].name,
                    pose: self.world.object_pose(i),
                    speed: self.world.object_speed(i),
                    touched: c.robot(),
                    fallen: c.floor || self.world.object_pose(i).translation.z < -0.1,
                }
            })
            .collect();
        self.judge.step(DT * JUDGE_EVERY as f64, &seen, &self.world.drops());
    }

    /// Simulated time since the lab began, s.
    pub fn time(&self) -> f64 {
        self.world.time()
    }

    /// The same as a stamp counted from `start`.
    pub fn stamp(&self, start: Stamp) -> Stamp {
        Stamp(start.0 + (self.world.ticks() * 2_000_000) as i64)
    }

    /// The seed it was made from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The scene and its meshes.
    pub fn assets(&self) -> &Arc<LabAssets> {
        &self.assets
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.assets.scene
    }

    /// What the robot's side may know: never the exact numbers.
    pub fn knowledge(&self) -> &Knowledge {
        &self.knowledge
    }

    /// The physics.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The physics, to put objects somewhere.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The UR controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The UR controller, for the dashboard.
    pub fn controller_mut(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// The gripper's registers to read.
    pub fn gripper_status(&self) -> GripperStatus {
        self.gripper.status()
    }

    /// Writes the gripper's registers.
    pub fn set_gripper_request(&mut self, request: GripperRequest) {
        self.gripper.set_request(request);
    }

    /// Joint angles (rad) and speeds (rad/s).
    pub fn joints(&self) -> (&[f64; 6], &[f64; 6]) {
        (self.controller.q(), self.controller.qd())
    }

    /// The pull on the tool by what it carries and touches, N in `base_link`.
    pub fn tool_force(&self) -> tdv_geometry::nalgebra::Vector3<f64> {
        self.contacts.robot_force
    }

    /// Truth: name and pose (`T_base_link_object`) of every object.
    pub fn objects(&self) -> impl Iterator<Item = (&str, Pose)> {
        let names = self.assets.scene.objects.iter();
        names.enumerate().map(move |(i, o)| (o.name.as_str(), self.world.object_pose(i)))
    }

    /// Truth: pose of one object.
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`].
    pub fn object_pose(&self, name: &str) -> Result<Pose, SimulationError> {
        Ok(self.world.object_pose(self.assets.scene.index_of(name)?))
    }

    /// Truth: whether an object is in the grip, touched by both fingers and not by the table.
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`].
    pub fn held(&self, name: &str) -> Result<bool, SimulationError> {
        let i = self.assets.scene.index_of(name)?;
        let c = self.contacts.objects.get(i).copied().unwrap_or_default();
        Ok(c.fingers[0] && c.fingers[1])
    }

    /// Truth: what touches what.
    pub fn contacts(&self) -> &Contacts {
        &self.contacts
    }

    /// Truth: mishaps so far.
    pub fn incidents(&self) -> Incidents {
        self.incidents
    }

    /// Says what the task's goal is (from a demonstration) and starts the trial's clock.
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`].
    pub fn begin_trial(&mut self, goal: PlacingGoal) -> Result<(), SimulationError> {
        self.judge = make_judge(&self.assets, goal)?;
        Ok(())
    }

    /// Truth: the verdict so far.
    pub fn trial(&self) -> &Verdict {
        self.judge.verdict()
    }

    /// Truth: ends the trial and returns its verdict; a trial not yet won is lost for the reason `why`.
    pub fn conclude(&mut self, why: &str) -> Verdict {
        self.look();
        self.judge.conclude(why).clone()
    }

    /// Poses in base_link of everything to draw, in the order of [`LabAssets::instances`].
    pub fn render_poses(&self) -> Vec<Pose> {
        let objects = (0..self.world.object_count()).map(|i| self.world.object_pose(i));
        let drops = self.world.drops().into_iter();
        let drops = drops.map(|p: Point3<f64>| Pose::translation(p.x, p.y, p.z));
        let robot = self.world.link_poses().into_iter().chain(self.world.finger_poses());
        objects.chain(robot).chain(drops).collect()
    }

    /// Everything to draw except table and background: objects, arm, gripper.
    pub fn render_instances(&self) -> Vec<LabInstance<'_>> {
        self.assets.instances(&self.render_poses())
    }

    /// Truth: pose of the tool centre point in base_link.
    pub fn tcp_pose(&self) -> Pose {
        self.world.link_poses()[6] * Translation3::new(0.0, 0.0, crate::gripper::TCP_OFFSET)
    }
}

fn make_judge(assets: &LabAssets, goal: PlacingGoal) -> Result<Judge, SimulationError> {
    let scene = &assets.scene;
    let of = |name: &str| -> Result<_, SimulationError> {
        let i = scene.index_of(name)?;
        Ok((i, assets.files[i].symmetry.clone()))
    };
    let (moving, reference) = (of(&scene.task.moving)?, of(&scene.task.reference)?);
    let judge = Judge::new(scene.task.success, goal, moving, reference);
    Ok(judge.with_rule(scene.task.rule))
}

fn mount_of(scene: &Scene, mount: &SceneMount) -> Result<Mount, SimulationError> {
    Ok(match mount {
        SceneMount::Free => Mount::Free,
        SceneMount::Fixed => Mount::Fixed,
        SceneMount::Slider(s) => Mount::Slider(Slider {
            base: scene.index_of(&s.base)?,
            axis: s.axis,
            travel: s.travel,
            friction: s.friction,
            comes_free: s.comes_free,
        }),
    })
}
