//! Any node but the lab is killed while the arm moves.

use std::time::Duration;
use tdv_tests::{json, machine, model, run};

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
    let folder = tempfile::tempdir().unwrap();
    let result = folder.path().join("result.json");
    let mut arguments = vec![
        "eval",
        "closed-loop",
        "--task",
        "config/tasks/cup_on_coaster.yaml",
        "--model",
        model.to_str().unwrap(),
        "--trials",
        "6",
        "--seed",
        "1",
        "--kill",
        "each",
        "--live",
        "--json",
        result.to_str().unwrap(),
        "--run",
        folder.path().to_str().unwrap(),
    ];
    arguments.extend(more);
    let (code, said) = run("tdv", &arguments, Duration::from_secs(600));
    println!("{said}");
    let trials = json(&result);
    let trials = trials["trials"].as_array().unwrap();
    assert_eq!(trials.len(), 6);
    for trial in trials {
        let fault = &trial["fault"];
        let node = fault["node"].as_str().expect("the arm moved and a node was killed");
        assert!(fault["speed"].as_f64().unwrap() > 0.1, "{node}: the arm hardly moved");
        let rest = fault["rest_ms"].as_f64();
        assert!(rest.is_some_and(|ms| ms <= REST_MS), "{node}: rest after {rest:?} ms");
        assert!(!fault["sentence"].as_str().unwrap().is_empty(), "{node}: nobody said why");
        assert_eq!(trial["success"], true, "{node}: {}", trial["reason"]);
    }
    assert_eq!(code, Some(0));
}
