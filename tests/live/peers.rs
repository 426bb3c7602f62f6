//! The graph beside rclpy, and with estimators like Isaac's; our bags beside `rosbags`, the virtual controller and gripper under ur_rtde
//! and pyrobotiqur, the driver's surface against the official driver's, its serial line beside robotiq2f.

use std::path::PathBuf;
use std::process::Command;
use tdv_tests::{holds, machine, model, program, repository};

/// Where launch_scripts/test.sh sets rclpy up (tests/peers/setup.sh).
fn environment() -> Option<PathBuf> {
    let folder = std::env::var_os("TDV_PEERS")
        .map_or_else(|| repository().join("target/peers"), PathBuf::from);
    let script = folder.join("env.sh");
    if !script.is_file() {
        println!("skipped: no rclpy; `tests/peers/setup.sh target/peers` sets it up");
        return None;
    }
    Some(script)
}

fn passes(script: &str, arguments: &[&str]) {
    let Some(environment) = environment() else { return };
    holds(script, || {
        let status = Command::new("bash")
            .args(["-c", "source \"$0\" && exec tests/peers/netns.sh python \"$@\""])
            .arg(&environment)
            .arg(script)
            .args(arguments)
            .current_dir(repository())
            .status()
            .unwrap();
        assert!(status.success(), "{script}: see the lines that begin with FAIL");
    });
}

#[test]
fn rclpy_and_rosbags_agree_with_the_whole_graph() {
    let Some(model) = model() else { return };
    let _machine = machine();
    let binaries = program("tdv").parent().unwrap().display().to_string();
    passes("tests/peers/graph_peer.py", &[&binaries, model.to_str().unwrap()]);
}

#[test]
fn estimators_with_the_interface_of_isaac_replace_the_classical_chain() {
    let Some(model) = model() else { return };
    let _machine = machine();
    let binaries = program("tdv").parent().unwrap().display().to_string();
    passes("tests/peers/isaac_peer.py", &[&binaries, model.to_str().unwrap()]);
}

#[test]
fn rclpy_agrees_with_every_feature_of_the_runtime() {
    let peer = program("examples/peer");
    let _machine = machine();
    passes("tests/peers/runtime_peer.py", &[peer.to_str().unwrap()]);
}

#[test]
fn ur_rtde_cannot_tell_the_virtual_controller_from_a_robot() {
    let controller = program("examples/controller");
    let _machine = machine();
    passes("tests/peers/ur_rtde_peer.py", &[controller.to_str().unwrap()]);
}

#[test]
fn pyrobotiqur_opens_closes_and_feels_an_object() {
    let controller = program("examples/controller");
    let _machine = machine();
    passes("tests/peers/robotiq_peer.py", &[controller.to_str().unwrap()]);
}

#[test]
fn our_driver_offers_what_the_official_one_does() {
    let lab = program("virtual_lab");
    program("ur5_driver");
    let _machine = machine();
    passes("tests/peers/driver_peer.py", &[lab.parent().unwrap().to_str().unwrap()]);
}

#[test]
fn a_gripper_on_a_serial_line_obeys_robotiq2f_and_our_driver() {
    let driver = program("ur5_driver");
    let _machine = machine();
    passes("tests/peers/modbus_peer.py", &[driver.to_str().unwrap()]);
}
