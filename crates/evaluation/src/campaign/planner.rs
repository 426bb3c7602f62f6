//! A pick-and-place by rule: stands in for the policies, from whatever is observed.

use tdv_geometry::nalgebra::{Translation3, UnitQuaternion};
use tdv_geometry::{Pose, interpolate, pose_from_xyz_rpy, yaw_of};

/// Height of the tool over the object's underside at the grasp, m.
const GRASP: f64 = 0.058;
/// Height above the grasp or the target at which the way is free, m.
const ABOVE: f64 = 0.10;
/// Speed of the tool on the way, m/s.
const SPEED: f64 = 0.16;
/// Arrived within this, m.
const ARRIVED: f64 = 0.006;
/// Time between two poses of a prediction, s, and how many there are.
pub const STEP: f64 = 0.05;
const HORIZON: usize = 16;

/// Where the tool has to be to take the object standing at `object`, `T_base_link_tcp`: straight down,
/// the fingers across the object's x axis.
pub fn grasp(object: &Pose) -> Pose {
    let t = object.translation;
    pose_from_xyz_rpy(
        [t.x, t.y, t.z + GRASP],
        [std::f64::consts::PI, 0.0, yaw_of(&object.rotation)],
    )
}

fn raised(p: &Pose, by: f64) -> Pose {
    Translation3::new(0.0, 0.0, by) * p
}

/// Where `from` has to go on its way to `goal`: up, over, down.
fn way(from: &Pose, goal: &Pose) -> Vec<Pose> {
    let apart = (from.translation.vector - goal.translation.vector).xy().norm();
    let turned = from.rotation.angle_to(&goal.rotation);
    if apart < 0.012 && turned < 0.15 {
        return vec![*from, *goal];
    }
    let over = raised(goal, ABOVE);
    if from.translation.z >= over.translation.z - 0.03 {
        return vec![*from, over, *goal];
    }
    let mut up = *from;
    up.translation.z = over.translation.z;
    vec![*from, up, over, *goal]
}

/// A prediction for the moving frame at `from` that is to come to `goal` (both in base_link).
pub fn predict(from: &Pose, goal: &Pose) -> Vec<Pose> {
    let way = way(from, goal);
    let length = |w: &[Pose]| {
        let d = (w[1].translation.vector - w[0].translation.vector).norm();
        d.max(0.12 * w[0].rotation.angle_to(&w[1].rotation)).max(1e-6)
    };
    let total: f64 = way.windows(2).map(length).sum();
    let mut s = 0.0;
    (0..HORIZON)
        .map(|_| {
            // Slower towards the end.
            s = (s + STEP * SPEED.min(0.02 + 1.5 * (total - s).max(0.0))).min(total);
            let mut left = s;
            for w in way.windows(2) {
                let part = length(w);
                if left <= part {
                    return interpolate(&w[0], &w[1], left / part);
                }
                left -= part;
            }
            *goal
        })
        .collect()
}

/// Whether `at` has come to `goal`.
pub fn arrived(at: &Pose, goal: &Pose) -> bool {
    (at.translation.vector - goal.translation.vector).norm() < ARRIVED
        && at.rotation.angle_to(&goal.rotation) < 0.06
}

/// The pose with an error: metres by axis, radians as a rotation vector.
pub fn disturbed(p: &Pose, shift: [f64; 3], turn: [f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::from(p.translation.vector + tdv_geometry::nalgebra::Vector3::from(shift)),
        UnitQuaternion::from_scaled_axis(tdv_geometry::nalgebra::Vector3::from(turn)) * p.rotation,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn predictions_followed_step_by_step_arrive_from_anywhere() {
        let goal = grasp(&pose_from_xyz_rpy([0.5, 0.1, 0.0], [0.0, 0.0, 0.7]));
        for start in [[0.4, 0.0, 0.35, 0.0], [0.6, -0.2, 0.05, 2.0], [0.5, 0.1, 0.2, 0.7]] {
            let [x, y, z, yaw] = start;
            let mut at = pose_from_xyz_rpy([x, y, z], [std::f64::consts::PI, 0.0, yaw]);
            let mut steps = 0;
            while !arrived(&at, &goal) {
                let next = predict(&at, &goal)[0];
                let moved = (next.translation.vector - at.translation.vector).norm();
                assert!(moved <= SPEED * STEP + 1e-9, "{moved}");
                let near = (next.translation.vector - goal.translation.vector).xy().norm() < 0.02;
                assert!(near || next.translation.z >= z.min(goal.translation.z + ABOVE) - 1e-6);
                at = next;
                steps += 1;
                assert!(steps < 400, "{at}");
            }
        }
    }
}
