//! Times a training step and a ten-step plan, for `tests/compare/policy_torch.py`. Arguments: a folder,
//! `small` or `base`, the batch. Writes a checkpoint with random weights and `io.safetensors` (an input
//! and its output) to the folder, prints one line of JSON: the least CPU time (ms) of several repeats
//! on one thread.

#![allow(clippy::print_stdout)]

use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;
use tdv_policy::network::{Batch, Workspace};
use tdv_policy::{
    POSE_DIM, Planner, PlannerConfig, PolicyConfig, TrainConfig, TrainedPolicy, Training, synthetic,
};

type Failure = Box<dyn std::error::Error>;

/// CPU seconds of this process.
fn cpu() -> f64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `t` outlives the call, which only writes it.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut t) };
    t.tv_sec as f64 + t.tv_nsec as f64 * 1e-9
}

fn least_ms(repeats: usize, mut work: impl FnMut() -> Result<(), Failure>) -> Result<f64, Failure> {
    let mut best = f64::INFINITY;
    for _ in 0..repeats {
        let begin = cpu();
        work()?;
        best = best.min(cpu() - begin);
    }
    Ok(best * 1e3)
}

/// Numbers that no one mistakes for zeros.
fn wave(n: usize, phase: f32) -> Vec<f32> {
    (0..n).map(|i| (i as f32 * 0.7 + phase).sin()).collect()
}

fn write_io(folder: &Path, policy: &TrainedPolicy) -> Result<(), Failure> {
    let a = &policy.architecture;
    let c = &a.config;
    let (history, noisy) =
        (wave(3 * c.history * POSE_DIM, 0.1), wave(3 * c.horizon * POSE_DIM, 0.2));
    let mut workspace = Workspace::new(a, 3);
    let batch = Batch {
        len: 3,
        history: &history,
        procedure: &[0, 1, 1],
        noisy: &noisy,
        step: &[0, 40, 99],
        text: None,
        task: &[0; 3],
    };
    workspace.forward(a, &policy.weights, &batch);
    let bytes = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let data = [
        ("history", c.history, bytes(&history)),
        ("noisy", c.horizon, bytes(&noisy)),
        ("output", c.horizon, bytes(&workspace.output)),
    ];
    let views = data
        .iter()
        .map(|(name, n, b)| Ok((*name, TensorView::new(Dtype::F32, vec![3, *n, POSE_DIM], b)?)))
        .collect::<Result<Vec<_>, Failure>>()?;
    std::fs::write(folder.join("io.safetensors"), safetensors::serialize(views, None)?)?;
    Ok(())
}

fn main() -> Result<(), Failure> {
    tdv_policy::tune_allocator();
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folder, preset, batch] = args.as_slice() else {
        return Err("arguments: folder, small or base, batch".into());
    };
    let preset = if preset == "base" { PolicyConfig::base() } else { PolicyConfig::small() };
    let config = PolicyConfig { dt: 0.1, ..preset };
    let set = synthetic::reach_and_place_set(50, 1);
    let mut policy = TrainedPolicy::untrained(&set, &config, 1)?;
    for (i, w) in policy.weights.iter_mut().enumerate() {
        *w += 0.05 * ((i % 97) as f32 - 48.0) / 48.0;
    }
    let folder = Path::new(folder);
    policy.save(&folder.join("policy.safetensors"))?;
    write_io(folder, &policy)?;
    let mut planner = Planner::new(&policy, PlannerConfig::default())?;
    let history = vec![policy.end_poses[0]; planner.history_len()];
    let plan_ms = least_ms(60, || Ok(planner.plan(0, &history, 1).map(drop)?))?;
    let train = TrainConfig { batch: batch.parse()?, threads: 1, ..TrainConfig::default() };
    let mut training = Training::new(&[set], &config, &train)?;
    let step_ms = least_ms(12, || Ok(training.step().map(drop)?))?;
    println!("{{\"plan_ms\": {plan_ms}, \"step_ms\": {step_ms}}}");
    Ok(())
}
