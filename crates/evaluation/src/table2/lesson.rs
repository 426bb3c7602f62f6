//! What a cell learns from: the demonstration as it is, or so many trajectories made of it; policy and
//! switch trained on them with the same number of steps, kept by a hash of everything that matters.

use super::{Arm, Surroundings, Table2Error};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use tdv_demonstration::{
    Collides, Demonstration, GenerateOptions, GenerationMode, GenerationReport, Limits, Task,
    ToolPose, densify, generate_with, retime,
};
use tdv_geometry::Pose;
use tdv_policy::{
    PolicyConfig, ProcedureData, SwitchPolicy, SwitchTrainConfig, TrainConfig, TrainedPolicy,
    TrainingSet, train, train_progress, train_switch,
};
use tdv_robot::Kinematics;

/// Changes with everything that the hash below does not see.
const VERSION: u32 = 1;
/// Poses of the demonstrated path before it is timed.
const SAMPLES: usize = 240;

/// The two networks of a cell.
#[derive(Debug, Clone)]
pub struct Pupil {
    /// Where to go.
    pub policy: TrainedPolicy,
    /// Whether it is there; the progress head in that ablation.
    pub switch: SwitchPolicy,
    /// Folder with the files, as `tdv launch` takes it.
    pub folder: PathBuf,
}

/// All that a trial needs to know of a cell.
#[derive(Debug, Clone)]
pub struct Lesson {
    /// The one demonstration.
    pub demonstration: Demonstration,
    /// The networks; none for the controls, which need none.
    pub pupil: Option<Pupil>,
    /// Identity of all of it.
    pub hash: String,
    /// Seconds between poses.
    pub dt: f64,
}

/// What was written beside the networks, last: a folder without it is not finished.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Identity, see [`Lesson::hash`].
    pub hash: String,
    /// Trajectories per procedure.
    pub trajectories: Vec<usize>,
    /// Denoising loss at the end.
    pub loss: f64,
    /// Seconds of training, policy and switch.
    pub seconds: [f64; 2],
    /// Figures of the switch on trajectories kept aside: precision, recall.
    pub switch: [f64; 2],
    /// Starts that generation rejected, in words.
    pub rejected: Vec<String>,
}

/// How it is taught.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Course {
    /// "Demonstrations": 1 is the demonstration itself, more are made of it.
    pub demos: usize,
    /// Seed of generation and training.
    pub seed: u64,
    /// Steps of the policy's training.
    pub steps: usize,
    /// What is changed against the ordinary.
    pub arm: Arm,
    /// Threads of training; the result does not depend on it.
    #[serde(skip)]
    pub threads: usize,
}

impl Lesson {
    /// For the controls: only the demonstration.
    pub fn untaught(demonstration: &Demonstration, task: &Task) -> Self {
        Self {
            hash: demonstration.hash(),
            demonstration: demonstration.clone(),
            pupil: None,
            dt: task.generation.retime.dt,
        }
    }

    /// With the networks of a model folder that `tdv teach` wrote, its demonstration too.
    ///
    /// # Errors
    /// Of the files.
    pub fn taught(folder: &Path, task: &Task) -> Result<Self, Table2Error> {
        let demonstration = Demonstration::load(&folder.join("demonstration.json"))?;
        let names: Vec<&str> = demonstration.procedures.iter().map(|p| p.name.as_str()).collect();
        let file = |name: &str| folder.join(name);
        let policy = TrainedPolicy::load_for(&file("policy.safetensors"), &task.name, &names)?;
        let switch = SwitchPolicy::load_for(&file("switch.safetensors"), &task.name, &names)?;
        let run = format!("{} {} {}", policy.dataset_hash, policy.seed, policy.steps);
        let tasks: Vec<&str> = policy.tasks().collect();
        let identity = [demonstration.hash(), run, tasks.join(" ")];
        Ok(Self {
            hash: super::fnv(identity.iter().map(String::as_str)),
            pupil: Some(Pupil { policy, switch, folder: folder.to_owned() }),
            dt: task.generation.retime.dt,
            demonstration,
        })
    }

    /// Takes the networks from `cache` or trains them and puts them there. Trajectories keep clear of the
    /// `surroundings`.
    ///
    /// # Errors
    /// Of generation, training and files.
    pub fn teach(
        demonstration: &Demonstration,
        task: &Task,
        surroundings: Option<&Surroundings>,
        course: &Course,
        cache: &Path,
        say: &dyn Fn(&str),
    ) -> Result<Self, Table2Error> {
        let hash = identity(demonstration, task, surroundings, course)?;
        let folder = cache.join(format!("{}-{}-{hash}", task.name, course.demos));
        let names: Vec<&str> = demonstration.procedures.iter().map(|p| p.name.as_str()).collect();
        let (policy_file, switch_file) =
            (folder.join("policy.safetensors"), folder.join("switch.safetensors"));
        let dt = task.generation.retime.dt;
        let lesson = |policy, switch| Self {
            demonstration: demonstration.clone(),
            pupil: Some(Pupil { policy, switch, folder: folder.clone() }),
            hash: hash.clone(),
            dt,
        };
        if folder.join("certificate.json").is_file() {
            let policy = TrainedPolicy::load_for(&policy_file, &task.name, &names)?;
            let switch = SwitchPolicy::load_for(&switch_file, &task.name, &names)?;
            return Ok(lesson(policy, switch));
        }
        let (set, report) = training_set(demonstration, task, surroundings, course)?;
        let config = policy_config(&course.arm, set.dt);
        let t = train_config(task, course);
        let began = std::time::Instant::now();
        let mut loss = f64::NAN;
        let policy = train(&set, &config, &t, &mut |p| {
            loss = p.loss;
            if p.step % 100 == 0 {
                say(&format!("step {} of {}, loss {:.5}", p.step, p.steps, p.loss));
            }
        })?;
        let policy_s = began.elapsed().as_secs_f64();
        let s = switch_config(course, &set);
        let (switch, figures) = if course.arm.progress {
            (train_progress(&set, &config, &t, &s)?, [f64::NAN; 2])
        } else {
            let (switch, r) = train_switch(&set, &config, &t, &s)?;
            (switch, [r.precision, r.recall])
        };
        let certificate = Certificate {
            hash: hash.clone(),
            trajectories: set.procedures.iter().map(|p| p.trajectories.len()).collect(),
            loss,
            seconds: [policy_s, began.elapsed().as_secs_f64() - policy_s],
            switch: figures.map(|f| if f.is_finite() { f } else { 0.0 }),
            rejected: report
                .procedures
                .iter()
                .flat_map(|p| p.rejected.iter().map(|(why, n)| format!("{}: {n} x {why}", p.name)))
                .collect(),
        };
        std::fs::create_dir_all(&folder).map_err(|e| Table2Error::io(&folder, e))?;
        demonstration.save(&folder.join("demonstration.json"))?;
        policy.save(&policy_file)?;
        switch.save(&switch_file)?;
        super::write_json(&folder.join("certificate.json"), &certificate)?;
        Ok(lesson(policy, switch))
    }
}

fn policy_config(arm: &Arm, dt: f64) -> PolicyConfig {
    PolicyConfig { history: arm.history, prediction: arm.prediction, dt, ..PolicyConfig::small() }
}

fn train_config(task: &Task, course: &Course) -> TrainConfig {
    let ordinary = TrainConfig::default();
    TrainConfig {
        steps: course.steps,
        seed: course.seed,
        ema: if course.arm.ema { ordinary.ema } else { 0.0 },
        noise_position: task.generation.noise_position.max(0.001),
        noise_rotation: task.generation.noise_angle_deg.to_radians().max(0.005),
        threads: course.threads.max(1),
        ..ordinary
    }
}

/// A few trajectories cannot spare every fifth.
fn switch_config(course: &Course, set: &TrainingSet) -> SwitchTrainConfig {
    let ordinary = SwitchTrainConfig::default();
    let least = set.procedures.iter().map(|p| p.trajectories.len()).min().unwrap_or(2);
    SwitchTrainConfig {
        seed: course.seed,
        hold_out: ordinary.hold_out.min(least).max(2),
        ..ordinary
    }
}

/// The task as the course changes it: exactly `demos` trajectories a procedure, recoveries included.
fn generation(task: &Task, course: &Course) -> (Task, usize) {
    let mut task = task.clone();
    let g = &mut task.generation;
    g.mode = course.arm.warp;
    if !course.arm.recovery || g.mode == GenerationMode::Paper {
        g.recovery.share = 0.0;
    }
    let ordinary = (course.demos as f64 / (1.0 + g.recovery.share)).round() as usize;
    // One ordinary trajectory would be the demonstration itself.
    let ordinary = ordinary.clamp(2, course.demos.max(2));
    g.recovery.share = (course.demos.saturating_sub(ordinary)) as f64 / ordinary as f64;
    g.count = ordinary;
    (task, ordinary)
}

fn training_set(
    demonstration: &Demonstration,
    task: &Task,
    surroundings: Option<&Surroundings>,
    course: &Course,
) -> Result<(TrainingSet, GenerationReport), Table2Error> {
    if course.demos <= 1 {
        return Ok((itself(demonstration, task), GenerationReport::default()));
    }
    let (task, ordinary) = generation(task, course);
    let arm = Kinematics::ur5();
    let reachable = |pose: &Pose| {
        if arm.ik_tcp(pose).is_empty() { Err("unreachable".to_owned()) } else { Ok(()) }
    };
    let collides = |at: &ToolPose<'_>| surroundings.map_or(Ok(()), |s| s.free(at));
    let options = GenerateOptions {
        reachable: Some(&reachable),
        collides: surroundings.is_some().then_some(&collides as Collides<'_>),
    };
    let (dataset, report) = generate_with(demonstration, &task, ordinary, course.seed, &options)?;
    Ok((TrainingSet::from(&dataset), report))
}

/// The demonstration itself: its paths, under the task's speed law, nothing made of them. Each stands
/// there twice because one is kept aside for the switch's figures.
fn itself(demonstration: &Demonstration, task: &Task) -> TrainingSet {
    let r = &task.generation.retime;
    let procedures = demonstration
        .procedures
        .iter()
        .map(|p| {
            let tail = if p.name == "reach" { task.generation.pregrasp_distance } else { 0.0 };
            let limits = Limits {
                speed: r.speed,
                acceleration: r.acceleration,
                angular_speed: r.angular_speed,
                tail,
                tail_speed: if tail > 0.0 { r.approach_speed } else { r.speed },
            };
            let canonical = p.canonical();
            let first = p.trajectory.poses().next().copied().unwrap_or_else(Pose::identity);
            let variant = canonical.choose(&first, None);
            let path: Vec<Pose> = p.trajectory.poses().map(|q| variant.apply(q)).collect();
            let poses = retime(&densify(&path, SAMPLES), &limits, r.dt);
            ProcedureData { name: p.name.clone(), trajectories: vec![poses.clone(), poses] }
        })
        .collect();
    let mut set = TrainingSet {
        task: demonstration.task.clone(),
        text: demonstration.text.clone(),
        text_embedding: None,
        procedures,
        dt: r.dt,
        dataset_hash: String::new(),
    };
    set.dataset_hash = set.content_hash();
    set
}

fn identity(
    demonstration: &Demonstration,
    task: &Task,
    surroundings: Option<&Surroundings>,
    course: &Course,
) -> Result<String, Table2Error> {
    fn json(v: &impl Serialize) -> Result<String, Table2Error> {
        serde_json::to_string(v).map_err(|e| Table2Error::Robot(e.to_string()))
    }
    // The encoder's cache changes nothing that is learned.
    let mut course = course.clone();
    course.arm = Arm { name: String::new(), encoder_cache: true, ..course.arm };
    let mut parts = vec![
        VERSION.to_string(),
        demonstration.hash(),
        json(task)?,
        json(&course)?,
        json(&policy_config(&course.arm, task.generation.retime.dt))?,
        json(&train_config(task, &Course { threads: 1, ..course.clone() }))?,
        json(&SwitchTrainConfig { seed: course.seed, ..Default::default() })?,
    ];
    parts.extend(surroundings.map(|s| s.identity().to_owned()));
    Ok(super::fnv(parts.iter().map(String::as_str)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table2::demonstrate;
    use tdv_simulation::{LabAssets, Scene};

    fn cup() -> (Task, Demonstration) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let task = Task::load(&root.join("config/tasks/cup_on_coaster.yaml")).unwrap();
        let assets = LabAssets::load(Scene::load(&root.join(&task.scene)).unwrap()).unwrap();
        let (demonstration, _) = demonstrate(&task, &assets).unwrap();
        (task, demonstration)
    }

    fn course(demos: usize) -> Course {
        Course { demos, seed: 1, steps: 2, arm: Arm::ordinary(), threads: 1 }
    }

    #[test]
    fn so_many_demonstrations_are_so_many_trajectories() {
        let (task, d) = cup();
        for demos in [2, 15, 50] {
            let (set, _) = training_set(&d, &task, None, &course(demos)).unwrap();
            for p in &set.procedures {
                assert_eq!(p.trajectories.len(), demos, "{}", p.name);
            }
        }
        // One is the demonstration: same ends, same place, nothing in between made up.
        let (set, _) = training_set(&d, &task, None, &course(1)).unwrap();
        for (p, demo) in set.procedures.iter().zip(&d.procedures) {
            assert_eq!(p.trajectories[0], p.trajectories[1]);
            let end = p.trajectories[0].last().unwrap();
            assert!(tdv_geometry::pose_distance(end, &demo.goal()).0 < 1e-6);
            for q in &p.trajectories[0] {
                let near = demo.trajectory.poses().map(|r| tdv_geometry::pose_distance(q, r).0);
                assert!(near.fold(f64::MAX, f64::min) < 0.02);
            }
        }
    }

    #[test]
    fn the_hash_sees_what_is_learned_and_only_that() {
        let (task, d) = cup();
        let base = identity(&d, &task, None, &course(15)).unwrap();
        let uncached = Arm { encoder_cache: false, name: "x".into(), ..Arm::ordinary() };
        let same = Course { arm: uncached, threads: 2, ..course(15) };
        assert_eq!(identity(&d, &task, None, &same).unwrap(), base);
        let no_ema = Course { arm: Arm { ema: false, ..Arm::ordinary() }, ..course(15) };
        for other in [course(50), Course { seed: 2, ..course(15) }, no_ema] {
            assert_ne!(identity(&d, &task, None, &other).unwrap(), base);
        }
        let mut wider = task.clone();
        wider.workspace.x[1] += 0.01;
        assert_ne!(identity(&d, &wider, None, &course(15)).unwrap(), base);
    }

    #[test]
    fn a_second_lesson_comes_from_the_cache() {
        let (task, d) = cup();
        let cache = tempfile::tempdir().unwrap();
        let teach = || Lesson::teach(&d, &task, None, &course(2), cache.path(), &|_| {}).unwrap();
        let (first, second) = (teach(), teach());
        let (a, b) = (first.pupil.unwrap(), second.pupil.unwrap());
        assert_eq!(a.policy.weights, b.policy.weights);
        assert_eq!(std::fs::read_dir(cache.path()).unwrap().count(), 1);
    }
}
