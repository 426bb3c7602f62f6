//! `reach`: from anywhere in the home region over a point above the object straight down its approach.

use super::check::{TIP, above_table, finite};
use super::sampling::{Spread, downward, in_disc, lerp, small_turn, symmetric, tilt};
use super::{Made, Maker, canonical_start, limits, shape_of};
use crate::path::{Limits, arcs, retime, round_corners};
use crate::{
    Demonstration, DemonstrationError, GenerationMode, GripperEnd, ObjectShape, ProcedureDemo,
    Task, warp_dmp, warp_paper, warp_rigid,
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use tdv_geometry::Pose;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};

/// Half width (m) over which corners of the path are rounded.
const ROUND: f64 = 0.03;
/// How far the gripper has backed off after a release when it reaches for the next object (m).
const RETREAT: [f64; 2] = [0.05, 0.15];
/// Half the width of the open fingers and their carriers (m), beside the tcp.
const FINGERS: f64 = 0.06;

pub(super) struct Reach<'a> {
    task: &'a Task,
    procedure: &'a ProcedureDemo,
    nominal: Pose,
    /// `T_base_tcp` where the gripper has let go before, if it has.
    released: Option<Pose>,
    shape: ObjectShape,
    plan: ReachPlan,
    spread: Spread,
}

impl<'a> Reach<'a> {
    pub(super) fn new(
        demo: &'a Demonstration,
        task: &'a Task,
        index: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self, DemonstrationError> {
        let procedure = &demo.procedures[index];
        let shape = shape_of(task, &procedure.reference)?.clone();
        let plan = ReachPlan::new(
            procedure.goal(),
            &shape,
            task.generation.pregrasp_distance,
            task.generation.margin,
        );
        // What is grasped is carried next, and must not stand where it goes to.
        let nominal = demo.reference_of((index + 1).min(demo.procedures.len() - 1));
        let before = index.checked_sub(1).filter(|b| demo.procedures[*b].end == GripperEnd::Open);
        let released = before.map(|b| {
            let end = demo.reference_of(b) * demo.procedures[b].goal();
            demo.grasp_of(b).map_or(end, |g| end * g)
        });
        let spread = Spread::new(7, rng);
        Ok(Self { task, procedure, nominal, released, shape, plan, spread })
    }

    /// Backed off from where something was let go.
    fn retreated(&self, from: &Pose, rng: &mut ChaCha8Rng) -> Pose {
        let r = &self.task.generation.recovery;
        let back = Pose::translation(0.0, 0.0, -lerp(RETREAT, rng.random::<f64>()));
        let mut p = from * back;
        for v in p.translation.vector.iter_mut() {
            *v += symmetric(rng, r.position);
        }
        p.rotation *= small_turn(rng, r.angle_deg.to_radians());
        p
    }
}

impl Maker for Reach<'_> {
    fn ordinary(&mut self, rng: &mut ChaCha8Rng) -> Result<Made, String> {
        self.spread.advance();
        let s: [f64; 7] = std::array::from_fn(|i| self.spread.coordinate(i));
        let config = &self.task.generation;
        let w = self.task.workspace_of(&self.procedure.name);
        let xy = [lerp(w.x, s[0]), lerp(w.y, s[1])];
        if !w.allows(xy, [self.nominal.translation.x, self.nominal.translation.y]) {
            return Err("start in the excluded disc".into());
        }
        let about = |a: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), a);
        let yaw = lerp(config.yaw_deg, s[2]).to_radians();
        let object = Pose::from_parts([xy[0], xy[1], -self.shape.bottom].into(), about(yaw));
        let h = &config.home;
        let at = [lerp(h.x, s[3]), lerp(h.y, s[4]), lerp(h.z, s[5])];
        let tool_yaw = std::f64::consts::PI * (2.0 * s[6] - 1.0);
        let tool = match &self.released {
            Some(from) if rng.random::<bool>() => self.retreated(from, rng),
            _ => downward(at, tool_yaw, tilt(rng, h.tilt_deg.to_radians())),
        };
        let start = object.inverse() * tool;
        let start = canonical_start(self.procedure, &start, rng).apply(&start);
        let (path, rule) = self.bend(&start)?;
        Ok(Made { path, reference: object, rule })
    }

    fn bend(&self, start: &Pose) -> Result<(Vec<Pose>, &'static str), String> {
        let config = &self.task.generation;
        let bent = match config.mode {
            GenerationMode::Paper | GenerationMode::Rigid | GenerationMode::Dmp => {
                let demo: Vec<Pose> = self.procedure.trajectory.poses().copied().collect();
                let demo = retime(&demo, &limits(config, 0.0), config.retime.dt);
                match config.mode {
                    GenerationMode::Rigid => {
                        (warp_rigid(&demo, start, config.alpha).poses, "rigid")
                    }
                    GenerationMode::Dmp => (warp_dmp(&demo, start).poses, "dmp"),
                    _ => (warp_paper(&demo, start, config.alpha)?.poses, "paper"),
                }
            }
            GenerationMode::Repaired => {
                let path = self.plan.path(start);
                self.plan.check(&path)?;
                (path, "approach")
            }
        };
        finite(&bent.0)?;
        Ok(bent)
    }

    fn recovery(&mut self, base: &Made, rng: &mut ChaCha8Rng) -> Result<Made, String> {
        let r = &self.task.generation.recovery;
        let arcs = arcs(&base.path);
        let total = arcs[arcs.len() - 1];
        let at = total * (0.05 + 0.93 * rng.random::<f64>());
        let j = arcs.partition_point(|s| *s < at).min(base.path.len() - 2);
        let p = base.path[j];
        let displaced = rng.random::<f64>() < r.displaced_share;
        // Between the object's walls and the fingers there are only millimetres.
        let room = ((total - arcs[j]) / 0.15).clamp(0.1, 1.0);
        let shift = if displaced {
            let [x, y] = in_disc(rng, r.displaced);
            Vector3::new(x, y, symmetric(rng, 0.5 * r.position))
        } else {
            let a = r.position * room;
            Vector3::new(symmetric(rng, a), symmetric(rng, a), symmetric(rng, a))
        };
        let turn = small_turn(rng, r.angle_deg.to_radians() * if displaced { 1.0 } else { room });
        let mut start = Pose::from_parts((p.translation.vector + shift).into(), p.rotation * turn);
        let floor = self.shape.bottom + TIP + 0.005;
        start.translation.z = start.translation.z.max(floor);
        if self.plan.is_inside(&start) {
            return Err("beside the path inside the object".into());
        }
        let path = self.plan.path(&start);
        self.plan.check(&path)?;
        finite(&path)?;
        Ok(Made { path, reference: base.reference, rule: "recovery" })
    }

    fn tool(&self, reference: &Pose, pose: &Pose) -> Pose {
        reference * pose
    }

    fn limits(&self) -> Limits {
        limits(&self.task.generation, self.task.generation.pregrasp_distance)
    }
}

/// The geometry of reaching for an object, in its frame.
pub(super) struct ReachPlan {
    grasp: Pose,
    approach: Vector3<f64>,
    /// Length of the straight last part (m).
    length: f64,
    /// Height of the tcp (m) at which the object is crossed.
    safe: f64,
    top: f64,
    bottom: f64,
    radius: f64,
    margin: f64,
}

impl ReachPlan {
    pub(super) fn new(grasp: Pose, shape: &ObjectShape, distance: f64, margin: f64) -> Self {
        let approach = grasp.rotation * Vector3::z();
        let safe = shape.top() + margin + TIP + ROUND;
        // From above the straight part has to begin where the fingers clear the object.
        let down = -approach.z;
        let length = if down > 0.3 {
            distance.max((safe - grasp.translation.z) / down)
        } else {
            distance.max(shape.radius + FINGERS)
        };
        let (top, bottom, radius) = (shape.top(), shape.bottom, shape.radius);
        Self { grasp, approach, length, safe, top, bottom, radius, margin }
    }

    /// Distance before the grasp along the approach, distance beside it, and angle to it.
    fn beside(&self, pose: &Pose) -> (f64, f64, f64) {
        let d = pose.translation.vector - self.grasp.translation.vector;
        let along = -d.dot(&self.approach);
        let beside = (d + self.approach * along).norm();
        (along, beside, pose.rotation.angle_to(&self.grasp.rotation))
    }

    /// Near enough to the approach line to go on along it: 10 mm at the grasp, opening upwards.
    fn in_funnel(&self, pose: &Pose) -> bool {
        let (along, beside, angle) = self.beside(pose);
        (-0.02..=self.length).contains(&along)
            && beside <= 0.010 + 0.35 * along.max(0.0)
            && angle <= 0.15 + 2.5 * along.max(0.0)
    }

    /// A tool that cannot be there because the object is.
    pub(super) fn is_inside(&self, pose: &Pose) -> bool {
        let p = &pose.translation;
        p.z - TIP < self.top && p.x.hypot(p.y) < self.radius && !self.in_funnel(pose)
    }

    /// Start -> (up to a safe height) -> above the pregrasp -> pregrasp -> grasp, corners rounded; from
    /// inside the funnel back onto the approach line.
    pub(super) fn path(&self, start: &Pose) -> Vec<Pose> {
        let back = |d: f64| {
            let p = self.grasp.translation.vector - self.approach * d;
            Pose::from_parts(p.into(), self.grasp.rotation)
        };
        let (along, beside, _) = self.beside(start);
        if self.in_funnel(start) {
            let join = along - (1.5 * beside).max(0.3 * along);
            let mut corners = vec![*start];
            if join > 0.003 {
                corners.push(back(join));
            }
            corners.push(self.grasp);
            return round_corners(&corners, 0.5 * ROUND, (0.5 * join).clamp(0.0, 0.02));
        }
        let pre = back(self.length);
        let mut corners = vec![*start];
        let raised = |p: &Pose| {
            let mut q = *p;
            q.translation.z = q.translation.z.max(self.safe);
            q
        };
        corners.push(raised(start));
        corners.push(raised(&pre));
        corners.push(pre);
        corners.push(self.grasp);
        round_corners(&corners, ROUND, (self.length - ROUND).max(0.02))
    }

    /// Fingers neither through the table nor through the object.
    pub(super) fn check(&self, path: &[Pose]) -> Result<(), String> {
        above_table(path, self.bottom)?;
        let Some(first) = path.first() else { return Ok(()) };
        for p in path {
            let t = &p.translation;
            let near = t.x.hypot(t.y) < self.radius + FINGERS;
            let low = t.z - TIP < self.top + 0.5 * self.margin;
            let risen = (t.x - first.translation.x).hypot(t.y - first.translation.y) > 0.005;
            if near && low && risen && !self.in_funnel(p) {
                return Err("sweeps the object".into());
            }
        }
        Ok(())
    }
}
