//! Every kind of trouble: the arm comes to rest, the status says why, and it goes on when told to.

mod bench;

use bench::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use tdv_geometry::pose_distance;
use tdv_robot::collision::{
    CollisionWorld, Fixture, FixtureShape, Margins, Workcell, fingertip_height,
};
use tdv_robot::motion::{ObjectPlace, Plan, Requests, StatusCode as S};
use tdv_robot::urdf::RobotModel;
use tdv_robot::{ArmController, ControllerParams, Desired};

fn strict() -> Bench {
    let mut b = Bench::new(ControllerParams::default());
    b.tick();
    b.input.requests.resume = true;
    b
}

fn lab() -> Bench {
    Bench::new(ControllerParams { auto_resume: true, ..Default::default() })
}

fn desired_speed(b: &Bench) -> f64 {
    let d = b.executor.sample(b.now);
    d.map_or(0.0, |d| d.qd.iter().fold(0.0, |m: f64, v| m.max(v.abs())))
}

/// Runs until the driver's target is at rest; seconds it took.
fn until_rest(b: &mut Bench) -> f64 {
    let begin = b.now;
    for _ in 0..200 {
        b.tick();
        if desired_speed(b) < 1e-9 {
            break;
        }
    }
    b.now.since(begin)
}

fn assert_still(b: &mut Bench, seconds: f64) {
    let before = b.k.fk_tcp(&b.q);
    b.run(seconds);
    let moved = pose_distance(&before, &b.k.fk_tcp(&b.q)).0;
    assert!(moved < 0.004, "moved {:.1} mm: {}", moved * 1e3, b.last_sentence());
}

#[test]
fn nothing_moves_before_joint_states_and_before_resume() {
    let mut c =
        ArmController::new(tdv_robot::Kinematics::ur5(), ControllerParams::default()).unwrap();
    let mut b = strict();
    b.input.joints = None;
    let out = c.step(b.now, &b.input);
    assert_eq!(out.status.code, S::WaitingForJoints);
    let mut nan = b.input.clone();
    nan.joints =
        Some(tdv_robot::motion::JointState { stamp: b.now, q: [f64::NAN; 6], qd: [0.0; 6] });
    let out = c.step(b.now, &nan);
    assert!(out.trajectory.is_none() && out.status.sentence.contains("NaN"), "{:?}", out.status);
    let mut b = Bench::new(ControllerParams::default());
    b.run(2.0);
    assert_eq!((b.last_code(), b.log.paths), (S::Ready, 0));
    b.input.requests.resume = true;
    b.run(1.0);
    assert_eq!(b.last_code(), S::Following);
}

#[test]
fn a_dead_controller_means_a_stopped_arm() {
    for n in 0..12 {
        let mut b = strict();
        b.run(0.9 + 0.173 * f64::from(n));
        assert!(desired_speed(&b) > 0.01, "moving when killed");
        b.alive = false;
        let t = until_rest(&mut b);
        assert!(t <= 0.2 + 2.0 * TICK, "at rest after {t}");
    }
}

#[test]
fn stale_observations_stop_the_arm_within_350_ms_until_resume() {
    let mut worst: f64 = 0.0;
    for n in 0..12 {
        let mut b = strict();
        b.run(1.2 + 0.171 * f64::from(n));
        b.perceive = false;
        until_rest(&mut b);
        worst = worst.max(b.now.since(b.last_frame));
        b.run(0.3);
        assert_eq!(b.last_code(), S::HoldStale);
        assert!(b.last_sentence().contains("ms old"), "{}", b.last_sentence());
        b.perceive = true;
        assert_still(&mut b, 1.0);
        b.input.requests.resume = true;
        b.run(40.0);
        assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    }
    println!("at rest {worst:.3} s after the last frame at the latest");
    assert!(worst <= 0.350, "{worst}");
}

#[test]
fn without_a_word_of_the_switch_policy_the_arm_rests_within_350_ms() {
    let mut b = strict();
    b.run(1.2);
    b.decide = false;
    let last_word = b.now;
    until_rest(&mut b);
    assert!(b.now.since(last_word) <= 0.350, "{}", b.now.since(last_word));
    b.run(0.3);
    assert_eq!(b.last_code(), S::HoldStale);
    assert!(b.last_sentence().contains("switch policy"), "{}", b.last_sentence());
    b.decide = true;
    b.input.requests.resume = true;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
}

#[test]
fn bad_plans_move_nothing() {
    let cases: [(&str, fn(&mut Plan)); 7] = [
        ("not a finite pose", |p| p.poses[5].translation.vector.x = f64::NAN),
        ("not a finite pose", |p| p.reference_pose.translation.vector.z = f64::INFINITY),
        ("poses, expected", |p| p.poses.clear()),
        ("dt is", |p| p.dt = -0.05),
        ("in the future", |p| p.stamp = p.stamp.plus(1.0)),
        ("ms old", |p| p.stamp = p.stamp.plus(-1.0)),
        ("it jumps", |p| p.reference_pose.translation.vector.x -= 0.30),
    ];
    for (says, tamper) in cases {
        let mut b = Bench::new(ControllerParams { auto_resume: true, ..Default::default() });
        b.tamper = Some(tamper);
        b.run(1.0);
        assert_eq!(b.log.paths, 0, "{says}");
        assert!(b.last_sentence().contains(says), "{says}: {}", b.last_sentence());
        // In mid-motion the last good plan is followed while it is fresh, then the arm holds.
        let mut b = strict();
        b.run(1.5);
        b.tamper = Some(tamper);
        let begin = b.now;
        until_rest(&mut b);
        let took = b.now.since(begin);
        b.run(0.3);
        assert_eq!(b.last_code(), S::HoldStale, "{says}");
        assert!(b.last_sentence().contains(says), "{says}: {}", b.last_sentence());
        assert!(took <= 0.350 + 0.034 + TICK, "{says}: {took}");
    }
}

#[test]
fn nothing_goes_through_the_table() {
    let mut b = lab();
    b.tamper = Some(|p| p.reference_pose.translation.vector.z -= 0.12);
    let mut least = f64::INFINITY;
    for _ in 0..1500 {
        b.tick();
        if let Some(d) = b.executor.sample(b.now) {
            least = least.min(fingertip_height(&b.k.fk(&d.q), 0.7929));
        }
    }
    println!("lowest fingertips {:.1} mm: {}", least * 1e3, b.last_sentence());
    let clearance = b.controller.params().limits.fingertip_clearance;
    assert!(least >= clearance - 1e-3, "{least}");
    assert!(b.log.codes.contains(&S::HoldRefused));
    assert!(b.log.sentences.iter().any(|s| s.contains("above the table")), "{:?}", b.log.sentences);
}

#[test]
fn a_plan_a_little_too_low_slides_along_the_table() {
    let mut b = lab();
    let low = b.references[0].inverse() * down(0.58, 0.18, 0.012, 0.6);
    let start = b.policies[0].path[0];
    b.policies[0].path = path(start, low, 0.0);
    for _ in 0..1000 {
        b.tick();
    }
    assert_eq!(b.last_code(), S::Following, "{}", b.last_sentence());
    let d = b.executor.sample(b.now).unwrap();
    let height = fingertip_height(&b.k.fk(&d.q), 0.7929);
    assert!((height - 0.005).abs() < 0.001, "{height}");
}

#[test]
fn out_of_reach_is_refused_where_it_begins() {
    let mut b = lab();
    let mut params = ControllerParams { auto_resume: true, ..Default::default() };
    params.limits.workspace_x = [0.0, 2.0];
    b.controller = ArmController::new(b.k.clone(), params).unwrap();
    let start = b.policies[0].path[0];
    b.policies[0].path = path(start, b.references[0].inverse() * down(1.1, 0.0, 0.3, 0.3), 0.0);
    b.run(12.0);
    assert!(b.log.codes.contains(&S::HoldRefused));
    assert!(b.log.sentences.iter().any(|s| s.contains("out of reach")), "{:?}", b.log.sentences);
}

#[test]
fn a_failed_grip_is_tried_again() {
    let mut b = lab();
    b.object = None;
    let mut low = f64::INFINITY;
    let mut recovered = None;
    for _ in 0..3000 {
        let Some(out) = b.tick() else { continue };
        let z = b.k.fk_tcp(&b.q).translation.z;
        low = low.min(z);
        let ended = b.policies[0].at_end(&b.relative());
        if b.procedure == 0 && ended && out.status.code == S::Following && recovered.is_none() {
            b.procedure = 1;
        }
        if out.reset_switch {
            recovered = Some(z);
            b.object = Some(0.064);
        }
    }
    assert!(recovered.unwrap() - low > 0.09, "backed off 0.1 m before starting over");
    assert!(b.log.sentences.iter().any(|s| s.contains("grip failed: the fingers closed to ")));
    b.run(30.0);
    assert_eq!(b.last_code(), S::Done, "{:?}", b.log.codes);
}

#[test]
fn a_lost_object_is_noticed() {
    let mut b = lab();
    b.run(7.0);
    assert_eq!((b.last_code(), b.procedure), (S::Following, 1), "{}", b.last_sentence());
    b.object = None;
    b.run(0.8);
    assert_eq!(b.last_code(), S::Recovering);
    assert!(b.last_sentence().contains("object lost"), "{}", b.last_sentence());
    b.object = Some(0.064);
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?}", b.log.codes);
}

#[test]
fn an_object_that_slips_is_noticed_by_fingers_or_camera() {
    let slips: [(&str, fn(&mut Bench)); 2] = [
        ("fingers are 50.0 mm apart", |b| b.object = Some(0.050)),
        ("camera sees it apart", |b| b.place = ObjectPlace::Apart),
    ];
    for (says, slip) in slips {
        let mut b = lab();
        b.run(7.0);
        assert_eq!((b.last_code(), b.procedure), (S::Following, 1), "{}", b.last_sentence());
        slip(&mut b);
        b.run(0.3);
        let early = b.last_code() == S::Recovering;
        b.run(0.5);
        assert_eq!(b.last_code(), S::Recovering, "{says}");
        assert!(b.last_sentence().contains(says), "{}", b.last_sentence());
        assert_eq!(early, b.place == ObjectPlace::Held, "the camera is given more time");
        (b.object, b.place) = (Some(0.064), ObjectPlace::Held);
        b.run(40.0);
        assert_eq!(b.last_code(), S::Done, "{:?}", b.log.codes);
    }
    // A word from before the tracker knew of the grip, and one that does not last, mean nothing.
    let mut b = lab();
    b.run(7.0);
    b.place = ObjectPlace::Apart;
    b.run(0.3);
    b.place = ObjectPlace::Unknown;
    b.run(0.3);
    b.place = ObjectPlace::Held;
    b.run(40.0);
    assert!(!b.log.codes.contains(&S::Recovering), "{:?}", b.log.codes);
}

#[test]
fn a_silent_gripper_stops_the_arm_until_it_speaks() {
    let mut b = lab();
    b.run(7.0);
    b.gripper_speaks = false;
    b.run(1.2);
    assert_eq!(b.last_code(), S::HoldGripper);
    assert!(b.last_sentence().contains("no word of the gripper"), "{}", b.last_sentence());
    assert_still(&mut b, 1.0);
    b.gripper_speaks = true;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?}", b.log.codes);
    assert!(!b.log.codes.contains(&S::Recovering));
}

#[test]
fn a_dry_run_shows_paths_from_where_the_arm_is_and_commands_nothing() {
    let params = ControllerParams { auto_resume: true, dry_run: true, ..Default::default() };
    let mut b = Bench::new(params);
    let mut shown = 0;
    for n in 0..500 {
        b.input.requests.home = n == 400;
        let q = b.q;
        let out = b.tick().unwrap();
        b.q = q; // a driver would not get the path
        assert!(out.gripper.is_none() && out.status.sentence.starts_with("dry run: "));
        if let Some(p) = out.trajectory {
            shown += 1;
            assert!((0..6).all(|i| (p.points[0].q[i] - q[i]).abs() < 0.02));
        }
    }
    assert!(shown > 100, "{shown}");
}

#[test]
fn the_arm_slows_down_into_a_singularity_and_goes_no_further() {
    // To a pose with a stretched elbow, just within reach.
    let mut b = lab();
    let mut params = ControllerParams { auto_resume: true, ..Default::default() };
    (params.limits.workspace_x, params.limits.workspace_z) = ([-2.0, 2.0], [0.0, 2.0]);
    let stop = params.limits.singular_stop;
    b.controller = ArmController::new(b.k.clone(), params).unwrap();
    let stretched = b.k.fk_tcp(&[b.q[0], -0.9, 0.005, -0.7, b.q[4], b.q[5]]);
    let inverse = b.references[0].inverse();
    b.policies[0].path = path(b.policies[0].path[0], inverse * stretched, 0.0);
    let mut worst: f64 = 0.0;
    for _ in 0..1500 {
        b.tick();
        let d = b.executor.sample(b.now).unwrap_or(Desired { q: b.q, qd: [0.0; 6] });
        worst = worst.max(b.k.dexterity(&d.q).condition);
    }
    println!("condition number at most {worst:.0}: {:?}", b.log.sentences.last());
    assert!(worst > 100.0 && worst <= 1.02 * stop, "{worst}");
}

#[test]
fn pause_resume_abort_reset_and_enable() {
    let mut b = lab();
    b.run(1.5);
    b.input.requests = Requests { pause: true, ..Default::default() };
    let took = until_rest(&mut b);
    assert!(took <= 0.2 + 2.0 * TICK);
    assert_eq!(b.last_code(), S::Paused);
    // The arm is as far behind as its servo lags.
    b.run(0.3 - took);
    assert_still(&mut b, 1.0);
    b.input.requests.resume = true;
    b.run(0.5);
    assert_eq!(b.last_code(), S::Following);
    b.input.disabled = Some("the program does not run".into());
    b.run(0.5);
    assert_eq!(b.last_code(), S::Disabled);
    b.input.disabled = None;
    b.run(0.5);
    assert_eq!(b.last_code(), S::Following, "the lab goes on by itself");
    b.input.requests.abort = true;
    b.run(0.5);
    b.input.requests.resume = true;
    assert_still(&mut b, 0.5);
    assert_eq!(b.last_code(), S::Aborted);
    b.input.requests.reset = true;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?}", b.log.codes);
    assert!(b.log.codes.contains(&S::Preparing));
}

#[test]
fn missing_joint_states_and_an_arm_that_does_not_follow() {
    let mut b = strict();
    b.run(1.5);
    b.guard = None;
    b.lag = 1e9; // a protective stop: targets go out, nothing moves
    b.run(2.0);
    assert_eq!(b.last_code(), S::HoldJoints);
    assert!(b.last_sentence().contains("does not follow"), "{}", b.last_sentence());
    b.lag = 0.045;
    b.executor.hold(b.now, b.q);
    b.input.requests.resume = true;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "goes on from the measured joints: {:?}", b.log.codes);

    let mut b = strict();
    b.run(1.5);
    let frozen = b.input.joints;
    for _ in 0..60 {
        b.now = b.now.plus(TICK);
        b.input.joints = frozen;
        b.input.plan.as_mut().unwrap().stamp = b.now;
        let out = b.controller.step(b.now, &b.input);
        if out.status.code == S::HoldJoints {
            assert!(out.status.sentence.contains("driver"), "{}", out.status.sentence);
        }
        b.log.codes.push(out.status.code);
    }
    assert_eq!(b.last_code(), S::HoldJoints);
}

#[test]
fn a_restarted_controller_goes_on_with_the_object_in_hand() {
    let mut b = lab();
    b.run(7.0);
    assert_eq!((b.last_code(), b.procedure), (S::Following, 1));
    b.alive = false;
    b.run(1.0);
    b.controller = ArmController::new(b.k.clone(), ControllerParams::default()).unwrap();
    b.alive = true;
    b.run(1.0);
    assert_eq!(b.last_code(), S::Ready);
    b.input.requests.resume = true;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    assert!(!b.log.codes.contains(&S::Recovering));
}

#[test]
fn a_switch_policy_that_begins_anew_makes_nothing_drop() {
    let mut b = lab();
    b.run(7.0);
    assert_eq!((b.last_code(), b.procedure), (S::Following, 1));
    let closed = b.knuckle;
    b.procedure = 0;
    b.run(1.5);
    assert_eq!(b.last_code(), S::HoldStale);
    assert!(b.last_sentence().contains("while an object is held"), "{}", b.last_sentence());
    assert!((b.knuckle - closed).abs() < 0.01, "the fingers opened: {closed} {}", b.knuckle);
    // By the status the policy has learned where the task was.
    assert_eq!(b.controller.step(b.now, &b.input).status.procedure, 1);
    b.procedure = 1;
    b.run(40.0);
    assert_eq!(b.last_code(), S::Done, "{:?} {}", b.log.codes, b.last_sentence());
    assert!(!b.log.codes.contains(&S::Recovering));
}

#[test]
fn a_gripper_that_does_not_open_is_named() {
    let mut b = lab();
    b.run(7.0);
    b.complete = true;
    for _ in 0..600 {
        let before = b.knuckle;
        b.tick();
        b.knuckle = before.max(b.knuckle); // stuck
    }
    assert!(b.log.codes.contains(&S::HoldGripper), "{:?}", b.log.codes);
    let said = |s: &String| s.contains("gripper not open") && s.contains("knuckle at 0.");
    assert!(b.log.sentences.iter().any(said), "{:?}", b.log.sentences);
}

#[test]
fn home_and_speed_scaling() {
    let mut b = lab();
    b.perceive = false;
    b.run(0.5);
    b.input.requests.home = true;
    b.run(15.0);
    assert!(b.log.codes.contains(&S::Homing));
    let home = b.controller.params().home;
    assert!((0..6).all(|i| (b.q[i] - home[i]).abs() < 0.005), "{:?}", b.q);
    b.input.speed_scaling = 0.0;
    b.run(0.2);
    assert_eq!(b.last_code(), S::Disabled);
    b.input.speed_scaling = f64::NAN;
    b.run(0.2);
    assert_eq!(b.last_code(), S::Disabled);
}

/// A wall between the arm and its home pose, and one in the way of a plan.
#[test]
fn the_way_home_leads_around_a_wall_and_no_plan_through_it() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/robot");
    let model = RobotModel::load(&folder.join("ur5_2f85.urdf")).unwrap();
    let wall = |position: [f64; 3], edges: [f64; 3]| Fixture {
        name: "wall".into(),
        shape: FixtureShape::Box(edges),
        position,
        rpy: [0.0; 3],
    };
    let world = |wall: Fixture| {
        CollisionWorld::new(&model, &Workcell::new(vec![wall]), Margins::default(), 0.0).unwrap()
    };
    // Start: tcp at y = -0.12, home: tcp near y = 0.11; the wall stands between.
    let around = world(wall([0.45, 0.02, 0.20], [0.5, 0.02, 0.40]));
    let mut params = ControllerParams { auto_resume: true, ..Default::default() };
    params.home = [0.45, -1.9, 1.9, -1.5708, -1.5708, 0.0];
    let mut b = Bench::new(params.clone());
    assert!(around.check(&b.q, 0.0, None).is_ok() && around.check(&params.home, 0.0, None).is_ok());
    let straight = (1..20).any(|i| {
        let x = f64::from(i) / 20.0;
        let q = std::array::from_fn(|j| b.q[j] + (params.home[j] - b.q[j]) * x);
        around.check(&q, 0.0, None).is_err()
    });
    assert!(straight, "the straight line is free: the test tests nothing");
    b.controller =
        ArmController::new(b.k.clone(), params.clone()).unwrap().with_world(around.clone());
    b.perceive = false;
    b.run(0.3);
    b.input.requests.home = true;
    let mut least = f64::INFINITY;
    for _ in 0..4000 {
        b.tick();
        least = least.min(around.distance(&b.q, 0.0, None).unwrap().distance);
    }
    assert!((0..6).all(|i| (b.q[i] - params.home[i]).abs() < 0.005), "{:?}", b.log.sentences);
    println!("nearest to the wall or itself {:.1} mm", least * 1e3);
    assert!(least > 0.0, "{least}");

    // Low and right on the way to the object: the arm stops before it.
    let ahead = world(wall([0.50, 0.05, 0.15], [0.02, 0.3, 0.30]));
    let mut b = lab();
    let params = ControllerParams { auto_resume: true, ..Default::default() };
    b.controller = ArmController::new(b.k.clone(), params).unwrap().with_world(ahead.clone());
    let mut least = f64::INFINITY;
    for _ in 0..800 {
        b.tick();
        least = least.min(ahead.distance(&b.q, b.knuckle, None).unwrap().distance);
    }
    assert!(least > 0.0, "{least}");
    assert!(b.log.sentences.iter().any(|s| s.contains("from wall")), "{:?}", b.log.sentences);
}

/// Whatever comes in, in whatever order: no panic, and nothing but sound trajectories that go on from
/// the one before.
#[test]
fn chaos() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    // A course may end early with something in the gripper; all together must have moved.
    let mut paths = 0;
    for _ in 0..6 {
        let mut b = lab();
        for n in 0..4000 {
            b.tamper = match rng.random_range(0..40) {
                0 => Some(|p| p.poses.truncate(1)),
                1 => Some(|p| p.poses[9].translation.vector.z = f64::NAN),
                2 => Some(|p| p.reference_pose.translation.vector.x += 0.15),
                3 => Some(|p| p.reference_pose.translation.vector.z -= 0.1),
                4 => Some(|p| p.moving_pose = None),
                5 => Some(|p| p.stamp = p.stamp.plus(0.5)),
                6 => Some(|p| p.dt = 1e-9),
                7 => Some(|p| p.poses.reverse()),
                8 => Some(|p| p.procedure += 1),
                _ => None,
            };
            let r = rng.random_range(0..2000);
            b.input.requests = Requests {
                pause: r == 0,
                resume: r % 50 == 1,
                reset: r == 2,
                home: r == 3,
                abort: r == 4,
            };
            b.input.disabled = (n % 700 == 0).then(|| "dead-man switch".into());
            b.perceive = rng.random_range(0..100) != 0;
            if r == 5 {
                b.object = None;
            } else if r == 6 {
                b.object = Some(0.05);
            } else if r < 12 {
                b.procedure = rng.random_range(0..3);
            } else if r < 14 {
                b.complete = !b.complete;
            }
            let before = b.controller.commanded();
            let out = b.tick().unwrap();
            if let (Some(path), Some((q, _))) = (out.trajectory, before) {
                let first = path.points[0];
                let most = (0..6).map(|i| (first.q[i] - q[i]).abs()).fold(0.0, f64::max);
                assert!(most <= 1.0 * (first.time + TICK) + 0.02, "{most} rad in {} s", first.time);
            }
        }
        println!("{} paths, {:?}", b.log.paths, b.log.codes);
        paths += b.log.paths;
    }
    assert!(paths > 600, "{paths}");
}
