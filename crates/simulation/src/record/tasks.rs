//! The demonstrations of the benchmark's tasks: what is shown, by which hand motion. Poses in base_link.

use super::{DemoConfig, Grip, Motion, Script};
use crate::avatar::GraspTarget;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_2;
use tdv_geometry::{Pose, pose_from_xyz_rpy};

/// A demonstration by the names of its objects.
#[derive(Debug, Clone)]
pub struct TaskDemo {
    /// What is shown.
    pub config: DemoConfig,
    /// Object folder of what the hand moves.
    pub moving: &'static str,
    /// Object folder of what it is moved against.
    pub reference: &'static str,
    /// What else stands there, by folder and pose.
    pub others: Vec<(&'static str, Pose)>,
}

/// The tasks that can be demonstrated.
pub const TASKS: [&str; 7] = [
    "cup_on_coaster",
    "stitch_on_card",
    "ring_on_peg",
    "pour_water",
    "open_drawer",
    "insert_plug",
    "pull_tissue",
];

/// The demonstration of the task called `name`, from its usual start; none for an unknown name. The
/// poses are those that the scene of the same name has room for.
pub fn demonstration(name: &str, seed: u64) -> Option<TaskDemo> {
    let base = DemoConfig::cup_on_coaster(seed, [0.55, 0.10, 0.262]);
    Some(match name {
        "cup_on_coaster" => {
            TaskDemo { config: base, moving: "mug", reference: "coaster", others: vec![] }
        }
        "stitch_on_card" => stitch_on_card(base),
        "ring_on_peg" => ring_on_peg(base),
        "pour_water" => pour_water(base),
        "open_drawer" => open_drawer(base),
        "insert_plug" => insert_plug(base),
        "pull_tissue" => pull_tissue(base),
        _ => return None,
    })
}

fn at(x: f64, y: f64, z: f64, yaw: f64) -> Pose {
    pose_from_xyz_rpy([x, y, z], [0.0, 0.0, yaw])
}

fn lifted(pose: &Pose, by: f64) -> Pose {
    Translation3::new(0.0, 0.0, by) * pose
}

/// Where the hand waits, seen from the object that it is going to take.
fn home(grasp: &Pose) -> Pose {
    Translation3::new(-0.04, 0.07, 0.22) * grasp
}

/// Home, over the object, down, closed.
fn take(hold: Pose, object: &Pose, above: f64) -> Script {
    let grasp = object * hold;
    Script::new(home(&grasp), hold)
        .then(lifted(&grasp, above), 1.2, 0.0)
        .then(grasp, 1.2, 0.3)
        .grip(Grip::Close, 0.45)
        .dwell(0.15)
}

/// Open, up, away.
fn leave(script: Script, above: f64) -> Script {
    let last = script.phases.last().map_or(script.from, |p| p.to);
    script.grip(Grip::Open, 0.4).then(lifted(&last, above), 0.9, 0.1).then(home(&last), 0.8, 0.4)
}

/// Lift, over to a place, down; `via` is the height (m) of the way.
fn carry(script: Script, from: &Pose, to: &Pose, via: f64) -> Script {
    let (from, to) = (from * script.hold, to * script.hold);
    let high = |p: &Pose| {
        Pose::from_parts(
            Translation3::new(p.translation.x, p.translation.y, via + p.translation.z),
            p.rotation,
        )
    };
    script.then(high(&from), 1.1, 0.0).then(high(&to), 1.9, 0.4).then(to, 1.2, 0.3).dwell(0.2)
}

fn stitch_on_card(base: DemoConfig) -> TaskDemo {
    let (start, end) = (at(0.55, 0.10, 0.0, 0.25), at(0.45, -0.22, 0.002, 0.1));
    // Thumb and fingers on belly and back: the grasp's y is the toy's x.
    let hold = pose_from_xyz_rpy([0.0; 3], [0.0, 0.0, -FRAC_PI_2]);
    let script = leave(carry(take(hold, &start, 0.12), &start, &end, 0.12), 0.12);
    TaskDemo {
        config: DemoConfig {
            moving_start: start,
            moving_end: end,
            target: GraspTarget { radius: 0.027, height: 0.108, tool_height: 0.062 },
            motion: Motion::Script(script),
            ..base
        },
        moving: "toy",
        reference: "card",
        others: vec![],
    }
}

fn ring_on_peg(base: DemoConfig) -> TaskDemo {
    let (start, end) = (at(0.52, 0.08, 0.0, 0.2), at(0.45, -0.25, 0.010, 0.05));
    let script = leave(carry(take(Pose::identity(), &start, 0.12), &start, &end, 0.17), 0.14);
    TaskDemo {
        config: DemoConfig {
            reference: at(0.45, -0.25, 0.0, 0.0),
            moving_start: start,
            moving_end: end,
            target: GraspTarget { radius: 0.025, height: 0.024, tool_height: 0.022 },
            motion: Motion::Script(script),
            ..base
        },
        moving: "ring",
        reference: "peg",
        others: vec![("wall", at(0.45, -0.15, 0.0, 0.0))],
    }
}

/// How far the mug is tilted at last (rad).
const POUR: f64 = 1.80;
/// Where the lip is while the drops leave it, seen from the middle of the tumbler's underside: x, z (m).
/// They fly 2 to 6 cm towards -x before they are at the tumbler's rim, so the lip is before its middle, and
/// no higher above it than the gripper needs.
const LIP: [f64; 2] = [0.028, 0.165];
/// How much higher the lip comes, so that the upright mug passes over the tumbler (m), and how far the mug is
/// tilted when that is gone (rad).
const OVER: (f64, f64) = (0.060, 1.0);
/// Parts that the tilting is drawn in.
const TILTS: u32 = 6;

/// The mug over the tumbler when it is tilted by `angle`, its mouth towards the robot's base: it turns about
/// its lip.
fn pour_pose(tumbler: &Pose, angle: f64) -> Pose {
    let t = tumbler.translation.vector;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -angle);
    let high = OVER.0 * (1.0 - angle / OVER.1).max(0.0);
    let lip = Vector3::new(t.x + LIP[0], t.y, t.z + LIP[1] + high);
    // The rim's lowest point is on the mug's -x side.
    Pose::from_parts(Translation3::from(lip - turn * Vector3::new(-0.032, 0.0, 0.090)), turn)
}

fn pour_water(base: DemoConfig) -> TaskDemo {
    let tumbler = at(0.45, -0.20, 0.0, 0.0);
    let start = at(0.52, 0.10, 0.0, 0.2);
    let over = pour_pose(&tumbler, 0.0);
    let tilted = pour_pose(&tumbler, POUR);
    let mut script = take(Pose::identity(), &start, 0.12)
        .then(lifted(&start, 0.170), 1.2, 0.0)
        .then(over, 2.0, 0.4);
    for k in 1..=TILTS {
        let angle = POUR * f64::from(k) / f64::from(TILTS);
        // The parts run into one another: it never stops.
        let overlap = if k == 1 { 0.0 } else { 0.45 };
        script = script.then(pour_pose(&tumbler, angle), 0.9, overlap);
    }
    let script = script.dwell(1.5);
    TaskDemo {
        config: DemoConfig {
            reference: tumbler,
            moving_start: start,
            moving_end: tilted,
            motion: Motion::Script(script),
            ..base
        },
        moving: "mug",
        reference: "tumbler",
        others: vec![],
    }
}

/// `T_drawer_grasp`: the handle bar's foot.
const HANDLE: [f64; 3] = [0.145, 0.0, 0.026];

fn open_drawer(base: DemoConfig) -> TaskDemo {
    let cabinet = at(0.36, 0.0, 0.0, 0.1);
    let open = cabinet * Translation3::new(0.12, 0.0, 0.0);
    let hold = Pose::translation(HANDLE[0], HANDLE[1], HANDLE[2]);
    let mut script = take(hold, &cabinet, 0.10).then(open * hold, 1.8, 0.0).dwell(0.3);
    script.guided = true;
    TaskDemo {
        config: DemoConfig {
            reference: cabinet,
            moving_start: cabinet,
            moving_end: open,
            target: GraspTarget { radius: 0.012, height: 0.064, tool_height: 0.038 },
            motion: Motion::Script(leave(script, 0.12)),
            ..base
        },
        moving: "drawer",
        reference: "cabinet",
        others: vec![],
    }
}

fn insert_plug(base: DemoConfig) -> TaskDemo {
    let socket = at(0.48, 0.0, 0.0, 0.15);
    let parked = socket * Translation3::new(-0.045, 0.0, 0.0202);
    let plugged = socket * Translation3::new(0.045, 0.0, 0.0062);
    let up = 0.06;
    let mut script = take(Pose::identity(), &parked, 0.10)
        .then(lifted(&parked, up), 1.0, 0.0)
        .then(lifted(&plugged, up + 0.014), 1.2, 0.0)
        .then(plugged, 1.4, 0.0)
        .dwell(0.3);
    script.guided = true;
    TaskDemo {
        config: DemoConfig {
            reference: socket,
            moving_start: parked,
            moving_end: plugged,
            target: GraspTarget { radius: 0.015, height: 0.070, tool_height: 0.052 },
            motion: Motion::Script(leave(script, 0.10)),
            ..base
        },
        moving: "plug",
        reference: "socket",
        others: vec![],
    }
}

fn pull_tissue(base: DemoConfig) -> TaskDemo {
    let tissue_box = at(0.48, 0.0, 0.0, 0.2);
    let out = lifted(&tissue_box, 0.13);
    let mut script = take(Pose::identity(), &tissue_box, 0.10).then(out, 1.6, 0.0).dwell(0.6);
    script.guided = true;
    TaskDemo {
        config: DemoConfig {
            reference: tissue_box,
            moving_start: tissue_box,
            moving_end: out,
            // A pinch as round something a little thicker than the tab.
            target: GraspTarget { radius: 0.006, height: 0.104, tool_height: 0.086 },
            motion: Motion::Script(script),
            ..base
        },
        moving: "tissue",
        reference: "tissue_box",
        others: vec![],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{DemoObject, DemoTruth, Recorder};
    use std::path::Path;
    use tdv_geometry::pose_distance;
    use tdv_rendering::{Mesh, ObjectFile};

    fn object(name: &str) -> DemoObject {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects").join(name);
        let mesh: Mesh = ObjectFile::load(&dir).unwrap().load_mesh(&dir).unwrap();
        DemoObject { name: name.to_owned(), mesh }
    }

    #[test]
    fn every_task_is_shown_smoothly_by_a_hand_that_holds() {
        assert!(demonstration("fly_to_the_moon", 1).is_none());
        for name in TASKS {
            let demo = demonstration(name, 3).unwrap();
            let (start, end) = (demo.config.moving_start, demo.config.moving_end);
            let rate = demo.config.rate;
            let others = demo.others.iter().map(|(n, p)| (object(n), *p)).collect();
            let r = Recorder::new(demo.config, object(demo.moving), object(demo.reference))
                .unwrap_or_else(|e| panic!("{name}: {e}"))
                .with_others(others);
            let all: Vec<DemoTruth> = (0..r.frames()).map(|k| r.truth(k)).collect();
            let poses: Vec<Pose> = all.iter().map(|f| f.objects[demo.moving]).collect();
            assert!((60..200).contains(&all.len()), "{name}: {} frames", all.len());
            let first = all.iter().position(|f| f.contact).unwrap();
            assert!(first > 10 && poses[..first].iter().all(|p| *p == start), "{name}");
            let (d, a) = pose_distance(poses.last().unwrap(), &end);
            println!("{name}: {} frames, ends {d:.5} m {a:.4} rad off", all.len());
            assert!(d < 3e-3 && a < 0.02, "{name}: ends {d} m, {a} rad from where it should");
            for (k, pair) in poses.windows(2).enumerate() {
                let (d, a) = pose_distance(&pair[0], &pair[1]);
                assert!(d * rate < 0.5 && a * rate < 2.0, "{name} frame {k}: {d} m, {a} rad");
            }
            // The gripper that follows from the hand is where the object can be taken.
            let tool = all[first].tool.unwrap();
            let up = tool.rotation * Vector3::z();
            assert!(up.z < -0.9, "{name}: the tool points {up}");
            assert!(all.iter().all(|f| f.joints.iter().all(|j| j.z > -0.002)), "{name}");
        }
    }
}
