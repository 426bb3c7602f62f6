//! Cells tried with the real graph: perceived poses, real time, one trial after the other.

use crate::arguments::{ClosedLoopArgs, Table2Args};
use crate::eval;
use anyhow::{Context as _, bail};
use std::path::{Path, PathBuf};
use tdv_evaluation::table2::{Arm, Cause, Job, PolicyKind, Start, TrialRecord, append_record};
use tdv_runtime::trial::{run_trial, shutdown_on_signals};

/// Between the labs' seeds of two seeds of the table.
const STRIDE: u64 = 10_000;

/// The key of the job's record.
pub fn key(job: &Job) -> String {
    record(job, job.lesson.hash.clone()).key()
}

/// Runs the jobs and appends their records to `file`.
pub fn run(args: &Table2Args, jobs: &[Job], file: &Path, done: &dyn Fn()) -> anyhow::Result<()> {
    if jobs.iter().any(|j| j.cell.policy == PolicyKind::StraightLine) {
        bail!("the live graph has no straight_line policy; leave it out of --policies");
    }
    if jobs.iter().any(|j| j.cell.arm.name != Arm::ordinary().name) {
        bail!("ablations run with --poses truth only");
    }
    let shutdown = shutdown_on_signals()?;
    for job in jobs {
        let (scene, start) = job.scene()?;
        let folder = args.out.join("live");
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let file_of_scene = folder.join("scene.yaml");
        scene.save(&file_of_scene)?;
        let one = ClosedLoopArgs {
            settings: vec![format!("scene:={}", file_of_scene.display())],
            ..arguments(args, job)
        };
        let task = &job.stage.task;
        let model = one.model.clone().unwrap_or_default();
        let setup = eval::setup(&one, task, &scene, &job.stage.demonstration, &model, one.seed)?;
        let outcome =
            run_trial(&setup, &shutdown).with_context(|| format!("trial {}", one.seed))?;
        let trial = eval::trial(task, one.seed, &outcome);
        let fell = ["fell off", "knocked over", "on its side"];
        let fell = fell.iter().any(|w| trial.reason.contains(w));
        append_record(
            file,
            &TrialRecord {
                start,
                success: trial.success,
                cause: (!trial.success).then_some(if fell {
                    Cause::Fell
                } else {
                    Cause::NeverPlaced
                }),
                reason: trial.reason,
                error_mm: trial.error_mm,
                error_deg: trial.error_deg,
                duration_s: trial.duration_s,
                wall_s: outcome.wall,
                ..record(job, job.lesson.hash.clone())
            },
        )?;
        done();
    }
    Ok(())
}

/// What `tdv eval closed-loop` would be given for this one trial.
fn arguments(args: &Table2Args, job: &Job) -> ClosedLoopArgs {
    let task = PathBuf::from(format!("config/tasks/{}.yaml", job.stage.task.name));
    let model = job.lesson.pupil.as_ref().map(|p| p.folder.clone());
    let seed = job.cell.seed * STRIDE + job.trial as u64;
    ClosedLoopArgs {
        disturb: job.cell.disturbed,
        open_loop: job.cell.policy == PolicyKind::OpenLoop,
        launch_file: args.launch_file.clone(),
        ..ClosedLoopArgs::one(task, model, seed, args.out.join("live"))
    }
}

fn record(job: &Job, lesson: String) -> TrialRecord {
    TrialRecord {
        task: job.stage.task.name.clone(),
        demos: job.cell.demos,
        level: job.cell.level,
        policy: job.cell.policy,
        disturbed: job.cell.disturbed,
        arm: job.cell.arm.name.clone(),
        poses: "perceived".into(),
        seed: job.cell.seed,
        trial: job.trial,
        lesson,
        start: Start { x: 0.0, y: 0.0, yaw: 0.0, point: None },
        success: false,
        reason: String::new(),
        sentence: String::new(),
        cause: None,
        error_mm: None,
        error_deg: None,
        duration_s: 0.0,
        wall_s: 0.0,
        plan_ms: 0.0,
        grips: 0,
        pushed: job.cell.disturbed,
        table_hits: 0,
    }
}
