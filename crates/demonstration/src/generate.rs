//! Many trajectories from one demonstration.

mod check;
mod lead_in;
mod path_task;
mod reach;
mod sampling;

pub(crate) use check::lowest;

use crate::path::{Limits, retime};
use crate::sequence::Role;
use crate::{
    Dataset, Demonstration, DemonstrationError, GenerationConfig, GenerationMode, HistoryNoise,
    Hold, ObjectShape, ProcedureDemo, ProcedureSet, Task, Variant,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tdv_geometry::{Pose, PoseTrajectory};

/// Asked for tool poses `T_base_tcp`; an error is the reason to reject the trajectory.
pub type Reachable<'a> = &'a dyn Fn(&Pose) -> Result<(), String>;

/// The gripper on a trajectory.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolPose<'a> {
    /// `T_base_tcp`.
    pub tool: Pose,
    /// The fingers are closed on something.
    pub grip: bool,
    /// The carried object and its `T_base_object`.
    pub object: Option<(&'a str, Pose)>,
}

/// Asked whether the arm, the gripper or what it carries hits something; an error is the reason to reject
/// the trajectory.
pub type Collides<'a> = &'a dyn Fn(&ToolPose<'_>) -> Result<(), String>;

/// What generation may ask of the outside. Every fifth pose is asked for.
#[derive(Clone, Copy, Default)]
pub struct GenerateOptions<'a> {
    /// Whether the arm can stand there; none = everything is reachable.
    pub reachable: Option<Reachable<'a>>,
    /// Whether it is free there; none = only what generation itself knows is looked at: the table, the
    /// object reached for and the reference.
    pub collides: Option<Collides<'a>>,
}

/// What became of one procedure's starts.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcedureReport {
    /// Name of the procedure.
    pub name: String,
    /// Ordinary trajectories.
    pub accepted: usize,
    /// Trajectories that start beside the path.
    pub recoveries: usize,
    /// Starts tried, for both.
    pub tried: usize,
    /// Rejected starts by reason.
    pub rejected: BTreeMap<String, usize>,
    /// Accepted ordinary trajectories by the rule that bent them.
    pub rules: BTreeMap<String, usize>,
    /// Largest distance of a last pose from the goal (m); zero in mode repaired.
    pub worst_end_miss: f64,
    /// Longest trajectory (s).
    pub longest: f64,
}

/// What became of a generation.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GenerationReport {
    /// One entry per procedure.
    pub procedures: Vec<ProcedureReport>,
    /// What a reader of the set should know.
    pub notes: Vec<String>,
}

/// [`generate_with`] without a reachability check.
///
/// # Errors
/// As [`generate_with`].
pub fn generate(
    demo: &Demonstration,
    task: &Task,
    count: usize,
    seed: u64,
) -> Result<(Dataset, GenerationReport), DemonstrationError> {
    generate_with(demo, task, count, seed, &GenerateOptions::default())
}

/// Makes `count` ordinary trajectories per procedure and (mode repaired) `recovery.share * count` that
/// start beside the path, all at the one speed law of the task, sampled every `retime.dt` seconds, in the
/// procedure's reference frame and canonical (see [`crate::Canonical`]). A `count` of one gives the
/// demonstration itself and nothing else. The same arguments give the same bytes.
///
/// # Errors
/// [`DemonstrationError::Invalid`] for a task with problems or a demonstration of another task,
/// [`DemonstrationError::StandsStill`], [`DemonstrationError::EmptyWorkspace`],
/// [`DemonstrationError::TooManyRejections`] with the counts by reason.
pub fn generate_with(
    demo: &Demonstration,
    task: &Task,
    count: usize,
    seed: u64,
    options: &GenerateOptions<'_>,
) -> Result<(Dataset, GenerationReport), DemonstrationError> {
    task.check(&format!("task '{}'", task.name))?;
    check_demonstration(demo, task, count)?;
    let config = &task.generation;
    let mut report = GenerationReport::default();
    let mut procedures = Vec::new();
    let holds = demo.holds();
    for (index, procedure) in demo.procedures.iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index as u64);
        check_workspace(demo, task, index, &mut report.notes)?;
        let maker = maker(demo, task, index, &mut rng, &mut report.notes)?;
        let hold = holds.get(index).cloned().unwrap_or_default();
        let outside = Outside { options, hold, procedure };
        let (set, procedure_report) = run(maker, config, count, &mut rng, &outside)?;
        procedures.push(set);
        report.procedures.push(procedure_report);
    }
    let dataset = Dataset {
        task: demo.task.clone(),
        text: demo.text.clone(),
        mode: config.mode,
        seed,
        demonstration: demo.hash(),
        dt: config.retime.dt,
        noise: HistoryNoise {
            position: config.noise_position,
            angle: config.noise_angle_deg.to_radians(),
        },
        procedures,
    };
    Ok((dataset, report))
}

/// The one demonstrated trajectory of a procedure bent to one start (canonical `T_reference_moving`),
/// timed as the training set is: what a robot without feedback would play.
///
/// # Errors
/// As [`generate_with`]; [`DemonstrationError::Invalid`] with the reason for a start that generation
/// would reject, [`DemonstrationError::UnknownProcedure`].
pub fn bend_to(
    demo: &Demonstration,
    task: &Task,
    procedure: usize,
    start: &Pose,
) -> Result<PoseTrajectory, DemonstrationError> {
    check_demonstration(demo, task, 1)?;
    let invalid = |problem: String| DemonstrationError::Invalid {
        what: format!("a trajectory of procedure {procedure}"),
        problems: vec![problem],
    };
    if procedure >= demo.procedures.len() {
        let names: Vec<&str> = demo.procedures.iter().map(|p| p.name.as_str()).collect();
        return Err(DemonstrationError::UnknownProcedure {
            asked: procedure.to_string(),
            known: format!("{}: {}", names.len(), names.join(", ")),
        });
    }
    // Only the drawing of starts is random, and here the start is given.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let maker = maker(demo, task, procedure, &mut rng, &mut Vec::new())?;
    let (path, _) = maker.bend(start).map_err(invalid)?;
    let poses = timed(&path, &task.generation, &maker.limits());
    PoseTrajectory::from_poses(&poses, task.generation.retime.dt)
        .map_err(|e| invalid(e.to_string()))
}

fn maker<'a>(
    demo: &'a Demonstration,
    task: &'a Task,
    index: usize,
    rng: &mut ChaCha8Rng,
    notes: &mut Vec<String>,
) -> Result<Box<dyn Maker + 'a>, DemonstrationError> {
    Ok(if demo.role(index) == Role::Reach {
        Box::new(reach::Reach::new(demo, task, index, rng)?)
    } else {
        Box::new(path_task::PathTask::new(demo, task, index, rng, notes)?)
    })
}

fn shape_of<'a>(task: &'a Task, name: &str) -> Result<&'a ObjectShape, DemonstrationError> {
    task.objects.get(name).ok_or_else(|| DemonstrationError::Invalid {
        what: format!("task '{}'", task.name),
        problems: vec![format!("objects has no entry for '{name}'")],
    })
}

/// Where the object of a reach or a carry may start there must be room; a demonstrated start outside is
/// worth a note.
fn check_workspace(
    demo: &Demonstration,
    task: &Task,
    index: usize,
    notes: &mut Vec<String>,
) -> Result<(), DemonstrationError> {
    let p = &demo.procedures[index];
    let goes_to = match demo.role(index) {
        Role::Reach => index + 1,
        Role::Carry => index,
        Role::Hand | Role::GoesOn => return Ok(()),
    };
    let at = |p: &Pose| [p.translation.x, p.translation.y];
    let reference = at(&demo.reference_of(goes_to));
    let w = task.workspace_of(&p.name);
    if !w.is_usable(reference) {
        return Err(DemonstrationError::EmptyWorkspace {
            procedure: p.name.clone(),
            x: w.x,
            y: w.y,
            radius: w.exclude_radius,
            reference,
        });
    }
    if demo.role(index) == Role::Carry {
        let start = at(&(demo.reference_of(index) * p.trajectory.first().pose));
        if !w.contains(start) {
            notes.push(format!(
                "procedure '{}': the demonstrated start ({:.2}, {:.2}) lies outside the workspace",
                p.name, start[0], start[1]
            ));
        }
    }
    Ok(())
}

/// A path under the speed law of the task, resting at its end for a while.
fn timed(path: &[Pose], config: &GenerationConfig, limits: &Limits) -> Vec<Pose> {
    let timing = &config.retime;
    let mut poses = match config.mode {
        GenerationMode::Paper => path.to_vec(),
        GenerationMode::Repaired | GenerationMode::Rigid | GenerationMode::Dmp => {
            retime(path, limits, timing.dt)
        }
    };
    let hold = (timing.hold / timing.dt).round() as usize;
    poses.extend(poses.last().copied().into_iter().cycle().take(hold));
    poses
}

fn check_demonstration(
    demo: &Demonstration,
    task: &Task,
    count: usize,
) -> Result<(), DemonstrationError> {
    let mut problems = Vec::new();
    if demo.task != task.name {
        problems.push(format!("it is of task '{}', not '{}'", demo.task, task.name));
    }
    if demo.procedures.is_empty() {
        problems.push("it has no procedure".into());
    }
    for p in &demo.procedures {
        if p.trajectory.len() < 2 {
            problems.push(format!("procedure '{}' has a single pose", p.name));
        }
    }
    if demo.grasp.is_some() && demo.object_start.is_none() {
        problems.push("it has a grasp, but no object_start".into());
    }
    if count == 0 {
        problems.push("zero trajectories are asked for".into());
    }
    for (i, p) in demo.procedures.iter().enumerate() {
        let broken = p.trajectory.poses().any(|q| {
            let numbers = q.translation.vector.iter().chain(q.rotation.coords.iter());
            !numbers.copied().all(f64::is_finite) || (q.rotation.norm() - 1.0).abs() > 1e-3
        });
        if broken {
            problems.push(format!("procedure '{}' has a pose that is none", p.name));
        }
        if demo.role(i) == Role::Carry && demo.grasp_of(i).is_none() {
            problems.push(format!("procedure '{}' carries an object without a grasp", p.name));
        }
    }
    if !problems.is_empty() {
        return Err(DemonstrationError::Invalid { what: "demonstration".into(), problems });
    }
    for p in &demo.procedures {
        let first = p.trajectory.first().pose;
        let far = |q: &Pose| tdv_geometry::twist_arc(&first, q, crate::path::RHO);
        if p.trajectory.poses().map(far).fold(0.0, f64::max) < 1e-6 {
            return Err(DemonstrationError::StandsStill {
                procedure: p.name.clone(),
                poses: p.trajectory.len(),
            });
        }
    }
    Ok(())
}

/// One accepted geometric path.
struct Made {
    /// Dense path in the reference frame (already timed in mode paper).
    path: Vec<Pose>,
    /// `T_base_reference` it was made for.
    reference: Pose,
    /// Which rule made it.
    rule: &'static str,
}

/// Makes the paths of one procedure; an error is the reason of a rejection.
trait Maker {
    /// From a start drawn over the workspace.
    fn ordinary(&mut self, rng: &mut ChaCha8Rng) -> Result<Made, String>;
    /// From a start beside an ordinary path.
    fn recovery(&mut self, base: &Made, rng: &mut ChaCha8Rng) -> Result<Made, String>;
    /// From a given start; also the name of the rule that was used.
    fn bend(&self, start: &Pose) -> Result<(Vec<Pose>, &'static str), String>;
    /// `T_base_tcp` for a pose of the procedure.
    fn tool(&self, reference: &Pose, pose: &Pose) -> Pose;
    /// Speed law.
    fn limits(&self) -> Limits;
}

/// What is asked of the outside for one procedure.
struct Outside<'a> {
    options: &'a GenerateOptions<'a>,
    hold: Hold,
    procedure: &'a ProcedureDemo,
}

impl Outside<'_> {
    fn check(&self, maker: &dyn Maker, made: &Made, last: &Pose) -> Result<(), String> {
        if self.options.reachable.is_none() && self.options.collides.is_none() {
            return Ok(());
        }
        for pose in made.path.iter().step_by(5).chain([last]) {
            let tool = maker.tool(&made.reference, pose);
            if let Some(reachable) = self.options.reachable {
                reachable(&tool)?;
            }
            if let Some(collides) = self.options.collides {
                let moving = self.procedure.moving.as_str();
                let object = (moving != crate::TCP).then(|| (moving, made.reference * pose));
                collides(&ToolPose { tool, grip: self.hold.grip, object })?;
            }
        }
        Ok(())
    }
}

fn run(
    mut maker: Box<dyn Maker + '_>,
    config: &GenerationConfig,
    count: usize,
    rng: &mut ChaCha8Rng,
    outside: &Outside<'_>,
) -> Result<(ProcedureSet, ProcedureReport), DemonstrationError> {
    let procedure = outside.procedure;
    let goal = procedure.goal();
    let limits = maker.limits();
    let mut report = ProcedureReport { name: procedure.name.clone(), ..Default::default() };
    let mut trajectories = Vec::new();
    let mut bases: Vec<Made> = Vec::new();
    let recoveries = match config.mode {
        GenerationMode::Repaired => (count as f64 * config.recovery.share).round() as usize,
        GenerationMode::Paper | GenerationMode::Rigid | GenerationMode::Dmp => 0,
    };
    // One trajectory is the demonstration, under the speed law and no way bent.
    let (ordinary_wanted, recoveries) = if count == 1 { (0, 0) } else { (count, recoveries) };
    if count == 1 {
        let demo: Vec<Pose> = procedure.trajectory.poses().copied().collect();
        let mut poses = retime(&demo, &limits, config.retime.dt);
        let hold = (config.retime.hold / config.retime.dt).round() as usize;
        poses.extend(std::iter::repeat_n(goal, hold));
        let t = PoseTrajectory::from_poses(&poses, config.retime.dt)
            .map_err(DemonstrationError::geometry(format!("procedure '{}'", procedure.name)))?;
        report.longest = t.duration();
        trajectories.push(t);
        (report.accepted, report.tried) = (1, 1);
        report.rules.insert("demonstration".into(), 1);
    }
    let count = ordinary_wanted;
    let allowed = 30 * (count + recoveries) + 100;
    while report.accepted < count || report.recoveries < recoveries {
        if report.tried >= allowed {
            return Err(DemonstrationError::TooManyRejections {
                procedure: procedure.name.clone(),
                accepted: report.accepted + report.recoveries,
                wanted: count + recoveries,
                tried: report.tried,
                reasons: report
                    .rejected
                    .iter()
                    .map(|(r, n)| format!("{n} x {r}"))
                    .collect::<Vec<_>>()
                    .join(", "),
            });
        }
        report.tried += 1;
        let ordinary = report.accepted < count;
        let made = if ordinary {
            maker.ordinary(rng)
        } else {
            let base = &bases[rng.random_range(0..bases.len())];
            maker.recovery(base, rng)
        };
        let checked = made.and_then(|m| {
            let poses = timed(&m.path, config, &limits);
            let last = *poses.last().ok_or("empty path")?;
            outside.check(maker.as_ref(), &m, &last)?;
            let t = PoseTrajectory::from_poses(&poses, config.retime.dt)
                .map_err(|_| "not finite".to_string())?;
            Ok((m, t))
        });
        match checked {
            Ok((made, trajectory)) => {
                let miss =
                    (trajectory.last().pose.translation.vector - goal.translation.vector).norm();
                report.worst_end_miss = report.worst_end_miss.max(miss);
                report.longest = report.longest.max(trajectory.duration());
                trajectories.push(trajectory);
                if ordinary {
                    report.accepted += 1;
                    *report.rules.entry(made.rule.to_string()).or_default() += 1;
                    bases.push(made);
                } else {
                    report.recoveries += 1;
                }
            }
            Err(reason) => *report.rejected.entry(reason).or_default() += 1,
        }
    }
    let set = ProcedureSet {
        name: procedure.name.clone(),
        moving: procedure.moving.clone(),
        reference: procedure.reference.clone(),
        goal,
        moving_symmetry: procedure.moving_symmetry.clone(),
        reference_symmetry: procedure.reference_symmetry.clone(),
        trajectories,
    };
    Ok((set, report))
}

/// The canonical variant of a start. Which one is held before is drawn, so that the set covers the
/// band in which the live rule may keep either (a little wider than its hysteresis).
fn canonical_start(procedure: &ProcedureDemo, start: &Pose, rng: &mut ChaCha8Rng) -> Variant {
    let canonical = procedure.canonical();
    let candidates = canonical.candidates(start);
    let previous = candidates[rng.random_range(0..candidates.len().max(1))];
    canonical.choose_with(start, previous, crate::Canonical::HYSTERESIS * 1.5)
}

/// The speed law of a task, with a slow tail of the given length.
fn limits(config: &GenerationConfig, tail: f64) -> Limits {
    let r = &config.retime;
    Limits {
        speed: r.speed,
        acceleration: r.acceleration,
        angular_speed: r.angular_speed,
        tail,
        tail_speed: if tail > 0.0 { r.approach_speed } else { r.speed },
    }
}

#[cfg(test)]
mod start_tests;
#[cfg(test)]
mod tests;
