//! 21 hand joints -> pose of a two-finger gripper.

use crate::gripper_symmetry;
use serde::{Deserialize, Serialize};
use tdv_geometry::nalgebra::{Point3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, pose_from_xyz_rpy};

/// Order of the 21 joints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointOrder {
    /// 0 wrist; 1-4 thumb CMC, MCP, IP, tip; 5-8 index MCP, PIP, DIP, tip; then middle, ring, little.
    /// Also MediaPipe's and HaMeR's order.
    #[default]
    Openpose,
    /// Native MANO: wrist; index, middle, little, ring, thumb with three joints each; then the tips of
    /// thumb, index, middle, ring, little.
    Mano,
}

/// MANO index of every OpenPose joint.
const FROM_MANO: [usize; 21] =
    [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20];

const THUMB_MCP: usize = 2;
const THUMB_IP: usize = 3;
const THUMB_TIP: usize = 4;
const INDEX_MCP: usize = 5;
const INDEX_TIP: usize = 8;
const MIDDLE_TIP: usize = 12;

/// Which joints make the gripper's frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RemapMethod {
    /// Approach along the thumb's proximal phalanx, closing towards the index knuckle: steady, because
    /// it needs no fingertips.
    #[default]
    Tdv,
    /// Origin between the tips of thumb and middle finger, approach from the index knuckle to the
    /// middle of the thumb and index tips, closing from thumb tip to index tip (as Phantom does).
    Phantom,
}

/// Settings of [`remap`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RemapConfig {
    /// Which joints.
    pub method: RemapMethod,
    /// Order of the input.
    pub joint_order: JointOrder,
    /// From the thumb's IP joint to the tcp along the approach (m), method tdv.
    pub tip_distance: f64,
    /// `T_tool_align`: x, y, z (m), roll, pitch, yaw (rad) of the tool seen from the derived frame;
    /// zero if the tool has z = approach and y = closing.
    pub tool_align: [f64; 6],
    /// Orientation (roll, pitch, yaw in base_link, rad) to which the first frame's choice between the
    /// two equivalent grippers is the nearer one.
    pub home_rpy: [f64; 3],
    /// Below this sine of the angle between the two defining directions a frame has no orientation.
    pub min_confidence: f64,
    /// Distance of the tips of thumb and index (m) at which the gripper is closed ...
    pub span_closed: f64,
    /// ... and open.
    pub span_open: f64,
    /// Opening of the gripper (m).
    pub max_opening: f64,
}

impl Default for RemapConfig {
    fn default() -> Self {
        Self {
            method: RemapMethod::Tdv,
            joint_order: JointOrder::Openpose,
            tip_distance: 0.03,
            tool_align: [0.0; 6],
            home_rpy: [std::f64::consts::PI, 0.0, 0.0],
            min_confidence: 0.2,
            span_closed: 0.02,
            span_open: 0.10,
            max_opening: 0.085,
        }
    }
}

/// A hand as a gripper, in the frame of the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Remapped {
    /// `T_base_tcp` (z = approach, y = closing axis from thumb to index), before the symmetry is decided.
    pub pose: Pose,
    /// 0..1: sine of the angle between approach and the direction that gives the closing axis.
    pub confidence: f64,
    /// Whether the orientation can be trusted; [`tool_track`] carries the last one on otherwise.
    pub valid: bool,
    /// Middle between the tips of thumb and of index and middle finger (m).
    pub tips: Point3<f64>,
    /// Distance between the tips of thumb and index finger (m).
    pub span: f64,
    /// The span as a gripper opening (m), 0..max_opening.
    pub opening: f64,
}

/// One hand; none if a joint is not finite.
pub fn remap(joints: &[Point3<f64>; 21], config: &RemapConfig) -> Option<Remapped> {
    if !joints.iter().all(|j| j.coords.iter().all(|v| v.is_finite())) {
        return None;
    }
    let j = |i: usize| match config.joint_order {
        JointOrder::Openpose => joints[i],
        JointOrder::Mano => joints[FROM_MANO[i]],
    };
    // Approach, the direction that gives the closing axis, and the origin once the axes are known.
    let (along, across) = match config.method {
        RemapMethod::Tdv => (j(THUMB_IP) - j(THUMB_MCP), j(INDEX_MCP) - j(THUMB_MCP)),
        RemapMethod::Phantom => {
            (middle(&j(THUMB_TIP), &j(INDEX_TIP)) - j(INDEX_MCP), j(INDEX_TIP) - j(THUMB_TIP))
        }
    };
    let z = along.try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let w = across - z * across.dot(&z);
    let confidence = if across.norm() > 1e-9 { (w.norm() / across.norm()).min(1.0) } else { 0.0 };
    let y = w.try_normalize(1e-9).unwrap_or_else(|| any_orthogonal(&z));
    let x = y.cross(&z);
    let origin = match config.method {
        RemapMethod::Tdv => j(THUMB_IP) + y * (0.5 * across.dot(&y)) + z * config.tip_distance,
        RemapMethod::Phantom => middle(&j(THUMB_TIP), &j(MIDDLE_TIP)),
    };
    let rotation = crate::path::from_axes(&x, &y, &z);
    let a = config.tool_align;
    let align = pose_from_xyz_rpy([a[0], a[1], a[2]], [a[3], a[4], a[5]]);
    let fingers = middle(&j(INDEX_TIP), &j(MIDDLE_TIP));
    let span = (j(THUMB_TIP) - j(INDEX_TIP)).norm();
    let share = (span - config.span_closed) / (config.span_open - config.span_closed).max(1e-6);
    Some(Remapped {
        pose: Pose::from_parts(origin.coords.into(), rotation) * align,
        confidence,
        valid: confidence >= config.min_confidence && along.norm() >= 0.005,
        tips: middle(&j(THUMB_TIP), &fingers),
        span,
        opening: share.clamp(0.0, 1.0) * config.max_opening,
    })
}

fn middle(a: &Point3<f64>, b: &Point3<f64>) -> Point3<f64> {
    tdv_geometry::nalgebra::center(a, b)
}

fn any_orthogonal(z: &Vector3<f64>) -> Vector3<f64> {
    z.cross(&Vector3::ith(z.iamin(), 1.0)).normalize()
}

/// A whole recording: of the two equivalent grippers (half a turn about the approach) every frame takes
/// the one nearer to the frame before, the first the one nearer to `home_rpy`; so a left hand gives
/// what a right hand gives. Frames without a trustworthy orientation carry the last one on.
pub fn tool_track(
    hands: &[Option<[Point3<f64>; 21]>],
    config: &RemapConfig,
) -> Vec<Option<Remapped>> {
    let [r, p, y] = config.home_rpy;
    let mut near = UnitQuaternion::from_euler_angles(r, p, y);
    let symmetry = gripper_symmetry();
    hands
        .iter()
        .map(|hand| {
            let mut tool = remap(hand.as_ref()?, config)?;
            if tool.valid {
                tool.pose = symmetry.nearest(&tool.pose, &near);
                near = tool.pose.rotation;
            } else {
                tool.pose.rotation = near;
            }
            Some(tool)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use tdv_geometry::pose_distance;

    /// A right hand that reaches down, thumb towards -y, index towards +y.
    fn hand() -> [Point3<f64>; 21] {
        let mut j = [Point3::new(-0.08, 0.0, 0.15); 21];
        j[1] = Point3::new(-0.05, -0.02, 0.12);
        j[2] = Point3::new(-0.01, -0.03, 0.10);
        j[3] = Point3::new(-0.005, -0.035, 0.06);
        j[4] = Point3::new(0.0, -0.03, 0.03);
        j[5] = Point3::new(0.0, 0.04, 0.09);
        j[8] = Point3::new(0.0, 0.03, 0.03);
        j[12] = Point3::new(0.01, 0.03, 0.03);
        j
    }

    fn moved(g: &Pose, hand: &[Point3<f64>; 21]) -> [Point3<f64>; 21] {
        hand.map(|p| g * p)
    }

    #[test]
    fn equivariant_under_rigid_motion_in_both_methods() {
        for method in [RemapMethod::Tdv, RemapMethod::Phantom] {
            let config = RemapConfig {
                method,
                tool_align: [0.01, 0.0, 0.02, 0.1, 0.0, 0.3],
                ..Default::default()
            };
            let t = remap(&hand(), &config).unwrap();
            for k in 0..30 {
                let k = f64::from(k);
                let g = pose_from_xyz_rpy([0.1 * k, -k, 0.3], [k, 0.5 * k, -0.3 * k]);
                let u = remap(&moved(&g, &hand()), &config).unwrap();
                let (d, a) = pose_distance(&u.pose, &(g * t.pose));
                assert!(d < 1e-9 && a < 1e-7, "{method:?} {d} {a}");
                assert!(
                    (u.confidence - t.confidence).abs() < 1e-9 && (u.span - t.span).abs() < 1e-9
                );
            }
        }
    }

    #[test]
    fn axes_are_approach_and_closing() {
        for method in [RemapMethod::Tdv, RemapMethod::Phantom] {
            let t = remap(&hand(), &RemapConfig { method, ..Default::default() }).unwrap();
            let (y, z) = (t.pose.rotation * Vector3::y(), t.pose.rotation * Vector3::z());
            assert!(z.z < -0.8, "{method:?} approach {z}");
            assert!(y.y > 0.8, "{method:?} closing {y}");
            assert!(t.valid && t.confidence > 0.8);
            assert!((t.span - 0.06).abs() < 1e-9);
            // The tcp lies between the fingertips.
            assert!((t.pose.translation.vector - t.tips.coords).norm() < 0.02, "{:?}", t.pose);
        }
    }

    #[test]
    fn a_left_hand_gives_the_same_gripper() {
        let config = RemapConfig::default();
        let left = hand().map(|p| Point3::new(p.x, -p.y, p.z));
        let r = tool_track(&[Some(hand())], &config)[0].unwrap();
        let l = tool_track(&[Some(left)], &config)[0].unwrap();
        let mirrored = r.pose.rotation * Vector3::z();
        let z = l.pose.rotation * Vector3::z();
        assert!((z - Vector3::new(mirrored.x, -mirrored.y, mirrored.z)).norm() < 1e-9);
        // Thumb and index have changed sides: only the symmetry rule keeps the wrist from turning over.
        assert!(l.pose.rotation.angle_to(&r.pose.rotation) < 0.6);
        let raw = |h: &[Point3<f64>; 21]| remap(h, &config).unwrap().pose.rotation;
        assert!(raw(&left).angle_to(&raw(&hand())) > 2.5);
    }

    #[test]
    fn joint_orders_agree() {
        let mut mano = [Point3::origin(); 21];
        for (i, m) in FROM_MANO.iter().enumerate() {
            mano[*m] = hand()[i];
        }
        let config = RemapConfig { joint_order: JointOrder::Mano, ..Default::default() };
        assert_eq!(remap(&mano, &config), remap(&hand(), &RemapConfig::default()));
        let wrong = remap(&mano, &RemapConfig::default()).unwrap();
        assert!(
            pose_distance(&wrong.pose, &remap(&hand(), &config_default()).unwrap().pose).1 > 0.2
        );
    }

    fn config_default() -> RemapConfig {
        RemapConfig::default()
    }

    #[test]
    fn five_millimetres_of_noise_cost_no_flip() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let noise = Normal::new(0.0, 0.005).unwrap();
        let frames: Vec<_> = (0..200)
            .map(|_| {
                Some(hand().map(|p| {
                    p + Vector3::new(
                        noise.sample(&mut rng),
                        noise.sample(&mut rng),
                        noise.sample(&mut rng),
                    )
                }))
            })
            .collect();
        let clean = remap(&hand(), &RemapConfig::default()).unwrap().pose;
        let track = tool_track(&frames, &RemapConfig::default());
        let near = gripper_symmetry().nearest(&clean, &track[0].unwrap().pose.rotation);
        let mut angles: Vec<f64> =
            track.iter().map(|t| t.unwrap().pose.rotation.angle_to(&near.rotation)).collect();
        angles.sort_by(f64::total_cmp);
        assert!(angles[100] < 0.35, "median {}", angles[100]);
        assert!(angles[199] < 1.3, "max {}", angles[199]);
    }

    #[test]
    fn degenerate_hands_are_flagged_and_keep_the_last_orientation() {
        let mut straight = hand();
        straight[5] = straight[2] + (straight[3] - straight[2]) * 2.0;
        let mut tiny = hand();
        tiny[3] = tiny[2];
        let mut nan = hand();
        nan[9].x = f64::NAN;
        let track = tool_track(
            &[Some(hand()), Some(straight), Some(tiny), Some(nan), None],
            &RemapConfig::default(),
        );
        assert!(!track[1].unwrap().valid && !track[2].unwrap().valid);
        for t in &track[1..3] {
            assert_eq!(t.unwrap().pose.rotation, track[0].unwrap().pose.rotation);
        }
        assert!(track[3].is_none() && track[4].is_none());
        let all_zero = remap(&[Point3::origin(); 21], &RemapConfig::default()).unwrap();
        assert!(!all_zero.valid && all_zero.pose.rotation.norm().is_finite());
    }
}
