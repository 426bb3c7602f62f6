//! A grasp from above round an upright body, found by least squares.

use super::kinematics::{FingerPose, HandPose, HandShape, ThumbPose};
use nalgebra::{
    DMatrix, DVector, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3,
};
use tdv_geometry::Pose;

/// An upright round body to hold, in its own frame (origin: middle of the underside, z up). The
/// thumb goes to its +y side, the fingers to its -y side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspTarget {
    /// Radius (m).
    pub radius: f64,
    /// Height (m).
    pub height: f64,
    /// Height (m) at which the tool centre point should come to lie.
    pub tool_height: f64,
}

impl GraspTarget {
    /// The demo world's mug.
    pub fn mug() -> Self {
        Self { radius: 0.032, height: 0.090, tool_height: 0.060 }
    }

    /// Signed distance (m) of a point from the body's surface.
    pub fn distance(&self, p: &Point3<f64>) -> f64 {
        let out = p.x.hypot(p.y) - self.radius;
        let up = (p.z - self.height / 2.0).abs() - self.height / 2.0;
        let outside = Vector3::new(out.max(0.0), up.max(0.0), 0.0).norm();
        outside + out.max(up).min(0.0)
    }
}

/// What [`fit_grasp`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspFit {
    /// The closed hand in the body's frame.
    pub closed: HandPose,
    /// The same with the fingers opened wide enough to lower it over the body.
    pub open: HandPose,
    /// T_body_tcp that follows from the closed hand by [`tool_from_hand`].
    pub tool: Pose,
    /// Deepest intrusion (m) of any bone's skin into the body.
    pub intrusion: f64,
    /// Distances (m) between the skin of thumb, index and middle fingertip and the body.
    pub gaps: [f64; 3],
}

/// Distance (m) from the thumb's IP joint to the tool centre point along the approach.
const TIP: f64 = 0.03;

/// The gripper pose that stands for a hand: approach (z) along the proximal phalanx of the thumb,
/// closing axis (y) from the thumb towards the index knuckle, origin midway at the depth of the
/// thumb's pad. `None` if the two directions nearly coincide.
///
/// Joints in any metric frame; the pose is in the same frame. Source: the project's hand-to-gripper
/// rule (three keypoints: thumb MCP, thumb IP, index MCP).
pub fn tool_from_hand(joints: &[Point3<f64>; 21]) -> Option<Pose> {
    let (a, b, c) = (joints[2], joints[3], joints[5]);
    let z = (b - a).try_normalize(5e-3)?;
    let w = c - a;
    let across = w - z * w.dot(&z);
    if across.norm() < 0.2 * w.norm() {
        return None;
    }
    let y = across.try_normalize(1e-9)?;
    let rotation = UnitQuaternion::from_matrix(&Matrix3::from_columns(&[y.cross(&z), y, z]));
    let p = b + y * (0.5 * w.dot(&y)) + z * TIP;
    Some(Pose::from_parts(Translation3::from(p.coords), rotation))
}

/// Radius (m) of the flesh round each joint of a hand of the standard size.
pub(super) const FLESH: [f64; 21] = [
    0.022, 0.016, 0.0115, 0.0100, 0.0085, // wrist, thumb
    0.0110, 0.0090, 0.0080, 0.0070, // index
    0.0110, 0.0092, 0.0082, 0.0072, // middle
    0.0105, 0.0088, 0.0078, 0.0070, // ring
    0.0095, 0.0078, 0.0070, 0.0062, // little
];

const BONES: [(usize, usize); 18] = [
    (1, 2),
    (2, 3),
    (3, 4),
    (5, 6),
    (6, 7),
    (7, 8),
    (9, 10),
    (10, 11),
    (11, 12),
    (13, 14),
    (14, 15),
    (15, 16),
    (17, 18),
    (18, 19),
    (19, 20),
    // The palm's edge over the rim.
    (2, 5),
    (5, 9),
    (9, 13),
];

const PARAMETERS: usize = 6 + 5 + 4 * 3;

/// Start of the search and how far (m, rad) each parameter may stray at the cost of one unit.
fn start(target: &GraspTarget) -> ([f64; PARAMETERS], [f64; PARAMETERS]) {
    let mut at = [0.0; PARAMETERS];
    let mut stray = [0.5; PARAMETERS];
    // Wrist above the body, tilted so that the knuckles stand over the -y side.
    at[..6].copy_from_slice(&[-0.010, 0.010, target.height + 0.115, 0.45, 0.0, 0.0]);
    stray[..6].copy_from_slice(&[0.03, 0.03, 0.03, 0.5, 0.25, 0.5]);
    // Thumb: well opposed, flexing back towards the fingers.
    at[6..11].copy_from_slice(&[0.35, 1.0, -1.4, 0.35, 0.15]);
    stray[6..11].copy_from_slice(&[0.4, 0.4, 0.4, 0.35, 0.3]);
    // Fingers: spread, knuckle, middle joint (the end joint follows).
    for (f, v) in [[0.0, 0.35, 0.25], [0.0, 0.4, 0.3], [0.0, 0.5, 0.5], [0.0, 0.55, 0.6]]
        .into_iter()
        .enumerate()
    {
        at[11 + 3 * f..14 + 3 * f].copy_from_slice(&v);
        stray[11 + 3 * f..14 + 3 * f].copy_from_slice(&[0.12, 0.4, 0.4]);
    }
    (at, stray)
}

fn hand(v: &[f64; PARAMETERS]) -> HandPose {
    // Fingers down, back of the hand towards -y, thumb's side towards +x.
    let down = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
        -Vector3::z(),
        Vector3::x(),
        -Vector3::y(),
    ]));
    let turn = Rotation3::from_euler_angles(-v[3], v[4], v[5]);
    let palm = Pose::from_parts(
        Translation3::new(v[0], v[1], v[2]),
        UnitQuaternion::from_rotation_matrix(&(turn * down)),
    );
    HandPose {
        palm,
        thumb: ThumbPose { abduction: v[6], opposition: v[7], roll: v[8], mcp: v[9], ip: v[10] },
        fingers: std::array::from_fn(|f| {
            let k = 11 + 3 * f;
            FingerPose { spread: v[k], mcp: v[k + 1], pip: v[k + 2], dip: 0.6 * v[k + 2] }
        }),
    }
}

/// What the search brings to zero, each in units of its tolerance.
fn residuals(
    v: &[f64; PARAMETERS],
    shape: &HandShape,
    target: &GraspTarget,
    (at, stray): &([f64; PARAMETERS], [f64; PARAMETERS]),
) -> DVector<f64> {
    let pose = hand(v);
    let joints = shape.joints(&pose);
    let mut out = Vec::with_capacity(128);
    match tool_from_hand(&joints) {
        Some(tool) => {
            let p = tool.translation.vector;
            out.extend([p.x / 0.002, p.y / 0.002, (p.z - target.tool_height) / 0.002]);
            let z = tool.rotation * Vector3::z();
            let y = tool.rotation * Vector3::y();
            out.extend([z.x / 0.05, z.y / 0.05, y.x / 0.05]);
        }
        None => out.extend([100.0; 6]),
    }
    // Thumb, index and middle fingertip touch; the ring finger nearly.
    for (tip, tolerance) in [(4, 0.0005), (8, 0.0005), (12, 0.0007), (16, 0.006)] {
        out.push((target.distance(&joints[tip]) - FLESH[tip]) / tolerance);
    }
    // Nothing goes in, nor below the table.
    for (p, radius) in flesh(&joints) {
        out.push((radius - target.distance(&p)).max(0.0) / 0.0007);
        out.push((radius + 0.004 - p.z).max(0.0) / 0.001);
    }
    for k in 0..PARAMETERS {
        out.push((v[k] - at[k]) / stray[k]);
    }
    // Joints bend one way only, and not without end.
    for k in [9, 10] {
        out.push((-0.2 - v[k]).max(0.0) / 0.02 + (v[k] - 1.2).max(0.0) / 0.02);
    }
    for f in 0..4 {
        let k = 11 + 3 * f;
        out.push((-0.25 - v[k + 1]).max(0.0) / 0.02 + (v[k + 1] - 1.4).max(0.0) / 0.02);
        out.push((0.02 - v[k + 2]).max(0.0) / 0.02 + (v[k + 2] - 1.6).max(0.0) / 0.02);
    }
    DVector::from_vec(out)
}

/// Balls of flesh along the bones: centre and radius.
fn flesh(joints: &[Point3<f64>; 21]) -> impl Iterator<Item = (Point3<f64>, f64)> {
    BONES.iter().flat_map(move |&(a, b)| {
        [0.0, 0.33, 0.67, 1.0].map(|t| {
            let p = joints[a] + (joints[b] - joints[a]) * t;
            (p, FLESH[a] + (FLESH[b] - FLESH[a]) * t)
        })
    })
}

/// Finds a hand that holds the body from above, thumb on its +y side, by damped least squares from
/// a fixed start: the same input always gives the same grasp.
pub fn fit_grasp(shape: &HandShape, target: &GraspTarget) -> GraspFit {
    let prior = start(target);
    let mut v = prior.0;
    let mut r = residuals(&v, shape, target, &prior);
    let mut damping = 1e-2;
    for _ in 0..200 {
        let mut jacobian = DMatrix::zeros(r.len(), PARAMETERS);
        for k in 0..PARAMETERS {
            let step = 1e-6;
            let mut w = v;
            w[k] += step;
            jacobian.set_column(k, &((residuals(&w, shape, target, &prior) - &r) / step));
        }
        let normal = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &r;
        let mut system = normal.clone();
        for k in 0..PARAMETERS {
            system[(k, k)] += damping * normal[(k, k)].max(1e-6);
        }
        let Some(solved) = system.cholesky() else {
            damping *= 10.0;
            continue;
        };
        let delta = solved.solve(&gradient);
        let tried: [f64; PARAMETERS] = std::array::from_fn(|k| v[k] - delta[k]);
        let next = residuals(&tried, shape, target, &prior);
        if next.norm_squared() < r.norm_squared() {
            (v, r) = (tried, next);
            damping = (damping * 0.4).max(1e-9);
        } else {
            damping *= 6.0;
            if damping > 1e9 {
                break;
            }
        }
    }
    let closed = hand(&v);
    let joints = shape.joints(&closed);
    let gap = |tip: usize| target.distance(&joints[tip]) - FLESH[tip];
    let intrusion =
        flesh(&joints).map(|(p, radius)| radius - target.distance(&p)).fold(0.0, f64::max);
    GraspFit {
        closed,
        open: opened(&closed),
        tool: tool_from_hand(&joints).unwrap_or_else(Pose::identity),
        intrusion,
        gaps: [gap(4), gap(8), gap(12)],
    }
}

/// The same hand with thumb and fingers spread away from what they hold.
fn opened(closed: &HandPose) -> HandPose {
    let mut open = *closed;
    open.thumb.opposition += 0.22;
    open.thumb.mcp -= 0.35;
    open.thumb.ip -= 0.25;
    for (f, finger) in open.fingers.iter_mut().enumerate() {
        finger.mcp -= 0.42 - 0.03 * f as f64;
        finger.pip = (finger.pip - 0.25).max(0.08);
        finger.dip = 0.6 * finger.pip;
    }
    open
}
