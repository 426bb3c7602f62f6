//! Poses: position in m and rotation vector in rad.

use super::Result;
use crate::error::ErrorKind;
use crate::value::Value;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

fn isometry(p: &[f64; 6]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], p[5]));
    Isometry3::from_parts(Translation3::new(p[0], p[1], p[2]), rotation)
}

fn numbers(pose: &Isometry3<f64>) -> [f64; 6] {
    let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

pub(super) fn inverse(p: &[f64; 6]) -> [f64; 6] {
    numbers(&isometry(p).inverse())
}

/// Between two poses: position on the line, rotation about one axis; `alpha` 0 is the first.
pub(super) fn interpolate(a: &[f64; 6], b: &[f64; 6], alpha: f64) -> [f64; 6] {
    let (a, b) = (isometry(a), isometry(b));
    let turn = (a.rotation.inverse() * b.rotation).scaled_axis() * alpha;
    let position = a.translation.vector + (b.translation.vector - a.translation.vector) * alpha;
    numbers(&Isometry3::from_parts(
        position.into(),
        a.rotation * UnitQuaternion::from_scaled_axis(turn),
    ))
}

/// Positions subtracted; the rotation that follows `from` to give `to`, in the base frame.
fn subtract(to: &[f64; 6], from: &[f64; 6]) -> [f64; 6] {
    let (to, from) = (isometry(to), isometry(from));
    let position = to.translation.vector - from.translation.vector;
    numbers(&Isometry3::from_parts(position.into(), to.rotation * from.rotation.inverse()))
}

fn length(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

pub(super) fn two(name: &str, a: &[f64; 6], b: &[f64; 6]) -> Result<Value> {
    Ok(match name {
        "pose_trans" => Value::Pose(numbers(&(isometry(a) * isometry(b)))),
        "pose_add" => {
            let (a, b) = (isometry(a), isometry(b));
            let position = a.translation.vector + b.translation.vector;
            Value::Pose(numbers(&Isometry3::from_parts(position.into(), a.rotation * b.rotation)))
        }
        "pose_sub" => Value::Pose(subtract(a, b)),
        "pose_dist" => Value::Float(length(&subtract(b, a))),
        "point_dist" => Value::Float(length(&[b[0] - a[0], b[1] - a[1], b[2] - a[2]])),
        _ => {
            // A wrench (force, torque) about another point: the torque loses lever times force.
            let pose = isometry(a);
            let (force, torque) = (Vector3::new(b[0], b[1], b[2]), Vector3::new(b[3], b[4], b[5]));
            let moved = torque - pose.translation.vector.cross(&force);
            let (f, t) = (pose.rotation.inverse() * force, pose.rotation.inverse() * moved);
            Value::numbers(&[f.x, f.y, f.z, t.x, t.y, t.z])
        }
    })
}

/// Rotation vector to roll, pitch, yaw (turns about the fixed x, y, z axes in this order) or back.
pub(super) fn rotation(name: &str, value: &Value) -> Result<Value> {
    let three: Option<[f64; 3]> = value.vector().and_then(|v| v.try_into().ok());
    let [a, b, c] = three.ok_or_else(|| ErrorKind::of_type("a list of three numbers is needed"))?;
    let out = if name == "rotvec2rpy" {
        let (r, p, y) = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c)).euler_angles();
        [r, p, y]
    } else {
        UnitQuaternion::from_euler_angles(a, b, c).scaled_axis().into()
    };
    Ok(Value::numbers(&out))
}
