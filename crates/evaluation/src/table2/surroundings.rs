//! What stands around the arm in a task that says so: the controller of a trial knows it, and what is
//! learned goes round it.

use super::{Table2Error, fnv};
use std::path::Path;
use tdv_demonstration::{Task, ToolPose};
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::Point3;
use tdv_robot::collision::{CollisionWorld, ConvexPart, HeldObject, Margins, Workcell};
use tdv_robot::gripper::{KNUCKLE_OPEN, knuckle_from_gap};
use tdv_robot::urdf::RobotModel;
use tdv_robot::{Kinematics, Limits};
use tdv_simulation::LabAssets;

/// The arm's description, from the repository's root.
const ROBOT: &str = "config/robot/ur5_2f85.urdf";

/// Fixtures, robot, and the shape of what is carried.
#[derive(Debug)]
pub struct Surroundings {
    world: CollisionWorld,
    arm: Kinematics,
    /// Convex hull of the moving object, in its frame; none for a task of the hand.
    carried: Option<(String, ConvexPart)>,
    /// Knuckle angle (rad) of fingers that hold it.
    knuckle: f64,
    identity: String,
}

impl Surroundings {
    /// What the task's workcell has; none for a task without one. `root`: the repository's.
    ///
    /// # Errors
    /// [`Table2Error::File`] and [`Table2Error::Robot`] of the workcell, the robot's description and the
    /// moving object's mesh.
    pub fn load(root: &Path, task: &Task, assets: &LabAssets) -> Result<Option<Self>, Table2Error> {
        let Some(file) = &task.workcell else { return Ok(None) };
        let robot = |e: &dyn std::fmt::Display| Table2Error::Robot(e.to_string());
        let path = root.join(file);
        let text = std::fs::read_to_string(&path).map_err(|e| Table2Error::io(&path, e))?;
        let cell = Workcell::load(&path).map_err(|e| robot(&e))?;
        let model = RobotModel::load(&root.join(ROBOT)).map_err(|e| robot(&e))?;
        // As the node arm_controller has them.
        let limits = Limits::default();
        let world = CollisionWorld::new(&model, &cell, Margins::of(&limits), limits.table_z);
        let carried = match task.moving_shape() {
            Some(_) => {
                let mesh = &assets.meshes[assets.scene.index_of(&task.moving_object)?];
                let points: Vec<Point3<f64>> =
                    mesh.positions.iter().map(|p| Point3::from(p.map(f64::from))).collect();
                let hull = ConvexPart::hull(&points).map_err(|e| robot(&e))?;
                Some((task.moving_object.clone(), hull))
            }
            None => None,
        };
        let width = task.grasp.closing.iter().map(|c| c.width).min_by(f64::total_cmp);
        Ok(Some(Self {
            world: world.map_err(|e| robot(&e))?,
            arm: Kinematics::ur5(),
            carried,
            knuckle: width.map_or(KNUCKLE_OPEN, knuckle_from_gap),
            identity: fnv([text.as_str()].into_iter()),
        }))
    }

    /// What the arm controller is told.
    pub fn world(&self) -> &CollisionWorld {
        &self.world
    }

    /// Changes with the workcell's file.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Whether some configuration of the arm is free with the tool there.
    ///
    /// # Errors
    /// The reason, for generation's report.
    pub fn free(&self, at: &ToolPose<'_>) -> Result<(), String> {
        let knuckle = if at.grip { self.knuckle } else { KNUCKLE_OPEN };
        let held = match (&self.carried, at.object) {
            (Some((name, hull)), Some((moving, pose))) if name == moving => {
                let tool0 = at.tool * self.arm.tool().inverse();
                let object: Pose = tool0.inverse() * pose;
                Some(HeldObject::new(name, vec![hull.clone()], &object, &[]))
            }
            _ => None,
        };
        let mut why = "unreachable".to_owned();
        for q in self.arm.ik_tcp(&at.tool).iter() {
            match self.world.check(q, knuckle, held.as_ref()) {
                Ok(()) => return Ok(()),
                Err(tdv_robot::collision::CollisionError::Bodies { a, b, .. }) => {
                    why = format!("{a} in {b}");
                }
                Err(e) => why = e.to_string(),
            }
        }
        Err(why)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tdv_geometry::pose_from_xyz_rpy;
    use tdv_simulation::Scene;

    fn load(name: &str) -> Option<Surroundings> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let task = Task::load(&root.join(format!("config/tasks/{name}.yaml"))).unwrap();
        let assets = LabAssets::load(Scene::load(&root.join(&task.scene)).unwrap()).unwrap();
        Surroundings::load(&root, &task, &assets).unwrap()
    }

    #[test]
    fn the_ring_has_to_come_over_the_wall() {
        assert!(load("cup_on_coaster").is_none());
        let around = load("ring_on_peg").unwrap();
        let at = |z: f64, ring: bool| {
            let tool = pose_from_xyz_rpy([0.45, -0.15, z], [std::f64::consts::PI, 0.0, 0.0]);
            let held = pose_from_xyz_rpy([0.45, -0.15, z - 0.022], [0.0; 3]);
            let object = ring.then_some(("ring", held));
            around.free(&ToolPose { tool, grip: ring, object })
        };
        assert_eq!(at(0.25, true), Ok(()));
        assert!(at(0.06, false).unwrap_err().contains("wall"));
        // The fingers clear the wall, the ring between them does not.
        assert_eq!(at(0.135, false), Ok(()));
        assert!(at(0.135, true).unwrap_err().contains("wall"));
    }
}
