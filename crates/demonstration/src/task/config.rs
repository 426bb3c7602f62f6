use serde::{Deserialize, Serialize};
use tdv_geometry::nalgebra::Vector3;

fn positive(p: &mut Vec<String>, name: &str, v: f64, max: f64) {
    if !(v > 0.0 && v <= max) {
        p.push(format!("{name} {v} must be greater than 0 and at most {max}"));
    }
}

fn range(p: &mut Vec<String>, name: &str, r: [f64; 2], min: f64, max: f64) {
    if !(r[0] < r[1] && r[0] >= min && r[1] <= max) {
        p.push(format!("{name} [{}, {}] must be [low, high] within {min}..{max}", r[0], r[1]));
    }
}

fn within(p: &mut Vec<String>, name: &str, v: f64, min: f64, max: f64) {
    if !(min..=max).contains(&v) {
        p.push(format!("{name} {v} must be within {min}..{max}"));
    }
}

/// The rectangle of object starts (m, base_link).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Workspace {
    /// Low and high x.
    pub x: [f64; 2],
    /// Low and high y.
    pub y: [f64; 2],
    /// No start of the moving object nearer than this to the reference object (m, in the plane).
    pub exclude_radius: f64,
    /// Corners (x, y) of an area within the rectangle; none = all of it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub polygon: Vec<[f64; 2]>,
}

impl Workspace {
    /// Whether a start (base_link, m) is inside rectangle and polygon and outside the excluded disc
    /// round the reference object.
    pub fn allows(&self, xy: [f64; 2], reference_xy: [f64; 2]) -> bool {
        self.contains(xy)
            && (xy[0] - reference_xy[0]).hypot(xy[1] - reference_xy[1]) >= self.exclude_radius
    }

    /// Whether a point is inside rectangle and polygon.
    pub fn contains(&self, xy: [f64; 2]) -> bool {
        (self.x[0]..=self.x[1]).contains(&xy[0])
            && (self.y[0]..=self.y[1]).contains(&xy[1])
            && (self.polygon.is_empty() || inside(&self.polygon, xy))
    }

    /// Whether any start is left, by a grid of 100 x 100 points.
    pub fn is_usable(&self, reference_xy: [f64; 2]) -> bool {
        let at = |r: [f64; 2], i: usize| r[0] + (r[1] - r[0]) * (i as f64 + 0.5) / 100.0;
        (0..100)
            .any(|i| (0..100).any(|j| self.allows([at(self.x, i), at(self.y, j)], reference_xy)))
    }

    pub(super) fn validate(&self, at: &str, p: &mut Vec<String>) {
        range(p, &format!("{at}.x"), self.x, -2.0, 2.0);
        range(p, &format!("{at}.y"), self.y, -2.0, 2.0);
        within(p, &format!("{at}.exclude_radius"), self.exclude_radius, 0.0, 1.0);
        let n = self.polygon.len();
        if n == 1 || n == 2 {
            p.push(format!("{at}.polygon has {n} corners, three or more make an area"));
        }
        if !self.polygon.iter().flatten().all(|v| v.is_finite()) {
            p.push(format!("{at}.polygon has a corner that is not finite"));
        }
    }
}

/// Even-odd rule.
fn inside(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    let mut last = polygon[polygon.len() - 1];
    for corner in polygon {
        let ([ax, ay], [bx, by]) = (last, *corner);
        if (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax) {
            inside = !inside;
        }
        last = *corner;
    }
    inside
}

/// A direction of the object along which the gripper may close.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClosingAxis {
    /// Direction in the object frame; its sign does not matter.
    pub axis: [f64; 3],
    /// The object's width along it (m).
    pub width: f64,
}

/// How the demonstrated grasp is fitted to the gripper. Every change is reported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraspConfig {
    /// Opening of the gripper (m); 0.085 for a 2F-85.
    pub max_opening: f64,
    /// Least room between object and open fingers, both sides together (m).
    pub clearance: f64,
    /// Directions the gripper may close along; empty = as demonstrated. The nearest that fits is taken.
    pub closing: Vec<ClosingAxis>,
    /// Largest turn from the demonstrated to the nearest allowed closing axis (deg).
    pub max_turn_deg: f64,
    /// Largest angle between the approach and straight down (deg); 180 = any.
    pub max_tilt_deg: f64,
    /// Move the grasp sideways so that the object's z axis lies between the fingers.
    pub centre: bool,
    /// Where (x, y, m) that axis stands in the frame of a hand's reference, of which what is held is a part;
    /// none = at its origin. What an object's grasp is centred on is the object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub middle: Option<[f64; 2]>,
    /// Range of the tcp's height in the object frame (m).
    pub height: Option<[f64; 2]>,
}

impl Default for GraspConfig {
    fn default() -> Self {
        Self {
            max_opening: 0.085,
            clearance: 0.005,
            closing: Vec::new(),
            max_turn_deg: 90.0,
            max_tilt_deg: 180.0,
            centre: false,
            middle: None,
            height: None,
        }
    }
}

impl GraspConfig {
    pub(super) fn validate(&self, at: &str, p: &mut Vec<String>) {
        positive(p, &format!("{at}.max_opening"), self.max_opening, 0.3);
        within(p, &format!("{at}.clearance"), self.clearance, 0.0, 0.05);
        within(p, &format!("{at}.max_turn_deg"), self.max_turn_deg, 0.0, 180.0);
        within(p, &format!("{at}.max_tilt_deg"), self.max_tilt_deg, 0.0, 180.0);
        if let Some(h) = self.height
            && !(h[0] <= h[1] && h[0].abs() < 1.0 && h[1].abs() < 1.0)
        {
            p.push(format!("{at}.height {h:?} must be [low, high] within +-1 m"));
        }
        if let Some(m) = self.middle
            && !m.iter().all(|v| v.abs() < 1.0)
        {
            p.push(format!("{at}.middle {m:?} must be within +-1 m"));
        }
        for (i, c) in self.closing.iter().enumerate() {
            if !(1e-6..1e6).contains(&Vector3::from(c.axis).norm()) {
                p.push(format!("{at}.closing[{i}].axis {:?} has no direction", c.axis));
            }
            positive(p, &format!("{at}.closing[{i}].width"), c.width, 1.0);
        }
        if !self.closing.is_empty()
            && self.closing.iter().all(|c| c.width + self.clearance > self.max_opening)
        {
            p.push(format!(
                "{at}.closing: no axis is narrow enough for an opening of {} m with {} m of room",
                self.max_opening, self.clearance
            ));
        }
    }
}

/// Which warp makes the trajectories.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GenerationMode {
    /// Section 3.2 of the paper, literally (its end misses when heights differ).
    Paper,
    /// Log-polar fade into the exact last part of the demonstration.
    #[default]
    Repaired,
    /// Comparator: the last part of the demonstration as it is, a straight line with the shortest turn
    /// before it, as MimicGen and DemoGen do.
    Rigid,
    /// Comparator: dynamic movement primitive, learned from the one path; its end is approached, not met.
    Dmp,
}

/// Where the gripper may start a reach (base_link, m).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HomeRegion {
    /// Low and high x.
    pub x: [f64; 2],
    /// Low and high y.
    pub y: [f64; 2],
    /// Low and high z of the tcp.
    pub z: [f64; 2],
    /// Largest angle between the approach and straight down (deg).
    pub tilt_deg: f64,
}

impl Default for HomeRegion {
    fn default() -> Self {
        Self { x: [0.25, 0.60], y: [-0.25, 0.25], z: [0.20, 0.45], tilt_deg: 15.0 }
    }
}

/// Trajectories that start beside the path and fade into it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecoveryConfig {
    /// Recovery trajectories per ordinary one.
    pub share: f64,
    /// Largest sideways offset (m, each axis); shrinks near the end of the path.
    pub position: f64,
    /// Largest turn (deg); shrinks likewise.
    pub angle_deg: f64,
    /// Share of the recoveries that stand for a displaced object.
    pub displaced_share: f64,
    /// Largest displacement in the plane (m).
    pub displaced: f64,
}

impl Default for RecoveryConfig {
    fn default() -> Self {
        Self { share: 0.5, position: 0.03, angle_deg: 15.0, displaced_share: 0.4, displaced: 0.10 }
    }
}

/// The one speed law of all trajectories.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RetimeConfig {
    /// Largest speed of the moving frame (m/s).
    pub speed: f64,
    /// Largest speed of the last `pregrasp_distance` of a reach (m/s).
    pub approach_speed: f64,
    /// Largest acceleration along the path, and across it in curves (m/s^2).
    pub acceleration: f64,
    /// Largest rotation rate (rad/s).
    pub angular_speed: f64,
    /// Sampling step (s).
    pub dt: f64,
    /// How long the last pose is repeated (s), so that stopping is learned.
    pub hold: f64,
}

impl Default for RetimeConfig {
    fn default() -> Self {
        Self {
            speed: 0.20,
            approach_speed: 0.10,
            acceleration: 0.6,
            angular_speed: 1.0,
            dt: 0.05,
            hold: 0.6,
        }
    }
}

/// How the training set is made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerationConfig {
    /// Which warp.
    pub mode: GenerationMode,
    /// Ordinary trajectories per procedure.
    pub count: usize,
    /// Last fraction of the demonstrated path (SE(3) arc length) that is kept exactly.
    pub alpha: f64,
    /// Yaw of the moving object at its start (deg, base_link).
    pub yaw_deg: [f64; 2],
    /// Roll of the moving object at the start of a carry (deg, about base_link's x), added to the
    /// demonstrated orientation; equal ends = always this much.
    pub roll_deg: [f64; 2],
    /// Pitch likewise, about base_link's y.
    pub pitch_deg: [f64; 2],
    /// Largest tilt of the moving object at the start of `place` (deg), about any horizontal axis.
    pub tilt_deg: f64,
    /// Turn the start's yaw with the direction of the start, instead of drawing it.
    pub yaw_follows: bool,
    /// Radius within which the reference object is moved about its demonstrated place (m); it
    /// widens the starts as seen from it.
    pub reference_spread: f64,
    /// Height that is gained before the object moves sideways (m); 0 = as demonstrated.
    pub lift: f64,
    /// Straight last part of a reach, along the approach (m).
    pub pregrasp_distance: f64,
    /// Room between fingertips and object while crossing it (m).
    pub margin: f64,
    /// Starts of the gripper.
    pub home: HomeRegion,
    /// Starts beside the path.
    pub recovery: RecoveryConfig,
    /// Speeds and sampling.
    pub retime: RetimeConfig,
    /// Noise of the pose history in training, position (m, one sigma).
    pub noise_position: f64,
    /// Noise of the pose history in training, rotation (deg, one sigma).
    pub noise_angle_deg: f64,
}

impl Default for GenerationConfig {
    fn default() -> Self {
        Self {
            mode: GenerationMode::Repaired,
            count: 50,
            alpha: 0.25,
            yaw_deg: [-180.0, 180.0],
            roll_deg: [0.0; 2],
            pitch_deg: [0.0; 2],
            tilt_deg: 0.0,
            yaw_follows: false,
            reference_spread: 0.10,
            lift: 0.03,
            pregrasp_distance: 0.10,
            margin: 0.02,
            home: HomeRegion::default(),
            recovery: RecoveryConfig::default(),
            retime: RetimeConfig::default(),
            noise_position: 0.002,
            noise_angle_deg: 1.0,
        }
    }
}

impl GenerationConfig {
    /// Every problem of the values, one sentence each.
    pub fn validate(&self, p: &mut Vec<String>) {
        if self.count == 0 || self.count > 100_000 {
            p.push(format!("generation.count {} must be within 1..100000", self.count));
        }
        if !(self.alpha > 0.0 && self.alpha < 0.9) {
            p.push(format!("generation.alpha {} must be within 0..0.9, both excluded", self.alpha));
        }
        let turn = |p: &mut Vec<String>, name: &str, r: [f64; 2]| {
            if !(r[0] <= r[1] && r[0] >= -180.0 && r[1] <= 180.0) {
                p.push(format!("{name} [{}, {}] must be [low, high] within -180..180", r[0], r[1]));
            }
        };
        turn(p, "generation.yaw_deg", self.yaw_deg);
        turn(p, "generation.roll_deg", self.roll_deg);
        turn(p, "generation.pitch_deg", self.pitch_deg);
        within(p, "generation.tilt_deg", self.tilt_deg, 0.0, 60.0);
        within(p, "generation.reference_spread", self.reference_spread, 0.0, 0.5);
        within(p, "generation.lift", self.lift, 0.0, 0.3);
        within(p, "generation.pregrasp_distance", self.pregrasp_distance, 0.02, 0.4);
        within(p, "generation.margin", self.margin, 0.0, 0.2);
        range(p, "generation.home.x", self.home.x, -2.0, 2.0);
        range(p, "generation.home.y", self.home.y, -2.0, 2.0);
        range(p, "generation.home.z", self.home.z, 0.0, 2.0);
        within(p, "generation.home.tilt_deg", self.home.tilt_deg, 0.0, 60.0);
        let r = &self.recovery;
        within(p, "generation.recovery.share", r.share, 0.0, 20.0);
        within(p, "generation.recovery.position", r.position, 0.0, 0.2);
        within(p, "generation.recovery.angle_deg", r.angle_deg, 0.0, 60.0);
        within(p, "generation.recovery.displaced_share", r.displaced_share, 0.0, 1.0);
        within(p, "generation.recovery.displaced", r.displaced, 0.0, 0.5);
        let t = &self.retime;
        positive(p, "generation.retime.speed", t.speed, 1.0);
        positive(p, "generation.retime.approach_speed", t.approach_speed, 1.0);
        positive(p, "generation.retime.acceleration", t.acceleration, 10.0);
        positive(p, "generation.retime.angular_speed", t.angular_speed, 6.0);
        within(p, "generation.retime.dt", t.dt, 0.001, 1.0);
        within(p, "generation.retime.hold", t.hold, 0.0, 10.0);
        within(p, "generation.noise_position", self.noise_position, 0.0, 0.05);
        within(p, "generation.noise_angle_deg", self.noise_angle_deg, 0.0, 30.0);
    }
}
