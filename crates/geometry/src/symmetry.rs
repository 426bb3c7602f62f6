use crate::{Pose, pose_distance};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Which rotations about an object's own axes leave it looking the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Symmetry {
    /// Every orientation is distinct.
    #[default]
    None,
    /// Any rotation about this axis of the object frame (a disc, a bottle).
    Continuous {
        /// The axis in the object frame; need not be normalised.
        axis: [f64; 3],
    },
    /// A finite group, listed as quaternions x, y, z, w in the object frame (the identity may be left out).
    Discrete {
        /// The rotations.
        rotations: Vec<[f64; 4]>,
    },
    /// The 24 rotations of a cube.
    Cube,
}

impl Symmetry {
    /// Rotations of a finite symmetry, identity first; only the identity for [`Symmetry::None`] and
    /// [`Symmetry::Continuous`].
    pub fn rotations(&self) -> Vec<UnitQuaternion<f64>> {
        let id = UnitQuaternion::identity();
        match self {
            Self::None | Self::Continuous { .. } => vec![id],
            Self::Discrete { rotations } => std::iter::once(id)
                .chain(rotations.iter().map(|q| {
                    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
                        q[3], q[0], q[1], q[2],
                    ))
                }))
                .filter({
                    let mut seen: Vec<UnitQuaternion<f64>> = Vec::new();
                    move |r| {
                        let new = seen.iter().all(|s| s.angle_to(r) > 1e-6);
                        if new {
                            seen.push(*r);
                        }
                        new
                    }
                })
                .collect(),
            Self::Cube => {
                let axes: [Vector3<f64>; 6] = [
                    Vector3::x(),
                    -Vector3::x(),
                    Vector3::y(),
                    -Vector3::y(),
                    Vector3::z(),
                    -Vector3::z(),
                ];
                let mut out = vec![id];
                for x in axes {
                    for y in axes {
                        if x.dot(&y).abs() > 0.5 {
                            continue;
                        }
                        let m = nalgebra::Matrix3::from_columns(&[x, y, x.cross(&y)]);
                        let r = crate::exact_rotation(m);
                        if r.angle() > 1e-6 {
                            out.push(r);
                        }
                    }
                }
                out
            }
        }
    }

    /// The equivalent of `pose` whose orientation is nearest to `near`'s.
    pub fn nearest(&self, pose: &Pose, near: &UnitQuaternion<f64>) -> Pose {
        let rotation = match self {
            Self::Continuous { axis } => {
                let Some(axis) = Unit::try_new(Vector3::from(*axis), 1e-9) else { return *pose };
                // Of the relative rotation only the swing stays: its twist about the axis is free.
                let relative = pose.rotation.inverse() * near;
                let v = relative.vector().dot(&axis);
                let twist = v.atan2(relative.w) * 2.0;
                pose.rotation * UnitQuaternion::from_axis_angle(&axis, twist)
            }
            _ => self
                .rotations()
                .into_iter()
                .map(|s| pose.rotation * s)
                .min_by(|a, b| a.angle_to(near).total_cmp(&b.angle_to(near)))
                .unwrap_or(pose.rotation),
        };
        Pose::from_parts(pose.translation, rotation)
    }

    /// Metres and radians between two poses of such an object, the least over its symmetry.
    pub fn distance(&self, a: &Pose, b: &Pose) -> (f64, f64) {
        pose_distance(&self.nearest(a, &b.rotation), b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose_from_xyz_rpy;

    #[test]
    fn continuous_keeps_the_tilt() {
        let s = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
        let a = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, 2.5]);
        let b = pose_from_xyz_rpy([0.0; 3], [0.2, 0.0, 0.0]);
        assert!((s.distance(&a, &b).1 - 0.2).abs() < 1e-9);
        assert!((s.distance(&b, &a).1 - 0.2).abs() < 1e-9);
    }

    #[test]
    fn a_cube_has_24_rotations() {
        let all = Symmetry::Cube.rotations();
        assert_eq!(all.len(), 24);
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a.angle_to(b) > 1.0), "rotation {i} comes twice");
        }
        let a = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, std::f64::consts::FRAC_PI_2 + 0.1]);
        assert!((Symmetry::Cube.distance(&a, &Pose::identity()).1 - 0.1).abs() < 1e-9);
    }
}
