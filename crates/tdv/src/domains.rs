//! `tdv eval domains`: the closed loop in scenes that look different.

use crate::arguments::{ClosedLoopArgs, DomainArgs};
use crate::eval::{trials, write_json};
use anyhow::{Context as _, bail};
use serde::Serialize;
use std::path::Path;
use tdv_demonstration::Task;
use tdv_evaluation::ClosedLoopReport;
use tdv_simulation::{Domain, Scene};

#[derive(Serialize)]
struct Row {
    domain: String,
    #[serde(flatten)]
    report: ClosedLoopReport,
}

#[derive(Serialize)]
struct Report {
    successes: usize,
    trials: usize,
    domains: Vec<Row>,
}

/// Trials of every domain. True when all succeeded.
pub fn run(args: &DomainArgs) -> anyhow::Result<bool> {
    let task = Task::load(&args.task)?;
    let scene = Scene::load(Path::new(&task.scene))?;
    let all = Domain::load_all(&args.domains)?;
    if let Some(name) = args.only.iter().find(|n| !all.iter().any(|d| d.name == **n)) {
        let names: Vec<&str> = all.iter().map(|d| d.name.as_str()).collect();
        bail!("--only {name:?}: {} has {}", args.domains.display(), names.join(", "));
    }
    let mut rows: Vec<Row> = Vec::new();
    for domain in all.iter().filter(|d| args.only.is_empty() || args.only.contains(&d.name)) {
        println!("{}", domain.name);
        let folder = args.run.join(domain.name.replace(' ', "_"));
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let file = folder.join("scene.yaml");
        domain.of(&scene).save(&file)?;
        let one = ClosedLoopArgs {
            trials: args.trials,
            settings: vec![format!("scene:={}", file.display())],
            pictures: args.pictures,
            ..ClosedLoopArgs::one(args.task.clone(), args.model.clone(), args.seed, folder)
        };
        rows.push(Row { domain: domain.name.clone(), report: trials(&one)? });
    }
    let sum = |f: fn(&ClosedLoopReport) -> usize| rows.iter().map(|r| f(&r.report)).sum();
    let report = Report {
        successes: sum(|r| r.summary.successes),
        trials: sum(|r| r.summary.trials),
        domains: rows,
    };
    println!("\n{:28} {:>8} {:>10} {:>12}", "domain", "placed", "off by mm", "host stole in");
    for Row { domain, report } in &report.domains {
        let s = &report.summary;
        let placed = format!("{}/{}", s.successes, s.trials);
        let error = s.median_error_mm.map_or("-".into(), |mm| format!("{mm:.1}"));
        println!("{domain:28} {placed:>8} {error:>10} {:>12}", s.stolen_trials);
    }
    println!("{:28} {:>8}", "together", format!("{}/{}", report.successes, report.trials));
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.successes == report.trials)
}
