//! Trains on the synthetic placing task and prints what it reaches after how many steps and seconds.
//! Arguments: trajectories, steps, seed, then optionally `epsilon`, `v`, `base`, or `early` to stop when
//! rollouts are good.

#![allow(clippy::print_stdout)]

use std::time::Instant;
use tdv_policy::rollout::{RolloutConfig, RolloutTrial, evaluate};
use tdv_policy::{Planner, PlannerConfig, PolicyConfig, Prediction, TrainConfig, synthetic};

/// CPU seconds of this process.
fn cpu() -> f64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `t` outlives the call, which only writes it.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut t) };
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    tdv_policy::tune_allocator();
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: u64| args.get(i).map_or(Ok(default), |a| a.parse::<u64>());
    let (count, steps, seed) = (number(0, 100)? as usize, number(1, 600)? as usize, number(2, 0)?);
    let has = |w: &str| args.iter().any(|a| a == w);
    let policy = PolicyConfig {
        dt: 0.1,
        prediction: if has("epsilon") {
            Prediction::Epsilon
        } else if has("v") {
            Prediction::V
        } else {
            Prediction::Sample
        },
        ..if has("base") { PolicyConfig::base() } else { PolicyConfig::small() }
    };
    let train = TrainConfig {
        steps,
        seed,
        evaluate_every: if has("early") { 100 } else { 0 },
        early_stop: has("early"),
        ..TrainConfig::default()
    };
    let set = synthetic::reach_and_place_set(count, seed + 1);
    let trials: Vec<RolloutTrial> = synthetic::reach_and_place_set(20, seed + 1000)
        .procedures
        .iter()
        .enumerate()
        .flat_map(|(s, p)| p.trajectories.iter().map(move |t| RolloutTrial::of(s, t)))
        .collect();
    println!(
        "| steps | loss | train CPU s | CPU ms/step | ok 10 mm 5 deg | ok 5 mm 3 deg | median mm | median deg | max mm |"
    );
    for part in [0.33, 0.66, 1.0] {
        // Each row is a training of its own, so that its learning rate has come down.
        let t = TrainConfig { steps: (steps as f64 * part) as usize, ..train.clone() };
        let begin = cpu();
        let mut loss = 0.0;
        let trained = tdv_policy::train(&set, &policy, &t, &mut |p| loss = p.loss)?;
        let seconds = cpu() - begin;
        let mut planner = Planner::new(&trained, PlannerConfig::default())?;
        let loose = evaluate(&mut planner, &trials, &RolloutConfig::default(), seed)?;
        let tight = RolloutConfig {
            position_tolerance: 0.005,
            rotation_tolerance: 3f64.to_radians(),
            ..RolloutConfig::default()
        };
        let tight = evaluate(&mut planner, &trials, &tight, seed)?;
        println!(
            "| {} | {loss:.4} | {seconds:.1} | {:.1} | {:.0}% | {:.0}% | {:.1} | {:.2} | {:.0} |",
            trained.steps,
            seconds * 1e3 / trained.steps as f64,
            loose.success_rate() * 100.0,
            tight.success_rate() * 100.0,
            loose.median_position * 1e3,
            loose.median_rotation.to_degrees(),
            loose.max_position * 1e3,
        );
        let history = vec![trials[0].start; planner.history_len()];
        let best = (0..50)
            .map(|_| {
                let begin = Instant::now();
                planner.plan(0, &history, 1).map(|_| begin.elapsed().as_secs_f64() * 1e3)
            })
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        println!("plan: {best:.2} ms (best of 50)");
    }
    let (_, report) =
        tdv_policy::train_switch(&set, &policy, &train, &tdv_policy::SwitchTrainConfig::default())?;
    println!("switch: {report:?}");
    Ok(())
}
