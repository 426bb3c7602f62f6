//! Any node but the lab is killed while the arm moves.

use std::path::Path;
use std::time::Duration;
use tdv_runtime::trial::NODES;
use tdv_tests::{holds, json, machine, model, run};

/// The design's limit (ms) from the kill to rest.
const REST_MS: f64 = 350.0;

#[test]
fn the_arm_rests_says_why_and_goes_on_whichever_node_dies() {
    kill_each(&[]);
}

#[test]
fn nothing_is_dropped_whichever_node_dies_in_mid_carry() {
    kill_each(&["--kill-carrying"]);
}

fn kill_each(more: &[&str]) {
    let Some(model) = model() else { return };
    let _machine = machine();
    for (seed, node) in (1..).zip(NODES) {
        holds(&format!("{node} killed {more:?}"), || kill(node, seed, model, more));
    }
}

fn kill(node: &str, seed: u64, model: &Path, more: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let result = folder.path().join("result.json");
    let seed = seed.to_string();
    let mut arguments = vec![
        "eval",
        "closed-loop",
        "--task",
        "config/tasks/cup_on_coaster.yaml",
        "--model",
        model.to_str().unwrap(),
        "--trials",
        "1",
        "--seed",
        &seed,
        "--kill",
        node,
        "--live",
        "--json",
        result.to_str().unwrap(),
        "--run",
        folder.path().to_str().unwrap(),
    ];
    arguments.extend(more);
    let (code, said) = run("tdv", &arguments, Duration::from_secs(150));
    println!("{said}");
    let trial = &json(&result)["trials"][0];
    let fault = &trial["fault"];
    assert_eq!(fault["node"].as_str(), Some(node), "the arm moved and the node was killed");
    assert!(fault["speed"].as_f64().unwrap() > 0.1, "{node}: the arm hardly moved");
    let rest = fault["rest_ms"].as_f64();
    assert!(rest.is_some_and(|ms| ms <= REST_MS), "{node}: rest after {rest:?} ms");
    assert!(!fault["sentence"].as_str().unwrap().is_empty(), "{node}: nobody said why");
    assert_eq!(trial["success"], true, "{node}: {}", trial["reason"]);
    assert_eq!(code, Some(0));
}
