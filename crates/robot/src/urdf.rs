//! The robot's URDF: frames of every link at given joints, collision shapes, joint limits.

use crate::gripper::KNUCKLE_JOINT;
use crate::kinematics::{JOINT_NAMES, Joints};
use nalgebra::{UnitQuaternion, UnitVector3, Vector3};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_geometry::{Pose, pose_from_xyz_rpy};
use thiserror::Error;
use urdf_rs::JointType;

/// Why a URDF cannot be used.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum UrdfError {
    /// The file cannot be read or is not a URDF.
    #[error("{path}: {reason}")]
    Read {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// A joint that the arm or the gripper needs is not there or of the wrong type.
    #[error("{path}: joint {joint} {reason}")]
    Joint {
        /// The file.
        path: String,
        /// The joint's name.
        joint: String,
        /// What is wrong.
        reason: String,
    },
    /// The links are not one tree.
    #[error("{path}: link {link} {reason}")]
    Tree {
        /// The file.
        path: String,
        /// The link's name.
        link: String,
        /// What is wrong.
        reason: String,
    },
}

/// A primitive fixed to a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Edge lengths (m).
    Box([f64; 3]),
    /// Radius and length along z (m).
    Cylinder(f64, f64),
    /// Radius (m).
    Sphere(f64),
}

/// A shape, where it is in its link, and its colour if it is a visual with a named material.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkShape {
    /// The link's name.
    pub link: String,
    /// `T_link_shape`.
    pub origin: Pose,
    /// What it is.
    pub shape: Shape,
    /// Red, green, blue, opacity 0..=1; collision shapes have none.
    pub color: Option<[f64; 4]>,
}

/// A link and the joint that carries it; parents come before their children.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub link: String,
    pub parent: Option<usize>,
    pub origin: Pose,
    /// Axis, driver (0..6 arm, 6 gripper), multiplier, offset; `None` for a fixed joint.
    pub drive: Option<(UnitVector3<f64>, usize, f64, f64)>,
}

/// A parsed and checked URDF of arm and gripper.
#[derive(Debug, Clone)]
pub struct RobotModel {
    robot: urdf_rs::Robot,
    text: String,
    nodes: Vec<Node>,
}

impl RobotModel {
    /// Reads a URDF file with the six arm joints (and, optionally, the gripper's knuckle joint and
    /// joints that mimic it).
    ///
    /// # Errors
    /// [`UrdfError`].
    pub fn load(path: &Path) -> Result<Self, UrdfError> {
        let model = Self::load_part(path)?;
        let name = path.display().to_string();
        for joint in JOINT_NAMES {
            let bad = |reason: &str| UrdfError::Joint {
                path: name.clone(),
                joint: joint.into(),
                reason: reason.into(),
            };
            match model.robot.joints.iter().find(|j| j.name == joint) {
                None => return Err(bad("is missing")),
                Some(j) if j.joint_type != JointType::Revolute => {
                    return Err(bad("is not revolute"));
                }
                _ => {}
            }
        }
        Ok(model)
    }

    /// As [`Self::load`] for a file that need not have the arm's joints: a gripper alone.
    ///
    /// # Errors
    /// [`UrdfError`].
    pub fn load_part(path: &Path) -> Result<Self, UrdfError> {
        let name = path.display().to_string();
        let read = |reason: String| UrdfError::Read { path: name.clone(), reason };
        let text = std::fs::read_to_string(path).map_err(|e| read(e.to_string()))?;
        let robot = urdf_rs::read_from_string(&text).map_err(|e| read(e.to_string()))?;
        let nodes = tree(&name, &robot)?;
        Ok(Self { robot, text, nodes })
    }

    /// The file's text, for `/robot_description`.
    pub fn text(&self) -> &str {
        &self.text
    }

    pub(crate) fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Names of all links.
    pub fn links(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|n| n.link.as_str())
    }

    /// Poses of all links in the root link (`base_link`) at arm joints `q` and knuckle angle `knuckle`
    /// (rad), by name.
    pub fn link_poses(&self, q: &Joints, knuckle: f64) -> BTreeMap<&str, Pose> {
        let mut poses: Vec<Pose> = Vec::with_capacity(self.nodes.len());
        for n in &self.nodes {
            let parent = n.parent.map_or_else(Pose::identity, |i| poses[i]);
            let turn =
                n.drive.map_or_else(UnitQuaternion::identity, |(axis, driver, m, offset)| {
                    let angle = if driver < 6 { q[driver] } else { knuckle };
                    UnitQuaternion::from_axis_angle(&axis, m * angle + offset)
                });
            poses.push(parent * n.origin * turn);
        }
        self.nodes.iter().map(|n| n.link.as_str()).zip(poses).collect()
    }

    /// Each link but the root with its parent: names, `T_parent_link` at arm joints `q` and knuckle angle
    /// `knuckle` (rad), and whether it is fixed.
    pub fn joint_transforms(&self, q: &Joints, knuckle: f64) -> Vec<(&str, &str, Pose, bool)> {
        let nodes = self.nodes.iter();
        nodes
            .filter_map(|n| {
                let parent = self.nodes.get(n.parent?)?;
                let turn =
                    n.drive.map_or_else(UnitQuaternion::identity, |(axis, driver, m, offset)| {
                        let angle = if driver < 6 { q[driver] } else { knuckle };
                        UnitQuaternion::from_axis_angle(&axis, m * angle + offset)
                    });
                let (parent, link) = (parent.link.as_str(), n.link.as_str());
                Some((parent, link, n.origin * turn, n.drive.is_none()))
            })
            .collect()
    }

    /// Least, greatest angle (rad) and greatest speed (rad/s) of a joint.
    pub fn joint_limits(&self, joint: &str) -> Option<(f64, f64, f64)> {
        let j = self.robot.joints.iter().find(|j| j.name == joint)?;
        Some((j.limit.lower, j.limit.upper, j.limit.velocity))
    }

    /// Collision primitives (meshes are left out).
    pub fn collisions(&self) -> Vec<LinkShape> {
        let shapes = self.robot.links.iter().flat_map(|l| {
            l.collision.iter().filter_map(|c| {
                let (link, origin) = (l.name.clone(), pose(&c.origin));
                Some(LinkShape { link, origin, shape: primitive(&c.geometry)?, color: None })
            })
        });
        shapes.collect()
    }

    /// Visual primitives with their colours (meshes are left out).
    pub fn visuals(&self) -> Vec<LinkShape> {
        let color = |m: &urdf_rs::Material| {
            let named = self.robot.materials.iter().find(|x| x.name == m.name);
            m.color.as_ref().or(named.and_then(|x| x.color.as_ref())).map(|c| *c.rgba)
        };
        let shapes = self.robot.links.iter().flat_map(|l| {
            l.visual.iter().filter_map(|v| {
                Some(LinkShape {
                    link: l.name.clone(),
                    origin: pose(&v.origin),
                    shape: primitive(&v.geometry)?,
                    color: v.material.as_ref().and_then(color),
                })
            })
        });
        shapes.collect()
    }
}

fn pose(p: &urdf_rs::Pose) -> Pose {
    pose_from_xyz_rpy(*p.xyz, *p.rpy)
}

fn primitive(g: &urdf_rs::Geometry) -> Option<Shape> {
    match g {
        urdf_rs::Geometry::Box { size } => Some(Shape::Box(**size)),
        urdf_rs::Geometry::Cylinder { radius, length } => Some(Shape::Cylinder(*radius, *length)),
        urdf_rs::Geometry::Sphere { radius } => Some(Shape::Sphere(*radius)),
        _ => None,
    }
}

/// Nodes with every parent before its children.
fn tree(path: &str, robot: &urdf_rs::Robot) -> Result<Vec<Node>, UrdfError> {
    let bad = |link: &str, reason: &str| UrdfError::Tree {
        path: path.into(),
        link: link.into(),
        reason: reason.into(),
    };
    let parents: BTreeMap<&str, &urdf_rs::Joint> =
        robot.joints.iter().map(|j| (j.child.link.as_str(), j)).collect();
    if let Some(l) = robot
        .links
        .iter()
        .find(|l| robot.joints.iter().filter(|j| j.child.link == l.name).count() > 1)
    {
        return Err(bad(&l.name, "has two parents"));
    }
    let mut roots = robot.links.iter().filter(|l| !parents.contains_key(l.name.as_str()));
    let Some(root) = roots.next() else { return Err(bad("(any)", "is not reached: no root")) };
    if let Some(other) = roots.next() {
        return Err(bad(&other.name, &format!("is not connected to {}", root.name)));
    }
    let root =
        Node { link: root.name.clone(), parent: None, origin: Pose::identity(), drive: None };
    let mut nodes = vec![root];
    let mut i = 0;
    while i < nodes.len() {
        let name = nodes[i].link.clone();
        for j in robot.joints.iter().filter(|j| j.parent.link == name) {
            let drive = drive(path, j)?;
            let link = j.child.link.clone();
            nodes.push(Node { link, parent: Some(i), origin: pose(&j.origin), drive });
        }
        i += 1;
    }
    match robot.links.iter().find(|l| !nodes.iter().any(|n| n.link == l.name)) {
        Some(l) => Err(bad(&l.name, "is in a loop")),
        None => Ok(nodes),
    }
}

type Drive = Option<(UnitVector3<f64>, usize, f64, f64)>;

fn drive(path: &str, j: &urdf_rs::Joint) -> Result<Drive, UrdfError> {
    let bad = |reason: &str| UrdfError::Joint {
        path: path.into(),
        joint: j.name.clone(),
        reason: reason.into(),
    };
    match j.joint_type {
        JointType::Fixed => return Ok(None),
        JointType::Revolute | JointType::Continuous => {}
        _ => return Err(bad("is of a type that this robot does not have")),
    }
    let axis = UnitVector3::try_new(Vector3::from(*j.axis.xyz), 1e-9)
        .ok_or_else(|| bad("has a zero axis"))?;
    let index = |name: &str| match JOINT_NAMES.iter().position(|n| *n == name) {
        Some(i) => Some(i),
        None => (name == KNUCKLE_JOINT).then_some(6),
    };
    let (name, multiplier, offset) = match &j.mimic {
        Some(m) => (&m.joint, m.multiplier.unwrap_or(1.0), m.offset.unwrap_or(0.0)),
        None => (&j.name, 1.0, 0.0),
    };
    let driver = index(name).ok_or_else(|| bad("is moved by a joint that nothing commands"))?;
    Ok(Some((axis, driver, multiplier, offset)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::CAPSULES;
    use crate::gripper::{KNUCKLE_CLOSED, fingertip_z, gap_from_knuckle};
    use crate::kinematics::Kinematics;
    use nalgebra::Point3;
    use rand::{Rng, SeedableRng};

    fn file(name: &str) -> std::path::PathBuf {
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robot")).join(name)
    }

    fn model() -> RobotModel {
        RobotModel::load(&file("ur5_2f85.urdf")).unwrap()
    }

    fn apart(a: &Pose, b: &Pose) -> f64 {
        let r = (a.rotation.inverse() * b.rotation).vector().norm();
        (a.translation.vector - b.translation.vector).norm().max(2.0 * r)
    }

    #[test]
    fn frames_equal_the_table_of_the_kinematics() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        for (name, k) in [
            ("ur5.urdf", Kinematics::ur5()),
            ("ur5_2f85.urdf", Kinematics::ur5()),
            ("ur5e.urdf", Kinematics::ur5e()),
            ("ur5e_2f85.urdf", Kinematics::ur5e()),
        ] {
            let m = RobotModel::load(&file(name)).unwrap();
            for _ in 0..250 {
                let q: Joints = std::array::from_fn(|_| rng.random_range(-6.0..6.0));
                let at = m.link_poses(&q, 0.0);
                assert!(apart(&at["tool0"], &k.fk(&q)) < 1e-9, "{name}");
                if name.contains("2f85") {
                    assert!(apart(&at["tcp"], &k.fk_tcp(&q)) < 1e-9);
                }
                assert!(apart(&at["base"], &crate::base_link_to_base()) < 1e-9);
                let links = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"];
                for (link, pose) in links.iter().zip(k.link_poses(&q)) {
                    assert!(apart(&at[format!("{link}_link").as_str()], &pose) < 1e-9, "{link}");
                }
            }
        }
    }

    #[test]
    fn the_gripper_alone_is_that_of_the_combined_model() {
        let path = file("robotiq_2f85.urdf");
        assert!(matches!(RobotModel::load(&path), Err(UrdfError::Joint { .. })));
        let (alone, both) = (RobotModel::load_part(&path).unwrap(), model());
        let q = [0.3, -1.2, 1.4, -0.7, 0.9, 2.2];
        for knuckle in [0.0, 0.3, KNUCKLE_CLOSED] {
            let (a, b) = (alone.link_poses(&q, knuckle), both.link_poses(&q, knuckle));
            let root = b["robotiq_85_base_link"].inverse();
            assert_eq!(a.len(), 9);
            for (link, pose) in &a {
                assert!(apart(pose, &(root * b[link])) < 1e-9, "{link}");
            }
        }
        // One joint is commanded, the five others mimic it.
        let moving: Vec<_> =
            alone.robot.joints.iter().filter(|j| j.joint_type == JointType::Revolute).collect();
        let own: Vec<_> = moving.iter().filter(|j| j.mimic.is_none()).map(|j| &j.name).collect();
        assert!(moving.len() == 6 && own == [KNUCKLE_JOINT], "{own:?}");
    }

    #[test]
    fn fingers_close_along_y_as_the_gripper_maps_say() {
        let (m, q) = (model(), [0.0; 6]);
        for i in 0..=10 {
            let knuckle = KNUCKLE_CLOSED * f64::from(i) / 10.0;
            let at = m.link_poses(&q, knuckle);
            let tool = at["tool0"].inverse();
            let left =
                tool * at["robotiq_85_left_finger_tip_link"] * Point3::new(-0.02526, 0.0, 0.051);
            let right =
                tool * at["robotiq_85_right_finger_tip_link"] * Point3::new(0.02526, 0.0, 0.051);
            assert!((left.y - right.y - gap_from_knuckle(knuckle)).abs() < 1e-6);
            assert!(left.x.abs() < 1e-9 && right.x.abs() < 1e-9, "{left} {right}");
            assert!(
                (left.z - fingertip_z(knuckle)).abs() < 1e-4,
                "{} {}",
                left.z,
                fingertip_z(knuckle)
            );
        }
    }

    #[test]
    fn the_plane_check_contains_the_same_shapes() {
        let shapes = model().collisions();
        let names = ["", "", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link"];
        for c in &CAPSULES {
            let palm = c.name == "gripper palm";
            let link = if palm { "robotiq_85_base_link" } else { names[c.link] };
            let held = shapes.iter().filter(|s| s.link == link).any(|s| {
                let Shape::Cylinder(r, l) = s.shape else { return false };
                let end = |sign: f64| s.origin * Point3::new(0.0, 0.0, sign * l / 2.0);
                let near = |p: Point3<f64>, q: [f64; 3]| {
                    (p - Point3::from(q)).norm() <= c.radius - r + 3e-4
                };
                let (a, b) = (end(-1.0), end(1.0));
                (near(a, c.a) && near(b, c.b)) || (near(a, c.b) && near(b, c.a))
            });
            assert!(held, "{} has no like in the URDF", c.name);
        }
        assert!(model().visuals().iter().all(|v| v.color.is_some()));
    }

    #[test]
    fn transforms_of_joints_chain_to_the_links_poses() {
        let (m, q) = (model(), [0.3, -1.1, 1.2, -0.9, -1.4, 0.5]);
        let at = m.link_poses(&q, 0.4);
        let joints = m.joint_transforms(&q, 0.4);
        assert_eq!(joints.len() + 1, m.links().count());
        assert!(joints.iter().any(|j| j.3) && joints.iter().filter(|j| !j.3).count() >= 6);
        for (parent, link, pose, _) in joints {
            assert!(apart(&(at[parent] * pose), &at[link]) < 1e-9, "{link}");
        }
    }

    #[test]
    fn limits_and_errors() {
        let m = model();
        let l = crate::Limits::default();
        for (i, name) in JOINT_NAMES.iter().enumerate() {
            let (lo, hi, v) = m.joint_limits(name).unwrap();
            assert!((lo - l.joint_lower[i]).abs() < 1e-9 && (hi - l.joint_upper[i]).abs() < 1e-9);
            assert!(v >= l.joint_velocity);
        }
        assert!(matches!(RobotModel::load(Path::new("/no.urdf")), Err(UrdfError::Read { .. })));
    }
}
