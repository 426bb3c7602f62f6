//! Every procedure but a reach: the demonstrated path, bent.

use super::lead_in::lead_in;
use super::sampling::{Spread, downward, in_disc, lerp, small_turn, symmetric, tilt};
use super::{Made, Maker, canonical_start, check, limits, shape_of};
use crate::path::{Limits, arcs, densify, retime};
use crate::sequence::Role;
use crate::warp::lift_first;
use crate::{
    Demonstration, DemonstrationError, GenerationMode, GripperEnd, ObjectShape, ProcedureDemo,
    Task, WarpConfig, WarpRule, warp_dmp, warp_paper, warp_repaired, warp_rigid,
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use tdv_geometry::nalgebra::{UnitQuaternion, Vector3};
use tdv_geometry::{Pose, smooth_step, yaw_of};

const SAMPLES: usize = 240;
/// Part of a recovery's offset by which a procedure's start may miss the end of the one before.
const CHAIN: f64 = 1.0 / 3.0;

/// Where the trajectories start.
enum Begin<'a> {
    /// An object in its workspace.
    Workspace,
    /// The gripper in its home region.
    Home,
    /// At the end of the procedure before; with that procedure's nominal `T_base_reference`.
    Before(&'a ProcedureDemo, Pose),
}

pub(super) struct PathTask<'a> {
    task: &'a Task,
    procedure: &'a ProcedureDemo,
    grasp: Pose,
    nominal: Pose,
    reference: ObjectShape,
    /// None when the gripper itself moves.
    moving: Option<ObjectShape>,
    begin: Begin<'a>,
    demo: Vec<Pose>,
    warp: WarpConfig,
    lifts: bool,
    spread: Spread,
}

impl<'a> PathTask<'a> {
    pub(super) fn new(
        demo: &'a Demonstration,
        task: &'a Task,
        index: usize,
        rng: &mut ChaCha8Rng,
        notes: &mut Vec<String>,
    ) -> Result<Self, DemonstrationError> {
        let config = &task.generation;
        let procedure = &demo.procedures[index];
        let reference = shape_of(task, &procedure.reference)?;
        let begin = match demo.role(index) {
            Role::GoesOn => {
                Begin::Before(&demo.procedures[index - 1], demo.reference_of(index - 1))
            }
            Role::Carry => Begin::Workspace,
            Role::Hand | Role::Reach => Begin::Home,
        };
        let moving = task.objects.get(&procedure.moving).cloned();
        let mut poses: Vec<Pose> = procedure.trajectory.poses().copied().collect();
        if matches!(demo.role(index), Role::Hand) {
            // A person's hand may come from beside the table, below its top; the gripper cannot.
            let low =
                poses.iter().take_while(|p| !check::fingers_above(p, reference.bottom)).count();
            if (1..poses.len()).contains(&low) {
                poses.drain(..low);
                notes.push(format!(
                    "procedure '{}': its first {low} samples, with fingers below the table, are left out",
                    procedure.name
                ));
            }
        }
        let (mut path, mut warp, mut lifts) =
            (poses, WarpConfig { alpha: config.alpha, ..Default::default() }, false);
        match config.mode {
            GenerationMode::Repaired => {
                path = densify(&path, SAMPLES);
                let wanted = matches!(begin, Begin::Workspace) && config.lift > 0.0;
                if wanted {
                    let (held, from) = lift_first(&path, config.lift, config.alpha);
                    if let Some(from) = from {
                        (path, warp.fade_from, lifts) = (densify(&held, SAMPLES), from, true);
                    } else {
                        notes.push(format!(
                            "procedure '{}': the demonstration does not rise by {} m before its last part; \
                             no lift is put first",
                            procedure.name, config.lift
                        ));
                    }
                }
            }
            // The paper keeps the number of samples: the demonstration is timed once, then warped. A
            // movement primitive learns from samples even in time.
            GenerationMode::Paper | GenerationMode::Dmp => {
                path = retime(&path, &limits(config, 0.0), config.retime.dt);
            }
            GenerationMode::Rigid => path = densify(&path, SAMPLES),
        }
        Ok(Self {
            task,
            procedure,
            grasp: demo.grasp_of(index).unwrap_or_else(Pose::identity),
            nominal: demo.reference_of(index),
            reference: reference.clone(),
            moving,
            begin,
            demo: path,
            warp,
            lifts,
            spread: Spread::new(5, rng),
        })
    }

    /// `T_base_reference` moved about its demonstrated place.
    fn draw_reference(&self, nominal: &Pose, rng: &mut ChaCha8Rng) -> Pose {
        let [dx, dy] = in_disc(rng, self.task.generation.reference_spread);
        let mut p = *nominal;
        p.translation.x += dx;
        p.translation.y += dy;
        p
    }

    /// `T_reference_moving` of a start.
    fn draw_start(&mut self, reference: &Pose, rng: &mut ChaCha8Rng) -> Result<Pose, String> {
        let config = &self.task.generation;
        let s: [f64; 5] = std::array::from_fn(|i| self.spread.coordinate(i));
        let first = self.demo[0];
        if let Begin::Before(before, nominal) = &self.begin {
            let base = if before.reference == self.procedure.reference {
                *reference
            } else {
                self.draw_reference(nominal, rng)
            };
            let end = reference.inverse() * base * before.goal();
            let a = CHAIN * config.recovery.position;
            let shift = Vector3::new(symmetric(rng, a), symmetric(rng, a), symmetric(rng, a));
            let turn = small_turn(rng, CHAIN * config.recovery.angle_deg.to_radians());
            return Ok(Pose::from_parts(
                (end.translation.vector + shift).into(),
                end.rotation * turn,
            ));
        }
        if matches!(self.begin, Begin::Home) {
            // The paper moves no hand's path in space, and the comparators have no way to it either.
            if config.mode != GenerationMode::Repaired {
                return Ok(first);
            }
            let h = &config.home;
            let yaw = std::f64::consts::PI * (2.0 * s[2] - 1.0);
            let at = [lerp(h.x, s[0]), lerp(h.y, s[1]), lerp(h.z, s[3])];
            let start = downward(at, yaw, tilt(rng, h.tilt_deg.to_radians()));
            return Ok(reference.inverse() * start);
        }
        let w = self.task.workspace_of(&self.procedure.name);
        let xy = [lerp(w.x, s[0]), lerp(w.y, s[1])];
        if !w.allows(xy, [reference.translation.x, reference.translation.y]) {
            return Err("start in the excluded disc".into());
        }
        let yaw = lerp(config.yaw_deg, s[2]).to_radians();
        let demonstrated = reference.rotation * first.rotation;
        let about = |a: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), a);
        let turn = if config.yaw_follows {
            let to_goal = |p: &Pose| {
                let v = self.demo[self.demo.len() - 1].translation.vector - p.translation.vector;
                v.y.atan2(v.x)
            };
            let start = reference.inverse() * Pose::translation(xy[0], xy[1], 0.0);
            to_goal(&start) - to_goal(&first)
        } else {
            yaw - yaw_of(&demonstrated)
        };
        let mut draw = |r: [f64; 2]| lerp(r, rng.random::<f64>()).to_radians();
        let (roll, pitch) = (draw(config.roll_deg), draw(config.pitch_deg));
        let tilted = tilt(rng, config.tilt_deg.to_radians())
            * UnitQuaternion::from_euler_angles(roll, pitch, 0.0);
        let mut start = reference.inverse()
            * Pose::from_parts([xy[0], xy[1], 0.0].into(), tilted * about(turn) * demonstrated);
        // Both stand on the same table: the height above it is the demonstrated one.
        start.translation.z = first.translation.z;
        if let Some(m) = &self.moving {
            // What lies tilted does not stand in the table.
            if roll != 0.0 || pitch != 0.0 {
                let low = self.reference.bottom - check::lowest(&start, m);
                start.translation.z += low.max(0.0);
            }
            if check::inside(&start, m, &self.reference) {
                return Err("start inside the reference object".into());
            }
        }
        Ok(start)
    }

    fn check(&self, path: &[Pose], from_rest: bool) -> Result<(), String> {
        check::finite(path)?;
        match &self.moving {
            Some(m) => {
                let lands = self.procedure.end == GripperEnd::Open;
                check::carried(path, m, &self.reference, from_rest && self.lifts, lands)
            }
            None => check::above_table(path, self.reference.bottom),
        }
    }

    /// The rest of `path` from sample `j` on, started at `start` instead.
    fn rejoin(&self, path: &[Pose], j: usize, start: &Pose) -> Vec<Pose> {
        let arcs = arcs(path);
        let total = arcs[arcs.len() - 1];
        let rest = (total - arcs[j]).max(1e-9);
        let until = ((total * (1.0 - self.warp.alpha) - arcs[j]) / rest).max(0.6);
        let shift = start.translation.vector - path[j].translation.vector;
        let turn = (path[j].rotation.inverse() * start.rotation).scaled_axis();
        let mut out: Vec<Pose> = path[j..]
            .iter()
            .zip(&arcs[j..])
            .map(|(p, s)| {
                let w = 1.0 - smooth_step((s - arcs[j]) / rest / until);
                if w == 0.0 {
                    return *p;
                }
                let rotation = p.rotation * UnitQuaternion::from_scaled_axis(turn * w);
                Pose::from_parts((p.translation.vector + shift * w).into(), rotation)
            })
            .collect();
        out[0] = *start;
        out
    }
}

impl Maker for PathTask<'_> {
    fn ordinary(&mut self, rng: &mut ChaCha8Rng) -> Result<Made, String> {
        self.spread.advance();
        let reference = self.draw_reference(&self.nominal, rng);
        let start = self.draw_start(&reference, rng)?;
        let start = canonical_start(self.procedure, &start, rng).apply(&start);
        let (path, rule) = self.bend(&start)?;
        Ok(Made { path, reference, rule })
    }

    fn bend(&self, start: &Pose) -> Result<(Vec<Pose>, &'static str), String> {
        let bent = match self.task.generation.mode {
            GenerationMode::Paper => {
                (warp_paper(&self.demo, start, self.task.generation.alpha)?.poses, "paper")
            }
            GenerationMode::Rigid => {
                (warp_rigid(&self.demo, start, self.task.generation.alpha).poses, "rigid")
            }
            GenerationMode::Dmp => (warp_dmp(&self.demo, start).poses, "dmp"),
            // A hand's path is not moved in space: a way to its begin is put before it.
            GenerationMode::Repaired if matches!(self.begin, Begin::Home) => {
                let margin = self.task.generation.margin;
                (lead_in(&self.demo, start, &self.reference, margin)?, "lead_in")
            }
            GenerationMode::Repaired => {
                let w = warp_repaired(&self.demo, start, &self.warp);
                self.check(&w.poses, true)?;
                let rule = if w.rule == WarpRule::LogPolar { "log_polar" } else { "offset_fade" };
                (w.poses, rule)
            }
        };
        check::finite(&bent.0)?;
        Ok(bent)
    }

    fn recovery(&mut self, base: &Made, rng: &mut ChaCha8Rng) -> Result<Made, String> {
        let r = &self.task.generation.recovery;
        let arcs = arcs(&base.path);
        let total = arcs[arcs.len() - 1];
        let at = total * (0.05 + 0.90 * rng.random::<f64>());
        let j = arcs.partition_point(|s| *s < at).min(base.path.len() - 2);
        let p = base.path[j];
        let rest = total - arcs[j];
        let goal = self.procedure.goal();
        let high = p.translation.z - goal.translation.z > self.task.generation.lift.max(0.02);
        let displaced = high && rest > 0.10 && rng.random::<f64>() < r.displaced_share;
        // Beside the end of the path there is no room for much.
        let room = (rest / 0.15).clamp(0.1, 1.0);
        let shift = if displaced {
            let [x, y] = in_disc(rng, r.displaced);
            Vector3::new(x, y, symmetric(rng, 0.5 * r.position))
        } else {
            let a = r.position * room;
            Vector3::new(symmetric(rng, a), symmetric(rng, a), symmetric(rng, a))
        };
        let turn = small_turn(rng, r.angle_deg.to_radians() * room);
        let mut start = Pose::from_parts((p.translation.vector + shift).into(), p.rotation * turn);
        if let Some(m) = &self.moving {
            // What would be inside the table stands on it instead.
            let low = check::lowest(&start, m);
            start.translation.z += (self.reference.bottom - low).max(0.0);
        }
        let path = self.rejoin(&base.path, j, &start);
        self.check(&path, false)?;
        Ok(Made { path, reference: base.reference, rule: "recovery" })
    }

    fn tool(&self, reference: &Pose, pose: &Pose) -> Pose {
        if self.moving.is_some() { reference * pose * self.grasp } else { reference * pose }
    }

    fn limits(&self) -> Limits {
        limits(&self.task.generation, 0.0)
    }
}
