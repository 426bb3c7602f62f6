//! Scene files (`config/scenes/NAME.yaml`): what stands where, and what is left to chance.

use crate::arm::ArmModel;
use crate::backdrop::{MAX_DISTRACTORS, TableTop};
use crate::controller::Generation;
use crate::error::SimulationError;
use crate::sensor::{ColorNoise, DepthNoise, SensorConfig};
use crate::trial::{PlacingGoal, Rule, SuccessConfig};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Point3;
use tdv_rendering::{Intrinsics, look_at};
use tdv_robot::{IkError, IkSelection};

pub use crate::draw::Knowledge;

/// A rectangle and a range of yaw to draw a start from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartRegion {
    /// Range of x in `base_link`, m.
    pub x: [f64; 2],
    /// Range of y, m.
    pub y: [f64; 2],
    /// Range of yaw, deg.
    pub yaw_deg: [f64; 2],
    /// A disc that is left out.
    #[serde(default)]
    pub exclude: Option<Exclusion>,
}

/// A disc around another object in which nothing starts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exclusion {
    /// Name of the other object; it has to stand before this one in the scene.
    pub object: String,
    /// Radius, m.
    pub radius: f64,
}

/// A spot with a little chance around it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spot {
    /// x, y in `base_link`, m.
    pub xy: [f64; 2],
    /// Yaw, deg.
    #[serde(default)]
    pub yaw_deg: f64,
    /// Each of x and y is off by at most this, m.
    #[serde(default)]
    pub jitter: f64,
    /// Yaw is off by at most this, deg.
    #[serde(default)]
    pub jitter_deg: f64,
}

/// How an object gets its start pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Placement {
    /// Anywhere in a region.
    Region(StartRegion),
    /// Near a spot.
    Spot(Spot),
    /// At a fixed place in another object's frame.
    On(Attached),
}

/// A place in another object's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attached {
    /// Name of the other object; it has to stand before this one in the scene.
    pub object: String,
    /// Position in its frame, m.
    #[serde(default)]
    pub xyz: [f64; 3],
    /// Yaw in its frame, deg.
    #[serde(default)]
    pub yaw_deg: f64,
}

impl Attached {
    /// `T_other_object`.
    pub fn pose(&self) -> Pose {
        tdv_geometry::pose_from_xyz_rpy(self.xyz, [0.0, 0.0, self.yaw_deg.to_radians()])
    }
}

/// How an object is fastened.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SceneMount {
    /// Not at all.
    #[default]
    Free,
    /// Screwed to the table.
    Fixed,
    /// Slides along another object.
    Slider(SceneSlider),
}

/// A straight guide between two objects whose frames are the same when it is shut.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSlider {
    /// The object that it slides on; it has to stand before this one in the scene.
    pub base: String,
    /// Direction in which it opens, in the base's frame.
    pub axis: [f64; 3],
    /// How far it goes, m.
    pub travel: f64,
    /// Dry friction, N.
    pub friction: f64,
    /// Comes free at the end of its travel instead of stopping there.
    #[serde(default)]
    pub comes_free: bool,
}

/// Small balls in an object that stand for water.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drops {
    /// How many.
    pub count: usize,
    /// Radius of each, m.
    pub radius: f64,
    /// Mass of each, kg.
    pub mass: f64,
    /// The object that they are in at the start.
    pub inside: String,
    /// Inner radius of that object, m.
    pub cup_radius: f64,
    /// Height of the floor inside it, m.
    pub cup_floor: f64,
}

/// Most drops that a scene may have: more would make it slow.
const MAX_DROPS: usize = 400;

impl Drops {
    /// Name of a field and what is wrong with it.
    fn check(&self) -> Result<(), (&'static str, String)> {
        if self.count == 0 || self.count > MAX_DROPS {
            return Err(("count", format!("is {}, 1 to {MAX_DROPS} is possible", self.count)));
        }
        for (field, v, low) in [
            ("radius", self.radius, 0.002),
            ("mass", self.mass, 1e-5),
            ("cup_radius", self.cup_radius, 1.5 * self.radius),
            ("cup_floor", self.cup_floor, 0.0),
        ] {
            if !(low..0.2).contains(&v) {
                return Err((field, format!("is {v}, {low} to 0.2 is possible")));
            }
        }
        Ok(())
    }
}

/// An object of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneObject {
    /// Folder in `config/objects`, and the object's name in the scene.
    pub name: String,
    /// Its start.
    pub start: Placement,
    /// How it is fastened.
    #[serde(default)]
    pub mount: SceneMount,
}

/// The camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Where it hangs in `base_link`, m.
    pub eye: [f64; 3],
    /// The point that it looks at, m.
    pub target: [f64; 3],
    /// Its pinhole numbers.
    pub intrinsics: Intrinsics,
    /// Frames per second.
    pub rate: f64,
    /// Imperfections of its depth image.
    #[serde(default)]
    pub depth: DepthNoise,
    /// Imperfections of its colour image.
    #[serde(default)]
    pub color: ColorNoise,
}

impl CameraConfig {
    /// Name of a field and what is wrong with it.
    fn check(&self) -> Result<(), (&'static str, String)> {
        let within = |field, value: f64, low: f64, high: f64| {
            // A NaN is outside too.
            if value >= low && value <= high {
                Ok(())
            } else {
                Err((field, format!("is {value}, {low} to {high} is possible")))
            }
        };
        let (k, d, c) = (&self.intrinsics, &self.depth, &self.color);
        within("intrinsics.width", f64::from(k.width), 16.0, 8192.0)?;
        within("intrinsics.height", f64::from(k.height), 16.0, 8192.0)?;
        within("intrinsics.fx", k.fx, 1.0, 1e5)?;
        within("intrinsics.fy", k.fy, 1.0, 1e5)?;
        within("intrinsics.cx", k.cx, -1e5, 1e5)?;
        within("intrinsics.cy", k.cy, -1e5, 1e5)?;
        within("rate", self.rate, 0.1, 500.0)?;
        for (i, v) in self.eye.iter().chain(&self.target).enumerate() {
            within(if i < 3 { "eye" } else { "target" }, *v, -100.0, 100.0)?;
        }
        within("depth.baseline", d.baseline, 1e-3, 10.0)?;
        within("depth.subpixel", d.subpixel, 0.0, 10.0)?;
        within("depth.edge_step", d.edge_step, 0.0, 100.0)?;
        within("depth.edge_reach", d.edge_reach as f64, 0.0, 50.0)?;
        within("depth.lateral", d.lateral, 0.0, 50.0)?;
        within("depth.grazing_begin", d.grazing_begin, 0.0, 1.0)?;
        within("depth.grazing_end", d.grazing_end, 0.0, 1.0)?;
        for (field, share) in [
            ("depth.shared", d.shared),
            ("depth.edge_loss", d.edge_loss),
            ("depth.flying", d.flying),
            ("depth.patch_loss", d.patch_loss),
            ("color.vignette", c.vignette),
            ("color.gain", c.gain),
            ("color.balance", c.balance),
            ("color.flicker", c.flicker),
        ] {
            within(field, share, 0.0, 1.0)?;
        }
        within("depth.range", d.range[0], 0.0, d.range[1])?;
        within("color.blur", c.blur, 0.0, 0.33)?;
        within("color.read", c.read, 0.0, 255.0)?;
        within("color.shot", c.shot, 0.0, 255.0)
    }

    /// Intrinsics and imperfections.
    pub fn sensor(&self) -> SensorConfig {
        SensorConfig {
            intrinsics: self.intrinsics,
            depth: self.depth.clone(),
            color: self.color.clone(),
        }
    }

    /// `T_base_link_camera_color_optical_frame`.
    pub fn pose(&self) -> Pose {
        look_at(&Point3::from(self.eye), &Point3::from(self.target))
    }
}

/// The arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// Joint angles at the start, rad.
    pub home: [f64; 6],
    /// Which controller is imitated.
    #[serde(default)]
    pub controller: Generation,
    /// Whether the arm is powered and its brakes are released when the lab begins.
    #[serde(default = "yes")]
    pub powered: bool,
    /// A push against the arm harder than this (N) stops it for protection.
    #[serde(default = "default_force")]
    pub force_limit: f64,
}

impl RobotConfig {
    /// Joint angles at the start, rad: `home` is a UR5's; a UR5e begins with its tool at the same place.
    ///
    /// # Errors
    /// [`IkError`] when it cannot.
    pub fn start(&self) -> Result<[f64; 6], IkError> {
        match self.controller.arm() {
            ArmModel::Ur5 => Ok(self.home),
            arm => {
                let tcp = ArmModel::Ur5.kinematics().fk_tcp(&self.home);
                arm.kinematics().nearest_tcp(&tcp, &self.home, &IkSelection::default())
            }
        }
    }
}

fn yes() -> bool {
    true
}

fn default_force() -> f64 {
    150.0
}

/// How far the robot's knowledge may be off; every number is the bound of a uniform draw.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KnowledgeErrors {
    /// Share by which a mesh is too large or too small.
    pub mesh_scale: f64,
    /// The camera's place, m.
    pub extrinsics: f64,
    /// The camera's orientation, deg.
    pub extrinsics_deg: f64,
    /// Share by which focal lengths and principal point (of the half image size) are off.
    pub intrinsics: f64,
}

impl Default for KnowledgeErrors {
    fn default() -> Self {
        Self { mesh_scale: 0.01, extrinsics: 0.003, extrinsics_deg: 0.5, intrinsics: 0.005 }
    }
}

/// What has to be done in the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacingTask {
    /// The object to be moved.
    pub moving: String,
    /// The object that it is placed on.
    pub reference: String,
    /// Where on it, unless a demonstration says otherwise.
    #[serde(default)]
    pub goal: PlacingGoal,
    /// What counts as done.
    #[serde(default)]
    pub rule: Rule,
    /// The numbers of that.
    #[serde(default)]
    pub success: SuccessConfig,
}

/// A scene file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// The objects; later ones may be placed relative to earlier ones.
    pub objects: Vec<SceneObject>,
    /// What has to be done.
    pub task: PlacingTask,
    /// The arm.
    pub robot: RobotConfig,
    /// The camera.
    pub camera: CameraConfig,
    /// What is poured.
    #[serde(default)]
    pub drops: Option<Drops>,
    /// How many random things are seen on the table that are no objects of the task (at most 16); they
    /// are beyond the arm's reach and not in the physics.
    #[serde(default)]
    pub distractors: usize,
    /// What the table looks like.
    #[serde(default)]
    pub table_top: TableTop,
    /// What the robot does not know exactly.
    #[serde(default)]
    pub errors: KnowledgeErrors,
    /// Where the object folders are, relative to the scene file.
    #[serde(default = "default_objects")]
    pub objects_dir: PathBuf,
    #[serde(skip)]
    pub(crate) path: PathBuf,
}

fn default_objects() -> PathBuf {
    PathBuf::from("../objects")
}

impl Scene {
    /// Reads and checks a scene file.
    ///
    /// # Errors
    /// [`SimulationError::Io`], [`SimulationError::Parse`], [`SimulationError::Value`].
    pub fn load(path: &Path) -> Result<Self, SimulationError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| SimulationError::Io { path: path.into(), source })?;
        Self::parse(&text, path)
    }

    /// The same from text; `path` is named in errors and anchors `objects_dir`.
    ///
    /// # Errors
    /// [`SimulationError::Parse`], [`SimulationError::Value`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, SimulationError> {
        let mut scene: Self = serde_saphyr::from_str(text)
            .map_err(|e| SimulationError::Parse { path: path.into(), reason: e.to_string() })?;
        scene.path = path.into();
        scene.check()?;
        Ok(scene)
    }

    /// Writes it as a file; its object folders stay where they are.
    ///
    /// # Errors
    /// [`SimulationError::Io`], [`SimulationError::Parse`].
    pub fn save(&self, path: &Path) -> Result<(), SimulationError> {
        let io = |source| SimulationError::Io { path: path.into(), source };
        let mut out = self.clone();
        let base = self.path.parent().unwrap_or(Path::new("."));
        out.objects_dir = base.join(&self.objects_dir).canonicalize().map_err(io)?;
        let text = serde_saphyr::to_string(&out)
            .map_err(|e| SimulationError::Parse { path: path.into(), reason: e.to_string() })?;
        std::fs::write(path, text).map_err(io)
    }

    /// The file that it came from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Folder of an object.
    pub fn object_dir(&self, name: &str) -> PathBuf {
        let base = self.path.parent().unwrap_or(Path::new("."));
        base.join(&self.objects_dir).join(name)
    }

    /// Index of an object.
    ///
    /// # Errors
    /// [`SimulationError::UnknownObject`].
    pub fn index_of(&self, name: &str) -> Result<usize, SimulationError> {
        self.objects.iter().position(|o| o.name == name).ok_or_else(|| {
            let known: Vec<&str> = self.objects.iter().map(|o| o.name.as_str()).collect();
            SimulationError::UnknownObject { name: name.into(), known: known.join(", ") }
        })
    }

    fn check(&self) -> Result<(), SimulationError> {
        let bad = |field: String, reason: String| {
            Err(SimulationError::Value { path: self.path.clone(), field, reason })
        };
        if let Err((field, reason)) = self.camera.check() {
            return bad(format!("camera.{field}"), reason);
        }
        if self.distractors > MAX_DISTRACTORS {
            return bad("distractors".into(), format!("is above {MAX_DISTRACTORS}"));
        }
        for (i, o) in self.objects.iter().enumerate() {
            let field = format!("objects[{i}] ({})", o.name);
            let earlier = &self.objects[..i];
            if earlier.iter().any(|e| e.name == o.name) {
                return bad(field, "appears twice".into());
            }
            if let SceneMount::Slider(s) = &o.mount {
                if !earlier.iter().any(|e| e.name == s.base) {
                    let reason = format!("slides on `{}`, which is not listed before it", s.base);
                    return bad(field, reason);
                }
                let lengths = [tdv_geometry::nalgebra::Vector3::from(s.axis).norm(), s.travel];
                if !lengths.iter().all(|v| *v > 1e-6 && *v < 5.0)
                    || !(0.0..1e3).contains(&s.friction)
                {
                    return bad(field, "slides along no axis, nowhere or without friction".into());
                }
            }
            match &o.start {
                Placement::On(a) => {
                    if !earlier.iter().any(|e| e.name == a.object) {
                        let reason = format!("is on `{}`, which is not listed before it", a.object);
                        return bad(field, reason);
                    }
                    if !a.xyz.iter().chain([&a.yaw_deg]).all(|v| v.is_finite()) {
                        return bad(field, "needs finite numbers".into());
                    }
                }
                Placement::Region(r) => {
                    let finite = r.x.iter().chain(&r.y).chain(&r.yaw_deg).all(|v| v.is_finite());
                    if !finite || r.x[0] > r.x[1] || r.y[0] > r.y[1] || r.yaw_deg[0] > r.yaw_deg[1]
                    {
                        return bad(field, "needs ranges written as [low, high]".into());
                    }
                    let Some(e) = &r.exclude else { continue };
                    if !earlier.iter().any(|o| o.name == e.object) {
                        return bad(
                            field,
                            format!(
                                "excludes a disc around `{}`, which is not listed before it",
                                e.object
                            ),
                        );
                    }
                    if !e.radius.is_finite() || e.radius < 0.0 {
                        return bad(field, "excludes a disc whose radius is no length".into());
                    }
                    let around = earlier.iter().find_map(|o| match &o.start {
                        Placement::Spot(s) if o.name == e.object => Some(s.xy),
                        _ => None,
                    });
                    let share = around.map_or(0.0, |xy| excluded_share(r, e.radius, xy));
                    if share > 0.10 {
                        let percent = 100.0 * share;
                        return bad(
                            field,
                            format!("excludes {percent:.1} % of its region; at most 10 % is fair"),
                        );
                    }
                }
                Placement::Spot(s) => {
                    let all = [s.xy[0], s.xy[1], s.yaw_deg, s.jitter, s.jitter_deg];
                    if !all.iter().all(|v| v.is_finite()) || s.jitter < 0.0 || s.jitter_deg < 0.0 {
                        return bad(field, "needs finite numbers and jitter >= 0".into());
                    }
                }
            }
        }
        self.index_of(&self.task.moving)?;
        self.index_of(&self.task.reference)?;
        if let Some(reason) = self.task.rule.problem() {
            return bad("task.rule".into(), reason);
        }
        if let Some(drops) = &self.drops {
            self.index_of(&drops.inside)?;
            if let Err((field, reason)) = drops.check() {
                return bad(format!("drops.{field}"), reason);
            }
        }
        if self.task.moving == self.task.reference {
            return bad("task".into(), "moves an object onto itself".into());
        }
        if !(self.camera.rate > 0.0 && self.camera.rate <= 120.0) {
            return bad(
                "camera.rate".into(),
                format!("{} is not between 0 and 120 Hz", self.camera.rate),
            );
        }
        if !self.robot.home.iter().all(|q| q.abs() <= std::f64::consts::TAU) {
            return bad("robot.home".into(), "has an angle outside +-2 pi".into());
        }
        let e = &self.errors;
        if ![e.mesh_scale, e.extrinsics, e.extrinsics_deg, e.intrinsics].iter().all(|v| *v >= 0.0) {
            return bad("errors".into(), "must not be negative".into());
        }
        Ok(())
    }
}

/// Share of the region's area that its excluded disc takes, the disc being around (`x`, `y`).
fn excluded_share(region: &StartRegion, radius: f64, [x, y]: [f64; 2]) -> f64 {
    const CELLS: usize = 400;
    let at = |[low, high]: [f64; 2], k: usize| low + (high - low) * (k as f64 + 0.5) / CELLS as f64;
    let inside = (0..CELLS * CELLS)
        .filter(|k| {
            let (u, v) = (at(region.x, k % CELLS), at(region.y, k / CELLS));
            (u - x).hypot(v - y) < radius
        })
        .count();
    inside as f64 / (CELLS * CELLS) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;

    fn all() -> Vec<Scene> {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes");
        let files = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().path());
        files.map(|p| Scene::load(&p).unwrap()).collect()
    }

    #[test]
    fn the_scenes_are_in_order() {
        let scenes = all();
        assert!(scenes.len() >= 2);
        for s in scenes {
            let frames = s.robot.controller.arm().link_frames(&s.robot.home);
            let tcp = frames[6] * Pose::translation(0.0, 0.0, crate::gripper::TCP_OFFSET);
            let want = pose_from_xyz_rpy([0.40, 0.0, 0.35], [std::f64::consts::PI, 0.0, 0.0]);
            let (d, a) = tdv_geometry::pose_distance(&tcp, &want);
            assert!(d < 1e-3 && a < 1e-3, "{}: home is off by {d} m, {a} rad", s.name);
        }
    }

    #[test]
    fn another_arm_begins_with_its_tool_at_the_same_place() {
        let mut robot = all().remove(0).robot;
        let tool = |r: &RobotConfig| r.controller.arm().kinematics().fk_tcp(&r.start().unwrap());
        robot.controller = Generation::Cb3;
        let (ur5, q) = (tool(&robot), robot.start().unwrap());
        assert_eq!(q, robot.home);
        robot.controller = Generation::ESeries;
        let (d, a) = tdv_geometry::pose_distance(&tool(&robot), &ur5);
        assert!(d < 1e-9 && a < 1e-9, "{d} m, {a} rad");
        let turn = (0..6).map(|i| (robot.start().unwrap()[i] - q[i]).abs()).fold(0.0, f64::max);
        assert!((0.02..0.5).contains(&turn), "{turn} rad: the same branch, another arm");
        robot.home = [0.0; 6];
        robot.home[1] = -0.2;
        assert!(robot.start().is_err(), "stretched beyond the other arm's reach");
    }

    #[test]
    fn bad_scenes_are_named() {
        let scene = all().into_iter().find(|s| s.name == "cup_on_coaster").unwrap();
        let good = std::fs::read_to_string(scene.path()).unwrap();
        let path = Path::new("scene.yaml");
        for (from, to, word) in [
            ("moving: mug", "moving: cup", "cup"),
            ("rate: 30", "rate: 0", "camera.rate"),
            ("radius: 0.11", "radius: 0.5", "excludes"),
            ("name: cup_on_coaster", "name: cup_on_coaster\ncolour: red", "colour"),
        ] {
            assert!(good.contains(from), "{from}");
            let e = Scene::parse(&good.replace(from, to), path).unwrap_err().to_string();
            assert!(e.contains(word), "{e}");
        }
    }
}
