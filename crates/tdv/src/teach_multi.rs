//! One policy for several tasks that were each taught before.

use crate::arguments::TeachArgs;
use crate::teach::{dataset, rollouts};
use crate::training::{Learned, embed, learn};
use anyhow::{Context as _, bail};
use std::path::{Path, PathBuf};
use tdv_demonstration::{Demonstration, Task};
use tdv_policy::TrainingSet;

/// Folder of the task files, which are named as their tasks.
const TASKS: &str = "config/tasks";
/// Where each task's demonstration is found, by name.
const MODELS: &str = "models";

/// Trains on the demonstrations in the tasks' model folders. Returns the folder of the result, which
/// has a model folder for each task: its demonstration and the policies that all share.
pub fn run(names: &[String], args: &TeachArgs) -> anyhow::Result<PathBuf> {
    if names.len() < 2 {
        bail!("--multi needs at least two tasks, such as --multi cup_on_coaster,mustard_on_disc");
    }
    let out = args.out.clone().unwrap_or_else(|| Path::new(MODELS).join(names.join("+")));
    let mut lessons = Vec::new();
    let mut sets = Vec::new();
    let mut noise = (0.0f64, 0.0f64);
    for name in names {
        let task = Task::load(&Path::new(TASKS).join(format!("{name}.yaml")))?;
        let file = Path::new(MODELS).join(name).join("demonstration.json");
        let demonstration = Demonstration::load(&file)
            .with_context(|| format!("teach `{name}` alone first, which parses its recording"))?;
        println!("  {name}:");
        let (data, _) = dataset(&demonstration, &task, args)?;
        noise = (noise.0.max(data.noise.position), noise.1.max(data.noise.angle));
        sets.push(TrainingSet::from(&data));
        lessons.push((task, demonstration));
    }
    embed(&mut sets, &args.training)?;
    let Learned { policy, switch, reports, .. } =
        learn(&sets, noise, &args.training, args.seed, &out)?;
    for ((task, demonstration), report) in lessons.iter().zip(&reports) {
        let chosen = policy.clone().choose(&task.name)?;
        let rollout = rollouts(&chosen, demonstration, task, args)?;
        println!(
            "taught \"{}\": {} of {} kinematic rollouts reach the goal; switch: precision {:.2}, \
             recall {:.2}, median delay {:.0} ms",
            task.text,
            rollout.successes,
            rollout.trials,
            report.precision,
            report.recall,
            1e3 * report.median_delay
        );
        let folder = out.join(&task.name);
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        demonstration.save(&folder.join("demonstration.json"))?;
        chosen.save(&folder.join("policy.safetensors"))?;
        switch.clone().choose(&task.name)?.save(&folder.join("switch.safetensors"))?;
    }
    println!("model folders, one per task: {}", out.display());
    Ok(out)
}
