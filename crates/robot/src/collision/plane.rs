//! Arm and gripper against the table plane, without a model file: capsules about the links, points at
//! the fingertips.

use crate::gripper::fingertip_z;
use crate::kinematics::{Joints, Kinematics};
use crate::limits::Limits;
use nalgebra::Point3;
use tdv_geometry::Pose;
use thiserror::Error;

/// A capsule fixed to a link: all points within `radius` of the segment `a..b` (m, link frame).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkCapsule {
    /// Index into [`Kinematics::link_poses`]; 5 is also `tool0`.
    pub link: usize,
    /// What the operator reads.
    pub name: &'static str,
    /// One end.
    pub a: [f64; 3],
    /// The other end.
    pub b: [f64; 3],
    /// Metres.
    pub radius: f64,
}

/// Capsules that contain the UR5's links and the gripper's palm. The shoulder does not move toward
/// the table and the upper arm starts at its height, so those two are left out of the plane check.
pub const CAPSULES: [LinkCapsule; 5] = [
    // The upper arm runs 136 mm beside the shoulder, the forearm 16.5 mm beside it.
    LinkCapsule {
        link: 2,
        name: "forearm",
        a: [0.0, 0.0, 0.0165],
        b: [-0.392, 0.0, 0.0165],
        radius: 0.06,
    },
    LinkCapsule {
        link: 3,
        name: "wrist 1",
        a: [0.0, 0.0, -0.06],
        b: [0.0, 0.0, 0.0],
        radius: 0.045,
    },
    LinkCapsule {
        link: 4,
        name: "wrist 2",
        a: [0.0, 0.0, -0.06],
        b: [0.0, 0.0, 0.0],
        radius: 0.045,
    },
    LinkCapsule {
        link: 5,
        name: "wrist 3",
        a: [0.0, 0.0, -0.03],
        b: [0.0, 0.0, -0.01],
        radius: 0.04,
    },
    LinkCapsule {
        link: 5,
        name: "gripper palm",
        a: [0.0, 0.0, 0.03],
        b: [0.0, 0.0, 0.06],
        radius: 0.045,
    },
];

/// Half extent (m) of the fingertips about the tool axis: across (x) and along the closing axis (y)
/// with the gripper open.
const TIP_HALF: [f64; 2] = [0.011, 0.055];

/// What the arm would run into.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ClearanceError {
    /// The tcp leaves the workspace box.
    #[error("tcp {axis} would be {value:.3} m, the workspace is {lower:.3}..{upper:.3} m")]
    Workspace {
        /// x, y or z in base_link.
        axis: char,
        /// Metres.
        value: f64,
        /// Metres.
        lower: f64,
        /// Metres.
        upper: f64,
    },
    /// Something would come too near to the table.
    #[error("{part} would be {:.1} mm above the table, {:.1} mm is the least", .height * 1e3, .least * 1e3)]
    Table {
        /// Which part of the arm.
        part: &'static str,
        /// Metres above the table plane, negative below.
        height: f64,
        /// Metres.
        least: f64,
    },
}

/// Height (m, `base_link` z) of the lowest point of the fingertips for `T_base_link_tool0` and a
/// knuckle angle (rad).
pub fn fingertip_height(tool0: &Pose, knuckle: f64) -> f64 {
    let z = fingertip_z(knuckle);
    let mut least = f64::INFINITY;
    for sx in [-1.0, 1.0] {
        for sy in [-1.0, 1.0] {
            let p = tool0 * Point3::new(sx * TIP_HALF[0], sy * TIP_HALF[1], z);
            least = least.min(p.z);
        }
    }
    least
}

/// Checks one configuration: tcp in the workspace, fingertips (at the closed gripper's length, the
/// longest), palm, wrists and forearm above the table.
///
/// # Errors
/// The first [`ClearanceError`].
pub fn check_clearance(k: &Kinematics, q: &Joints, limits: &Limits) -> Result<(), ClearanceError> {
    let links = k.link_poses(q);
    let tcp = (links[5] * k.tool()).translation;
    for (axis, value, [lower, upper]) in [
        ('x', tcp.x, limits.workspace_x),
        ('y', tcp.y, limits.workspace_y),
        ('z', tcp.z, limits.workspace_z),
    ] {
        if !(value >= lower && value <= upper) {
            return Err(ClearanceError::Workspace { axis, value, lower, upper });
        }
    }
    let tips = fingertip_height(&links[5], crate::gripper::KNUCKLE_CLOSED) - limits.table_z;
    if !(tips >= limits.fingertip_clearance) {
        return Err(ClearanceError::Table {
            part: "fingertips",
            height: tips,
            least: limits.fingertip_clearance,
        });
    }
    for c in &CAPSULES {
        let low = |p: [f64; 3]| (links[c.link] * Point3::from(p)).z;
        let height = low(c.a).min(low(c.b)) - c.radius - limits.table_z;
        if !(height >= limits.link_clearance) {
            return Err(ClearanceError::Table {
                part: c.name,
                height,
                least: limits.link_clearance,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::IkSelection;
    use tdv_geometry::pose_from_xyz_rpy;

    const SEED: Joints = [0.2, -1.3, 1.7, -2.0, -1.6, 0.4];

    fn at(x: f64, y: f64, z: f64, tilt: f64) -> Joints {
        let k = Kinematics::ur5();
        let down = pose_from_xyz_rpy([x, y, z], [std::f64::consts::PI - tilt, 0.0, 0.0]);
        k.nearest_tcp(&down, &SEED, &IkSelection::default()).unwrap()
    }

    #[test]
    fn the_whole_start_area_is_clear_and_the_table_is_not() {
        let (k, l) = (Kinematics::ur5(), Limits::default());
        for x in [0.25, 0.45, 0.70] {
            for y in [-0.25, 0.0, 0.25] {
                for z in [0.03, 0.1, 0.3] {
                    let q = at(x, y, z, 0.0);
                    assert_eq!(check_clearance(&k, &q, &l), Ok(()), "{x} {y} {z} {q:?}");
                }
            }
        }
        let e = check_clearance(&k, &at(0.45, 0.0, 0.012, 0.0), &l).unwrap_err();
        assert!(matches!(e, ClearanceError::Table { part: "fingertips", .. }), "{e}");
        let e = check_clearance(&k, &at(0.45, 0.0, -0.05, 0.0), &l).unwrap_err();
        assert!(matches!(e, ClearanceError::Workspace { axis: 'z', .. }), "{e}");
    }

    #[test]
    fn a_tilted_gripper_needs_more_height() {
        let (k, l) = (Kinematics::ur5(), Limits::default());
        assert!(check_clearance(&k, &at(0.45, 0.0, 0.03, 0.6), &l).is_err());
        assert!(check_clearance(&k, &at(0.45, 0.0, 0.08, 0.6), &l).is_ok());
    }

    #[test]
    fn a_horizontal_approach_is_stopped_by_palm_or_wrist() {
        let (k, l) = (Kinematics::ur5(), Limits::default());
        let low = pose_from_xyz_rpy([0.5, 0.1, 0.06], [0.0, std::f64::consts::FRAC_PI_2, 0.0]);
        for q in k.ik_tcp(&low).iter() {
            let e = check_clearance(&k, q, &l).unwrap_err();
            assert!(matches!(e, ClearanceError::Table { .. }), "{e}");
        }
        assert!(!k.ik_tcp(&low).is_empty());
    }
}
