//! A real human hand's path, learned and rolled out without a robot: how closely is the smoothed path
//! followed? Arguments: the recording `dexmv_mustard.json` (or its folder), a task file whose reference
//! object is the disc, then optionally trajectories, steps and seed.
//!
//! `cargo run -p tdv-policy --example hand_path -- ../shared/data/dexmv_mustard \
//! config/tasks/mustard_on_disc.yaml`. Fails over 5 mm or 3 degrees.

#![allow(clippy::print_stdout)]

use std::path::Path;
use tdv_demonstration::mustard::ImportOptions;
use tdv_demonstration::{Task, TaskKind, generate, mustard};
use tdv_geometry::{Pose, interpolate, pose_distance};
use tdv_policy::rollout::{RolloutConfig, RolloutTrial, rollout};
use tdv_policy::{Planner, PlannerConfig, PolicyConfig, TrainConfig, TrainingSet};

/// Largest distance (m) and angle (rad) from the path.
const WANTED: (f64, f64) = (0.005, 3.0 * std::f64::consts::PI / 180.0);
/// Poses of the path nearer than this (m) to a trajectory made of it are on it.
const SAME: f64 = 0.001;
/// What a turn counts (m/rad) in the search for the nearest pose.
const LEVER: f64 = 0.1;

/// How far (m, rad) the nearest pose of `way`, also between its poses, is from `pose`.
fn off(pose: &Pose, way: &[Pose]) -> (f64, f64) {
    way.windows(2)
        .flat_map(|w| (0..=20).map(move |i| interpolate(&w[0], &w[1], f64::from(i) / 20.0)))
        .map(|q| pose_distance(pose, &q))
        .min_by(|a, b| (a.0 + LEVER * a.1).total_cmp(&(b.0 + LEVER * b.1)))
        .unwrap_or((f64::INFINITY, f64::INFINITY))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    tdv_policy::tune_allocator();
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [recording, task, ..] = args.as_slice() else {
        return Err("arguments: recording, task file, trajectories, steps, seed".into());
    };
    let number = |i: usize, default: u64| args.get(i).map_or(Ok(default), |a| a.parse::<u64>());
    let (count, steps, seed) = (number(2, 100)? as usize, number(3, 3000)? as usize, number(4, 0)?);
    let mut task = Task::load(Path::new(task))?;
    (task.kind, task.moving_object) = (TaskKind::Hand, "tcp".into());
    task.objects.retain(|name, _| *name == task.reference_object);
    let imported = mustard::import(Path::new(recording), &task, &ImportOptions::default())?;
    let demonstration = &imported.demonstration;
    // A single trajectory is the smoothed path itself, timed for the robot.
    let path = TrainingSet::from(&generate(demonstration, &task, 1, seed)?.0);
    let path = path.procedures[0].trajectories[0].clone();
    let set = TrainingSet::from(&generate(demonstration, &task, count, seed)?.0);
    let unseen = TrainingSet::from(&generate(demonstration, &task, 10, seed + 1000)?.0);

    // The person's hand came from beside the table, below its top, where no gripper goes.
    let whole = path.len();
    let shown = &set.procedures[0].trajectories[0];
    let path: Vec<Pose> = path.into_iter().skip_while(|p| off(p, shown).0 > SAME).collect();
    println!("{} of {whole} poses of the path are above the table", path.len());

    let policy = PolicyConfig { dt: set.dt, ..PolicyConfig::small() };
    let train = TrainConfig { steps, seed, ..TrainConfig::default() };
    let mut loss = 0.0;
    let trained = tdv_policy::train(&set, &policy, &train, &mut |p| loss = p.loss)?;
    println!("{} poses over {:.1} s, loss {loss:.5}", path.len(), path.len() as f64 * set.dt);

    let mut planner = Planner::new(&trained, PlannerConfig::default())?;
    let mut worst = (0.0f64, 0.0f64);
    for (i, way) in unseen.procedures[0].trajectories[..10].iter().enumerate() {
        let trial = RolloutTrial::of(0, way);
        let config = RolloutConfig { steps: way.len() + 40, ..RolloutConfig::default() };
        let done = rollout(&mut planner, &trial, &config, seed + i as u64)?;
        let (d, a) = path
            .iter()
            .map(|p| off(p, &done))
            .fold((0.0f64, 0.0f64), |w, o| (w.0.max(o.0), w.1.max(o.1)));
        let end = pose_distance(&done[done.len() - 1], &trial.goal);
        println!(
            "start {i}: the path's poses are missed by at most {:.1} mm and {:.1} deg, the end by {:.1} mm",
            1e3 * d,
            a.to_degrees(),
            1e3 * end.0
        );
        worst = (worst.0.max(d), worst.1.max(a));
    }
    println!("largest: {:.1} mm, {:.1} deg", 1e3 * worst.0, worst.1.to_degrees());
    if worst.0 > WANTED.0 || worst.1 > WANTED.1 {
        return Err("the path is not followed within 5 mm and 3 degrees".into());
    }
    Ok(())
}
