//! Training as the user sees it: a bar with the time left, logs, a state on the disk to go on from.

use crate::arguments::TrainingArgs;
use crate::observe::bar;
use anyhow::{Context as _, bail};
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use tdv_policy::log::{EventWriter, append_line, keep_until, scalars};
use tdv_policy::text::{Pooling, TextEncoder};
use tdv_policy::{
    PolicyConfig, SwitchPolicy, SwitchReport, SwitchTrainConfig, TrainConfig, TrainProgress,
    TrainedPolicy, Training, TrainingSet, train_switch_tasks,
};

/// With early stopping: rollouts on kept starts every so many steps.
const EVALUATE_EVERY: usize = 100;

/// What was learned, and how it went.
pub struct Learned {
    pub policy: TrainedPolicy,
    pub switch: SwitchPolicy,
    /// One per task.
    pub reports: Vec<SwitchReport>,
    pub progress: Vec<TrainProgress>,
}

/// Adds to each set the embedding of its text. Without the model a task alone is learned without words.
pub fn embed(sets: &mut [TrainingSet], args: &TrainingArgs) -> anyhow::Result<()> {
    let folder = &args.text_model;
    if !folder.join("config.json").exists() {
        if sets.len() > 1 {
            bail!(
                "no sentence encoder in {}: one policy tells its tasks apart by their words; \
                 launch_scripts/fetch_text_model.sh gets it",
                folder.display()
            );
        }
        eprintln!(
            "warning: no sentence encoder in {}: the policy is taught without words \
             (launch_scripts/fetch_text_model.sh gets it)",
            folder.display()
        );
        return Ok(());
    }
    let pooling = if args.text_cls { Pooling::Cls } else { Pooling::Mean };
    let encoder = TextEncoder::load(folder, pooling)?;
    for set in sets {
        let embedding = encoder.embed(&set.text);
        set.text_embedding =
            Some(embedding.with_context(|| format!("the words of task `{}`", set.task))?);
    }
    Ok(())
}

/// Trains both policies on the sets; state and logs go to the folder `out`. The noise of the histories
/// is at least `noise` (m, rad).
pub fn learn(
    sets: &[TrainingSet],
    noise: (f64, f64),
    args: &TrainingArgs,
    seed: u64,
    out: &Path,
) -> anyhow::Result<Learned> {
    let network = PolicyConfig::small();
    let config = TrainConfig {
        steps: args.steps,
        seed,
        noise_position: noise.0.max(0.001),
        noise_rotation: noise.1.max(0.005),
        threads: 2,
        evaluate_every: if args.early_stop { EVALUATE_EVERY } else { 0 },
        early_stop: args.early_stop,
        ..Default::default()
    };
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let state = out.join("train_state.safetensors");
    let mut training = if args.resume {
        if !state.exists() {
            bail!("{}: nothing to resume; teach without --resume", state.display());
        }
        Training::resume(&state, sets, &network, &config)?
    } else {
        Training::new(sets, &network, &config)?
    };
    let (mut log, mut progress) = Log::open(out, training.steps_done(), args.resume)?;
    let progress_bar = bar(args.steps as u64, "training");
    progress_bar.set_position(training.steps_done() as u64);
    while !training.is_done() {
        let p = training.step()?;
        log.write(&p)?;
        progress_bar.set_position(p.step as u64);
        if p.step.is_multiple_of(args.save_every) {
            training.save_state(&state)?;
            log.flush()?;
        }
        progress.push(p);
    }
    training.save_state(&state)?;
    log.flush()?;
    progress_bar.finish_and_clear();
    let policy = training.policy()?;
    let switch = SwitchTrainConfig { seed, ..Default::default() };
    let (switch, reports) = train_switch_tasks(sets, &network, &config, &switch)?;
    Ok(Learned { policy, switch, reports, progress })
}

/// `training.jsonl` and TensorBoard's event file.
struct Log {
    lines: BufWriter<File>,
    events: EventWriter<BufWriter<File>>,
}

impl Log {
    /// And what a training that is resumed said before.
    fn open(out: &Path, steps: usize, resume: bool) -> anyhow::Result<(Self, Vec<TrainProgress>)> {
        let path = out.join("training.jsonl");
        let old =
            if resume { std::fs::read_to_string(&path).unwrap_or_default() } else { String::new() };
        let kept = keep_until(&old, steps);
        std::fs::write(&path, &kept).with_context(|| path.display().to_string())?;
        let progress = kept
            .lines()
            .map(serde_json::from_str)
            .collect::<Result<Vec<TrainProgress>, serde_json::Error>>()
            .with_context(|| path.display().to_string())?;
        let lines = OpenOptions::new().append(true).open(&path)?;
        if !resume {
            remove_events(out)?;
        }
        let now = wall_time();
        let path = out.join(format!("events.out.tfevents.{:.0}.{}", now, std::process::id()));
        let events = File::create(&path).with_context(|| path.display().to_string())?;
        let events = EventWriter::new(BufWriter::new(events), now, resume.then_some(steps))?;
        Ok((Self { lines: BufWriter::new(lines), events }, progress))
    }

    fn write(&mut self, p: &TrainProgress) -> anyhow::Result<()> {
        append_line(&mut self.lines, p)?;
        Ok(self.events.write(wall_time(), p.step, &scalars(p))?)
    }

    fn flush(&mut self) -> anyhow::Result<()> {
        std::io::Write::flush(&mut self.lines)?;
        Ok(self.events.flush()?)
    }
}

/// Event files of a training that is now done again.
fn remove_events(out: &Path) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(out)? {
        let path: PathBuf = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with("events.out.tfevents.") {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}
