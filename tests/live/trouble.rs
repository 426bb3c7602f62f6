//! Bad input: one clear line that names the thing, exit code 1 (input) or 2 (arguments), nothing half-written.

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tdv_bag::{BagWriter, Durability, Topic};
use tdv_geometry::Stamp;
use tdv_tests::{machine, model, repository, run};

const SOON: Duration = Duration::from_secs(30);
const TASK: &str = "config/tasks/cup_on_coaster.yaml";

/// Runs a program that must refuse, and gives what it said.
fn refused(code: i32, name: &str, arguments: &[&str], words: &[&str]) {
    let (got, said) = run(name, arguments, SOON);
    let shown = format!("{name} {arguments:?} said:\n{said}");
    assert_eq!(got, Some(code), "{shown}");
    assert!(!said.contains("panicked"), "{shown}");
    for word in words {
        assert!(said.contains(word), "{word:?} is not in it: {shown}");
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Teaches from `bag`, which must fail, and looks that no model was left.
fn teach_refused(bag: &Path, folder: &Path, words: &[&str]) {
    let out = folder.join("model");
    let arguments = ["teach", "--task", TASK, "--bag", text(bag), "--out", text(&out)];
    refused(1, "tdv", &arguments, words);
    assert!(!out.exists(), "something was written");
}

#[test]
fn arguments_that_make_no_sense_end_with_two() {
    refused(2, "tdv", &["teach", "--task", TASK], &["--bag"]);
    refused(2, "tdv", &["dance"], &["dance"]);
    refused(2, "tdv", &["record-demo", "-o", "x", "--quality", "0"], &["quality"]);
    refused(2, "pose_tracker", &["--ros-args", "-p"], &["-p"]);
    refused(
        2,
        "pose_tracker",
        &["--ros-args", "-p", "no_such_parameter:=1"],
        &["no_such_parameter"],
    );
    refused(2, "camera_replay", &["--ros-args", "-p", "bag:=x", "-p", "rate:=-1.0"], &["rate"]);
}

#[test]
fn bags_that_are_none_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    teach_refused(&at("absent"), folder.path(), &["absent"]);
    fs::create_dir(at("old")).unwrap();
    fs::write(at("old/old_0.db3"), b"SQLite format 3\0").unwrap();
    teach_refused(&at("old"), folder.path(), &[".db3", "mcap"]);
    let recorded = repository().join("rosbags/cup_on_coaster/cup_on_coaster_0.mcap");
    let bytes = fs::read(recorded).unwrap();
    fs::write(at("cut.mcap"), &bytes[..200]).unwrap();
    teach_refused(&at("cut.mcap"), folder.path(), &["cut.mcap"]);
    fs::write(at("noise.mcap"), vec![7_u8; 5000]).unwrap();
    teach_refused(&at("noise.mcap"), folder.path(), &["noise.mcap"]);
    refused(1, "tdv", &["bag", "info", text(&at("absent"))], &["absent"]);
}

#[test]
fn a_truncated_bag_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.mcap");
    let recorded = repository().join("rosbags/cup_on_coaster/cup_on_coaster_0.mcap");
    let bytes = fs::read(recorded).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    refused(1, "tdv", &["bag", "info", text(&cut)], &["cut.mcap"]);
    teach_refused(&cut, folder.path(), &["cut.mcap"]);
}

#[test]
fn a_bag_without_the_camera_says_which_topics_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("talk");
    let mut writer = BagWriter::create(&path).unwrap();
    let id = writer
        .add_topic(Topic {
            name: "/chatter".into(),
            type_name: "std_msgs/msg/String".into(),
            schema: "string data".into(),
            durability: Durability::Volatile,
        })
        .unwrap();
    writer.write(id, Stamp(1), Stamp(1), &[0, 1, 0, 0, 2, 0, 0, 0, b'h', 0]).unwrap();
    writer.finish().unwrap();
    teach_refused(&path, folder.path(), &["/chatter"]);
    let bag = format!("bag:={}", path.display());
    let _machine = machine();
    refused(1, "camera_replay", &["--ros-args", "-p", &bag], &["/chatter", "camera"]);
}

#[test]
fn missing_networks_and_absurd_meshes_say_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().join("no_networks");
    fs::create_dir(&empty).unwrap();
    let bag = "rosbags/cup_on_coaster";
    let networks = ["teach", "--task", TASK, "--bag", bag, "--hand-models", text(&empty)];
    refused(1, "tdv", &networks, &["palm_detection_full.tflite", "fetch_hand_models.sh"]);
    // A mug of 95 metres: somebody forgot the millimetres.
    let objects = folder.path().join("objects");
    for name in ["mug", "coaster"] {
        let (from, to) = (repository().join("config/objects").join(name), objects.join(name));
        fs::create_dir_all(&to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
    let mesh: PathBuf = objects.join("mug/mesh.obj");
    let large: Vec<String> = fs::read_to_string(&mesh)
        .unwrap()
        .lines()
        .map(|line| match line.strip_prefix("v ") {
            Some(numbers) => {
                let mut numbers: Vec<f64> =
                    numbers.split_whitespace().filter_map(|n| n.parse().ok()).collect();
                numbers.iter_mut().take(3).for_each(|n| *n *= 1000.0);
                format!("v {}", numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" "))
            }
            None => line.to_owned(),
        })
        .collect();
    fs::write(&mesh, large.join("\n")).unwrap();
    let out = folder.path().join("model");
    let meshes =
        ["teach", "--task", TASK, "--bag", bag, "--objects", text(&objects), "--out", text(&out)];
    refused(1, "tdv", &meshes, &["mesh.obj", "millimetres"]);
    assert!(!out.exists());
}

#[test]
fn a_checkpoint_of_another_task_and_none_at_all_are_refused() {
    let Some(model) = model() else { return };
    let folder = tempfile::tempdir().unwrap();
    let _machine = machine();
    let absent = format!("model:={}", folder.path().join("absent").display());
    for node in ["diffusion_policy", "switch_policy"] {
        refused(1, node, &["--ros-args", "-p", &absent], &["absent", "tdv teach"]);
    }
    let other = folder.path().join("other");
    fs::create_dir(&other).unwrap();
    let text = fs::read_to_string(model.join("demonstration.json")).unwrap();
    fs::write(other.join("demonstration.json"), text.replace("cup_on_coaster", "tea_party"))
        .unwrap();
    for file in ["policy.safetensors", "switch.safetensors"] {
        fs::copy(model.join(file), other.join(file)).unwrap();
    }
    let mixed = format!("model:={}", other.display());
    for node in ["diffusion_policy", "switch_policy"] {
        refused(1, node, &["--ros-args", "-p", &mixed], &["tea_party", "cup_on_coaster"]);
    }
}

#[test]
fn ports_and_domains_that_cannot_be_had_are_named() {
    let _machine = machine();
    let port = TcpListener::bind("127.0.0.1:0").unwrap();
    let number = port.local_addr().unwrap().port().to_string();
    let taken = format!("rtde_port:={number}");
    let scene = "scene:=config/scenes/cup_on_coaster.yaml";
    refused(1, "virtual_lab", &["--ros-args", "-p", scene, "-p", &taken], &[&number, "in use"]);
    let mut command =
        tdv_tests::command("pose_tracker", &["--ros-args", "-p", &format!("task:={TASK}")]);
    let output = command.env("ROS_DOMAIN_ID", "500").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(1 | 2)), "{said}");
    assert!(said.contains("ROS_DOMAIN_ID") && said.contains("500"), "{said}");
}
