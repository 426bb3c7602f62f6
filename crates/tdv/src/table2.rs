//! `tdv eval table2` and `tdv eval ablations`.

mod live;

use crate::arguments::{AblationArgs, Table2Args};
use crate::eval::write_json;
use crate::observe::bar;
use anyhow::{Context as _, bail};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::sync::Arc;
use tdv_evaluation::table2::{
    Arm, Cell, Course, Job, Lesson, Level, POINTS, PolicyKind, PoseNoise, Stage, Table2Report,
    TrialRecord, append_record, read_records, run_jobs,
};

/// The table of success rates.
pub fn table(args: &Table2Args) -> anyhow::Result<bool> {
    run(args, &[Arm::ordinary()])
}

/// The same for every arm of the study.
pub fn ablations(args: &AblationArgs) -> anyhow::Result<bool> {
    let arms =
        if args.arms.is_empty() { Arm::all() } else { named(&args.arms, "arm", Arm::named)? };
    run(&args.table, &arms)
}

fn named<T>(
    names: &[String],
    what: &str,
    find: impl Fn(&str) -> Option<T>,
) -> anyhow::Result<Vec<T>> {
    names
        .iter()
        .map(|name| find(name).with_context(|| format!("there is no {what} {name:?}")))
        .collect()
}

fn level(name: &str) -> Option<Level> {
    [Level::PG, Level::PoG].into_iter().find(|l| l.name() == name)
}

fn policy(name: &str) -> Option<PolicyKind> {
    PolicyKind::ALL.into_iter().find(|p| p.name() == name)
}

/// Which part of the trials is ours: (index from 0, parts).
fn shard(text: Option<&str>) -> anyhow::Result<(usize, usize)> {
    let Some(text) = text else { return Ok((0, 1)) };
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((i, n)) if (1..=n).contains(&i) => Ok((i - 1, n)),
        _ => bail!("--shard {text:?}: expected I/N with I from 1 to N, such as 1/4"),
    }
}

/// All cells that the arguments ask for. The controls learn nothing: they have the one demonstration,
/// and only the ordinary arm.
fn cells(args: &Table2Args, arms: &[Arm]) -> anyhow::Result<Vec<Cell>> {
    let levels = named(&args.levels, "level", level)?;
    let policies = named(&args.policies, "policy", policy)?;
    if args.demos.contains(&0) {
        bail!("--demos 0: there is at least the one demonstration");
    }
    let mut cells = Vec::new();
    for &seed in &args.seeds {
        for arm in arms {
            for &policy in &policies {
                let learned = policy == PolicyKind::Learned;
                if !learned && arm.name != Arm::ordinary().name {
                    continue;
                }
                let demos: &[usize] = if learned { &args.demos } else { &[1] };
                for &demos in demos {
                    for &level in &levels {
                        for disturbed in [false, true] {
                            if disturbed && !args.disturb {
                                continue;
                            }
                            let arm = arm.clone();
                            cells.push(Cell { demos, level, policy, disturbed, arm, seed });
                        }
                    }
                }
            }
        }
    }
    Ok(cells)
}

fn run(args: &Table2Args, arms: &[Arm]) -> anyhow::Result<bool> {
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    if !args.merge.is_empty() {
        let mut records = Vec::new();
        for file in &args.merge {
            records.extend(records_of(file)?);
        }
        return publish(args, &Table2Report::new(records));
    }
    match (args.poses.as_str(), args.live) {
        ("truth", false) | ("perceived", true) => {}
        ("truth", true) => bail!("--live: the live graph perceives; give --poses perceived"),
        ("perceived", false) => {
            bail!("--poses perceived: only the live graph has eyes; give --live")
        }
        (other, _) => bail!("--poses {other:?}: expected 'truth' or 'perceived'"),
    }
    let (part, parts) = shard(args.shard.as_deref())?;
    let cells = cells(args, arms)?;
    let mut jobs = Vec::new();
    for name in &args.tasks {
        let stage = Arc::new(Stage::load(Path::new("."), name)?);
        let mut lessons = BTreeMap::new();
        for cell in &cells {
            let lesson = lesson(args, &stage, cell, &mut lessons)?;
            let first = if args.no_points { POINTS } else { 0 };
            jobs.extend((first..POINTS + args.starts).map(|trial| Job {
                stage: stage.clone(),
                lesson: lesson.clone(),
                cell: cell.clone(),
                trial,
            }));
        }
    }
    let file = match parts {
        1 => args.out.join("trials.jsonl"),
        _ => args.out.join(format!("trials-{}-of-{parts}.jsonl", part + 1)),
    };
    let jobs: Vec<Job> = jobs.into_iter().skip(part).step_by(parts).collect();
    let old = read_records(&file)?;
    let keys: HashSet<String> = old.iter().map(TrialRecord::key).collect();
    let key = |job: &Job| if args.live { live::key(job) } else { job.key() };
    let left: Vec<Job> = jobs.iter().filter(|job| !keys.contains(&key(job))).cloned().collect();
    println!(
        "{} trials, {} of them already in {}",
        jobs.len(),
        jobs.len() - left.len(),
        file.display()
    );
    let progress = bar(left.len() as u64, "trials");
    if args.live {
        live::run(args, &left, &file, &|| progress.inc(1))?;
    } else {
        run_jobs(&left, PoseNoise::default(), usize::from(args.threads), &mut |record| {
            progress.inc(1);
            append_record(&file, record)
        })?;
    }
    progress.finish_and_clear();
    // Of the file only what was asked for now.
    let wanted: HashSet<String> = jobs.iter().map(key).collect();
    let records = read_records(&file)?.into_iter().filter(|r| wanted.contains(&r.key()));
    publish(args, &Table2Report::new(records))
}

/// The cell's lesson; cells that differ only in how they are tried share it.
fn lesson(
    args: &Table2Args,
    stage: &Stage,
    cell: &Cell,
    known: &mut BTreeMap<(usize, u64, String), Arc<Lesson>>,
) -> anyhow::Result<Arc<Lesson>> {
    // Live there is always a whole graph.
    let taught = cell.policy == PolicyKind::Learned || args.live;
    let key =
        if taught { (cell.demos, cell.seed, cell.arm.name.clone()) } else { (0, 0, String::new()) };
    if let Some(lesson) = known.get(&key) {
        return Ok(lesson.clone());
    }
    let lesson = if let Some(models) = args.models.as_ref().filter(|_| taught) {
        let folder = models.join(&stage.task.name);
        Lesson::taught(&folder, &stage.task).with_context(|| folder.display().to_string())?
    } else if taught {
        let course = Course {
            demos: cell.demos,
            seed: cell.seed,
            steps: args.steps,
            arm: cell.arm.clone(),
            threads: usize::from(args.threads),
        };
        let what = format!(
            "{}, {} demonstrations, seed {}, {}",
            stage.task.name, cell.demos, cell.seed, cell.arm.name
        );
        let say = |text: &str| println!("  {what}: {text}");
        let models = args.out.join("models");
        stage.teach(&course, &models, &say).with_context(|| what.clone())?
    } else {
        Lesson::untaught(&stage.demonstration, &stage.task)
    };
    let lesson = Arc::new(lesson);
    known.insert(key, lesson.clone());
    Ok(lesson)
}

/// Trials of a result file or of a file of trials.
fn records_of(file: &Path) -> anyhow::Result<Vec<TrialRecord>> {
    if file.extension().is_some_and(|e| e == "jsonl") {
        if !file.is_file() {
            bail!("{}: no such file", file.display());
        }
        return Ok(read_records(file)?);
    }
    let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let report: Table2Report =
        serde_json::from_str(&text).with_context(|| file.display().to_string())?;
    Ok(report.trials)
}

fn publish(args: &Table2Args, report: &Table2Report) -> anyhow::Result<bool> {
    let table = report.markdown();
    print!("{table}");
    std::fs::write(args.out.join("table.md"), &table)?;
    std::fs::write(args.out.join("figure.svg"), report.svg())?;
    if let Some(path) = &args.json {
        write_json(path, report)?;
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Arguments, Command, EvalCommand};
    use clap::Parser as _;

    fn parse(more: &[&str]) -> Table2Args {
        let words = ["tdv", "eval", "table2"];
        match Arguments::try_parse_from(words.iter().chain(more)).unwrap().command {
            Command::Eval(EvalCommand::Table2(args)) => args,
            _ => unreachable!("the words say table2"),
        }
    }

    #[test]
    fn cells_are_all_combinations_once() {
        let all = cells(&parse(&["--disturb", "--seeds", "1,2"]), &[Arm::ordinary()]).unwrap();
        // Two seeds, two levels, with and without a push: 3 numbers learned, 2 controls with one.
        assert_eq!(all.len(), 2 * 2 * 2 * (3 + 2));
        let arms = Arm::all();
        let few = parse(&["--demos", "50", "--levels", "PoG"]);
        assert_eq!(cells(&few, &arms).unwrap().len(), arms.len() + 2);
        assert!(cells(&parse(&["--levels", "PX"]), &arms).is_err());
        assert!(cells(&parse(&["--demos", "0"]), &arms).is_err());
    }

    #[test]
    fn shards() {
        assert_eq!(shard(None).unwrap(), (0, 1));
        assert_eq!(shard(Some("2/4")).unwrap(), (1, 4));
        for bad in ["0/4", "5/4", "1", "a/b", "1/0"] {
            assert!(shard(Some(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn poses_and_live_belong_together() {
        let dir = std::env::temp_dir().join("tdv_table2_poses");
        let out = dir.to_string_lossy().into_owned();
        for more in [&["--poses", "perceived"][..], &["--live"], &["--poses", "felt"]] {
            let mut words = vec!["--out", &out];
            words.extend(more);
            assert!(table(&parse(&words)).is_err(), "{more:?}");
        }
    }
}
