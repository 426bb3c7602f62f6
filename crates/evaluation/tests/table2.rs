//! A tiny table: trials are decided by their seeds, and a run goes on where it was ended.

use std::path::Path;
use std::sync::Arc;
use tdv_evaluation::table2::{
    Arm, Cell, Course, Job, Lesson, Level, PolicyKind, PoseNoise, Stage, Table2Report, TrialRecord,
    append_record, read_records, run_jobs,
};

fn stage() -> Arc<Stage> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    Arc::new(Stage::load(&root, "cup_on_coaster").unwrap())
}

fn cell(policy: PolicyKind, level: Level) -> Cell {
    Cell { demos: 1, level, policy, disturbed: false, arm: Arm::ordinary(), seed: 1 }
}

fn run(jobs: &[Job], threads: usize) -> Vec<TrialRecord> {
    let mut records = Vec::new();
    run_jobs(jobs, PoseNoise::default(), threads, &mut |r| {
        records.push(r.timeless());
        Ok(())
    })
    .unwrap();
    records.sort_by_key(TrialRecord::key);
    records
}

#[test]
fn the_demonstration_played_places_the_cup_and_equal_seeds_give_equal_trials() {
    let stage = stage();
    let lesson = Arc::new(Lesson::untaught(&stage.demonstration, &stage.task));
    let jobs: Vec<Job> = [8, 9]
        .map(|trial| Job {
            stage: stage.clone(),
            lesson: lesson.clone(),
            cell: cell(PolicyKind::OpenLoop, Level::PG),
            trial,
        })
        .into();
    let records = run(&jobs, 2);
    for r in &records {
        println!("{r:?}");
        assert_eq!(r.success, r.cause.is_none());
        assert_eq!(r.start.point, Some(r.trial));
    }
    assert!(records.iter().any(|r| r.success), "{records:?}");
    assert_eq!(run(&jobs[..1], 1)[0], *records.iter().find(|r| r.trial == 8).unwrap());
}

#[test]
fn two_steps_of_training_place_nothing_and_records_are_found_again() {
    let stage = stage();
    let dir = tempfile::tempdir().unwrap();
    let arm = Arm::ordinary();
    let course = Course { demos: 1, seed: 1, steps: 2, arm, threads: 1 };
    let lesson = stage.teach(&course, dir.path(), &|_| {}).unwrap();
    let job = Job {
        stage,
        lesson: Arc::new(lesson),
        cell: cell(PolicyKind::Learned, Level::PoG),
        trial: 20,
    };
    let record = job.run(PoseNoise::default()).unwrap();
    println!("{record:?}");
    assert!(!record.success && record.cause.is_some() && record.start.point.is_none());
    let file = dir.path().join("trials.jsonl");
    append_record(&file, &record).unwrap();
    let back = read_records(&file).unwrap();
    assert_eq!(back[0].key(), job.key());
    let report = Table2Report::new(back);
    assert_eq!((report.cells[0].trials, report.cells[0].successes), (1, 0));
}
