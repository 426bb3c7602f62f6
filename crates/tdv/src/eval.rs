use crate::arguments::ClosedLoopArgs;
use crate::{launch, motion, picture};
use anyhow::{Context as _, bail};
use std::collections::BTreeMap;
use std::path::Path;
use tdv_demonstration::{Demonstration, Task};
use tdv_evaluation::{ClosedLoopReport, Fault, StreamFigures, StreamStatistics, Trial};
use tdv_geometry::yaw_of;
use tdv_runtime::record::Recording;
use tdv_runtime::trial::{
    FaultSetup, NODES, TrialOutcome, TrialSetup, run_trial, shutdown_on_signals,
};
use tdv_simulation::Scene;
use tdv_simulation::arm::ArmModel;
use tdv_simulation::controller::Generation;

/// Seconds of the clock that a trial may take: the task's limit and the start of eight processes.
const PATIENCE: f64 = 85.0;

/// Trials of the live graph. True when all succeeded.
pub fn closed_loop(args: &ClosedLoopArgs) -> anyhow::Result<bool> {
    let report = trials(args)?;
    print!("{}", report.table());
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(report.summary.successes == report.summary.trials)
}

/// The trials of [`closed_loop`].
pub fn trials(args: &ClosedLoopArgs) -> anyhow::Result<ClosedLoopReport> {
    if !args.live {
        bail!("give --live: trials in process come with a later version");
    }
    if let Some(name) = args.kill.as_deref().filter(|n| *n != "each" && !NODES.contains(n)) {
        bail!("--kill {name:?}: expected 'each' or one of {}", NODES.join(", "));
    }
    let task = Task::load(&args.task)?;
    let model = args.model.clone().unwrap_or_else(|| Path::new("models").join(&task.name));
    let demonstration = Demonstration::load(&model.join("demonstration.json"))
        .context("teach first: `tdv teach` makes the model folder")?;
    let scene = Scene::load(Path::new(&task.scene))?;
    std::fs::create_dir_all(&args.run).with_context(|| args.run.display().to_string())?;
    let shutdown = shutdown_on_signals()?;
    let arm = arm(args, &scene).kinematics();
    let (mut stream, mut measured) = (StreamStatistics::default(), BTreeMap::new());
    let (mut trials, mut latency, mut cpu) = (Vec::new(), BTreeMap::new(), BTreeMap::new());
    for seed in args.seed..args.seed + args.trials {
        let setup = setup(args, &task, &scene, &demonstration, &model, seed)?;
        if let Some(old) = &setup.bag {
            tdv_bag::remove_bag(old)?;
        }
        let outcome = run_trial(&setup, &shutdown).with_context(|| format!("trial {seed}"))?;
        let trial = trial(&task, seed, &outcome);
        println!(
            "trial {seed}: {} ({:.1} s) {}",
            if trial.success { "success" } else { "FAILURE" },
            trial.duration_s,
            trial.reason
        );
        if !trial.success || args.kill.is_some() || args.drop {
            for line in &outcome.story {
                println!("    {line}");
            }
        }
        if let Some(f) = &outcome.fault {
            println!(
                "    {} killed at {:.2} rad/s: {}; told: {}",
                f.node,
                f.speed,
                f.rest_ms.map_or("NOT at rest".into(), |ms| format!("at rest after {ms:.0} ms")),
                f.sentence
            );
        }
        if args.pictures && !outcome.pictures.is_empty() {
            let path = args.run.join(format!("trial_{seed}.gif"));
            picture::save_gif(&path, &outcome.pictures, 100)?;
            println!("    picture: {}", path.display());
        }
        if let Some(bag) = &outcome.bag {
            println!("    bag: {}", bag.path.display());
            tell_dropped(bag);
        }
        let (motion, predictions) = (motion::samples(&outcome), motion::predictions(&outcome));
        stream.add(&motion, &predictions, |q| arm.fk_tcp(q));
        for (name, value) in outcome.stream {
            let worst = measured.entry(name).or_insert(value);
            *worst = value.max(*worst);
        }
        for (stage, samples) in outcome.latency_ms {
            latency.entry(stage).or_insert_with(Vec::new).extend(samples);
        }
        for (node, share) in outcome.cpu {
            let sum: &mut f64 = cpu.entry(node).or_insert(0.0);
            *sum += share / args.trials as f64;
        }
        trials.push(trial);
    }
    let stream = StreamFigures { measured, ..stream.figures() };
    let condition = condition(args);
    Ok(ClosedLoopReport::new(&task.name, &condition, trials, &latency, cpu, stream))
}

/// The arm of the lab's controller.
fn arm(args: &ClosedLoopArgs, scene: &Scene) -> ArmModel {
    args.controller.unwrap_or(scene.robot.controller).arm()
}

/// Says what a bag does not have.
pub fn tell_dropped(recording: &Recording) {
    for (topic, count) in &recording.dropped {
        eprintln!("tdv: {topic}: {count} messages came too fast and are not in the bag");
    }
}

fn condition(args: &ClosedLoopArgs) -> String {
    let killed = args.kill.as_deref().map(|name| match name {
        "each" => "one node killed, another in each trial".to_owned(),
        _ => format!("{name} killed"),
    });
    let mut parts = Vec::new();
    for (on, name) in [
        (args.disturb, "displaced in mid-run"),
        (args.drop, "grip fails once"),
        (args.freeze_perception, "perception frozen"),
        (args.untrained, "untrained network"),
        (args.open_loop, "open-loop replay"),
        (args.grasp_offset != 0.0, "grasp offset"),
    ] {
        if on {
            parts.push(name);
        }
    }
    if args.driver.is_some() {
        parts.push("another driver");
    }
    if args.controller == Some(Generation::ESeries) {
        parts.push("e-Series controller");
    }
    parts.extend(killed.as_deref());
    if args.kill_carrying {
        parts.push("while carrying");
    }
    parts.extend(args.settings.iter().map(String::as_str));
    if parts.is_empty() { "plain".into() } else { parts.join(", ") }
}

/// How the live graph is started for one trial.
pub fn setup(
    args: &ClosedLoopArgs,
    task: &Task,
    scene: &Scene,
    demonstration: &Demonstration,
    model: &Path,
    seed: u64,
) -> anyhow::Result<TrialSetup> {
    let settings = launch::settings(&args.settings)?;
    let mut arguments = BTreeMap::new();
    let mut set = |name: &str, value: String| {
        arguments.insert(name.to_owned(), value);
    };
    set("task", args.task.display().to_string());
    set("scene", task.scene.clone());
    set("model", model.display().to_string());
    set("prompt", task.text.clone());
    // A hand's tool is no object of the catalogue.
    let others = task.objects.keys().filter(|name| **name != task.reference_object);
    let names: Vec<&str> =
        std::iter::once(&task.reference_object).chain(others).map(String::as_str).collect();
    set("objects", format!("[{}]", names.join(", ")));
    set("seed", seed.to_string());
    if let Some(place) = demonstration.procedures.last() {
        let goal = place.goal();
        set("goal_yaw", format!("{:.6}", yaw_of(&goal.rotation)));
    }
    // The robot's side gets meshes that are as wrong as the scene says.
    let scales: Vec<String> = scene
        .objects
        .iter()
        .zip(scene.draw_knowledge(seed).mesh_scale)
        .map(|(o, scale)| format!("\"{}:{scale:.6}\"", o.name))
        .collect();
    set("mesh_scales", format!("[{}]", scales.join(", ")));
    if let Some(controller) = args.controller {
        set("controller", controller.name().into());
    }
    set("robot", arm(args, scene).name().into());
    set("disturb", args.disturb.to_string());
    set("drop", args.drop.to_string());
    set("driver", args.driver.is_none().to_string());
    set("freeze_perception", args.freeze_perception.to_string());
    set("untrained", args.untrained.to_string());
    set("open_loop", args.open_loop.to_string());
    set("grasp_offset", format!("[{:?}, 0.0, 0.0]", args.grasp_offset));
    arguments.extend(settings);
    Ok(TrialSetup {
        launch_file: args.launch_file.clone(),
        share: launch::share(&args.launch_file),
        arguments,
        log_folder: args.run.join(format!("logs_{seed}")),
        domain: 60 + (seed % 40) as u16,
        patience: PATIENCE,
        pictures: args.pictures,
        fault: args.kill.as_deref().map(|name| {
            let name = match name {
                "each" => NODES[(seed - args.seed) as usize % NODES.len()],
                _ => name,
            };
            FaultSetup::kill(name, args.kill_carrying)
        }),
        driver: args.driver.clone(),
        bag: args.bag.then(|| args.run.join(format!("trial_{seed}"))),
    })
}

/// What a live trial comes to.
pub fn trial(task: &Task, seed: u64, outcome: &TrialOutcome) -> Trial {
    let start = outcome.start.get(&task.moving_object).map_or([f64::NAN; 4], |p| {
        [p.translation.x, p.translation.y, p.translation.z, yaw_of(&p.rotation)]
    });
    let ended: Vec<String> =
        outcome.exits.iter().map(|e| format!("{} ended ({:?})", e.name, e.code)).collect();
    let Some(v) = &outcome.verdict else {
        let reason =
            if ended.is_empty() { "the lab gave no verdict".into() } else { ended.join(", ") };
        return Trial {
            seed,
            success: false,
            start,
            error_mm: None,
            error_deg: None,
            duration_s: outcome.wall,
            real_time_factor: f64::NAN,
            stolen_ms: outcome.stolen_ms,
            reason,
            fault: None,
        };
    };
    let mut reason = if v.finished { v.reason.clone() } else { format!("given up: {}", v.reason) };
    if !ended.is_empty() {
        reason = format!("{}; {reason}", ended.join(", "));
    }
    Trial {
        seed,
        success: v.finished && v.success,
        start,
        error_mm: Some(1e3 * v.error_m).filter(|e| e.is_finite()),
        error_deg: Some(v.error_rad.to_degrees()).filter(|e| e.is_finite()),
        duration_s: v.elapsed,
        real_time_factor: v.real_time_factor,
        stolen_ms: outcome.stolen_ms,
        reason,
        fault: outcome.fault.as_ref().map(|f| Fault {
            node: f.node.clone(),
            speed: f.speed,
            rest_ms: f.rest_ms,
            sentence: f.sentence.clone(),
        }),
    }
}

/// Writes a result file, whole or not at all.
pub fn write_json(path: &Path, report: &impl serde::Serialize) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let partial = path.with_extension("json.partial");
    std::fs::write(&partial, serde_json::to_string_pretty(report)?)
        .with_context(|| partial.display().to_string())?;
    std::fs::rename(&partial, path).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Arguments, Command, EvalCommand};
    use clap::Parser as _;

    fn parse(more: &[&str]) -> Result<ClosedLoopArgs, clap::Error> {
        let words = ["tdv", "eval", "closed-loop", "--task", "t.yaml", "--live"];
        let parsed = Arguments::try_parse_from(words.iter().chain(more))?;
        match parsed.command {
            Command::Eval(EvalCommand::ClosedLoop(args)) => Ok(args),
            _ => unreachable!("the words say closed-loop"),
        }
    }

    #[test]
    fn the_condition_names_all_that_was_done() {
        let condition = |more: &[&str]| condition(&parse(more).unwrap());
        assert_eq!(condition(&[]), "plain");
        assert_eq!(condition(&["--kill", "ur5_driver"]), "ur5_driver killed");
        assert_eq!(
            condition(&["--disturb", "--kill", "each", "--kill-carrying"]),
            "displaced in mid-run, one node killed, another in each trial, while carrying"
        );
    }

    #[test]
    fn no_trials_are_a_usage_mistake() {
        let error = parse(&["--trials", "0"]).err().unwrap();
        assert_eq!(error.exit_code(), 2);
        assert_eq!(parse(&["--trials", "1"]).unwrap().trials, 1);
    }
}
