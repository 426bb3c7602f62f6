use super::convert;
use super::shapes::{ConvexPart, ShapeError};
use crate::kinematics::Joints;
use crate::urdf::{RobotModel, Shape};
use glamx::{DPose3, DQuat, DVec3};
use nalgebra::Point3;
use tdv_geometry::Pose;

/// Links that are rigidly joined, moved by one joint.
#[derive(Debug, Clone)]
struct Body {
    parent: Option<usize>,
    /// From the parent body to the joint's frame at angle zero.
    origin: DPose3,
    axis: DVec3,
    /// 0..6 arm, 6 gripper.
    driver: usize,
    multiplier: f64,
    offset: f64,
    /// How many of the arm's joints move it.
    depth: usize,
}

/// A convex part of a link.
#[derive(Debug, Clone)]
pub(super) struct RobotPart {
    pub link: String,
    pub body: usize,
    /// How many of the arm's joints move it: those before this index.
    pub depth: usize,
    /// Moved by the knuckle.
    pub finger: bool,
    pub part: ConvexPart,
    /// No point of the part is ever farther than this (m) from the axis of each joint.
    pub reach: Joints,
}

/// The robot's convex parts and how they move.
#[derive(Debug, Clone)]
pub(super) struct BodyModel {
    bodies: Vec<Body>,
    pub parts: Vec<RobotPart>,
    /// The body of `tool0` and where `tool0` is in it.
    pub tool: usize,
    pub tool0: Pose,
    /// No farther is the tool body's origin from the axis of each joint (m).
    pub tool_reach: Joints,
}

impl BodyModel {
    /// From the collision primitives of a URDF; cylinders become the capsules about their axes.
    pub fn new(model: &RobotModel) -> Result<Self, (String, ShapeError)> {
        let mut bodies = vec![Body {
            parent: None,
            origin: DPose3::IDENTITY,
            axis: DVec3::Z,
            driver: 6,
            multiplier: 0.0,
            offset: 0.0,
            depth: 0,
        }];
        // Body and pose in it of each link.
        let mut places: Vec<(usize, Pose)> = Vec::new();
        for n in model.nodes() {
            let (parent, at) = n.parent.map_or((0, Pose::identity()), |i| places[i]);
            let origin = at * n.origin;
            let Some((axis, driver, multiplier, offset)) = n.drive else {
                places.push((parent, origin));
                continue;
            };
            let depth = bodies[parent].depth + usize::from(driver < 6);
            bodies.push(Body {
                parent: Some(parent),
                origin: convert::pose(&origin),
                axis: DVec3::new(axis.x, axis.y, axis.z),
                driver,
                multiplier,
                offset,
                depth,
            });
            places.push((bodies.len() - 1, Pose::identity()));
        }
        let place = |link: &str| {
            model.nodes().iter().position(|n| n.link == link).and_then(|i| places.get(i).copied())
        };
        let last = bodies.iter().position(|b| b.driver == 5 && b.multiplier != 0.0).unwrap_or(0);
        let (tool, tool0) = place("tool0").unwrap_or((last, Pose::identity()));
        let mut out = Self { bodies, parts: Vec::new(), tool, tool0, tool_reach: [0.0; 6] };
        out.tool_reach = out.reach(tool, DVec3::ZERO, 0.0);
        for c in model.collisions() {
            let Some((body, at)) = place(&c.link) else { continue };
            let part = primitive(&c.shape, &(at * c.origin)).map_err(|e| (c.link.clone(), e))?;
            let b = &out.bodies[body];
            out.parts.push(RobotPart {
                body,
                depth: b.depth,
                finger: b.driver == 6 && b.multiplier != 0.0,
                reach: out.reach(body, part.centre, part.bound),
                part,
                link: c.link,
            });
        }
        Ok(out)
    }

    /// Bound on the distance from each arm joint's axis of a sphere fixed to a body: offsets of the
    /// joints between add up; of the offset next to the axis only what is across it counts.
    fn reach(&self, body: usize, centre: DVec3, radius: f64) -> Joints {
        let mut out = [0.0; 6];
        let (mut at, mut offset, mut beyond) = (body, centre, radius);
        loop {
            let b = &self.bodies[at];
            let Some(parent) = b.parent else { return out };
            if b.driver < 6 {
                out[b.driver] = offset.reject_from(b.axis).length() + beyond;
            }
            // Once the joint has turned, the offset may point anywhere.
            beyond += offset.length();
            offset = b.origin.translation;
            at = parent;
        }
    }

    /// Poses of all bodies in `base_link`.
    pub fn poses(&self, q: &Joints, knuckle: f64) -> Vec<DPose3> {
        let mut out: Vec<DPose3> = Vec::with_capacity(self.bodies.len());
        for b in &self.bodies {
            let parent = b.parent.map_or(DPose3::IDENTITY, |i| out[i]);
            let angle = q.get(b.driver).copied().unwrap_or(knuckle) * b.multiplier + b.offset;
            let joint = parent * b.origin;
            let turn = DQuat::from_axis_angle(b.axis, angle);
            out.push(DPose3::from_parts(joint.translation, joint.rotation * turn));
        }
        out
    }
}

fn primitive(shape: &Shape, at: &Pose) -> Result<ConvexPart, ShapeError> {
    let end = |z: f64| -> [f64; 3] { (at * Point3::new(0.0, 0.0, z)).coords.into() };
    match shape {
        Shape::Box(edges) => ConvexPart::cuboid(*edges, at),
        Shape::Cylinder(radius, length) => {
            ConvexPart::capsule(end(-length / 2.0), end(length / 2.0), *radius)
        }
        Shape::Sphere(radius) => ConvexPart::capsule(end(0.0), end(0.0), *radius),
    }
}
