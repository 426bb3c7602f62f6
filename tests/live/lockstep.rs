//! The same recording and seed, played twice in lockstep.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;
use tdv_bag::BagReader;
use tdv_tests::{command, holds, machine, model, run};

const TOPICS: [&str; 2] = ["/pose_tracker/objects", "/diffusion_policy/prediction"];

/// What was answered to the demonstration, message by message.
fn replayed(model: &Path, folder: &Path, name: &str) -> BTreeMap<String, Vec<Vec<u8>>> {
    let bag = folder.join(name);
    let mut recorder = command("tdv", &["record", "-o", bag.to_str().unwrap()])
        .args(TOPICS)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let model = format!("model:={}", model.display());
    let launch = "launch_scripts/replay.launch.yaml";
    let played = "bag:=rosbags/cup_on_coaster";
    let arguments = [
        "launch",
        launch,
        played,
        "lockstep:=true",
        "startup_delay:=4.0",
        &model,
        "--until",
        "camera_replay",
    ];
    let (code, said) = run("tdv", &arguments, Duration::from_secs(120));
    assert_eq!(code, Some(0), "{said}");
    // The shell's own `kill`: a minimal system has no program of that name.
    let interrupt = format!("kill -INT {}", recorder.id());
    assert!(std::process::Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
    assert!(recorder.wait().unwrap().success());
    let mut reader = BagReader::open(&bag).unwrap();
    let mut messages: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    while let Some(m) = reader.next_message().unwrap() {
        messages.entry(m.topic.clone()).or_default().push(m.data.to_vec());
    }
    messages
}

#[test]
fn poses_and_predictions_are_the_same_bytes() {
    let Some(model) = model() else { return };
    let _machine = machine();
    holds("two replays in lockstep", || same_bytes(model));
}

fn same_bytes(model: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let first = replayed(model, folder.path(), "first");
    let second = replayed(model, folder.path(), "second");
    for topic in TOPICS {
        let (a, b) = (&first[topic], &second[topic]);
        assert_eq!(a.len(), 121, "{topic}: an answer to each frame");
        let long = a.iter().filter(|m| m.len() > 1000).count();
        assert!(topic != TOPICS[1] || long > 60, "only {long} predictions have poses");
        assert!(
            a == b,
            "{topic}: {} of {} differ",
            a.iter().zip(b).filter(|(a, b)| a != b).count(),
            a.len()
        );
    }
}
