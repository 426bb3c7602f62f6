use super::convert;
use super::model::BodyModel;
use super::shapes::{ConvexPart, Placed, distance};
use super::workcell::{Workcell, WorkcellError};
use crate::kinematics::Joints;
use crate::limits::Limits;
use crate::urdf::RobotModel;
use glamx::DPose3;
use tdv_geometry::Pose;
use thiserror::Error;

/// What each kind of pair has to keep (m). A negative margin lets the shapes overlap by as much; only
/// against the table is that measured, elsewhere touching is the least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Links of the robot among themselves.
    pub own: f64,
    /// Links against fixtures.
    pub fixture: f64,
    /// Palm, wrist, forearm and upper arm above the table.
    pub table: f64,
    /// Fingers above the table.
    pub fingertip: f64,
    /// A held object against fixtures and the arm.
    pub held: f64,
    /// A held object above the table; below zero, so that it may stand on it.
    pub held_table: f64,
}

impl Margins {
    /// With the heights above the table that the limits ask for.
    pub fn of(limits: &Limits) -> Self {
        Self {
            table: limits.link_clearance,
            fingertip: limits.fingertip_clearance,
            ..Self::default()
        }
    }
}

impl Default for Margins {
    fn default() -> Self {
        Self {
            own: 0.002,
            fixture: 0.010,
            table: 0.020,
            fingertip: 0.004,
            held: 0.005,
            held_table: -0.003,
        }
    }
}

/// Why a configuration is not free.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum CollisionError {
    /// Two bodies are nearer than they may be.
    #[error("{a} would be {:.1} mm from {b}, {:.1} mm is the least", .distance * 1e3, .least * 1e3)]
    Bodies {
        /// A link or the held object.
        a: String,
        /// A link, a fixture or the table.
        b: String,
        /// Metres.
        distance: f64,
        /// Metres.
        least: f64,
    },
    /// A joint or the knuckle angle is NaN or infinite.
    #[error("joints {q:?} with knuckle {knuckle} are not finite")]
    NotFinite {
        /// Rad.
        q: Joints,
        /// Rad.
        knuckle: f64,
    },
}

/// The pair that is nearest to its margin.
#[derive(Debug, Clone, PartialEq)]
pub struct Clearance {
    /// A link or the held object.
    pub a: String,
    /// A link, a fixture or the table.
    pub b: String,
    /// Between the two (m).
    pub distance: f64,
    /// What is left of it above the pair's margin (m), the least of all pairs.
    pub slack: f64,
}

/// What the gripper carries: convex parts fixed to `tool0`.
#[derive(Debug, Clone)]
pub struct HeldObject {
    /// What the operator reads.
    pub name: String,
    parts: Vec<ConvexPart>,
    touching: Vec<String>,
}

impl HeldObject {
    /// `parts` in the object's frame and `pose` = `T_tool0_object`. Fixtures named in `touching` (the
    /// shelf that it stands on) may be touched by it.
    pub fn new(name: &str, parts: Vec<ConvexPart>, pose: &Pose, touching: &[&str]) -> Self {
        let parts = parts.into_iter().map(|p| p.moved(pose)).collect();
        let touching = touching.iter().map(|s| (*s).into()).collect();
        Self { name: name.into(), parts, touching }
    }
}

/// How far the arm may go on along `dq` (rad for the whole edge).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Advance<'a> {
    /// The edge's joint differences.
    pub dq: &'a Joints,
    /// What is left of the edge, 0..=1.
    pub remaining: f64,
    /// How far shapes may intrude into their margins between two looks (m).
    pub slip: f64,
}

/// Robot, table and fixtures.
#[derive(Debug, Clone)]
pub struct CollisionWorld {
    model: BodyModel,
    pairs: Vec<(usize, usize)>,
    fixtures: Vec<(String, ConvexPart, Placed)>,
    margins: Margins,
    table_z: f64,
}

#[derive(Clone, Copy)]
enum Mode<'a> {
    Check,
    Nearest,
    Advance(Advance<'a>),
}

/// Index of a robot's part, of a held part, a fixture's part or the table.
#[derive(Clone, Copy)]
enum Id {
    Robot(usize),
    Held,
    Fixture(usize),
    Table,
}

/// The least of what was looked for, and whose it is.
struct Search<'a> {
    mode: Mode<'a>,
    /// `Nearest`: slack; `Advance`: fraction of the edge.
    best: f64,
    found: Option<(Id, Id, f64, f64)>,
}

impl Search<'_> {
    /// Distances of this or more do not matter for a pair with margin `least` that closes at `rate`.
    fn enough(&self, least: f64, rate: f64) -> f64 {
        match self.mode {
            Mode::Check => least,
            Mode::Nearest => self.best + least,
            Mode::Advance(a) => least + (self.best * rate - a.slip).max(0.0),
        }
    }

    /// False ends the search: a collision.
    fn see(&mut self, ids: (Id, Id), distance: f64, least: f64, rate: f64) -> bool {
        let slack = distance - least;
        let found = Some((ids.0, ids.1, distance, least));
        match self.mode {
            Mode::Nearest => {
                if slack < self.best {
                    (self.best, self.found) = (slack, found);
                }
                true
            }
            _ if slack < 0.0 => {
                self.found = found;
                false
            }
            Mode::Check => true,
            Mode::Advance(a) => {
                if rate > 0.0 {
                    self.best = self.best.min((slack + a.slip) / rate);
                }
                true
            }
        }
    }

    fn rate(&self, reach: &Joints, from: usize, to: usize) -> f64 {
        let Mode::Advance(a) = self.mode else { return 0.0 };
        (from..to).map(|j| a.dq[j].abs() * reach[j]).sum()
    }
}

impl CollisionWorld {
    /// From the URDF's collision primitives, fixtures and the height of the table (m, `base_link`).
    ///
    /// Pairs that may touch are left out by construction: parts of one link or of links next to each
    /// other, all of the hand among itself, and whatever does not move against the fixtures. Base and
    /// shoulder stand on the table and are not checked against it.
    ///
    /// # Errors
    /// [`WorkcellError`].
    pub fn new(
        model: &RobotModel,
        cell: &Workcell,
        margins: Margins,
        table_z: f64,
    ) -> Result<Self, WorkcellError> {
        let model = BodyModel::new(model)
            .map_err(|(name, source)| WorkcellError::Shape { name, source })?;
        let fixtures = cell.parts()?.into_iter();
        let fixtures = fixtures.flat_map(|(name, parts)| {
            parts.into_iter().map(move |p| {
                let at = p.place(&DPose3::IDENTITY);
                (name.clone(), p, at)
            })
        });
        let n = model.parts.len();
        let depth = |i: usize| model.parts[i].depth;
        let all = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        let pairs = all.filter(|(i, j)| depth(*i) + 1 < depth(*j)).collect();
        Ok(Self { fixtures: fixtures.collect(), pairs, model, margins, table_z })
    }

    /// Checks one configuration: arm joints `q` and `knuckle` (rad), and what is held.
    ///
    /// # Errors
    /// [`CollisionError`] with the first pair found.
    pub fn check(
        &self,
        q: &Joints,
        knuckle: f64,
        held: Option<&HeldObject>,
    ) -> Result<(), CollisionError> {
        let mut s = Search { mode: Mode::Check, best: 0.0, found: None };
        self.search(q, knuckle, held, &mut s)
    }

    /// The pair with the least slack; negative slack is a collision.
    ///
    /// # Errors
    /// [`CollisionError::NotFinite`].
    pub fn distance(
        &self,
        q: &Joints,
        knuckle: f64,
        held: Option<&HeldObject>,
    ) -> Result<Clearance, CollisionError> {
        let mut s = Search { mode: Mode::Nearest, best: f64::MAX, found: None };
        self.search(q, knuckle, held, &mut s)?;
        let none = || Clearance {
            a: String::new(),
            b: String::new(),
            distance: f64::MAX,
            slack: f64::MAX,
        };
        Ok(s.found.map_or_else(none, |(a, b, distance, least)| Clearance {
            a: self.name(a, held),
            b: self.name(b, held),
            distance,
            slack: distance - least,
        }))
    }

    /// The fraction of the edge, at most what remains, over which no pair comes nearer than its margin
    /// less the slip: no point of a part is faster than the sum of the joints' speeds times its greatest
    /// distance from their axes.
    pub(crate) fn advance(
        &self,
        q: &Joints,
        knuckle: f64,
        held: Option<&HeldObject>,
        by: Advance,
    ) -> Result<f64, CollisionError> {
        let mut s = Search { mode: Mode::Advance(by), best: by.remaining, found: None };
        self.search(q, knuckle, held, &mut s)?;
        Ok(s.best)
    }

    fn search(
        &self,
        q: &Joints,
        knuckle: f64,
        held: Option<&HeldObject>,
        s: &mut Search,
    ) -> Result<(), CollisionError> {
        if !q.iter().all(|v| v.is_finite()) || !knuckle.is_finite() {
            return Err(CollisionError::NotFinite { q: *q, knuckle });
        }
        let poses = self.model.poses(q, knuckle);
        let parts = self.model.parts.iter();
        let at: Vec<Placed> = parts.map(|p| p.part.place(&poses[p.body])).collect();
        let free = self.robot(&at, s)
            && held.is_none_or(|h| self.held(&poses[self.model.tool], &at, h, s));
        match s.found {
            Some((a, b, distance, least)) if !free => Err(CollisionError::Bodies {
                a: self.name(a, held),
                b: self.name(b, held),
                distance,
                least,
            }),
            _ => Ok(()),
        }
    }

    /// The robot's parts against table, fixtures and each other; false at a collision.
    fn robot(&self, at: &[Placed], s: &mut Search) -> bool {
        let m = &self.margins;
        for (i, p) in self.model.parts.iter().enumerate().filter(|(_, p)| p.depth > 1) {
            let least = if p.finger { m.fingertip } else { m.table };
            // Turning about the vertical does not change a height.
            let rate = s.rate(&p.reach, 1, p.depth);
            let height = p.part.lowest(&at[i]) - self.table_z;
            if !s.see((Id::Robot(i), Id::Table), height, least, rate) {
                return false;
            }
        }
        for (i, p) in self.model.parts.iter().enumerate().filter(|(_, p)| p.depth > 0) {
            let rate = s.rate(&p.reach, 0, p.depth);
            for (f, (_, fixture, there)) in self.fixtures.iter().enumerate() {
                let ids = (Id::Robot(i), Id::Fixture(f));
                if !pair(s, ids, (&p.part, &at[i]), (fixture, there), m.fixture, rate) {
                    return false;
                }
            }
        }
        for &(i, j) in &self.pairs {
            let (a, b) = (&self.model.parts[i], &self.model.parts[j]);
            let rate = s.rate(&b.reach, a.depth, b.depth);
            let ids = (Id::Robot(i), Id::Robot(j));
            if !pair(s, ids, (&a.part, &at[i]), (&b.part, &at[j]), m.own, rate) {
                return false;
            }
        }
        true
    }

    /// The held object against table, fixtures and the arm up to wrist 2.
    fn held(&self, tool: &DPose3, robot: &[Placed], h: &HeldObject, s: &mut Search) -> bool {
        let m = &self.margins;
        let tool0 = *tool * convert::pose(&self.model.tool0);
        let shift = self.model.tool0.translation.vector.norm();
        for part in &h.parts {
            let at = part.place(&tool0);
            let extent = shift + part.centre.length() + part.bound;
            let reach = self.model.tool_reach.map(|r| r + extent);
            let rate = s.rate(&reach, 1, 6);
            let height = part.lowest(&at) - self.table_z;
            if !s.see((Id::Held, Id::Table), height, m.held_table, rate) {
                return false;
            }
            let rate = s.rate(&reach, 0, 6);
            for (f, (name, fixture, there)) in self.fixtures.iter().enumerate() {
                if h.touching.iter().any(|t| t == name) {
                    continue;
                }
                let ids = (Id::Held, Id::Fixture(f));
                if !pair(s, ids, (part, &at), (fixture, there), m.held, rate) {
                    return false;
                }
            }
            for (i, p) in self.model.parts.iter().enumerate().filter(|(_, p)| p.depth < 6) {
                let rate = s.rate(&reach, p.depth, 6);
                let ids = (Id::Held, Id::Robot(i));
                if !pair(s, ids, (part, &at), (&p.part, &robot[i]), m.held, rate) {
                    return false;
                }
            }
        }
        true
    }

    fn name(&self, id: Id, held: Option<&HeldObject>) -> String {
        match id {
            Id::Robot(i) => self.model.parts[i].link.clone(),
            Id::Fixture(i) => self.fixtures[i].0.clone(),
            Id::Held => held.map(|h| h.name.clone()).unwrap_or_default(),
            Id::Table => "table".into(),
        }
    }
}

/// Looks at a pair if a cheap lower bound of its distance does not rule it out; false at a collision.
fn pair(
    s: &mut Search,
    ids: (Id, Id),
    (a, at): (&ConvexPart, &Placed),
    (b, there): (&ConvexPart, &Placed),
    least: f64,
    rate: f64,
) -> bool {
    let enough = s.enough(least, rate);
    if a.at_least(at, b, there, enough) >= enough {
        return true;
    }
    let d = distance((a, at), (b, there), enough);
    d >= enough || s.see(ids, d, least, rate)
}
