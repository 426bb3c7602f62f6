//! A small fault campaign: nothing breaks, and the same seed gives the same case.

use std::path::Path;
use std::sync::Arc;
use tdv_evaluation::campaign::{run_campaign, run_case};
use tdv_simulation::{LabAssets, Scene};

#[test]
fn troubles_break_nothing_and_the_task_goes_on() {
    let scene =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/scenes/cup_on_coaster.yaml");
    let assets = Arc::new(LabAssets::load(Scene::load(&scene).unwrap()).unwrap());
    let report = run_campaign(&assets, 1, 40, &|_| {}).unwrap();
    println!("{}", report.table());
    assert!(report.safe());
    let recovered = report.cases.iter().filter(|c| c.recovered).count();
    // An object that fell over cannot be taken again.
    assert!(recovered >= 38, "{recovered} of 40");
    assert!(report.kinds.len() > 10, "{} kinds", report.kinds.len());
    let again = run_case(&assets, 7).unwrap();
    assert_eq!(report.cases.iter().find(|c| c.seed == 7), Some(&again));
}
