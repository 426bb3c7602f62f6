//! The whole lab: a scripted robot goes through the controller's registers and the gripper's, the
//! judge watches.

mod common;

use common::down;
use common::script::Script;
use std::path::Path;
use std::sync::Arc;
use tdv_robot::Kinematics;
use tdv_simulation::controller::StopReason;
use tdv_simulation::disturbance::ForcedDrop;
use tdv_simulation::trial::PlacingGoal;
use tdv_simulation::world::DT;
use tdv_simulation::{Lab, LabAssets, Scene};

fn assets() -> Arc<LabAssets> {
    assets_of("cup_on_coaster")
}

fn assets_of(scene: &str) -> Arc<LabAssets> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config/scenes")
        .join(scene)
        .with_extension("yaml");
    Arc::new(LabAssets::load(Scene::load(&path).unwrap()).unwrap())
}

#[test]
fn the_home_configuration_is_as_described() {
    let scene = &assets().scene;
    let arm = Kinematics::ur5();
    let want = down(0.40, 0.0, 0.35, 0.0);
    for q in arm.ik_tcp(&want).iter() {
        println!("{q:.6?} elbow z {:.3}", arm.frames(&q)[2].translation.z);
    }
    let tcp = arm.fk_tcp(&scene.robot.home);
    let (d, a) = tdv_geometry::pose_distance(&tcp, &want);
    assert!(d < 1e-3 && a < 1e-3, "{d} {a}");
    assert!(arm.frames(&scene.robot.home)[2].translation.z > 0.3, "elbow up");
}

#[test]
fn scripted_trials_succeed() {
    let assets = assets();
    let goal = PlacingGoal { offset: [0.0, 0.0], yaw: 0.3 };
    let mut won = 0;
    for seed in 0..6 {
        let mut lab = Lab::from_assets(Arc::clone(&assets), seed).unwrap();
        lab.begin_trial(goal).unwrap();
        let start = lab.object_pose("mug").unwrap().translation;
        let mut s = Script::new(lab);
        let moved = s.pick_and_place(goal, |_| {});
        s.wait(1.5);
        let v = s.lab.trial().clone();
        let i = s.lab.incidents();
        println!("{seed}: start {:.3} {:.3} moved {moved} {v:?} {i:?}", start.x, start.y);
        assert_eq!((i.table_hits, i.protective_stops), (0, 0));
        won += u32::from(v.success);
    }
    assert_eq!(won, 6);
}

#[test]
fn the_bottle_is_placed_on_the_disc() {
    let assets = assets_of("mustard_on_disc");
    for (seed, low) in [(0, 0.128), (1, 0.131), (2, 0.134)] {
        let mut lab = Lab::from_assets(Arc::clone(&assets), seed).unwrap();
        lab.begin_trial(PlacingGoal::default()).unwrap();
        let mut s = Script::new(lab);
        s.heights = [low, 0.006];
        let moved = s.pick_and_place(PlacingGoal::default(), |_| {});
        s.wait(1.5);
        let (v, i) = (s.lab.trial().clone(), s.lab.incidents());
        println!("{seed}: {moved} {v:?} {i:?}");
        assert!(moved && v.success && i.protective_stops == 0, "{v:?} {i:?}");
    }
}

/// What a learned policy does: a grasp off by a centimetre and ten degrees, a mug dropped from 6 mm or
/// pressed down by 4 mm.
#[test]
fn sloppy_but_fair_trials_succeed() {
    let assets = assets();
    for (seed, slop) in [
        (0, [0.004, 0.008, 0.0, 0.006]),
        (1, [-0.006, -0.006, 0.17, -0.004]),
        (2, [0.003, -0.010, -0.17, -0.004]),
        (3, [0.0, 0.0, 0.1, 0.010]),
    ] {
        let mut lab = Lab::from_assets(Arc::clone(&assets), seed).unwrap();
        lab.begin_trial(PlacingGoal::default()).unwrap();
        let mut s = Script::new(lab);
        s.slop = slop;
        let moved = s.pick_and_place(PlacingGoal::default(), |_| {});
        s.wait(1.5);
        let (v, i) = (s.lab.trial().clone(), s.lab.incidents());
        println!("{slop:?}: {moved} {v:?} {i:?}");
        // Turned or shifted in the grip by what the grasp was off, the mug may miss its target; it
        // must never be thrown about.
        assert!(moved && i.protective_stops == 0 && i.table_hits == 0, "{i:?}");
        assert!(v.tilt_rad < 0.02 && v.error_m < 0.015 && v.released, "{v:?}");
    }
}

#[test]
fn a_displaced_coaster_fails_the_blind_script() {
    let goal = PlacingGoal::default();
    let mut lab = Lab::from_assets(assets(), 3).unwrap();
    lab.begin_trial(goal).unwrap();
    let mut s = Script::new(lab);
    let before = s.lab.object_pose("coaster").unwrap();
    s.pick_and_place(goal, |lab| {
        let by = lab.disturb("coaster", 11).unwrap();
        let d = by[0].hypot(by[1]);
        assert!((0.05..=0.10).contains(&d));
    });
    let shift =
        s.lab.object_pose("coaster").unwrap().translation.vector - before.translation.vector;
    assert!((0.045..0.11).contains(&shift.norm()), "{shift}");
    s.wait(2.0);
    let v = s.lab.conclude("the script ended");
    println!("{v:?}");
    assert!(!v.success && v.reason.contains("mm from"), "{v:?}");
}

#[test]
fn driving_into_the_table_is_stopped_and_counted() {
    let mut s = Script::new(Lab::from_assets(assets(), 5).unwrap());
    let at = s.tcp.translation;
    s.go(down(at.x, at.y, -0.02, 0.0));
    let i = s.lab.incidents();
    println!("{i:?}, {:?}", s.lab.controller().protective_stop());
    assert!(i.table_hits == 1 && i.protective_stops == 1 && i.table_depth < 0.01, "{i:?}");
    assert_eq!(s.lab.controller().protective_stop(), Some(StopReason::Table));
}

/// Prints how fast the lab is; no assertion on the clock.
#[test]
fn speed() {
    let mut s = Script::new(Lab::from_assets(assets(), 0).unwrap());
    let start = std::time::Instant::now();
    let before = s.lab.world().ticks();
    s.pick_and_place(PlacingGoal::default(), |_| {});
    let ticks = s.lab.world().ticks() - before;
    let rate = ticks as f64 / start.elapsed().as_secs_f64();
    println!("{ticks} ticks, {rate:.0} ticks/s, {:.0} times real time", rate * DT);
    assert!(ticks > 1000);
}

#[test]
fn the_lab_is_deterministic_and_seeds_differ() {
    let assets = assets();
    let run = |seed| {
        let mut s = Script::new(Lab::from_assets(Arc::clone(&assets), seed).unwrap());
        s.pick_and_place(PlacingGoal::default(), |_| {});
        s.lab.world().state_hash()
    };
    let first = run(1);
    assert_eq!(first, run(1));
    assert_ne!(first, run(2));
}

#[test]
fn a_forced_drop_loses_the_mug_once_and_leaves_it_standing_mostly() {
    let (mut dropped, mut standing) = (0, 0);
    let assets = assets();
    for seed in 1..=30 {
        let mut lab = Lab::from_assets(assets.clone(), seed).unwrap();
        let goal = PlacingGoal { offset: [0.0, 0.0], yaw: 0.0 };
        lab.begin_trial(goal).unwrap();
        let mut script = Script::new(lab);
        script.drop = Some(ForcedDrop::new(seed));
        script.pick_and_place(goal, |_| {});
        dropped += usize::from(script.drop.as_ref().is_some_and(ForcedDrop::is_done));
        let up =
            script.lab.object_pose("mug").unwrap().rotation * tdv_geometry::nalgebra::Vector3::z();
        standing += usize::from(up.z > 0.98);
        assert!(!script.lab.held("mug").unwrap());
    }
    println!("{dropped} dropped, {standing} standing");
    assert!(dropped >= 27 && standing >= 24, "{dropped} dropped, {standing} standing");
}
