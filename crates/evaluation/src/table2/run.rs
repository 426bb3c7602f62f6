//! Cells, their trials, and running them on several threads.

use super::layout::{self, Start};
use super::record::key;
use super::trial::start;
use super::{
    Arm, Course, Lesson, Level, PolicyKind, PoseNoise, Setting, Surroundings, Table2Error,
    TrialRecord, demonstrate, run_trial,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tdv_demonstration::{Demonstration, Task};
use tdv_simulation::scene::{Placement, Spot};
use tdv_simulation::{LabAssets, Scene};

/// Trials of a cell whose starts are the fixed points; those that follow are drawn.
pub const POINTS: usize = 13;

/// A task, ready to be learned and tried.
#[derive(Debug)]
pub struct Stage {
    /// The task.
    pub task: Task,
    /// Its scene.
    pub assets: Arc<LabAssets>,
    /// The one demonstration.
    pub demonstration: Demonstration,
    /// What stands around the arm, where the task says so.
    pub surroundings: Option<Surroundings>,
}

impl Stage {
    /// Loads `config/tasks/NAME.yaml` under `root`, its scene, and has the task demonstrated.
    ///
    /// # Errors
    /// Of the files, and of the scripted demonstrator for a task that it cannot show.
    pub fn load(root: &Path, name: &str) -> Result<Self, Table2Error> {
        let task = Task::load(&root.join("config/tasks").join(format!("{name}.yaml")))?;
        let scene = Scene::load(&root.join(&task.scene))?;
        let assets = Arc::new(LabAssets::load(scene)?);
        let (demonstration, _) = demonstrate(&task, &assets)?;
        let surroundings = Surroundings::load(root, &task, &assets)?;
        Ok(Self { task, assets, demonstration, surroundings })
    }

    /// Its lesson, see [`Lesson::teach`].
    ///
    /// # Errors
    /// As [`Lesson::teach`].
    pub fn teach(
        &self,
        course: &Course,
        cache: &Path,
        say: &dyn Fn(&str),
    ) -> Result<Lesson, Table2Error> {
        let around = self.surroundings.as_ref();
        Lesson::teach(&self.demonstration, &self.task, around, course, cache, say)
    }
}

/// One cell of the table, for one seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Demonstrations; 1 for the controls, which use the demonstration itself.
    pub demos: usize,
    /// Level.
    pub level: Level,
    /// Who drives.
    pub policy: PolicyKind,
    /// An object is pushed in mid-run.
    pub disturbed: bool,
    /// Ablation.
    pub arm: Arm,
    /// Seed of training and starts.
    pub seed: u64,
}

/// One trial to do.
#[derive(Debug, Clone)]
pub struct Job {
    /// Task.
    pub stage: Arc<Stage>,
    /// What was taught for the cell.
    pub lesson: Arc<Lesson>,
    /// Cell.
    pub cell: Cell,
    /// Number of the trial.
    pub trial: usize,
}

impl Job {
    /// The key that its record will have, see [`TrialRecord::key`].
    pub fn key(&self) -> String {
        let c = &self.cell;
        key(
            &[&self.stage.task.name, &c.arm.name, "truth", &self.lesson.hash],
            c.demos,
            (c.level, c.policy, c.disturbed),
            (c.seed, self.trial),
        )
    }

    /// The scene with the object that varies at this trial's start, for a lab elsewhere.
    ///
    /// # Errors
    /// Of the scene.
    pub fn scene(&self) -> Result<(Scene, Start), Table2Error> {
        let start = start(&self.setting(PoseNoise::default()), self.trial)?;
        let mut scene = self.stage.assets.scene.clone();
        let varied = scene.index_of(layout::varied(&scene, &self.stage.task))?;
        scene.objects[varied].start = Placement::Spot(Spot {
            xy: [start.x, start.y],
            yaw_deg: start.yaw.to_degrees(),
            jitter: 0.0,
            jitter_deg: 0.0,
        });
        Ok((scene, start))
    }

    /// Does it.
    ///
    /// # Errors
    /// As [`run_trial`].
    pub fn run(&self, noise: PoseNoise) -> Result<TrialRecord, Table2Error> {
        run_trial(&self.setting(noise), self.trial)
    }

    fn setting(&self, noise: PoseNoise) -> Setting<'_> {
        Setting {
            task: &self.stage.task,
            assets: &self.stage.assets,
            surroundings: self.stage.surroundings.as_ref(),
            lesson: &self.lesson,
            demos: self.cell.demos,
            level: self.cell.level,
            policy: self.cell.policy,
            disturbed: self.cell.disturbed,
            arm: &self.cell.arm,
            noise,
            seed: self.cell.seed,
        }
    }
}

/// Does the jobs on so many threads; `done` is told each record as it is finished, one at a time.
/// The records do not depend on the number of threads, their order does.
///
/// # Errors
/// The first error of a job or of `done`; what was done before has been told.
pub fn run_jobs(
    jobs: &[Job],
    noise: PoseNoise,
    threads: usize,
    done: &mut (dyn FnMut(&TrialRecord) -> Result<(), Table2Error> + Send),
) -> Result<(), Table2Error> {
    let (next, failed, done) = (AtomicUsize::new(0), AtomicBool::new(false), Mutex::new(done));
    let work = || -> Result<(), Table2Error> {
        while !failed.load(Ordering::Relaxed) {
            let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) else { break };
            let told = job.run(noise).and_then(|record| {
                let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                (*done)(&record)
            });
            if let Err(e) = told {
                failed.store(true, Ordering::Relaxed);
                return Err(e);
            }
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|t| {
            // A panic of a trial is a finding: it goes on in the caller.
            t.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    })
}
