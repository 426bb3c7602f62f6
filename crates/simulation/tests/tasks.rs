//! The benchmark's tasks can be done in the lab by a scripted robot, and are not done by themselves.

mod common;

use common::down;
use common::script::Script;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;
use std::sync::Arc;
use tdv_geometry::nalgebra::{Translation3, UnitQuaternion, Vector3};
use tdv_geometry::{Pose, yaw_of};
use tdv_simulation::gripper::ObjectStatus;
use tdv_simulation::trial::{Measured, PlacingGoal, Verdict};
use tdv_simulation::{Lab, LabAssets, Scene};

fn start(scene: &str, seed: u64) -> Script {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config/scenes")
        .join(scene)
        .with_extension("yaml");
    let assets = Arc::new(LabAssets::load(Scene::load(&path).unwrap()).unwrap());
    let mut lab = Lab::from_assets(assets, seed).unwrap();
    lab.begin_trial(PlacingGoal::default()).unwrap();
    Script::new(lab)
}

fn pose(s: &Script, name: &str) -> Pose {
    s.lab.object_pose(name).unwrap()
}

/// Straight down over `frame` at (x, y, z) of it, fingers closing along its y turned by `turn`.
fn over(frame: &Pose, [x, y, z]: [f64; 3], turn: f64) -> Pose {
    let p = frame * Translation3::new(x, y, 0.0);
    let p = p.translation.vector;
    down(p.x, p.y, frame.translation.z + z, yaw_of(&frame.rotation) + turn)
}

/// From above, closes on something and says whether something is between the fingers.
fn take(s: &mut Script, frame: &Pose, at: [f64; 3], turn: f64) -> bool {
    let above = [at[0], at[1], at[2] + 0.13];
    s.go(over(frame, above, turn))
        && s.go(over(frame, at, turn))
        && s.fingers(255) == ObjectStatus::ContactClosing
}

/// Nothing has been said to be done yet; then waits and concludes.
fn verdict(mut s: Script, seconds: f64) -> (Verdict, Script) {
    s.wait(seconds);
    let v = s.lab.conclude("the script ended");
    println!("{v:?} {:?}", s.lab.incidents());
    (v, s)
}

#[test]
fn the_toy_is_placed_on_the_card() {
    let mut s = start("stitch_on_card", 1);
    s.wait(0.3);
    let (toy, card) = (pose(&s, "toy"), pose(&s, "card"));
    assert!(take(&mut s, &toy, [0.0, 0.0, 0.052], FRAC_PI_2));
    assert!(s.lab.held("toy").unwrap() && !s.lab.trial().success);
    let t = card.translation;
    let place = |z| down(t.x, t.y, z, FRAC_PI_2);
    assert!(s.go(over(&toy, [0.0, 0.0, 0.20], FRAC_PI_2)));
    assert!(s.go(place(0.20)) && s.go(place(0.055)));
    s.fingers(0);
    assert!(s.go(place(0.20)));
    let (v, s) = verdict(s, 1.5);
    assert!(v.success && v.reason == "placed", "{v:?}");
    assert_eq!((s.lab.incidents().table_hits, s.lab.incidents().protective_stops), (0, 0));
}

/// Lowers the ring over the peg, off by `aside` (m) in x, and lets go.
fn ring(aside: f64) -> Verdict {
    let mut s = start("ring_on_peg", 2);
    s.wait(0.3);
    let (ring, peg) = (pose(&s, "ring"), pose(&s, "peg"));
    assert!(take(&mut s, &ring, [0.0, 0.0, 0.022], 0.0) && s.lab.held("ring").unwrap());
    assert!(!s.lab.trial().success);
    let (x, y) = (peg.translation.x + aside, peg.translation.y);
    assert!(s.go(over(&ring, [0.0, 0.0, 0.22], 0.0)));
    assert!(s.go(down(x, y, 0.22, 0.0)));
    // Half way down the peg, then it falls.
    s.go(down(x, y, 0.022 + 0.040, 0.0));
    s.fingers(0);
    s.go(down(x, y, 0.22, 0.0));
    verdict(s, 1.5).0
}

#[test]
fn the_ring_goes_on_when_it_is_central() {
    for aside in [0.0, 0.0015] {
        let v = ring(aside);
        assert!(v.success && v.reason == "on the peg", "{aside}: {v:?}");
    }
    let v = ring(0.006);
    assert!(!v.success, "{v:?}");
}

#[test]
fn the_ring_does_not_pass_through_the_wall() {
    let mut s = start("ring_on_peg", 2);
    s.wait(0.3);
    let ring = pose(&s, "ring");
    assert!(take(&mut s, &ring, [0.0, 0.0, 0.022], 0.0));
    // Straight for the peg, too low.
    s.go(down(0.45, -0.05, 0.08, 0.0));
    s.go(down(0.45, -0.25, 0.062, 0.0));
    let (v, s) = verdict(s, 0.5);
    assert!(!v.success && s.lab.incidents().protective_stops > 0, "{v:?}");
}

fn drops_in(s: &Script, name: &str, radius: f64, height: f64) -> usize {
    let into = pose(s, name).inverse();
    let inside = |p: &tdv_geometry::nalgebra::Point3<f64>| {
        let q = into * p;
        q.x.hypot(q.y) < radius && (0.0..height).contains(&q.z)
    };
    s.lab.world().drops().iter().filter(|p| inside(p)).count()
}

#[test]
fn the_mug_is_carried_full_and_poured_out() {
    let mut s = start("pour_water", 1);
    s.wait(0.5);
    assert_eq!(drops_in(&s, "mug", 0.030, 0.085), 100);
    let (mug, tumbler) = (pose(&s, "mug"), pose(&s, "tumbler"));
    assert!(take(&mut s, &mug, [0.0, 0.0, 0.050], 0.0) && s.lab.held("mug").unwrap());
    let grip = pose(&s, "mug").inverse() * s.tcp;
    assert!(s.go(over(&mug, [0.0, 0.0, 0.26], 0.0)));
    let t = tumbler.translation;
    let upright = Pose::translation(t.x + 0.080, t.y, 0.20);
    assert!(s.go(upright * grip));
    let kept = drops_in(&s, "mug", 0.030, 0.085);
    println!("{kept} drops left after the carry");
    assert!(kept >= 98 && !s.lab.trial().success, "{kept}");
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -1.75);
    let rim = Vector3::new(t.x + 0.024, t.y, 0.200);
    let tilted = Pose::from_parts((rim - turn * Vector3::new(-0.032, 0.0, 0.090)).into(), turn);
    assert!(s.go(tilted * grip), "the arm cannot pour there");
    let (v, s) = verdict(s, 2.0);
    assert!(v.success, "{v:?}");
    assert!(matches!(v.measured, Measured::Drops { inside, total: 100 } if inside >= 80), "{v:?}");
    assert!(s.lab.held("mug").unwrap(), "it need not be let go");
}

#[test]
fn the_drawer_opens_when_it_is_pulled_and_not_else() {
    let mut s = start("open_drawer", 3);
    s.wait(1.0);
    let cabinet = pose(&s, "cabinet");
    let i = s.lab.scene().index_of("drawer").unwrap();
    let shut = s.lab.world().joint_travel(i).unwrap();
    assert!(shut.abs() < 5e-4, "{shut}");
    assert!(take(&mut s, &cabinet, [0.145, 0.0, 0.062], 0.0) && s.lab.held("drawer").unwrap());
    assert!(!s.lab.trial().success);
    assert!(s.go(over(&cabinet, [0.145 + 0.115, 0.0, 0.062], 0.0)));
    let (v, s) = verdict(s, 1.5);
    assert!(v.success && v.reason == "opened", "{v:?}");
    assert_eq!(s.lab.incidents().protective_stops, 0);
}

#[test]
fn an_unpulled_drawer_stays_shut() {
    let mut s = start("open_drawer", 4);
    let cabinet = pose(&s, "cabinet");
    assert!(take(&mut s, &cabinet, [0.145, 0.0, 0.062], 0.0));
    s.fingers(0);
    s.go(over(&cabinet, [0.145, 0.0, 0.20], 0.0));
    let (v, _) = verdict(s, 1.5);
    assert!(!v.success && v.reason.contains("mm open"), "{v:?}");
    assert!(matches!(v.measured, Measured::Travel(d) if d.abs() < 0.003), "{v:?}");
}

/// Takes the plug out and pushes it down `aside` (m) beside the socket.
fn plug(aside: f64) -> Verdict {
    let mut s = start("insert_plug", 5);
    s.wait(0.3);
    let socket = pose(&s, "socket");
    assert!(take(&mut s, &socket, [-0.045, 0.0, 0.072], 0.0) && s.lab.held("plug").unwrap());
    assert!(!s.lab.trial().success);
    assert!(s.go(over(&socket, [-0.045, 0.0, 0.13], 0.0)));
    assert!(s.go(over(&socket, [0.045 + aside, 0.0, 0.13], 0.0)));
    s.go(over(&socket, [0.045 + aside, 0.0, 0.059], 0.0));
    s.fingers(0);
    verdict(s, 1.5).0
}

#[test]
fn the_plug_goes_into_the_socket() {
    for aside in [0.0, 0.0015] {
        let v = plug(aside);
        assert!(v.success && v.reason == "inserted", "{aside}: {v:?}");
    }
    assert!(!plug(0.012).success);
}

#[test]
fn the_tissue_stays_until_it_is_pulled() {
    let mut s = start("pull_tissue", 6);
    s.wait(1.0);
    let tissue_box = pose(&s, "tissue_box");
    let i = s.lab.scene().index_of("tissue").unwrap();
    assert!(s.lab.world().joint_travel(i).unwrap().abs() < 5e-4);
    assert!(take(&mut s, &tissue_box, [0.0, 0.0, 0.085], 0.0) && s.lab.held("tissue").unwrap());
    assert!(!s.lab.trial().success);
    assert!(s.go(over(&tissue_box, [0.0, 0.0, 0.085 + 0.125], 0.0)));
    assert!(s.lab.world().joint_travel(i).is_none(), "it has come free");
    let (v, s) = verdict(s, 1.5);
    assert!(v.success && v.reason == "pulled out" && s.lab.held("tissue").unwrap(), "{v:?}");
}

/// Prints how fast each scene is; no assertion on the clock.
#[test]
fn speed() {
    for scene in
        ["stitch_on_card", "ring_on_peg", "pour_water", "open_drawer", "insert_plug", "pull_tissue"]
    {
        let mut s = start(scene, 0);
        let begin = std::time::Instant::now();
        s.wait(1.0);
        println!("{scene}: {:.0} steps/s", 500.0 / begin.elapsed().as_secs_f64());
    }
}

/// The arm is told of the wall where it stands in the scene.
#[test]
fn the_workcell_of_the_ring_is_that_of_its_scene() {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/robot/workcell_ring_on_peg.yaml");
    let cell = tdv_robot::collision::Workcell::load(&file).unwrap();
    let s = start("ring_on_peg", 9);
    for (fixture, object) in [("wall", "wall"), ("peg_base", "peg")] {
        let f = cell.fixtures.iter().find(|f| f.name == fixture).unwrap();
        let stands = pose(&s, object).translation;
        let off = (f.position[0] - stands.x).hypot(f.position[1] - stands.y);
        assert!(off < 1e-6, "{fixture} is {off} m off");
        let i = s.lab.scene().index_of(object).unwrap();
        let (low, high) = s.lab.assets().meshes[i].bounds();
        let tdv_robot::collision::FixtureShape::Box(edges) = f.shape.clone() else { panic!() };
        assert!((edges[0] - (high.x - low.x)).abs() < 1e-6);
        assert!((edges[1] - (high.y - low.y)).abs() < 1e-6);
        assert!((f.position[2] - edges[2] / 2.0).abs() < 1e-9, "it stands on the table");
    }
}
