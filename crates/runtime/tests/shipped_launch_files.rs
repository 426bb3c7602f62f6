//! The launch files in `launch_scripts/` resolve, and what they refer to exists.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tdv_runtime::launch::LaunchFile;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn launch_files() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(root().join("launch_scripts"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.to_string_lossy().ends_with(".launch.yaml"))
        .collect();
    files.sort();
    files
}

#[test]
fn every_launch_file_resolves_to_nodes_and_files_that_exist() {
    let files = launch_files();
    assert!(files.len() >= 2);
    for path in files {
        let file = LaunchFile::load(&path).unwrap();
        // Arguments without a default are the user's to give.
        let given: BTreeMap<String, String> = file
            .arguments()
            .into_iter()
            .filter(|(_, default, _)| default.is_none())
            .map(|(name, _, _)| (name, "given".into()))
            .collect();
        for (name, _, description) in file.arguments() {
            assert!(!description.is_empty(), "{}: {name} has no description", path.display());
        }
        let commands = file.commands(&given, &root()).unwrap();
        assert!(!commands.is_empty());
        for command in commands {
            let node = root().join("nodes").join(&command.executable);
            assert!(node.is_dir(), "{}: no node {}", path.display(), command.executable);
            let mut arguments = command.arguments.iter();
            while let Some(a) = arguments.next() {
                if a == "--params-file" {
                    let params = Path::new(arguments.next().unwrap());
                    let text = std::fs::read_to_string(params)
                        .unwrap_or_else(|e| panic!("{}: {e}", params.display()));
                    assert!(text.contains(&format!("{}:", command.executable)), "{params:?}");
                }
            }
        }
    }
}
