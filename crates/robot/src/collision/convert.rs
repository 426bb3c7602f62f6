//! Between nalgebra, which every public type uses, and the glam types of parry.

use glamx::{DPose3, DVec3};
use nalgebra::Point3;
use tdv_geometry::Pose;

pub(super) fn pose(p: &Pose) -> DPose3 {
    DPose3::from(*p)
}

pub(super) fn point(p: &Point3<f64>) -> DVec3 {
    DVec3::new(p.x, p.y, p.z)
}

pub(super) fn array(p: [f64; 3]) -> DVec3 {
    DVec3::from_array(p)
}
