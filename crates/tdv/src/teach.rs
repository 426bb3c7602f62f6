use crate::arguments::TeachArgs;
use crate::observe::{Observed, observe};
use crate::report;
use crate::training::{Learned, embed, learn};
use anyhow::{Context as _, bail};
use std::path::{Path, PathBuf};
use std::time::Instant;
use tdv_demonstration::{
    Demonstration, FrameObservation, GenerateOptions, ParseConfig, ParseReport, Segments, Task,
    generate_with, mustard, parse,
};
use tdv_policy::rollout::{RolloutConfig, RolloutTrial, evaluate};
use tdv_policy::{Planner, PlannerConfig, TrainProgress, TrainingSet};
use tdv_robot::Kinematics;

/// What the report page shows.
pub struct Lesson {
    pub task: Task,
    pub demonstration: Demonstration,
    pub parse: ParseReport,
    pub observations: Vec<FrameObservation>,
    pub pictures: Vec<(f64, tdv_rendering::RgbImage)>,
    pub dataset: tdv_demonstration::Dataset,
    pub generation: tdv_demonstration::GenerationReport,
    pub progress: Vec<TrainProgress>,
    pub switch: tdv_policy::SwitchReport,
    pub rollout: tdv_policy::rollout::RolloutReport,
    /// Stage and seconds.
    pub seconds: Vec<(&'static str, f64)>,
}

/// The whole way from recording to policy. Returns the model folder.
pub fn run(args: &TeachArgs) -> anyhow::Result<PathBuf> {
    if !args.multi.is_empty() {
        return crate::teach_multi::run(&args.multi, args);
    }
    let task = Task::load(&args.task)?;
    let out = args.out.clone().unwrap_or_else(|| Path::new("models").join(&task.name));
    let mut seconds = Vec::new();
    let began = Instant::now();
    let (observed, demonstration, parsed) = demonstration(args, &task)?;
    seconds.push(("parse", began.elapsed().as_secs_f64()));
    for repair in &parsed.repairs {
        println!("  repaired: {}", repair.text);
    }

    let began = Instant::now();
    let (dataset, generation) = dataset(&demonstration, &task, args)?;
    seconds.push(("generate", began.elapsed().as_secs_f64()));

    let began = Instant::now();
    let mut sets = [TrainingSet::from(&dataset)];
    embed(&mut sets, &args.training)?;
    let noise = (dataset.noise.position, dataset.noise.angle);
    let Learned { policy, switch: switch_policy, mut reports, progress } =
        learn(&sets, noise, &args.training, args.seed, &out)?;
    let switch = reports.pop().context("no report on the switch policy")?;
    seconds.push(("train", began.elapsed().as_secs_f64()));

    let rollout = rollouts(&policy, &demonstration, &task, args)?;
    if rollout.success_rate() < 0.5 {
        tracing::warn!(
            "only {:.0} % of the kinematic rollouts reach the goal",
            100.0 * rollout.success_rate()
        );
    }
    demonstration.save(&out.join("demonstration.json"))?;
    if let Some(segments) = &parsed.segments {
        segments.save(&out.join("segments.yaml"))?;
    }
    policy.save(&out.join("policy.safetensors"))?;
    switch_policy.save(&out.join("switch.safetensors"))?;
    for (stage, s) in &seconds {
        println!("  {stage}: {s:.1} s");
    }
    let lesson = Lesson {
        task,
        demonstration,
        parse: parsed,
        observations: observed.frames,
        pictures: observed.pictures,
        dataset,
        generation,
        progress,
        switch,
        rollout,
        seconds,
    };
    let page = out.join("report.html");
    report::write(&page, &lesson)?;
    println!(
        "taught \"{}\": {} of {} kinematic rollouts reach the goal; report: {}",
        lesson.task.text,
        lesson.rollout.successes,
        lesson.rollout.trials,
        page.display()
    );
    Ok(out)
}

fn demonstration(
    args: &TeachArgs,
    task: &Task,
) -> anyhow::Result<(Observed, Demonstration, ParseReport)> {
    let segments = args.segments.as_deref().map(Segments::load).transpose()?;
    let config = ParseConfig { segments, ..Default::default() };
    if let Some(file) = &args.import_dexmv {
        let options = mustard::ImportOptions { parse: config, ..Default::default() };
        let imported = mustard::import(file, task, &options)?;
        let observed =
            Observed { hands: 0, unpaired: 0, frames: imported.frames, pictures: Vec::new() };
        return Ok((observed, imported.demonstration, imported.report));
    }
    let Some(bag) = &args.bag else { bail!("give --bag or --import-dexmv") };
    let observed = observe(bag, task, &args.hand_models, &args.objects)?;
    println!(
        "  {} frames, a hand in {}, {} images without a partner",
        observed.frames.len(),
        observed.hands,
        observed.unpaired
    );
    let (demonstration, report) = parse(&observed.frames, task, &config)
        .with_context(|| format!("the demonstration in {}", bag.display()))?;
    Ok((observed, demonstration, report))
}

/// Trajectories from reachable starts, made of the demonstration.
pub fn dataset(
    demonstration: &Demonstration,
    task: &Task,
    args: &TeachArgs,
) -> anyhow::Result<(tdv_demonstration::Dataset, tdv_demonstration::GenerationReport)> {
    let count = args.count.unwrap_or(task.generation.count);
    let kinematics = Kinematics::ur5();
    let reachable = |pose: &tdv_geometry::Pose| {
        if kinematics.ik_tcp(pose).is_empty() { Err("unreachable".to_owned()) } else { Ok(()) }
    };
    let options = GenerateOptions { reachable: Some(&reachable), ..Default::default() };
    let (dataset, generation) = generate_with(demonstration, task, count, args.seed, &options)?;
    for p in &generation.procedures {
        println!("  {}", report::describe(p));
    }
    Ok((dataset, generation))
}

/// Kinematic rollouts from starts that the training set does not have.
pub fn rollouts(
    policy: &tdv_policy::TrainedPolicy,
    demonstration: &Demonstration,
    task: &Task,
    args: &TeachArgs,
) -> anyhow::Result<tdv_policy::rollout::RolloutReport> {
    let (unseen, _) = generate_with(
        demonstration,
        task,
        20,
        args.seed.wrapping_add(0x5EED),
        &GenerateOptions::default(),
    )?;
    let unseen = TrainingSet::from(&unseen);
    let trials: Vec<RolloutTrial> = unseen
        .procedures
        .iter()
        .enumerate()
        .flat_map(|(i, p)| p.trajectories.iter().map(move |t| RolloutTrial::of(i, t)))
        .collect();
    let mut planner = Planner::new(policy, PlannerConfig::default())?;
    Ok(evaluate(&mut planner, &trials, &RolloutConfig::default(), args.seed)?)
}
