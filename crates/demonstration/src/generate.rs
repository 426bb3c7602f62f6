//! Many trajectories from one demonstration.

mod check;
mod path_task;
mod reach;
mod sampling;

pub(crate) use check::lowest;

use crate::path::{Limits, retime};
use crate::{
    Dataset, Demonstration, DemonstrationError, GenerationConfig, GenerationMode, HistoryNoise,
    ProcedureDemo, ProcedureSet, Task, Variant,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tdv_geometry::{Pose, PoseTrajectory};

/// Asked for tool poses `T_base_tcp`; an error is the reason to reject the trajectory.
pub type Reachable<'a> = &'a dyn Fn(&Pose) -> Result<(), String>;

/// What generation may ask of the outside.
#[derive(Clone, Copy, Default)]
pub struct GenerateOptions<'a> {
    /// Whether the arm can stand there; none = everything is reachable.
    pub reachable: Option<Reachable<'a>>,
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

/// Makes `count` ordinary trajectories per procedure and `recovery.share * count` that start beside the
/// path, all at the one speed law of the task, sampled every `retime.dt` seconds, in the procedure's
/// reference frame and canonical (see [`crate::Canonical`]). The same arguments give the same bytes.
///
/// # Errors
/// [`DemonstrationError::Invalid`] for a task with problems or a demonstration of another task,
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
    for (index, procedure) in demo.procedures.iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index as u64);
        let maker = maker(demo, task, procedure, &mut rng, &mut report.notes)?;
        let (set, procedure_report) =
            run(maker, procedure, config, count, &mut rng, options.reachable)?;
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
/// would reject, and for a procedure that the demonstration does not have.
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
    let one = demo
        .procedures
        .get(procedure)
        .ok_or_else(|| invalid(format!("the demonstration has {}", demo.procedures.len())))?;
    // Only the drawing of starts is random, and here the start is given.
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let maker = maker(demo, task, one, &mut rng, &mut Vec::new())?;
    let (path, _) = maker.bend(start).map_err(invalid)?;
    let poses = timed(&path, &task.generation, &maker.limits());
    PoseTrajectory::from_poses(&poses, task.generation.retime.dt)
        .map_err(|e| invalid(e.to_string()))
}

fn maker<'a>(
    demo: &'a Demonstration,
    task: &'a Task,
    procedure: &'a ProcedureDemo,
    rng: &mut ChaCha8Rng,
    notes: &mut Vec<String>,
) -> Result<Box<dyn Maker + 'a>, DemonstrationError> {
    Ok(if procedure.name == "reach" {
        Box::new(reach::Reach::new(demo, task, procedure, rng)?)
    } else {
        Box::new(path_task::PathTask::new(demo, task, procedure, rng, notes)?)
    })
}

/// A path under the speed law of the task, resting at its end for a while.
fn timed(path: &[Pose], config: &GenerationConfig, limits: &Limits) -> Vec<Pose> {
    let timing = &config.retime;
    let mut poses = match config.mode {
        GenerationMode::Paper => path.to_vec(),
        GenerationMode::Repaired => retime(path, limits, timing.dt),
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
        if p.name == "reach" && demo.object_start.is_none() {
            problems.push("procedure 'reach' needs object_start".into());
        }
    }
    if count == 0 {
        problems.push("zero trajectories are asked for".into());
    }
    if problems.is_empty() {
        return Ok(());
    }
    Err(DemonstrationError::Invalid { what: "demonstration".into(), problems })
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

fn run(
    mut maker: Box<dyn Maker + '_>,
    procedure: &ProcedureDemo,
    config: &GenerationConfig,
    count: usize,
    rng: &mut ChaCha8Rng,
    reachable: Option<Reachable<'_>>,
) -> Result<(ProcedureSet, ProcedureReport), DemonstrationError> {
    let goal = procedure.goal();
    let limits = maker.limits();
    let mut report = ProcedureReport { name: procedure.name.clone(), ..Default::default() };
    let mut trajectories = Vec::new();
    let mut bases: Vec<Made> = Vec::new();
    let recoveries = match config.mode {
        GenerationMode::Paper => 0,
        GenerationMode::Repaired => (count as f64 * config.recovery.share).round() as usize,
    };
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
            if let Some(reachable) = reachable {
                for pose in m.path.iter().step_by(5).chain([&last]) {
                    reachable(&maker.tool(&m.reference, pose))?;
                }
            }
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
mod tests;
