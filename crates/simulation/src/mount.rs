//! How objects are fastened, and the drops that are poured: what the world puts into the engine beside
//! free objects.

use crate::units;
use rapier3d::prelude::*;
use tdv_geometry::Pose as Pose64;
use tdv_geometry::nalgebra::{Point3, Vector3};

/// How an object is fastened.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Mount {
    /// Not at all.
    #[default]
    Free,
    /// Screwed to the table.
    Fixed,
    /// Slides along another object.
    Slider(Slider),
}

/// A straight guide; the frames of both objects are the same when it is shut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slider {
    /// Index of the object that it slides on; smaller than its own.
    pub base: usize,
    /// Direction in which it opens, in the base's frame.
    pub axis: [f64; 3],
    /// How far it goes, m.
    pub travel: f64,
    /// Dry friction, N.
    pub friction: f64,
    /// Comes free at the end of its travel.
    pub comes_free: bool,
}

/// Speed (m/s) below which dry friction gives way to creep.
const CREEP: f64 = 0.002;
/// A guide that comes free does so this far (m) before its end, where nothing yet pushes back.
const FREE_BEFORE: f64 = 0.002;

/// A slider at work.
pub(crate) struct Guide {
    pub(crate) object: usize,
    pub(crate) slider: Slider,
    joint: Option<ImpulseJointHandle>,
}

impl Guide {
    /// Joins the two bodies.
    pub(crate) fn insert(
        physics: &mut PhysicsWorld,
        (base, body): (RigidBodyHandle, RigidBodyHandle),
        object: usize,
        slider: Slider,
    ) -> Self {
        let axis = Vector3::from(slider.axis).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let mut joint: GenericJoint = PrismaticJointBuilder::new(units::vector(&axis))
            .local_anchor1(Vector::ZERO)
            .local_anchor2(Vector::ZERO)
            .limits([0.0, slider.travel as f32])
            .motor_model(MotorModel::ForceBased)
            .into();
        // A velocity motor that wants to stand still, with a limited force, is dry friction.
        joint.set_motor(JointAxis::LinX, 0.0, 0.0, 0.0, (slider.friction / CREEP) as f32);
        joint.set_motor_max_force(JointAxis::LinX, slider.friction as f32);
        // The guide holds them apart; that it has walls is of no interest.
        joint.contacts_enabled = false;
        let joint = Some(physics.insert_impulse_joint(base, body, joint));
        Self { object, slider, joint }
    }

    /// Whether the two are joined.
    pub(crate) fn joined(&self) -> bool {
        self.joint.is_some()
    }

    /// How far it is open, m, for the poses of the base and the object.
    pub(crate) fn travel(&self, base: &Pose64, object: &Pose64) -> f64 {
        let axis = Vector3::from(self.slider.axis).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        axis.dot(&(base.inverse() * object).translation.vector)
    }

    /// Comes free if that is due.
    pub(crate) fn release(&mut self, physics: &mut PhysicsWorld, travel: f64) {
        if self.slider.comes_free
            && travel > self.slider.travel - FREE_BEFORE
            && let Some(joint) = self.joint.take()
        {
            physics.remove_impulse_joint(joint);
        }
    }
}

/// Drops of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct DropSet {
    /// Centres at the start, m in base_link.
    pub centres: Vec<Point3<f64>>,
    /// Radius, m.
    pub radius: f64,
    /// Mass of each, kg.
    pub mass: f64,
}

/// `count` places (m) for balls of `radius` in a round cup with the given inner radius and floor, layer
/// upon layer, in the cup's frame.
pub fn filling(count: usize, radius: f64, cup_radius: f64, floor: f64) -> Vec<Point3<f64>> {
    let pitch = 2.1 * radius;
    let reach = cup_radius - 1.05 * radius;
    let steps = (reach / pitch).ceil().max(0.0) as i32;
    let mut out = Vec::with_capacity(count);
    for layer in 0..count {
        // Every other layer is shifted, else the balls would stand on one another's tops.
        let shift = if layer % 2 == 0 { 0.0 } else { 0.5 * pitch };
        let z = floor + 1.05 * radius + layer as f64 * 0.85 * pitch;
        for i in -steps..=steps {
            for j in -steps..=steps {
                let (x, y) = (f64::from(i) * pitch + shift, f64::from(j) * pitch + shift);
                if x.hypot(y) <= reach && out.len() < count {
                    out.push(Point3::new(x, y, z));
                }
            }
        }
        if out.len() >= count {
            break;
        }
    }
    out
}

/// Inserts the balls; they touch everything that stands on the table, and the gripper.
pub(crate) fn insert_drops(
    physics: &mut PhysicsWorld,
    drops: &DropSet,
    groups: InteractionGroups,
) -> Vec<RigidBodyHandle> {
    let insert = |centre: &Point3<f64>| {
        let body = physics.insert_body(
            RigidBodyBuilder::dynamic()
                .translation(units::vector(&centre.coords))
                // Water does not roll for ever.
                .angular_damping(4.0),
        );
        physics.insert_collider(
            ColliderBuilder::ball(drops.radius as f32)
                .mass(drops.mass as f32)
                .friction(0.05)
                .friction_combine_rule(CoefficientCombineRule::Min)
                .collision_groups(groups),
            Some(body),
        );
        body
    };
    drops.centres.iter().map(insert).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cup_is_filled_without_overlap() {
        let balls = filling(120, 0.004, 0.029, 0.005);
        assert_eq!(balls.len(), 120);
        for (i, a) in balls.iter().enumerate() {
            assert!(a.x.hypot(a.y) < 0.029 - 0.004 && a.z > 0.005 + 0.004, "{a}");
            for b in &balls[i + 1..] {
                assert!((a - b).norm() > 0.008, "{a} {b}");
            }
        }
        assert!(balls.iter().all(|b| b.z < 0.06));
    }
}
